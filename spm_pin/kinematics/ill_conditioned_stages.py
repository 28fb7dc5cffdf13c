"""Assembly modes of single stages with many digits, where double precision cannot count them.

Beside lengths with a continuous family all terms of the quartic nearly cancel, so that its roots lose as many digits as
the lengths share with the family's; and beside very short legs rounding of the equations is larger than the legs are.
The same equations are solved here as in `spm_pin.kinematics.kernels`, one stage at a time.
"""

from __future__ import annotations

import math
import operator
from functools import reduce
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx
from numpy.polynomial import Polynomial

from spm_pin.formulas.operations import bind
from spm_pin.formulas.stages import StageEquations, corners, quartic, residual, stage_equations, tilt_quadratic
from spm_pin.kinematics.kernels.mode_kernels import PLACES
from spm_pin.mechanism.arguments import FloatArray

_DIGITS = 600
"""So many that of a root of multiplicity four, and of the square root of what comes from it, 75 are left."""
_REAL, _SOLVED, _SAME = 1e-20, 1e-40, 1e-14


def solve_stage_with_more_digits(lengths: FloatArray, pivot_radius: float, side: float, above: float) -> FloatArray:
    """Return the sixteen assembly modes of a stage (16, 5), as `kernels.mode_kernels` orders them, NaN where none is.

    `pivot_radius` is E or C [m], and `above` 1 where the sheet + is above the pivots, -1 where it is below.
    """
    modes = np.full((4 * PLACES, 5), np.nan)
    with ctx.workdps(_DIGITS):
        r = arb(side) / arb(3).sqrt()
        first, second, third, epsilon = (arb(x) / r for x in [*lengths.tolist(), pivot_radius])
        for mode, signed in enumerate((epsilon, -epsilon)):
            equations: Any = bind(stage_equations, COS_30=arb(3).sqrt() / 2)
            stage = equations(first, second, third, signed)
            for place, (x0, x1, x2, zeta) in enumerate(_in_order(_solutions(stage), mode == 1)[:PLACES]):
                plain = (0.0, -x2, x1, x0, zeta) if mode else (x0, x1, x2, 0.0, zeta)
                _, heights = corners(*plain)
                flat = max(abs(h) for h in heights) <= _SAME
                for sheet in range(1 if flat else 2):
                    sign = above if sheet == 0 else -above
                    q0, q1, q2, q3, height = plain
                    modes[(mode * PLACES + place) * 2 + sheet] = q0, sign * q1, sign * q2, q3, sign * height
    return modes


def _solutions(stage: StageEquations) -> list[list[float]]:
    """Return all distinct solutions x0, x1, x2, ζ of one mode, x0 and ζ not negative."""
    harmonic: Any = acb(stage.real, stage.imag)
    kappa, size = 2 * stage.epsilon - 1, abs(harmonic)
    nu: Any = harmonic / size if size > 0 else acb(3, 4) / 5
    mu, span = nu**3, abs(acb(kappa, size))
    omega: Any = abs(kappa) / span
    gain: Any = (-1 if kappa < 0 else 1) / span
    # Turned by an angle that no root shares, so that none is at infinity.
    turn = arb(0.777).tan()
    solutions: list[list[float]] = []
    for t in _real_roots(_substituted(quartic(stage, size, mu.real, mu.imag, omega, gain), turn)):
        gamma = acb(1 - t * turn, t + turn)
        gamma /= abs(gamma)
        delta = acb(gamma.real, omega * gamma.imag)
        for state in _states(stage, delta / abs(delta) * nu.conjugate(), size * gain * gamma.imag / abs(delta)):
            if all(max(abs(x - y) for x, y in zip(state, known, strict=True)) > _SAME for known in solutions):
                solutions.append(state)
    return solutions


def _substituted(coefficients: tuple[Any, ...], turn: Any) -> list[Any]:
    """Return a quartic of tan γ as one of t, tan γ = (t + turn) / (1 - t turn), from its constant up."""
    above, below = (Polynomial(np.array(ends)) for ends in ([turn, arb(1)], [arb(1), -turn]))
    terms = (above**power * below ** (4 - power) * c for power, c in enumerate(coefficients))
    return list(reduce(operator.add, terms).coef)


def _real_roots(coefficients: list[Any]) -> list[Any]:
    """Return the real roots of a quartic, multiple ones as often: eigenvalues of its companion matrix."""
    companion = acb_mat([[int(j == i + 1) for j in range(4)] for i in range(4)])
    for k in range(4):
        companion[3, k] = -coefficients[k] / coefficients[4]
    roots = (root.mid() for root in companion.eig(algorithm="approx"))
    return [root.real for root in roots if abs(root.imag) <= _REAL * (1 + abs(root.real))]


def _states(stage: StageEquations, turn: Any, a: Any) -> list[list[float]]:
    """Return the solutions of one azimuth, see `kernels.mode_kernels`."""
    b = stage.real * turn.real - stage.imag * turn.imag
    cosine = (turn**3).real
    square, linear, constant = tilt_quadratic(stage, a, b, cosine)
    root = _root(linear * linear - 4 * square * constant)
    larger: Any = -(linear + (-root if linear < 0 else root)) / 2
    states = []
    for p in larger / square, constant / larger if larger != 0 else arb(0):
        if not -0.01 < p < 1.01:
            continue
        p = p.max(arb(0)).min(arb(1)).mid()
        upper = _root(p) if b >= (2 * stage.epsilon - 1 + 2 * p) * p * cosine else -_root(p)
        x0, zeta = _root(1 - p), _root(stage.level - (2 * stage.epsilon + p) * p)
        state = x0, upper * turn.real, upper * turn.imag, zeta
        if max(abs(float(value)) for value in residual(stage, state)) <= _SOLVED * float(stage.scale):
            states.append([float(x) for x in state])
    return states


def _root(x: Any) -> Any:
    """Return the square root of a number that may be negative by rounding, then zero."""
    return x.mid().max(arb(0)).sqrt()


def _in_order(states: list[list[float]], half_turned: bool) -> list[list[float]]:
    """Sort by falling mean radius; where nine digits of it agree, by the azimuth of the tilt axis."""

    def key(state: list[float]) -> tuple[float, float]:
        x0, x1, x2, _ = state
        radius = -(x0**2) if half_turned else x0**2
        return -float(np.rint(1e9 * radius)), (math.atan2(x2, x1) + math.pi / 6.0) % math.pi

    return sorted(states, key=key)
