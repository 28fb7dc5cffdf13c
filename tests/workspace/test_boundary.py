"""The boundary's mesh, and the theorem behind it, checked by searches that do not use it."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from problems import PAPER
from scipy.optimize import minimize

import spm_pin as spm
from spm_pin.workspace.boundary import Boundary, BoundaryPoints, reachable_boundary
from spm_pin.workspace.positions import reachable_position

NARROW = spm.LegLimits(1.2, 1.4)
LEGS_APART = spm.LegLimits([1.2, 1.25, 1.2, 1.2, 1.2, 1.3], [1.4, 1.4, 1.35, 1.4, 1.4, 1.4])


@pytest.fixture(scope="module")
def boundary() -> Boundary:
    return reachable_boundary(PAPER, spacing=0.3)


@pytest.fixture(scope="module")
def points(boundary: Boundary) -> BoundaryPoints:
    return boundary.sample(120, rng=1)


def check_theorem(points: BoundaryPoints, limits: spm.LegLimits) -> None:
    """A leg is at a limit or the Jacobian is singular; and no leg can move o outwards."""
    low, high = np.array(limits.minimum), np.array(limits.maximum)
    np.testing.assert_array_equal(points.at_limit == -1, points.readings == low)
    np.testing.assert_array_equal(points.at_limit == 1, points.readings == high)
    # Recomputed here, by the platform's Jacobian.
    states = spm.forward_physical(PAPER, points.readings)
    np.testing.assert_allclose(states.translation, points.position, atol=1e-9)
    jacobian = spm.kinematics.platform_jacobian(states)[:, :3]
    outward = (points.normal[:, :, None] * jacobian).sum(axis=1)
    np.testing.assert_allclose(np.linalg.norm(points.normal, axis=-1), 1.0, atol=1e-9)
    tolerance = 1e-6
    assert np.abs(outward[points.at_limit == 0]).max() < tolerance
    assert outward[points.at_limit == 1].min() > -tolerance
    assert outward[points.at_limit == -1].max() < tolerance
    at_a_limit = (points.at_limit != 0).any(axis=-1)
    smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    assert (at_a_limit | (smallest < tolerance)).all()
    assert points.violation.max() < tolerance


def test_the_mesh_is_closed_and_oriented_outward(boundary: Boundary) -> None:
    assert boundary.volume > 0.0
    mesh = boundary.mesh
    assert mesh.is_watertight, "each edge twice"
    assert mesh.is_winding_consistent, "in both senses"
    assert mesh.volume == pytest.approx(boundary.volume, rel=1e-9)
    assert mesh.area == pytest.approx(boundary.area, rel=1e-9)
    assert mesh.euler_number == boundary.euler_characteristic


def test_boundary_points_obey_the_theorem(points: BoundaryPoints) -> None:
    check_theorem(points, spm.LegLimits(1.1, 1.5))


def test_limits_may_differ_from_leg_to_leg() -> None:
    boundary = reachable_boundary(PAPER, LEGS_APART, spacing=0.5)
    assert boundary.limits == LEGS_APART
    check_theorem(boundary.sample(50, rng=2), LEGS_APART)


def test_boundary_points_moved_outwards_are_unreachable_and_inwards_reachable(points: BoundaryPoints) -> None:
    outside = reachable_position(PAPER, points.position + 1e-3 * points.normal)
    assert not outside.reachable.any()
    np.testing.assert_allclose(outside.distance, 1e-3, rtol=1e-3)
    # On an edge or a corner of the set, square to one of its sides may lead out through another.
    smooth = (points.at_limit == 0).sum(axis=-1) >= 2
    inside = reachable_position(PAPER, points.position - 1e-4 * points.normal)
    assert inside.reachable[smooth].mean() > 0.97


def test_a_solver_for_constrained_optimisation_gets_no_farther_out(points: BoundaryPoints) -> None:
    """No leg lengths that keep o within 3 cm of a boundary point's normal line put it farther out nearby."""
    rng = np.random.default_rng(3)
    for k in range(3):
        place, normal = points.position[k], points.normal[k]

        def off(legs: np.ndarray, place: np.ndarray = place) -> np.ndarray:
            return spm.forward_physical(PAPER, legs).translation - place

        # Nearest to a point 1 cm outside.
        target = 0.01 * normal

        def distance2(legs: np.ndarray, target: np.ndarray = target) -> float:
            return float(((off(legs) - target) ** 2).sum()) * 1e4

        for _ in range(3):
            start = np.clip(points.readings[k] + rng.normal(0.0, 0.1, 6), 1.1, 1.5)
            answer = minimize(distance2, start, bounds=[(1.1, 1.5)] * 6, method="SLSQP", options={"maxiter": 60})
            assert np.sqrt(answer.fun) >= 1.0 - 1e-3


def test_dense_sample_of_leg_lengths_lies_inside(boundary: Boundary) -> None:
    rng = np.random.default_rng(4)
    sample = spm.forward_physical(PAPER, 1.1 + 0.4 * rng.beta(0.3, 0.3, (3000, 6))).translation
    signed = boundary.distance(sample[:300])
    np.testing.assert_array_equal(signed > 0.0, boundary.mesh.contains(sample[:300]))
    # Outside the mesh by no more than it cuts off the set.
    assert signed.min() > -boundary.spacing
    assert sample.min(axis=0) == pytest.approx(boundary.vertices.min(axis=0), abs=boundary.spacing)


def test_the_search_reports_progress_and_can_be_interrupted() -> None:
    told: list[tuple[str, int, int]] = []

    def tell(what: str, done: int, of: int) -> None:
        told.append((what, done, of))
        if what == "vertices":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reachable_boundary(PAPER, NARROW, spacing=0.6, progress=tell)
    assert all(0 <= done <= of for _, done, of in told)
    assert len({what for what, _, _ in told}) >= 3


def test_a_spacing_in_millimetres_is_refused() -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="spacing")):
        reachable_boundary(PAPER, spacing=1e-3)
