"""Closed triangle meshes: volume, area, points inside, distances, and volumes of ever finer meshes extrapolated.

A point is inside by how many times the surface goes round it: for an outward oriented surface that does not meet itself
once, and not at all outside. Where the surface passes through itself that still is a well-defined whole number, which
the parity of a ray's crossings is not. The signed crossings of a ray are counted. Whether it passes left or right of an
edge is decided by the same arithmetic for both faces at the edge, so no ray slips through between them. All rays have
one oblique direction, far from the symmetries of a mesh: of a face that a ray runs along, rounding could not tell
whether it is ahead of the point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from spm_pin.errors import require_extra
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, real_array

if TYPE_CHECKING:
    from trimesh import Trimesh

Counts = npt.NDArray[np.int32]

_PAIRS = 1 << 17
"""Points times faces looked at together: some 60 MB of intermediate results."""
_OBLIQUE = Rotation.from_rotvec([0.37, -0.59, 0.83]).as_matrix()
"""To a frame whose last axis is the rays' direction."""


@dataclass(frozen=True)
class ClosedMesh:
    """A closed, oriented triangle mesh."""

    vertices: FloatArray
    """Positions of o in {B} [m], shape (V, 3)."""
    faces: IntArray
    """Triangles, counter-clockwise seen from outside, shape (F, 3)."""

    @property
    def volume(self) -> float:
        """Volume enclosed by the mesh [m³]; its error falls with the square of the spacing of its vertices."""
        return enclosed_volume(self.vertices, self.faces)

    @property
    def face_areas(self) -> FloatArray:
        """Areas of the faces [m²], shape (F,)."""
        return np.asarray(np.linalg.norm(self._doubled_normals, axis=-1) / 2.0)

    @property
    def area(self) -> float:
        """Area of the mesh [m²]."""
        return float(self.face_areas.sum())

    @property
    def euler_characteristic(self) -> int:
        """V - E + F of the mesh, 2 for a sphere; where a set has thin parts, it depends on the spacing."""
        return len(self.vertices) - 3 * len(self.faces) // 2 + len(self.faces)

    @property
    def _doubled_normals(self) -> FloatArray:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def mesh(self) -> Trimesh:
        """The mesh as a `trimesh.Trimesh` in {B} [m], watertight, its normals outward."""
        mesh: Trimesh = _trimesh().Trimesh(self.vertices, self.faces, process=False)
        return mesh

    @cached_property
    def _winding_numbers(self) -> WindingNumbers:
        return WindingNumbers(self.vertices, self.faces)

    def winding_number(self, points: npt.ArrayLike) -> npt.NDArray[np.int32]:
        """Return how many times the mesh goes round each of `points` (..., 3) [m], shape (...).

        For a point on the mesh to within rounding it is the number on one of its sides.
        """
        return self._winding_numbers.at(points)

    def contains(self, points: npt.ArrayLike) -> BoolArray:
        """Return which of `points` (..., 3) [m] are inside: whose winding number is not zero, shape (...)."""
        return np.asarray(self.winding_number(points) != 0)

    def distance(self, points: npt.ArrayLike) -> FloatArray:
        """Return how far `points` (..., 3) are from the mesh [m], shape (...): positive inside, negative outside."""
        array = real_array(points, "points", (3,), "positions in metres")
        distance = self._unsigned_distance(array.reshape(-1, 3)).reshape(array.shape[:-1])
        return np.where(self.contains(array), distance, -distance)

    @cached_property
    def _faces_by_place(self) -> tuple[cKDTree, float]:
        """The faces' centroids in a tree, and how far a face reaches from its centroid at most [m]."""
        triangles = self.vertices[self.faces]
        centroids = triangles.mean(axis=1)
        return cKDTree(centroids), float(np.linalg.norm(triangles - centroids[:, None], axis=-1).max())

    def _unsigned_distance(self, points: FloatArray) -> FloatArray:
        """Return the distance of each of `points` (N, 3) from the nearest face [m], shape (N,)."""
        closest_point = _trimesh().triangles.closest_point
        tree, reach = self._faces_by_place
        shortest = np.empty(len(points))
        for k, point in enumerate(points):
            # The nearest centroid is on the mesh; a face whose centroid is farther by `reach` is itself farther.
            near = tree.query_ball_point(point, (1.0 + 1e-9) * (tree.query(point)[0] + reach))
            nearest = closest_point(self.vertices[self.faces[near]], np.broadcast_to(point, (len(near), 3)))
            shortest[k] = np.linalg.norm(nearest - point, axis=1).min()
        return shortest


@dataclass(frozen=True)
class Convergence:
    """The volume that meshes of growing resolution enclose, extrapolated.

    A mesh's error is a series in even powers of 1/n, so a polynomial in 1/n² through the values leads to its limit.
    """

    resolutions: tuple[int, ...]
    """Resolutions n of the meshes, growing."""
    volumes: tuple[float, ...]
    """Volumes that the meshes enclose [m³]."""

    @property
    def limit(self) -> float:
        """The polynomial at 1/n = 0 [m³]."""
        return self._extrapolated(slice(None))

    @property
    def error(self) -> float:
        """Change of the limit without the coarsest or the finest mesh [m³], a bound on the limit's error."""
        parts = (slice(1, None), slice(None, -1))
        return max(abs(self.limit - self._extrapolated(part)) for part in parts)

    @property
    def order(self) -> float:
        """Power of 1/n with which the error falls from the last mesh but one to the last; 2 in theory."""
        coarse, fine = (abs(volume - self.limit) for volume in self.volumes[-2:])
        if fine == 0.0:
            return float("inf")
        return float(np.log(coarse / fine) / np.log(self.resolutions[-1] / self.resolutions[-2]))

    def _extrapolated(self, part: slice) -> float:
        squares = 1.0 / np.array(self.resolutions[part], dtype=np.float64) ** 2
        return float(np.polyfit(squares, self.volumes[part], len(squares) - 1)[-1])


def enclosed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """Return the signed volume of a closed mesh [m³]."""
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    return float((a * np.cross(b, c)).sum()) / 6.0


def _trimesh() -> Any:
    require_extra("workspace", "trimesh")
    return import_module("trimesh")


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
        for group in np.split(np.arange(len(inside)), cuts):
            which, offset = _ragged(length[group])
            point, face = inside[group[which]], self._filed[start[group[which]] + offset]
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
