"""Winding numbers of closed triangle meshes: how many times the surface goes round a point.

For an outward oriented surface that does not meet itself it is 1 inside and 0 outside. Where the surface passes through
itself it still is a well-defined integer, which the parity of a ray's crossings is not.

The signed crossings of a ray are counted. Whether it passes left or right of an edge is decided by the same arithmetic
for both faces at the edge, so no ray slips through between them. All rays have one oblique direction, far from the
symmetries of a mesh: of a face that a ray runs along, rounding could not tell whether it is ahead of the point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.mechanism.arguments import FloatArray, IntArray, real_array

Counts = npt.NDArray[np.int32]

_PAIRS = 1 << 17
"""Points times faces looked at together: some 60 MB of intermediate results."""
_OBLIQUE = Rotation.from_rotvec([0.37, -0.59, 0.83]).as_matrix()
"""To a frame whose last axis is the rays' direction."""


class WindingNumbers:
    """Winding numbers of a mesh of vertices (V, 3) [m] and triangles (F, 3), counter-clockwise seen from outside.

    It may pass through itself, but every edge must be run along as often one way as the other; that is not checked.
    Its faces are filed by the cells of a grid across the rays.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self._vertices, self._faces = vertices @ _OBLIQUE, faces
        self._cells = int(np.clip(math.sqrt(2.0 * len(faces)), 1, 1024))  # per direction
        across = self._vertices[:, :2]
        self._low = across.min(axis=0)
        self._width = np.maximum(np.ptp(across, axis=0) / self._cells, np.finfo(np.float64).tiny)
        corners = np.minimum((across - self._low) / self._width, self._cells - 1).astype(np.intp)[faces]
        start, span = corners.min(axis=1), np.ptp(corners, axis=1) + 1
        face, place = _ragged(span.prod(axis=1))
        cell = (start[face, 0] + place // span[face, 1]) * self._cells + start[face, 1] + place % span[face, 1]
        # The faces of each cell lie together in `_filed`, those of the next cell after them.
        self._first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=self._cells**2))])
        self._filed = face[np.argsort(cell, kind="stable")]
        self._top = self._vertices[:, 2][faces].max(axis=1)

    def at(self, points: npt.ArrayLike) -> Counts:
        """Return how many times the surface goes round each of `points` (..., 3) [m], shape (...); see `ClosedMesh`."""
        array = real_array(points, "points", (3,), "positions in metres")
        flat = array.reshape(-1, 3) @ _OBLIQUE
        number = np.zeros(len(flat), dtype=np.int32)
        for point, face in self._near(flat):
            hit, turn = self._crossings(flat[point], face)
            np.add.at(number, point[hit], turn)
        return number.reshape(array.shape[:-1])

    def _near(self, points: FloatArray) -> Iterator[tuple[IntArray, IntArray]]:
        """Give each point together with each face of its cell that reaches its height, so many pairs at a time."""
        place = (points[:, :2] - self._low) / self._width
        inside = np.flatnonzero(((place >= 0.0) & (place <= self._cells)).all(axis=1))
        column = np.minimum(place[inside].astype(np.intp), self._cells - 1)
        cell = column[:, 0] * self._cells + column[:, 1]
        start, length = self._first[cell], np.diff(self._first)[cell]
        cuts = np.flatnonzero(np.diff(np.cumsum(length) // _PAIRS)) + 1
        for part in np.split(np.arange(len(inside)), cuts):
            which, at = _ragged(length[part])
            point, face = inside[part[which]], self._filed[start[part[which]] + at]
            ahead = self._top[face] >= points[point, 2]
            yield point[ahead], face[ahead]

    def _crossings(self, points: FloatArray, face: IntArray) -> tuple[IntArray, Counts]:
        """Return which of M pairs have the face ahead of the point, and how often its outline goes round the ray."""
        corners = self._faces[face]
        following = np.roll(corners, -1, axis=1)
        a, b = (self._vertices[pick(corners, following)] for pick in (np.minimum, np.maximum))
        x, y = points[:, None, 0], points[:, None, 1]
        upward, downward = (a[..., 1] <= y) & (y < b[..., 1]), (b[..., 1] <= y) & (y < a[..., 1])
        side = (b[..., 0] - a[..., 0]) * (y - a[..., 1]) - (x - a[..., 0]) * (b[..., 1] - a[..., 1])
        turn = (upward & (side > 0.0)).astype(np.int32) - (downward & (side < 0.0))
        turn = np.where(corners < following, turn, -turn).sum(axis=1, dtype=np.int32)

        hit = np.flatnonzero(turn)
        triangle = self._vertices[corners[hit]]
        u, v, w = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], triangle[:, 0] - points[hit]
        hit = hit[(np.cross(u, v) * w).sum(axis=1) * turn[hit] > 0.0]
        return hit, turn[hit]


def _ragged(counts: IntArray) -> tuple[IntArray, IntArray]:
    """Return, for rows of `counts` items each, every item's row and its place in that row."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - (np.cumsum(counts) - counts)[row]
