"""Winding numbers: known answers, degenerate rays, and sums of solid angles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import trimesh

from spm_pin.workspace.boundary import _OBLIQUE, ClosedMesh

Array = npt.NDArray[np.float64]


def solid_angles(mesh: trimesh.Trimesh, points: Array) -> Array:
    """The generalised winding number: solid angles over 4π, by van Oosterom and Strackee's formula."""
    total = np.empty(len(points))
    for k, point in enumerate(points):
        a, b, c = np.moveaxis(np.asarray(mesh.triangles) - point, 1, 0)
        la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
        triple = (a * np.cross(b, c)).sum(axis=-1)
        dots = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        total[k] = (2.0 * np.arctan2(triple, dots)).sum() / (4.0 * np.pi)
    return total


def winding(mesh: trimesh.Trimesh, points: npt.ArrayLike) -> npt.NDArray[np.int32]:
    return ClosedMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)).winding_number(points)


CUBE = trimesh.creation.box((2.0, 2.0, 2.0))
SPHERE = trimesh.creation.icosphere(subdivisions=3)
TORUS = trimesh.creation.torus(1.0, 0.3)


def test_rays_through_vertices_and_edges() -> None:
    rng = np.random.default_rng(0)
    edges = np.asarray(SPHERE.vertices)[SPHERE.edges_unique]
    share = rng.random((len(edges), 1))
    targets = np.concatenate([SPHERE.vertices, share * edges[:, 0] + (1.0 - share) * edges[:, 1]])
    points = targets - rng.uniform(-3.0, 3.0, (len(targets), 1)) * _OBLIQUE[:, 2]
    radius = np.linalg.norm(points, axis=-1)
    clear = (radius < 0.98) | (radius > 1.0 + 1e-9)
    assert (radius < 0.98).sum() > 300
    np.testing.assert_array_equal(winding(SPHERE, points[clear]), radius[clear] < 0.98)


@pytest.mark.parametrize("mesh", [CUBE, SPHERE, TORUS], ids=["cube", "sphere", "torus"])
def test_agrees_with_solid_angles(mesh: trimesh.Trimesh) -> None:
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (400, 3))
    exact = solid_angles(mesh, points)
    assert np.abs(exact - exact.round()).max() < 1e-9
    np.testing.assert_array_equal(winding(mesh, points), exact.round())


def test_surfaces_that_go_round_twice_backwards_or_round_a_cavity() -> None:
    points = [[0.1, 0.2, 0.05], [0.0, 0.0, 0.8], [0.0, 0.0, 3.0]]
    twice = trimesh.util.concatenate([SPHERE, SPHERE])
    assert winding(twice, points).tolist() == [2, 2, 0]
    inverted = SPHERE.copy()
    inverted.invert()
    assert winding(inverted, points).tolist() == [-1, -1, 0]
    small = inverted.copy().apply_scale(0.5)
    assert winding(trimesh.util.concatenate([SPHERE, small]), points).tolist() == [0, 1, 0]
