"""Machines as built go through the same search: what it returns closes, keeps the readings' limits, is physical."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.mechanism.branch_of_state import physical
from spm_pin.workspace import (
    nearest_reachable_pose,
    orientation_workspace,
    pose_distance,
    pose_volume,
    reachable,
    reachable_boundary,
    reachable_volume,
    sample_reachable,
)

PAPER = spm.Geometry.paper()
BUILT = PAPER.perturbed(3, length=5e-3, angle=5e-3)


def check_states(states: spm.Configuration) -> None:
    assert states.geometry == BUILT
    assert states.closure_residual.max() < 1e-13
    assert spm.LegLimits(1.1 - 1e-12, 1.5 + 1e-12).contains(states.readings).all()
    assert physical(states).all()


@pytest.mark.parametrize("space", ["legs", "poses"])
def test_random_states(space: str) -> None:
    states = sample_reachable(BUILT, 300, space=space, rng=1)  # type: ignore[arg-type]
    check_states(states)
    again = spm.forward_physical(BUILT, states.readings)
    np.testing.assert_allclose(again.translation, states.translation, atol=1e-9)
    assert reachable(BUILT, states.pose).reachable.mean() > 0.99


@pytest.mark.parametrize("geometry", [PAPER, BUILT], ids=["as drawn", "as built"])
@pytest.mark.parametrize("limits", [(1.1, 1.5), (0.6, 2.0)])
def test_a_drag_stays_within_the_limits_and_comes_never_farther(
    geometry: spm.Geometry, limits: tuple[float, float]
) -> None:
    rng, box = np.random.default_rng(6), spm.LegLimits(*limits)
    here = spm.forward_physical(geometry, [1.3] * 6)
    place, turn = here.translation.copy(), here.pose.rotation
    for _ in range(60):
        place = place + rng.normal(0.0, 0.04, 3)
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.03, 3)) * turn
        target = spm.pose(place, rotation=turn)
        before = pose_distance(geometry, here.pose, target)
        nearest = nearest_reachable_pose(geometry, target, box, near=here)
        here = nearest.configuration
        assert nearest.distance <= before + 1e-8
        assert nearest.distance == pytest.approx(pose_distance(geometry, here.pose, target), abs=1e-12)
        assert box.margin(here.readings) >= -1e-12
        assert here.closure_residual < 1e-13
        assert physical(here)


def test_without_limits_the_nearest_pose_has_the_branch() -> None:
    free = PAPER.from_parameters(BUILT.parameters)
    target = spm.pose([1.5, 0.4, 2.2], xyx=np.deg2rad([20.0, 30.0, -15.0]))
    drawn, built = (
        nearest_reachable_pose(machine, target, spm.LegLimits(0.0, np.inf), branch="TT+") for machine in (PAPER, free)
    )
    assert built.configuration.closure_residual < 1e-13
    assert built.distance == pytest.approx(drawn.distance, abs=0.03)


def test_volumes_and_boundaries_of_small_errors_are_nearly_those_of_the_drawing() -> None:
    small = PAPER.perturbed(7, length=1e-4, angle=1e-4)
    volumes = [reachable_volume(machine, samples=3000, rng=8) for machine in (PAPER, small)]
    assert volumes[1].value == pytest.approx(volumes[0].value, rel=0.02)
    limits = spm.LegLimits(1.1, 1.5)
    poses = [pose_volume(machine, limits, samples=4000, rng=9) for machine in (PAPER, small)]
    assert poses[1].value == pytest.approx(poses[0].value, rel=0.05)
    turns = [orientation_workspace(machine, [0.3, 0.1, 2.45], samples=3000, rng=9).volume for machine in (PAPER, small)]
    assert turns[1].value == pytest.approx(turns[0].value, rel=0.1)
    boundary = reachable_boundary(BUILT, spacing=0.4)
    states = spm.forward_physical(BUILT, boundary.readings)
    assert np.abs(states.translation - boundary.vertices).max() < 1e-5
    assert ((boundary.readings == 1.1) | (boundary.readings == 1.5)).any(axis=-1).all()
    points = boundary.sample(20, rng=1)
    assert points.violation.max() < 1e-6
