"""The box of leg lengths within limits: samples of its states, and coarse distances of points from the reachable set.

The two stages are independent, so the reachable positions are what the lower stage makes of one fixed set: with L the
states of the lower stage and S where o is seen from the middle platform in all states of the upper one,

    W = { t_a(u) + R_a(u) s : u in L, s in S },    dist(y, W) = min over u in L of dist(R_aᵀ (y - t_a), S).

S has three dimensions, and its distance is a table. A sample of L is gone through for every point: no local minimum is
overlooked, and what is found is good enough to begin an exact search with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull, KDTree

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, IntArray, first_offender, instance
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.workspace.reachability.position_map import PositionMap, rotated, stage_centre
from spm_pin.workspace.reachability.stage_set import StageSet

__all__ = ["LegLengthBox", "leg_length_box"]

_EPS = float(np.finfo(np.float64).eps)
_LOWER, _UPPER = 2048, 200_000
"""States of the lower stage that are gone through, and of the upper stage that the table is made of."""
_SAMPLE = 20_000
"""Number of states in `LegLengthBox.sample`."""
_VOXELS = 64
"""Cells of the distance table along the longest side of S and its margin."""
_MARGIN = 0.15
"""Margin of the table around S, relative to its size."""
_CELLS = 20
"""Cells along each axis of the grid that covers the reachable positions."""
_PORTION = 64
"""Points whose distances are looked up together, for each of them all states of the lower stage."""
_POOL = 512
"""Best states of a point, among which `nearby` chooses different ones."""
_SEED = 20_140_131
"""Seed of the samples, fixed so that results repeat."""


@dataclass(frozen=True, eq=False)
class LegLengthBox:
    """The leg lengths that limits allow, and the states and positions that belong to them."""

    geometry: Geometry
    limits: LegLimits
    minimum: FloatArray
    """Least leg lengths (6,) [m], none of them zero."""
    maximum: FloatArray
    """Largest leg lengths (6,) [m]."""
    family: str = "TT"
    """The family of the states."""
    sides: tuple[float, float] = (1.0, 1.0)
    """On which side of its forward singularities each stage is: 1 for the side of the home."""

    @property
    def size(self) -> float:
        """E + C + d + the longest legs [m]: what lengths are compared with."""
        g = self.geometry
        return float(g.base_radius + g.platform_radius + g.middle_side + self.maximum.max())

    @cached_property
    def map(self) -> PositionMap:
        """The states of the family by the coordinates of their stages."""
        return PositionMap(self.geometry, self.family)

    @cached_property
    def stages(self) -> tuple[StageSet, StageSet]:
        """The physical states of the lower and of the upper stage."""
        lower, upper = (
            StageSet(self.map, k, *(x[3 * k : 3 * k + 3] for x in (self.minimum, self.maximum))) for k in range(2)
        )
        return lower, upper

    def snapped(self, lengths: FloatArray) -> FloatArray:
        """Return `lengths` (N, 6) within the limits, those within rounding of a limit at it."""
        tolerance = 64.0 * _EPS * self.size
        lengths = np.where(lengths <= self.minimum + tolerance, self.minimum, lengths)
        return np.where(lengths >= self.maximum - tolerance, self.maximum, lengths)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Draw states uniformly in the coordinates of both stages, (count, 2, 3); and estimate their volume."""
        lower, upper = (stage.draw(count, rng) for stage in self.stages)
        return np.stack([lower[0], upper[0]], axis=1), lower[1] * upper[1]

    @cached_property
    def _samples(self) -> tuple[FloatArray, FloatArray]:
        """States of the lower and of the upper stage, (n, 3) each."""
        rng = np.random.default_rng(_SEED)
        return self.stages[0].draw(_LOWER, rng)[0], self.stages[1].draw(_UPPER, rng)[0]

    @cached_property
    def sample(self) -> FloatArray:
        """States within the limits, (n, 2, 3), always the same."""
        return self.draw(_SAMPLE, np.random.default_rng(_SEED))[0]

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the positions of o at the samples."""
        return KDTree(self.map.points(self.sample)[0])

    @cached_property
    def _seen(self) -> tuple[FloatArray, KDTree]:
        """S as a sample (n, 3), and its tree."""
        seen = self.map.seen(self._samples[1])[0]
        return seen, KDTree(seen)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, float]:
        """Distances to S [m] on a grid, less how deep inside it is; the grid's origin; and its spacing [m]."""
        seen = self._seen[0]
        low, high = seen.min(axis=0), seen.max(axis=0)
        margin = _MARGIN * float((high - low).max())
        spacing = float((high - low).max() + 2.0 * margin) / _VOXELS
        origin = low - margin
        shape = np.ceil((high - low + 2.0 * margin) / spacing).astype(int) + 1
        occupied = np.zeros(tuple(shape), dtype=bool)
        occupied[tuple(((seen - origin) / spacing).astype(int).T)] = True
        signed = distance_transform_edt(~occupied) - distance_transform_edt(occupied)
        return (signed * spacing).astype(np.float32), origin, spacing

    @cached_property
    def _views(self) -> tuple[FloatArray, FloatArray]:
        """R_a, shape (n, 3, 3), and R_aᵀ t_a, (n, 3) [m], of the lower stages."""
        lower = self._samples[0]
        rotation = np.swapaxes(rotated(lower[:, None], np.eye(3)), -1, -2)
        centre = stage_centre(lower, self.map.radii[0])[0]
        return rotation, (np.swapaxes(rotation, -1, -2) @ centre[..., None])[..., 0]

    @property
    def spacing(self) -> float:
        """Resolution of the table of distances [m], about the error of `nearby`."""
        return self._table[2]

    @cached_property
    def extent(self) -> tuple[FloatArray, FloatArray]:
        """Corners of a box, (3,) each [m], that holds the reachable positions of the samples, and a margin."""
        seen = self._seen[0]
        seen = seen[ConvexHull(seen).vertices]
        rotation, _ = self._views
        centre = stage_centre(self._samples[0], self.map.radii[0])[0]
        # Row by row: where o is along one axis of {B}, for every lower stage and every place at which o is seen.
        along = [(centre[:, k, None] + rotation[:, k] @ seen.T) for k in range(3)]
        pad = 2.0 * self.spacing
        return np.array([x.min() for x in along]) - pad, np.array([x.max() for x in along]) + pad

    @cached_property
    def cells(self) -> tuple[FloatArray, FloatArray]:
        """Lower corners (n, 3) and sides (3,) of cells [m] that together hold the reachable positions.

        Cells of a grid whose centre is not farther from the set than their own corners are.
        """
        low, high = self.extent
        size = (high - low) / _CELLS
        corners = low + size * np.indices((_CELLS,) * 3).reshape(3, -1).T
        distance, _ = self.nearby(corners + 0.5 * size)
        return corners[distance <= 0.5 * np.linalg.norm(size) + self.margin], size

    @property
    def margin(self) -> float:
        """Farther than this nothing is reachable by the distances of `nearby` [m]: 1.42 spacings were observed."""
        return 2.5 * self.spacing

    def nearby(self, points: FloatArray, count: int = 1, *, spread: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return about how far points (N, 3) [m] are from the reachable set, (N,) [m], and states that put o near them.

        The distance is negative well inside, and meaningless, but large, far away. The states (N, count, 2, 3) are of
        the samples, the best first. With `spread` those after the best are not the next best ones, but those among the
        best 512 whose lower stages differ most.
        """
        pool = _POOL if spread else count
        table, origin, spacing = self._table
        rotation, offset = self._views
        scaled = (np.swapaxes(rotation, 0, 1).reshape(3, -1) / spacing).astype(np.float32)
        shift = (((offset + origin) / spacing).ravel()).astype(np.float32)
        last, strides = np.array(table.shape) - 1, np.array(table.strides, dtype=np.int32) // table.itemsize
        low, high = self.extent
        best, distance = np.empty((len(points), pool), dtype=np.intp), np.empty(len(points))
        for begin in range(0, len(points), _PORTION):
            part = slice(begin, begin + _PORTION)
            index = np.clip(points[part], low, high).astype(np.float32) @ scaled
            index -= shift
            cells = index.reshape(len(index), -1, 3).astype(np.int32)
            place = np.clip(cells[..., 0], 0, last[0]) * strides[0]
            place += np.clip(cells[..., 1], 0, last[1]) * strides[1]
            place += np.clip(cells[..., 2], 0, last[2])
            found = table.ravel()[place]
            order = np.argpartition(found, (0, pool - 1) if spread else range(count), axis=1)[:, :pool]
            best[part], distance[part] = order, found[np.arange(len(found)), order[:, 0]]
        if spread:
            best = np.take_along_axis(best, _far_apart(self._samples[0][best], count), axis=1)
        lower = self._samples[0][best]
        seen = (np.swapaxes(rotation[best], -1, -2) @ points[:, None, :, None])[..., 0] - offset[best]
        upper = self._samples[1][self._seen[1].query(seen)[1]]
        return distance, np.stack([lower, upper], axis=2)


def _far_apart(points: FloatArray, count: int) -> IntArray:
    """Return which of points (N, M, 3) to choose so that the next one is the farthest from all before, (N, count)."""
    chosen = np.zeros((len(points), count), dtype=np.intp)
    distance = np.full(points.shape[:2], np.inf)
    for k in range(1, count):
        last = points[np.arange(len(points)), chosen[:, k - 1], None]
        distance = np.minimum(distance, ((points - last) ** 2).sum(axis=-1))
        chosen[:, k] = distance.argmax(axis=1)
    return chosen


def leg_length_box(geometry: Geometry, limits: LegLimits | None = None) -> LegLengthBox:
    """Return the box of leg lengths within `limits`, or within those of `geometry`.

    Raises
    ------
    ArgumentError
        If there are no limits or one is infinite, or no lengths within them belong to a configuration.
    """
    instance(geometry, Geometry, "geometry")
    limits = geometry.limits if limits is None else limits
    if not isinstance(limits, LegLimits):
        cause = "The geometry has none of its own" if limits is None else ""
        raise ArgumentError("limits", "LegLimits(minimum, maximum) in metres", repr(limits), cause)
    if not np.isfinite(limits.maximum).all():
        leg = LEGS[first_offender(~np.isfinite(limits.maximum))[0]]
        raise ArgumentError(
            "limits", "a finite maximum for every leg", f"infinity for {leg}", "The set has no end then"
        )
    return _checked(geometry, limits)


@lru_cache(maxsize=8)
def _checked(geometry: Geometry, limits: LegLimits) -> LegLengthBox:
    # A leg of no length has no direction.
    maximum = np.array(limits.maximum)
    box = LegLengthBox(geometry, limits, np.maximum(limits.minimum, 1e-6 * maximum), maximum)
    if not all(len(stage.draw(1, np.random.default_rng(_SEED))[0]) for stage in box.stages):
        received = f"limits from {min(limits.minimum):g} to {max(limits.maximum):g} m, which reach no pose"
        cause = "Too short to join the platforms, too different from each other, or in another unit?"
        raise ArgumentError("limits", "leg limits within which the machine can be assembled", received, cause)
    return box
