"""The least time along a path under limits that are linear in u = s̈ and x = ṡ², as a convex programme.

On a grid of parameters x is linear from each point to the next, so that u = (x_{k+1} - x_k) / (2 h) is constant there
and every limit at a parameter in between is a half-plane of the two values,

    g · (x_k, x_{k+1}) <= 1,

which rest, x = 0, keeps. Hence a motion that is slow enough keeps all limits of any path. They are kept at the points
and in the middle of the parts between them; parts over which a limit in use curves are split. Only the half-planes on
the convex hull of the g of a part matter. The duration, Σ 2 h / (√x_k + √x_{k+1}), is convex: IPOPT finds its least
value. A pass from one end to the other, as that of TOPP-RA, does not where a limit does not depend on u: at such a
point the largest x_k may be one from which there is no way but to stop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from spm_pin.motion.paths import LimitRows
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray

Clock = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""A function of times (m,) [s], which gives s, ṡ and s̈ there."""

_FASTEST = 1e16
"""Largest x without a limit, in units of that of a motion which keeps all limits."""
_LEAST = 1e-3
"""Smallest x, in units of the same."""
_SPLITS, _MOST_POINTS = 4, 40_000
"""Maximum number of times that parts are split, each time into four, and points of a grid above which none is split."""
_BROKEN = 5e-4
"""Share of a limit by which it may be broken between three points of a part before the part is split."""


def even_grid(knots: FloatArray, parts: int) -> FloatArray:
    """Return even steps from 0 to 1, (n,), the nearest to each inner knot (k,) moved there."""
    parts = max(parts, 2 * len(knots))
    nearest = np.clip((knots[1:-1] * parts).round().astype(np.intp), 1, parts - 1)
    grid = np.linspace(0.0, 1.0, parts + 1)
    grid[nearest] = knots[1:-1]
    # Knots nearer to each other than a step.
    return np.unique(np.concatenate([grid, knots]))


@dataclass
class _HalfPlanes:
    """Limits g · (x_k, x_{k+1}) <= 1 of parts k of a grid."""

    parts: IntArray  # indices of the parts, shape (m,)
    slopes: FloatArray  # the g, shape (m, 2)

    @classmethod
    def from_rows(cls, points: FloatArray, limits: LimitRows, nodes: IntArray) -> _HalfPlanes:
        """Return the limits on a coarser grid, of `nodes` (n,) of the points at which limits are known."""
        index = np.stack([nodes[:-1], (nodes[:-1] + nodes[1:]) // 2, nodes[1:]], axis=-1)
        steps, rows = np.diff(points[nodes]), limits[index.ravel()]
        shares = (points[index] - points[nodes[:-1], None]) / steps[:, None]
        a, b, c = (values.reshape(*index.shape, -1) for values in (rows.a, rows.b, rows.c))
        span = rows.upper - rows.lower
        # In terms of u and of x in the middle of the part: x there is so many times u away from it.
        arm = ((2.0 * shares - 1.0) * steps[:, None])[..., None]
        a = a + arm * b
        rooms = [np.maximum(room, 1e-12 * span) for room in (rows.upper - c, c - rows.lower)]
        fastest = 1.0 / rows.fastest.reshape(*index.shape, 1)
        change = np.concatenate(
            [a / rooms[0], -a / rooms[1], (2.0 * shares - 1.0)[..., None] * steps[:, None, None] * fastest], -1
        )
        level = np.concatenate([b / rooms[0], -b / rooms[1], fastest], -1)
        normals = np.stack([change, level], axis=-1).reshape(len(steps), -1, 2)
        kept = [_hull(each) for each in normals]
        parts = np.repeat(np.arange(len(steps)), [len(k) for k in kept])
        u, x = normals[parts, np.concatenate(kept)].T
        half = 0.5 * u / steps[parts]
        return cls(parts, np.stack([0.5 * x - half, 0.5 * x + half], axis=-1))

    def used(self, x: FloatArray) -> FloatArray:
        """Return which share of each limit values x (n,) at the points of the grid use, shape (m,)."""
        return np.asarray(self.slopes[:, 0] * x[self.parts] + self.slopes[:, 1] * x[self.parts + 1])


def _hull(normals: FloatArray) -> IntArray:
    """Return the indices of the normals (p, 2) of half-planes n · v <= 1 that are not implied by others."""
    size = np.abs(normals).max(axis=0)
    size[size == 0.0] = 1.0
    # x < 0 is not considered.
    points = np.concatenate([normals / size, [[0.0, -1e-6], [1e-6, 0.0], [-1e-6, 0.0]]])
    try:
        vertices = ConvexHull(points).vertices
    except QhullError:
        return np.arange(len(normals))
    return np.asarray(vertices[vertices < len(normals)])


class LeastTime:
    """The fastest motion along a path with knots (k,) from 0 to 1, whose limits at parameters (m,) are `rows_at`."""

    def __init__(self, knots: FloatArray, parts: int, rows_at: Callable[[FloatArray], LimitRows]) -> None:
        grid = even_grid(knots, parts)
        points = np.sort(np.concatenate([grid, 0.5 * (grid[1:] + grid[:-1])]))
        rows, start = rows_at(points), None
        for split in range(_SPLITS + 1):
            self.grid = points[::2]
            self._steps = np.diff(self.grid)
            self.x = _solved(self._steps, _HalfPlanes.from_rows(points, rows, np.arange(0, len(points), 2)), start)
            curved = self._curved_parts(rows)
            if split == _SPLITS or len(points) > _MOST_POINTS or not curved.any():
                break
            eighths = np.array([1.0, 2.0, 3.0, 5.0, 6.0, 7.0]) / 8.0
            more = (self.grid[:-1][curved, None] + eighths * self._steps[curved, None]).ravel()
            order = np.argsort(np.concatenate([points, more]))
            points, rows = np.concatenate([points, more])[order], rows.joined(rows_at(more))[order]
            start = np.interp(points[::2], self.grid, self.x)
        # The same with half as many points: the error of such a scheme is proportional to its step.
        corners = 2 * np.searchsorted(self.grid, knots)
        coarse = np.unique(np.concatenate([np.arange(0, len(points), 4), corners]))
        steps = np.diff(points[coarse])
        slower = _solved(steps, _HalfPlanes.from_rows(points, rows, coarse), None)
        self.error = abs(float(_durations(steps, slower).sum()) / self.duration - 1.0)
        """Share of the duration by which it is expected to be above the least one because of the grid."""

    def _curved_parts(self, rows: LimitRows) -> BoolArray:
        """Return the parts (n,) between whose points, ends and middle, a limit is probably broken."""
        inside = 2 * np.arange(len(self._steps))[:, None] + np.arange(3)
        x = np.stack([self.x[:-1], 0.5 * (self.x[:-1] + self.x[1:]), self.x[1:]], axis=-1)
        u = 0.5 * np.diff(self.x) / self._steps
        values = rows.a[inside] * u[:, None, None] + rows.b[inside] * x[..., None] + rows.c[inside]
        used = (2.0 * values - rows.upper - rows.lower) / (rows.upper - rows.lower)
        used = np.concatenate([used, (x / rows.fastest[inside])[..., None]], axis=-1)
        # How far a parabola through three points is from the lines between them, at most.
        bend = 0.25 * np.abs(used[:, 1] - 0.5 * (used[:, 0] + used[:, 2]))
        return np.asarray((np.abs(used).max(axis=1) + bend > 1.0 + _BROKEN).any(axis=-1))

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(_durations(self._steps, self.x).sum())

    def clock(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return s, ṡ and s̈ at times (m,) [s]."""
        grid, speeds, changes = self.grid, np.sqrt(self.x), 0.5 * np.diff(self.x) / self._steps
        starts = np.concatenate([[0.0], np.cumsum(_durations(self._steps, self.x))])
        k = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, len(self._steps) - 1)
        since = times - starts[k]
        s = grid[k] + since * (speeds[k] + 0.5 * since * changes[k])
        return np.clip(s, 0.0, 1.0), np.maximum(speeds[k] + since * changes[k], 0.0), changes[k]


def _durations(steps: FloatArray, x: FloatArray) -> FloatArray:
    roots = np.sqrt(x)
    return np.asarray(2.0 * steps / (roots[1:] + roots[:-1]))


def _solved(steps: FloatArray, planes: _HalfPlanes, start: FloatArray | None) -> FloatArray:
    """Return the x at the points of a grid with which the motion is fastest, zero at both ends."""
    import casadi as ca
    from scipy.sparse import csr_matrix

    count = len(steps) + 1
    place = np.concatenate([[0.0], np.cumsum(steps)])
    slow = np.minimum(place, place[-1] - place)
    slow = slow / max(float(planes.used(slow).max()), 1e-300)
    unit = slow.max()
    sizes = unit * np.linalg.norm(planes.slopes, axis=-1)
    places = np.tile(np.arange(len(sizes)), 2), np.concatenate([planes.parts, planes.parts + 1])
    matrix = csr_matrix(((unit * planes.slopes / sizes[:, None]).T.ravel(), places), (len(sizes), count))
    z = ca.MX.sym("z", count - 2)
    roots = ca.vertcat(0.0, ca.sqrt(z), 0.0)
    problem = {
        "x": z,
        "f": ca.dot(2.0 * steps, 1.0 / (roots[1:] + roots[:-1])),
        "g": ca.mtimes(ca.DM(matrix[:, 1:-1]), z),
    }
    quiet: Any = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 300, "tol": 1e-8},
    }
    first = 0.5 * slow if start is None else 0.9 * start
    bounds = {"lbx": _LEAST * slow[1:-1] / unit, "ubx": _FASTEST, "lbg": -np.inf, "ubg": 1.0 / sizes}
    solution = ca.nlpsol("least_time", "ipopt", problem, quiet)(x0=first[1:-1] / unit, **bounds)
    x = np.concatenate([[0.0], unit * np.asarray(solution["x"])[:, 0], [0.0]])
    # Whether or not IPOPT has converged: the larger of its result and of a slow motion, made to keep the limits.
    used = planes.used(x) if np.isfinite(x).all() and (x[1:-1] > 0.0).all() else np.array([np.inf])
    x = x / max(float(used.max()), 1.0)
    return x if x.any() and _durations(steps, x).sum() <= _durations(steps, slow).sum() else slow
