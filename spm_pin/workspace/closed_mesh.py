"""Closed triangle meshes: volume, area, points inside, distances, and volumes of ever finer meshes extrapolated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from spm_pin.errors import require_extra
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, real_array
from spm_pin.workspace.winding_numbers import WindingNumbers

if TYPE_CHECKING:
    from trimesh import Trimesh

_FEW = 16
"""Number of nearest faces examined first."""
_CHUNK = 1 << 20
"""Points times faces whose distances are computed together."""


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
        """The mesh as a `trimesh.Trimesh` in {B} [m], watertight, its normals outward.

        Raises
        ------
        MissingExtraError
            If trimesh is not installed.
        """
        mesh: Trimesh = _trimesh().Trimesh(self.vertices, self.faces, process=False)
        return mesh

    @cached_property
    def _winding_numbers(self) -> WindingNumbers:
        return WindingNumbers(self.vertices, self.faces)

    def winding_number(self, points: npt.ArrayLike) -> npt.NDArray[np.int32]:
        """Return how many times the mesh goes round each of `points` (..., 3) [m], shape (...).

        For a point on the mesh to within rounding it is the number on one of its sides.

        Raises
        ------
        ArgumentError
            If `points` are not finite numbers of that shape.
        """
        return self._winding_numbers.at(points)

    def contains(self, points: npt.ArrayLike) -> BoolArray:
        """Return which of `points` (..., 3) [m] are inside: those with a winding number that is not zero, shape (...).

        Raises
        ------
        ArgumentError
            If `points` are not finite numbers of that shape.
        """
        return np.asarray(self.winding_number(points) != 0)

    def distance(self, points: npt.ArrayLike) -> FloatArray:
        """Return how far `points` (..., 3) are from the mesh [m], shape (...): positive inside, negative outside.

        Raises
        ------
        ArgumentError
            If `points` are not finite numbers of that shape.
        MissingExtraError
            If trimesh is not installed.
        """
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
        """Return the distance of each of `points` (N, 3) from the nearest face [m], shape (N,).

        Raises
        ------
        MissingExtraError
            If trimesh is not installed.
        """
        closest_point = _trimesh().triangles.closest_point
        tree, reach = self._faces_by_place
        shortest, settled = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
        left, few = np.arange(len(points)), _FEW
        while len(left):
            few = min(few, len(self.faces))
            for part in np.array_split(left, -(-len(left) * few // _CHUNK)):
                apart, near = (np.asarray(found) for found in tree.query(points[part], k=np.arange(1, few + 1)))
                queries = np.repeat(points[part], few, axis=0)
                nearest = closest_point(self.vertices[self.faces[near.ravel()]], queries)
                shortest[part] = np.linalg.norm(nearest - queries, axis=1).reshape(near.shape).min(axis=1)
                # A face whose centroid is farther than this is itself farther than the nearest one found.
                settled[part] = (apart[:, -1] - reach >= shortest[part]) | (few == len(self.faces))
            left, few = left[~settled[left]], 4 * few
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
