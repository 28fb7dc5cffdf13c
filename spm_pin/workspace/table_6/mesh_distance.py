"""Distances of points from a triangle mesh."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from spm_pin.errors import MissingExtraError
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["FacesByPlace"]

_FEW = 16
"""Number of nearest faces examined first."""
_CHUNK = 1 << 20
"""Points times faces whose distances are computed together."""


class FacesByPlace:
    """The faces of a mesh in a tree of their centroids.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Positions [m].
    faces : ndarray of int, shape (F, 3)
        Triangles.
    """

    def __init__(self, vertices: FloatArray, faces: npt.NDArray[np.intp]) -> None:
        self._triangles = vertices[faces]
        centroids = self._triangles.mean(axis=1)
        self._tree = cKDTree(centroids)
        # How far a face reaches from its centroid at most.
        self._reach = float(np.linalg.norm(self._triangles - centroids[:, None], axis=-1).max())

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance of each of `points` (N, 3) from the nearest face [m], shape (N,).

        Raises
        ------
        MissingExtraError
            If trimesh is not installed.
        """
        try:
            import trimesh
        except ModuleNotFoundError as missing:
            raise MissingExtraError("workspace", "trimesh") from missing

        shortest, settled = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
        left, few = np.arange(len(points)), _FEW
        while len(left):
            few = min(few, len(self._triangles))
            for part in np.array_split(left, -(-len(left) * few // _CHUNK)):
                apart, near = (np.asarray(found) for found in self._tree.query(points[part], k=np.arange(1, few + 1)))
                queries = np.repeat(points[part], few, axis=0)
                nearest = trimesh.triangles.closest_point(self._triangles[near.ravel()], queries)
                shortest[part] = np.linalg.norm(nearest - queries, axis=1).reshape(near.shape).min(axis=1)
                # A face whose centroid is farther than this is itself farther than the nearest one found.
                settled[part] = (apart[:, -1] - self._reach >= shortest[part]) | (few == len(self._triangles))
            left, few = left[~settled[left]], 4 * few
        return shortest
