"""The shell: closed, oriented, symmetric, of the known volume, and smaller than the reachable set."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from error_fields import with_fields
from scipy.stats import binomtest

import spm_pin as spm
from spm_pin.crosscheck.paper import published
from spm_pin.crosscheck.paper_shell import (
    ERRATA,
    Shell,
    sub_workspaces,
    workspace_shell,
)
from spm_pin.errors import SelectionError

PAPER = spm.Manipulator.paper()
SHELL = workspace_shell(PAPER, resolution=16)


def flux(shell: Shell, nodes: int = 12) -> float:
    """The volume by the divergence theorem: ∫ o·(∂o/∂u × ∂o/∂v) / 3 over each patch, by Gauss and Legendre.

    No mesh takes part; the derivatives are columns of the platform's Jacobian. A patch's sense is that of its first
    face.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    total = 0.0
    for patch in shell.patches:
        first, second = patch.varying
        corners = patch.increments(1)[[0, 1], [0, 1]]
        low, high = np.where(corners, shell.limits.maximum, shell.limits.minimum)
        legs = np.broadcast_to(low, (nodes, nodes, 6)).copy()
        half = (high - low) / 2.0
        legs[..., first] = (low + half)[first] + half[first] * x[:, None]
        legs[..., second] = (low + half)[second] + half[second] * x
        state = spm.forward_physical(shell.machine, legs)
        columns = spm.kinematics.platform_jacobian(state)[..., :3, :]
        normal = np.cross(columns[..., first], columns[..., second])
        corner = [int(patch.grid[at]) for at in ((0, 0), (1, 0), (1, 1))]
        face = [int(k) for k in shell.faces[patch.faces[0]]]
        sense = 1.0 if face in [corner[k:] + corner[:k] for k in range(3)] else -1.0
        integrand = (state.translation * normal).sum(axis=-1) * w[:, None] * w
        total += sense * float(integrand.sum() * half[first] * half[second] / 3.0)
    return total


def test_the_mesh_is_a_closed_outward_sphere() -> None:
    mesh = SHELL.mesh
    assert len(SHELL.vertices) == 24 * 16**2 + 2
    assert SHELL.euler_characteristic == mesh.euler_number == 2
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    # Vertices are apart, so nothing was left for a merge of nearly equal numbers to join.
    assert len(np.unique(SHELL.vertices.round(9), axis=0)) == len(SHELL.vertices)


def test_patches_are_forward_displacement_of_their_legs() -> None:
    assert [patch.name for patch in SHELL.patches] == [name for name, *_ in published.TABLE_6]
    assert SHELL.configuration.closure_residual.max() < 1e-14
    for patch in SHELL.patches:
        first, second = patch.varying
        legs = SHELL.configuration.leg_lengths[patch.grid]
        expected = np.broadcast_to(np.where(patch.increments(1)[0, 0], 1.5, 1.1), legs.shape).copy()
        expected[..., first] = np.linspace(1.1, 1.5, 17)[:, None]
        expected[..., second] = np.linspace(1.1, 1.5, 17)
        np.testing.assert_allclose(legs, expected, rtol=0.0, atol=1e-14)
        assert set(np.unique(SHELL.faces[patch.faces])) == set(patch.grid.ravel())
    assert SHELL.area == pytest.approx(SHELL.mesh.area, rel=1e-12)
    assert SHELL["Sm5"].varying == (0, 2)
    with pytest.raises(SelectionError, check=with_fields(argument="name")):
        SHELL["Sx1"]


def test_every_face_has_the_inside_behind_it_and_nothing_in_front() -> None:
    """Hence the shell does not meet itself either, to a hundredth of a millimetre."""
    mesh = SHELL.mesh
    np.testing.assert_array_equal(SHELL.winding_number(mesh.triangles_center + 1e-5 * mesh.face_normals), 0)
    np.testing.assert_array_equal(SHELL.winding_number(mesh.triangles_center - 1e-5 * mesh.face_normals), 1)


def test_the_papers_volume_and_its_convergence() -> None:
    shell = workspace_shell(PAPER)
    assert shell.volume == pytest.approx(1.653, rel=1e-3)
    assert shell.mesh.volume == pytest.approx(shell.convergence.volumes[-1], rel=1e-12)
    assert shell.mesh.volume == pytest.approx(1.653, rel=1e-3)
    assert shell.convergence.resolutions == (10, 20, 40)
    assert shell.convergence.order == pytest.approx(2.0, abs=1e-3)
    exact = flux(shell)
    assert abs(shell.volume - exact) < shell.volume_error < 1e-6
    assert abs(shell.mesh.volume - exact) > 100.0 * shell.volume_error


def test_the_error_estimate_covers_the_error() -> None:
    shell = workspace_shell(PAPER, resolution=5)
    assert abs(shell.volume - flux(SHELL)) < shell.volume_error


def test_inside_is_where_rays_say_and_distance_is_that_to_the_nearest_point_of_the_mesh() -> None:
    low, high = SHELL.vertices.min(axis=0) - 0.05, SHELL.vertices.max(axis=0) + 0.05
    points = np.random.default_rng(0).uniform(low, high, (5_000, 3))
    np.testing.assert_array_equal(SHELL.contains(points), SHELL.mesh.contains(points))
    points = points[:100]
    distance = SHELL.distance(points)
    triangles = SHELL.mesh.triangles
    from trimesh.triangles import closest_point

    every = (closest_point(triangles, np.tile(p, (len(triangles), 1))) - p for p in points)
    nearest = [np.linalg.norm(gaps, axis=1).min() for gaps in every]
    np.testing.assert_allclose(np.abs(distance), nearest, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(distance > 0.0, SHELL.contains(points))
    just_inside = SHELL.mesh.triangles_center[::50] - 1e-4 * SHELL.mesh.face_normals[::50]
    np.testing.assert_allclose(SHELL.distance(just_inside), 1e-4, rtol=1e-6)
    assert SHELL.distance(np.zeros((2, 0, 3))).shape == (2, 0)


def test_some_reachable_points_lie_outside_the_shell() -> None:
    legs = np.random.default_rng(6).uniform(1.1, 1.5, (20_000, 6))
    positions = spm.forward_physical(PAPER, legs).translation
    beyond = int(np.count_nonzero(~workspace_shell(PAPER, resolution=24).contains(positions)))
    interval = binomtest(beyond, 20_000).proportion_ci(0.999, "exact")
    assert 0.0 < interval.low < interval.high < 0.004


def test_limits_may_differ_from_leg_to_leg() -> None:
    limits = spm.LegLimits([1.1, 1.15, 1.2, 1.1, 1.1, 1.2], [1.5, 1.4, 1.5, 1.5, 1.45, 1.5])
    shell = workspace_shell(PAPER, limits, resolution=16)
    assert shell.limits == limits
    assert shell.mesh.is_watertight
    assert abs(shell.volume - flux(shell)) < shell.volume_error
    lengths = shell.configuration.leg_lengths[shell["St1"].grid]
    np.testing.assert_allclose(lengths[0, 0], (1.1, 1.15, 1.5, 1.5, 1.45, 1.5), atol=1e-14)
    np.testing.assert_allclose(lengths[-1, -1], (1.5, 1.4, 1.5, 1.5, 1.45, 1.5), atol=1e-14)
    assert SHELL.contains(shell.mesh.triangles_center).mean() > 0.9


@pytest.mark.parametrize(
    ("machine", "limits"),
    [
        (spm.Manipulator(0.7, 0.35, 0.8), None),
        (PAPER, spm.LegLimits(0.0, 1.5)),
        (PAPER, spm.LegLimits(1.1, np.inf)),
        (PAPER, spm.LegLimits(0.05, 0.1)),
        (PAPER, spm.LegLimits(0.3, 4.0)),
    ],
)
def test_limits_and_machines_without_a_shell(machine: spm.Manipulator, limits: spm.LegLimits | None) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="limits")):
        workspace_shell(machine, limits, resolution=4)


# --- Table 6: every cell is legible or a misprint named, and its rows close to a sphere ------------------------------

ROWS = sub_workspaces()


def test_only_the_misprints_named_are_misprints() -> None:
    assert Counter(row.family for row in ROWS) == {"St": 3, "Sc": 9, "Sm": 9, "Sl": 3}
    found = {}
    for name, *cells in published.TABLE_6:
        for leg, cell in zip(spm.machine.LEGS, cells, strict=True):
            low, high = f"{leg[2]}min", f"{leg[2]}max"
            if cell.replace("~", " ").split() not in ([low], [high], [low, high]):
                found[name, leg] = cell
    assert found == ERRATA
