"""The quickest motion of limited jerk along a path, as a nonlinear programme that IPOPT solves.

The path is gone through as s = S(τ), S = 10 τ³ - 15 τ⁴ + 6 τ⁵: however τ grows with time, the legs begin and end at
rest and without acceleration. Sought is y = τ̇² as a function of τ, a cubic B-spline with positive coefficients. With
derivatives by τ as primes,

    ṡ² = S'² y,    s̈ = S'' y + S' y' / 2,    s⃛ = √y (S''' y + 3/2 S'' y' + 1/2 S' y''),

so that limits of speed, acceleration and force are linear in the coefficients. The jerk of a leg of length l(s),

    dl/ds s⃛ + 3 d²l/ds² ṡ s̈ + d³l/ds³ ṡ³,

is √y times something linear. The duration, the integral of 1/√y, is convex. Where the third derivative of the path
jumps, at its knots, y'' may jump too, and the limits hold on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import BPoly, BSpline
from scipy.special import betaincinv

from spm_pin.errors import ArgumentError
from spm_pin.motion.least_time import Clock, even_grid
from spm_pin.motion.paths import LimitRows
from spm_pin.support.arguments import FloatArray, IntArray

_EASE = [Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0]).deriv(order) for order in range(4)]
"""S and its derivatives."""
_PIECES = 400
"""Largest number of polynomials that y is made of; else a tenth of the grid's parts."""
_POINTS = 5
"""Points of each polynomial at which the programme keeps the limits, at first."""
_ROUNDS = 4
"""Maximum number of programmes: each also keeps the limits where the previous one did not."""
_ACCEPTED = 0.9995
"""Share of y, keeping all limits, above which no further programme is solved."""
_LEAST = 1e-6
"""Smallest coefficient of y, as a share of the fastest constant y."""
_LEFT = 1e-12
"""Distance to the left of a grid point at which the values from the left are evaluated."""


@dataclass(frozen=True)
class EasedGrid:
    """Even steps of τ from 0 to 1, moved to the path's knots where these are near."""

    tau: FloatArray  # the grid, shape (n,)
    corners: IntArray  # indices in `tau` of the inner knots of the path, shape (k,)

    @classmethod
    def from_knots(cls, knots: FloatArray, parts: int) -> EasedGrid:
        """Return a grid for a path with knots (k,) at parameters from 0 to 1."""
        moved = betaincinv(3.0, 3.0, knots)
        tau = even_grid(moved, parts)
        return cls(tau, np.searchsorted(tau, moved[1:-1]))

    @property
    def parameters(self) -> FloatArray:
        """The parameters s = S(τ) of the path, shape (n,)."""
        return np.asarray(np.clip(_EASE[0](self.tau), 0.0, 1.0))


def limited_jerk(
    grid: EasedGrid, rows: LimitRows, first: FloatArray, second: FloatArray, jerks: FloatArray
) -> tuple[float, Clock, float]:
    """Return the duration [s] and the clock of the quickest motion that keeps all limits on a grid of n points.

    `rows` are the limits at its parameters, `first` and `second` (n, legs) the derivatives of the leg lengths by s
    there, `jerks` (legs,) the largest jerk of each leg [m/s³]. The third result is by which share of it the duration
    may be above the least: how much longer it is with half as many polynomials. Raises `ArgumentError` if there is no
    such motion.
    """
    programme = _Programme.from_rows(grid, rows, first, second, jerks)
    count = len(programme.tau)
    one, none = np.ones((count, 1)), np.zeros((count, 1))
    top = float(programme.feasible_scale([one, none, none]).min())
    if not 0.0 < top < np.inf:
        cause = "A force limit that only just holds the machine?"
        raise ArgumentError("path", "a path along which a motion within the limits exists", "no such motion", cause)
    pieces = int(np.clip(len(grid.tau) // 10, 4, _PIECES))
    rough = _quickest(programme, grid, BSpline([0.0, 0.0, 1.0, 1.0], [0.9 * top] * 2, 1), top, pieces // 2)
    fine = _quickest(programme, grid, rough, top, pieces)
    durations = [_times(grid.tau, y)[-1] for y in (rough, fine)]
    y = fine if durations[1] <= durations[0] else rough
    times = _times(grid.tau, y)
    reached = BPoly.from_derivatives(times, np.stack([grid.tau, np.sqrt(y(grid.tau)), 0.5 * y(grid.tau, 1)], axis=-1))

    def clock(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        tau = np.clip(reached(at), 0.0, 1.0)
        s, s1, s2 = (_EASE[order](tau) for order in range(3))
        return np.clip(s, 0.0, 1.0), s1 * np.sqrt(y(tau)), s2 * y(tau) + 0.5 * s1 * y(tau, 1)

    return float(times[-1]), clock, abs(float(durations[0] / durations[1]) - 1.0)


def _times(tau: FloatArray, y: BSpline) -> FloatArray:
    """Return the times at the points of a grid (n,)."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    half = 0.5 * np.diff(tau)[:, None]
    steps = (half * weights / np.sqrt(y(tau[:-1, None] + half * (1.0 + nodes)))).sum(axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _quickest(programme: _Programme, grid: EasedGrid, start: BSpline, top: float, pieces: int) -> BSpline:
    """Return the quickest y made of so many polynomials that keeps all limits; `start` keeps them."""
    inner = grid.tau[grid.corners]
    knots = even_grid(np.concatenate([[0.0], inner, [1.0]]), pieces)
    # Twice at the path's knots: there y'' may jump.
    knots = np.sort(np.concatenate([[0.0] * 3, knots, knots[1:-1][np.isin(knots[1:-1], inner)], [1.0] * 3]))
    count = len(programme.tau)
    chosen = np.zeros(count, dtype=bool)
    chosen[np.linspace(0, count - 1, _POINTS * pieces + 1).round().astype(int)] = True
    chosen[2 * grid.corners - 1] = chosen[2 * grid.corners] = True
    middle = np.array([knots[k + 1 : k + 4].mean() for k in range(len(knots) - 4)])
    y = BSpline(knots, 0.9 * start(middle), 3)
    for _ in range(_ROUNDS):
        y = programme.solve(y, top, np.flatnonzero(chosen))
        scale = programme.feasible_scale([y(programme.tau, order)[:, None] for order in range(3)])
        if scale.min() > _ACCEPTED:
            break
        chosen |= scale < _ACCEPTED
    y = BSpline(knots, float(scale.min()) * y.c, 3)
    slowest = BSpline(knots, np.full(len(knots) - 4, top), 3)
    return y if _times(grid.tau, y)[-1] <= _times(grid.tau, slowest)[-1] else slowest


@dataclass(frozen=True)
class _Programme:
    """The limits at both ends of every part of the grid, (m,) points; derivatives (m, legs) of readings there."""

    tau: FloatArray
    rows: LimitRows
    first: FloatArray
    second: FloatArray
    third: FloatArray  # first and second derivatives by s, and the derivative of the second one by τ
    jerks: FloatArray

    @classmethod
    def from_rows(
        cls, grid: EasedGrid, rows: LimitRows, first: FloatArray, second: FloatArray, jerks: FloatArray
    ) -> _Programme:
        index = np.repeat(np.arange(len(grid.tau)), 2)[1:-1]
        tau = grid.tau[index] - np.tile([0.0, _LEFT], len(grid.tau) - 1)
        third = []
        for begin, end in pairwise([0, *grid.corners.tolist(), len(grid.tau) - 1]):
            segment = slice(begin, end + 1)
            slopes = np.gradient(second[segment], grid.tau[segment], axis=0, edge_order=2 if end - begin > 1 else 1)
            third.append(np.repeat(slopes, 2, axis=0)[1:-1])
        return cls(tau, rows[index], first[index], second[index], np.concatenate(third), jerks)

    def motion(self, y: list[FloatArray], at: Any = slice(None)) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ṡ², s̈ and the legs' jerks over √y (legs, p, k), of y and its derivatives (p, k) at p of the points."""
        s1, s2, s3 = (_EASE[order](self.tau[at])[:, None] for order in (1, 2, 3))
        x, u, jerk = s1**2 * y[0], s2 * y[0] + 0.5 * s1 * y[1], s3 * y[0] + 1.5 * s2 * y[1] + 0.5 * s1 * y[2]
        first, second, third = (values[at].T[..., None] for values in (self.first, self.second, self.third))
        return x, u, first * jerk + 3.0 * second * s1 * u + third * x

    def feasible_scale(self, y: list[FloatArray]) -> FloatArray:
        """Return the largest factor of y (m, 1) with which all limits hold, at each point."""
        x, u, jerk = self.motion(y)
        used = (np.sqrt(y[0][:, 0]) * np.abs(jerk[..., 0]) / self.jerks[:, None]).max(axis=0)
        return np.asarray(
            np.minimum(self.rows.feasible_scale(x[:, 0], u[:, 0]), np.maximum(used, 1e-300) ** (-2.0 / 3.0))
        )

    def solve(self, start: BSpline, top: float, at: IntArray) -> BSpline:
        """Return the quickest y that keeps the limits at p of the points; its unknowns are in units of `top`."""
        import casadi as ca

        count, rows = len(start.c), self.rows[at]
        basis = BSpline(start.t, np.eye(count), 3)
        values = [basis(self.tau[at], order) for order in range(3)]
        x, u, jerk = self.motion(values, at)
        z = ca.MX.sym("z", count)

        def times_z(matrix: FloatArray) -> Any:
            return ca.mtimes(ca.sparsify(ca.DM(matrix)), z)

        root, width = ca.sqrt(times_z(values[0])), rows.upper - rows.lower
        used = [
            times_z(top * (a[:, None] * u + b[:, None] * x) / w)
            for a, b, w in zip(rows.a.T, rows.b.T, width, strict=True)
        ]
        used.append(times_z(top * x / rows.fastest[:, None]))
        used += [root * times_z(top**1.5 * row / most) for row, most in zip(jerk, self.jerks, strict=True)]
        ones = np.ones((1 + len(self.jerks)) * len(at))
        lower, upper = ((((limit - rows.c) / width).T.ravel()) for limit in (rows.lower, rows.upper))
        weights = np.gradient(self.tau[at])
        quiet: Any = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 500, "tol": 1e-6}}
        problem = {"x": z, "f": ca.dot(weights, 1.0 / root), "g": ca.densify(ca.vertcat(*used))}
        solver = ca.nlpsol("limited_jerk", "ipopt", problem, quiet)
        bounds = {"lbg": np.concatenate([lower, -ones]), "ubg": np.concatenate([upper, ones])}
        unknowns = np.asarray(solver(x0=start.c / top, lbx=_LEAST, **bounds)["x"])[:, 0]
        # If IPOPT has not converged, its last result is slowed down.
        return BSpline(start.t, top * np.maximum(unknowns, _LEAST), 3) if np.isfinite(unknowns).all() else start
