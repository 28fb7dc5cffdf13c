"""Coarse distances of points from the reachable set, and states near them to begin an exact search with.

The two stages are independent: the reachable positions are what the lower stage makes of one fixed set S, where o is
seen from the middle platform in all states of the upper stage, Eq. (2) of `docs/theory/reachable_set.md`. S has three
dimensions, and the distance from it is a table. A sample of lower stages is gone through for every point: no local
minimum is overlooked, and what is found is good enough to begin an exact search with.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull, KDTree

from spm_pin.mechanism.arguments import FloatArray, IntArray
from spm_pin.workspace.reachability.position_map import rotated, stage_centre
from spm_pin.workspace.reachability.stage_set import StageSet

_LOWER, _UPPER = 2048, 200_000
"""States of the lower stage that are gone through, and of the upper stage that the table is made of."""
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


class CoarseDistance:
    """Distances of points from the reachable positions, to about `spacing`, by samples of both stages.

    Parameters
    ----------
    lower, upper : StageSet
        The states of the stages.
    rng : Generator
        Source of the samples.

    Attributes
    ----------
    spacing : float
        Resolution of the table [m], about the error of `nearby`.
    margin : float
        Farther than this nothing is reachable by the distances of `nearby` [m]: 1.42 spacings were observed.
    extent : tuple of two ndarrays
        Corners of a box, (3,) each [m], that holds the reachable positions of the samples, and a margin.
    """

    def __init__(self, lower: StageSet, upper: StageSet, rng: np.random.Generator) -> None:
        self._lower, self._upper = lower.draw(_LOWER, rng)[0], upper.draw(_UPPER, rng)[0]
        seen = lower.map.seen(self._upper)[0]
        self._seen = KDTree(seen)
        low, high = seen.min(axis=0), seen.max(axis=0)
        longest = float((high - low).max())
        pad = _MARGIN * longest
        self.spacing = (longest + 2.0 * pad) / _VOXELS
        self.margin = 2.5 * self.spacing
        self._origin = low - pad
        shape = np.ceil((high - low + 2.0 * pad) / self.spacing).astype(int) + 1
        occupied = np.zeros(tuple(shape), dtype=bool)
        occupied[tuple(((seen - self._origin) / self.spacing).astype(int).T)] = True
        # Less how deep inside S it is.
        signed = distance_transform_edt(~occupied) - distance_transform_edt(occupied)
        self._table = (signed * self.spacing).astype(np.float32)

        # R_a, shape (n, 3, 3), and R_aᵀ t_a, (n, 3) [m], of the lower stages.
        centre = stage_centre(self._lower, lower.map.radii[0])[0]
        self._rotation = np.swapaxes(rotated(self._lower[:, None], np.eye(3)), -1, -2)
        self._offset = (np.swapaxes(self._rotation, -1, -2) @ centre[..., None])[..., 0]
        # Where o is along each axis of {B}, for every lower stage and every place at which o is seen.
        hull = seen[ConvexHull(seen).vertices]
        along = [(centre[:, k, None] + self._rotation[:, k] @ hull.T) for k in range(3)]
        pad = 2.0 * self.spacing
        self.extent = np.array([x.min() for x in along]) - pad, np.array([x.max() for x in along]) + pad

    def nearby(self, points: FloatArray, count: int = 1, *, spread: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return about how far points (N, 3) [m] are from the reachable set, (N,) [m], and states that put o near them.

        The distance is negative well inside, and meaningless, but large, far away. The states (N, count, 2, 3) are of
        the samples, the best first. With `spread` those after the best are not the next best ones, but those among the
        best 512 whose lower stages differ most.
        """
        pool = _POOL if spread else count
        scaled = (np.swapaxes(self._rotation, 0, 1).reshape(3, -1) / self.spacing).astype(np.float32)
        shift = ((self._offset + self._origin) / self.spacing).ravel().astype(np.float32)
        table, last = self._table, np.array(self._table.shape) - 1
        strides = np.array(table.strides, dtype=np.int32) // table.itemsize
        best, distance = np.empty((len(points), pool), dtype=np.intp), np.empty(len(points))
        for begin in range(0, len(points), _PORTION):
            part = slice(begin, begin + _PORTION)
            index = np.clip(points[part], *self.extent).astype(np.float32) @ scaled
            index -= shift
            cells = index.reshape(len(index), -1, 3).astype(np.int32)
            # `np.ravel_multi_index` takes up to twice as long.
            place = sum(np.clip(cells[..., k], 0, last[k]) * strides[k] for k in range(3))
            found = table.ravel()[place]
            order = np.argpartition(found, (0, pool - 1) if spread else range(count), axis=1)[:, :pool]
            best[part], distance[part] = order, found[np.arange(len(found)), order[:, 0]]
        if spread:
            best = np.take_along_axis(best, _far_apart(self._lower[best], count), axis=1)
        seen = (np.swapaxes(self._rotation[best], -1, -2) @ points[:, None, :, None])[..., 0] - self._offset[best]
        return distance, np.stack([self._lower[best], self._upper[self._seen.query(seen)[1]]], axis=2)

    @cached_property
    def _cells(self) -> tuple[FloatArray, FloatArray]:
        """Lower corners (n, 3) and sides (3,) of cells [m] that together hold the reachable positions.

        Cells of a grid whose centre is not farther from the set than their own corners are.
        """
        low, high = self.extent
        size = (high - low) / _CELLS
        corners = low + size * np.indices((_CELLS,) * 3).reshape(3, -1).T
        distance, _ = self.nearby(corners + 0.5 * size)
        return corners[distance <= 0.5 * np.linalg.norm(size) + self.margin], size

    def draw_around(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Draw points (count, 3) [m] uniformly from a region that holds the reachable set; and its volume [m³]."""
        corners, size = self._cells
        points = corners[rng.integers(len(corners), size=count)] + size * rng.uniform(size=(count, 3))
        return points, float(len(corners) * size.prod())


def _far_apart(points: FloatArray, count: int) -> IntArray:
    """Return which of points (N, M, 3) to choose so that the next one is the farthest from all before, (N, count)."""
    chosen = np.zeros((len(points), count), dtype=np.intp)
    distance = np.full(points.shape[:2], np.inf)
    for k in range(1, count):
        last = points[np.arange(len(points)), chosen[:, k - 1], None]
        distance = np.minimum(distance, ((points - last) ** 2).sum(axis=-1))
        chosen[:, k] = distance.argmax(axis=1)
    return chosen
