"""Searches for states: with o at given points, or with points of the platform as near as possible to given ones.

The searches begin at states of a sample. The two stages are independent: the reachable positions are images, by the
lower stage, of one fixed set S: the positions of o relative to the middle platform in all states of the upper stage. S
has three dimensions, and the distance from it is a table, in which every point is looked up for each lower stage.
See `docs/theory/reachable_set.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull

from spm_pin.kinematics.batches import run_kernel
from spm_pin.kinematics.kernels import RESOLUTION
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, Progress
from spm_pin.workspace.state_set import CENTRE, StateSet

SINGULARITY_MARGIN = 1e-6
"""Smallest determinant of a stage, about 1 at home: closer to a forward singularity, rounding of the readings moves o
farther than `RESOLUTION`, and still closer no state may be found from them."""
_LEVELS, _GROUP, _UPPER, _SEED = 5, 64, 200_000, 20_140_131
"""The sample: 2^5 groups of 64 similar lower stages, the number of upper stages, and its seed."""
_VOXELS, _PAD = 64, 0.15
"""Cells of the distance table along the longest side of S with its margin, and the margin relative to S."""
_CELLS = 20
"""Cells along each axis of the grid that covers the reachable positions."""
_REMOTE_STARTS, _MORE_STARTS = 6, 8
"""Number of states of the sample nearest to a point that are further starts of a search for the nearest reachable
point, and of a second search for a state at a point after that from the groups has failed."""
_MOST_STEPS, _PATIENT = 400, 3000
"""Largest number of Newton steps for the nearest state: while a platform is dragged, and for the nearest point."""
_CHUNK, _MIN_BATCH = 4096, 256
"""Number of points processed together, and number worth a thread of their own."""


class Membership(NamedTuple):
    """True for points that are reachable, (N,)."""

    reached: BoolArray
    """Points with a state, which proves it, (N,)."""
    undecided: BoolArray
    """Points (N,) without a state whose search ended beyond a forward singularity or stalled close to a state."""
    coordinates: FloatArray
    """The states (N, 2, 3); for those not found, the ones with the smallest residual norm."""
    readings: FloatArray
    """Their readings (N, 6), within the limits; NaN if missing."""


class NearestPoints(NamedTuple):
    """States nearest to N targets."""

    coordinates: FloatArray
    """The states (N, 2, 3)."""
    readings: FloatArray
    """Their readings (N, 6), within the limits; a leg at a limit has that limit to the last bit."""
    distance: FloatArray
    """Root mean square distance from the targets (N,) [m]."""
    optimality: FloatArray
    """Residuals of Eq. (1) of the page, (N,); infinite where the state is the start."""

    def update(self, index: IntArray, other: NearestPoints, chosen: IntArray | slice = slice(None)) -> None:
        """Put the `chosen` states of `other` into the places `index`."""
        for array, values in zip(self, other, strict=True):
            array[index] = values[chosen]


class StartTable:
    """Coarse distances from the reachable positions, and states near them, by samples of both stages.

    Distances have errors of about `spacing` [m], the table's; nothing is reachable farther than `margin` [m]. The
    reachable positions are in the box with the corners `extent`, two of (3,) [m].
    """

    def __init__(self, states: StateSet) -> None:
        rng = np.random.default_rng(_SEED)
        lower, _ = states.draw_stages(0, _GROUP << _LEVELS, rng)
        for level in range(_LEVELS):
            # Sorted along the coordinate that differs most, so that similar stages are in one half of a block.
            blocks = np.split(lower, 1 << level)
            lower = np.concatenate([block[block[:, np.ptp(block, axis=0).argmax()].argsort()] for block in blocks])
        self._lower, self._upper = lower, states.draw_stages(1, _UPPER, rng)[0]
        stages = states.stages(1, self._upper)
        seen = -states.mode_turn * (stages.rotation.mT @ stages.centre[..., None])[..., 0]
        low, high = seen.min(axis=0), seen.max(axis=0)
        longest = float((high - low).max())
        pad = _PAD * longest
        self.spacing = (longest + 2.0 * pad) / _VOXELS
        self.margin = 2.5 * self.spacing
        origin = low - pad
        shape = tuple(np.ceil((high - low + 2.0 * pad) / self.spacing).astype(int) + 1)
        member = np.full(shape, -1)
        member[tuple(((seen - origin) / self.spacing).astype(int).T)] = np.arange(len(seen))
        # The nearest upper stage of every cell, and the distance minus the depth inside S.
        outside, nearest = distance_transform_edt(member < 0, return_indices=True)
        self._member = member[tuple(nearest)].ravel()
        self._table = (outside - distance_transform_edt(member >= 0)) * self.spacing
        stages = states.stages(0, lower)
        self._rotation, centre = np.ascontiguousarray(stages.rotation), stages.centre
        self._offset = ((self._rotation.mT @ centre[..., None])[..., 0] + origin) / self.spacing
        # Where o is along each axis of {B}, for every lower stage and every place at which o is seen.
        hull = seen[ConvexHull(seen).vertices]
        along = [(centre[:, k, None] + self._rotation[:, k] @ hull.T) for k in range(3)]
        pad = 2.0 * self.spacing
        self.extent = np.array([x.min() for x in along]) - pad, np.array([x.max() for x in along]) + pad

    def nearby(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances of points (N, 3) from the reachable set, (N, 32) [m], and states near them (N, 32, 2, 3).

        One for each group of lower stages, the best first. Distances are negative well inside, large but meaningless
        far away.
        """
        from spm_pin.kinematics.kernels.stage_states import nearby_stages

        groups = 1 << _LEVELS
        inputs = [np.require(points, requirements=("C", "W"))]
        results = ((groups,), np.int64), ((groups,), np.int64), ((groups,), np.float64)
        constants = self._rotation, self._offset, self._table, self.spacing
        stages, cells, distances = run_kernel(nearby_stages, inputs, constants, results, _MIN_BATCH)
        order = distances.argsort(axis=1)
        stages, cells, distances = (np.take_along_axis(array, order, axis=1) for array in (stages, cells, distances))
        return distances, np.stack([self._lower[stages], self._upper[self._member[cells]]], axis=2)

    @cached_property
    def _cells(self) -> tuple[FloatArray, FloatArray]:
        """Lower corners (n, 3) and sides (3,) of cells [m] that together contain the reachable positions.

        Cells of a grid whose centre is not farther from the set than their own corners are.
        """
        low, high = self.extent
        size = (high - low) / _CELLS
        corners = low + size * np.indices((_CELLS,) * 3).reshape(3, -1).T
        distance = self.nearby(corners + 0.5 * size)[0][:, 0]
        return corners[distance <= 0.5 * np.linalg.norm(size) + self.margin], size

    def draw_around(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Return random points (count, 3) [m], uniform in a region around the reachable set, and its volume [m³]."""
        corners, size = self._cells
        points = corners[rng.integers(len(corners), size=count)] + size * rng.uniform(size=(count, 3))
        return points, float(len(corners) * size.prod())


@lru_cache(maxsize=8)
def start_table(states: StateSet) -> StartTable:
    """Return the table of a set of states, made on first use."""
    return StartTable(states)


def search_states(
    states: StateSet,
    points: FloatArray,
    starts: FloatArray | None = None,
    *,
    what: str = "",
    progress: Progress | None = None,
) -> Membership:
    """Search for states within the limits that put o at `points` (N, 3), in {B} [m].

    With `starts` (N, 2, 3) the search begins at one state for each point, instead of those of `StartTable.nearby`.
    Determinants are larger than `SINGULARITY_MARGIN`. `what` is the description of the work for `progress`.
    """
    machine = states.constants(margin=SINGULARITY_MARGIN)

    def search(points: FloatArray, starts: FloatArray | None = None) -> Membership:
        from spm_pin.kinematics.kernels.state_search import search_points

        def run(points: FloatArray, starts: FloatArray, distances: FloatArray) -> tuple[Any, ...]:
            inputs = [np.require(array, requirements=("C", "W")) for array in (points, starts, distances)]
            results = ((2, 3), np.float64), ((6,), np.float64), ((), np.int64)
            return run_kernel(search_points, inputs, (machine,), results, _MIN_BATCH)

        if starts is None:
            table = start_table(states)
            distances, several = table.nearby(points)
            # Near the rim, states that seem farther may be the only ones that lead there: try all, or none.
            near = distances[:, 0] <= table.margin
            result = run(points, several, np.where(near[:, None], distances, np.inf))
            left = np.flatnonzero(near & (result[2] != 1))
            again = run(points[left], states.sample[states.tree.query(points[left], _MORE_STARTS)[1]], distances[left])
            better = again[2] == 1
            for array, values in zip(result, again, strict=True):
                array[left[better]] = values[better]
        else:
            result = run(points, starts[:, None], np.zeros((len(points), 1)))
        coordinates, readings, outcome = result
        return Membership(outcome == 1, outcome == -1, coordinates, readings)

    arrays = (points,) if starts is None else (points, starts)
    return Membership(*in_chunks(search, what, progress, *arrays))


def nearest_states(
    states: StateSet, targets: FloatArray, starts: FloatArray, body: FloatArray = CENTRE, most: int = _MOST_STEPS
) -> NearestPoints:
    """Search for the states within the limits with the points of `body` (K, 3) nearest to `targets` (N, 3K) [m].

    The Gauss-Newton method with penalties for limits starts from all `starts` (N, M, 2, 3), then Newton's method with
    multipliers from the best of the M, with at most `most` steps. The first of the starts must be within the limits,
    and is the result if the search fails.
    """
    from spm_pin.kinematics.kernels.state_search import search_nearest

    inputs = [np.require(array, requirements=("C", "W")) for array in (targets / np.sqrt(len(body)), starts)]
    constants = states.constants(body, SINGULARITY_MARGIN), most
    results = ((2, 3), np.float64), ((6,), np.float64), ((2,), np.float64)
    coordinates, readings, quality = run_kernel(search_nearest, inputs, constants, results, 16)
    distance, slope = quality.T
    scale = np.where(distance > RESOLUTION * states.size, distance, np.inf)
    return NearestPoints(coordinates, readings, distance, np.where(np.isinf(slope), np.inf, slope / scale))


def nearest_points(states: StateSet, points: FloatArray) -> NearestPoints:
    """Return the states with o nearest to `points` (N, 3) [m]."""

    def search(points: FloatArray) -> NearestPoints:
        member = search_states(states, points)
        result = NearestPoints(member.coordinates, member.readings, *np.zeros((2, len(points))))
        left = np.flatnonzero(~member.reached)
        if len(left):
            # A sample's state is within the limits; that with the smallest residual may not be, or not be the nearest.
            remote = states.sample[states.tree.query(points[left], _REMOTE_STARTS)[1]]
            near = start_table(states).nearby(points[left])[1]
            starts = np.concatenate([remote, near, member.coordinates[left, None]], axis=1)
            result.update(left, nearest_states(states, points[left], starts, most=_PATIENT))
        return result

    return NearestPoints(*in_chunks(search, "", None, points))


def in_chunks(
    function: Callable[..., tuple[Any, ...]], what: str, progress: Progress | None, *arrays: FloatArray
) -> Iterator[Any]:
    """Call `function` with a chunk of the rows of the arrays at a time; return each of its results, concatenated."""
    parts, count = [], len(arrays[0])
    for begin in range(0, max(count, 1), _CHUNK):
        if progress is not None:
            progress(what, begin, count)
        parts.append(function(*(array[begin : begin + _CHUNK] for array in arrays)))
    if progress is not None:
        progress(what, count, count)
    return map(np.concatenate, zip(*parts, strict=True))
