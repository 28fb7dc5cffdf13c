"""Winding numbers of closed triangle meshes: how many times the surface goes round a point.

For an outward oriented surface that does not meet itself it is 1 inside and 0 outside. Where the surface passes through
itself it still is a well-defined integer, which the parity of a ray's crossings is not.

The signed crossings of an axis-parallel ray are counted. Whether it passes left or right of an edge is decided by the
same arithmetic for both faces at the edge, so no ray slips through between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray, real_array

__all__ = ["ClosedSurface"]

BoolArray = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]
Counts = npt.NDArray[np.int32]

_PAIRS = 1 << 17
"""Points times faces looked at together: some 60 MB of intermediate results."""
_ROUNDING = 32.0 * float(np.finfo(np.float64).eps)


class ClosedSurface:
    """A mesh of vertices (V, 3) [m] and triangles (F, 3), counter-clockwise seen from outside, and its winding numbers.

    It may pass through itself, but every edge must be run along as often one way as the other; that is not checked.
    """

    def __init__(self, vertices: FloatArray, faces: Indices) -> None:
        self._vertices = vertices
        self._faces = faces
        self._rays: dict[int, _Rays] = {}

    def winding_number(self, points: npt.ArrayLike) -> Counts:
        """Return how many times the surface goes round each of `points` (..., 3) [m], shape (...); see `Shell`."""
        array = real_array(points, "points", (3,), "positions in metres")
        flat = array.reshape(-1, 3)
        number = np.zeros(len(flat), dtype=np.int32)
        left = np.arange(len(flat))
        # A ray along a steep face may be undecided; one along another axis decides, unless the point is on the face.
        for axis in (2, 0, 1):
            number[left], doubtful = self._along(axis).count(np.roll(flat[left], 2 - axis, axis=-1))
            left = left[doubtful]
            if not len(left):
                break
        return number.reshape(array.shape[:-1])

    def _along(self, axis: int) -> _Rays:
        # Cyclic exchange of the coordinates makes any axis the last and keeps what is left of what.
        if axis not in self._rays:
            self._rays[axis] = _Rays.through(np.roll(self._vertices, 2 - axis, axis=-1), self._faces)
        return self._rays[axis]


@dataclass(frozen=True)
class _Rays:
    """A mesh seen along the last axis, its faces filed by the cells of a grid across that axis."""

    vertices: FloatArray  # (V, 3)
    faces: Indices  # (F, 3)
    top: FloatArray  # (F,), how far each reaches along the axis
    low: FloatArray  # (2,), corner of the grid
    width: FloatArray  # (2,), of a cell
    cells: int  # per direction
    first: Indices  # (cells² + 1,), where the faces of each cell begin in `filed`
    filed: Indices

    @classmethod
    def through(cls, vertices: FloatArray, faces: Indices) -> _Rays:
        cells = int(np.clip(math.sqrt(2.0 * len(faces)), 1, 1024))
        across = vertices[:, :2]
        low = across.min(axis=0)
        width = np.maximum(np.ptp(across, axis=0) / cells, np.finfo(np.float64).tiny)
        corners = np.minimum((across - low) / width, cells - 1).astype(np.intp)[faces]
        start, span = corners.min(axis=1), np.ptp(corners, axis=1) + 1
        face, place = _ragged(span.prod(axis=1))
        cell = (start[face, 0] + place // span[face, 1]) * cells + start[face, 1] + place % span[face, 1]
        first = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=cells * cells))])
        top = vertices[:, 2][faces].max(axis=1)
        return cls(vertices, faces, top, low, width, cells, first, face[np.argsort(cell, kind="stable")])

    def count(self, points: FloatArray) -> tuple[Counts, BoolArray]:
        """Return winding numbers (N,), and where rounding leaves a doubt."""
        number, doubtful = np.zeros(len(points), dtype=np.int32), np.zeros(len(points), dtype=bool)
        for point, face in self._near(points):
            turn, above, doubt = self._crossings(points[point], face)
            np.add.at(number, point, np.where(above, turn, 0))
            doubtful[point[doubt]] = True
        return number, doubtful

    def _near(self, points: FloatArray) -> Iterator[tuple[Indices, Indices]]:
        """Give each point together with each face of its cell that reaches its height, so many pairs at a time."""
        place = (points[:, :2] - self.low) / self.width
        inside = np.flatnonzero(((place >= 0.0) & (place <= self.cells)).all(axis=1))
        column = np.minimum(place[inside].astype(np.intp), self.cells - 1)
        cell = column[:, 0] * self.cells + column[:, 1]
        start, length = self.first[cell], np.diff(self.first)[cell]
        cuts = np.flatnonzero(np.diff(np.cumsum(length) // _PAIRS)) + 1
        for part in np.split(np.arange(len(inside)), cuts):
            which, at = _ragged(length[part])
            point, face = inside[part[which]], self.filed[start[part[which]] + at]
            ahead = self.top[face] >= points[point, 2]
            yield point[ahead], face[ahead]

    def _crossings(self, points: FloatArray, face: Indices) -> tuple[Counts, BoolArray, BoolArray]:
        """Return for M pairs how often the face's outline goes round the ray, if the face is ahead, and doubts."""
        corners = self.faces[face]
        following = np.roll(corners, -1, axis=1)
        a, b = (self.vertices[pick(corners, following)] for pick in (np.minimum, np.maximum))
        x, y = points[:, None, 0], points[:, None, 1]
        upward, downward = (a[..., 1] <= y) & (y < b[..., 1]), (b[..., 1] <= y) & (y < a[..., 1])
        side = (b[..., 0] - a[..., 0]) * (y - a[..., 1]) - (x - a[..., 0]) * (b[..., 1] - a[..., 1])
        turn = (upward & (side > 0.0)).astype(np.int32) - (downward & (side < 0.0))
        turn = np.where(corners < following, turn, -turn).sum(axis=1, dtype=np.int32)

        hit = np.flatnonzero(turn)
        above, doubt = np.zeros(len(face), dtype=bool), np.zeros(len(face), dtype=bool)
        triangle = self.vertices[corners[hit]]
        u, v, w = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], triangle[:, 0] - points[hit]
        volume = (np.cross(u, v) * w).sum(axis=1)
        above[hit] = volume * turn[hit] > 0.0
        size = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(w, axis=1)
        doubt[hit] = np.abs(volume) <= _ROUNDING * size
        return turn, above, doubt


def _ragged(counts: Indices) -> tuple[Indices, Indices]:
    """Return, for rows of `counts` items each, every item's row and its place in that row."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - (np.cumsum(counts) - counts)[row]
