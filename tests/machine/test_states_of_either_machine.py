"""What states of stages and of manipulators have in common: a manipulator's legs are where those of its stages are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.machine.configuration import Configuration

LEGS = {"RPS": spm.RPS(), "PRS": spm.PRS(rod=0.4), "RRS": spm.RRS(crank=0.15, rod=0.35)}
OVER = RigidTransform.from_rotation(Rotation.from_euler("y", 180.0, degrees=True))


@pytest.mark.parametrize("upper", LEGS)
@pytest.mark.parametrize("lower", LEGS)
def test_legs_are_where_those_of_the_two_stages_are(lower: str, upper: str) -> None:
    below, above = spm.Stage(0.30, 0.25, LEGS[lower]), spm.Stage(0.32, 0.25, LEGS[upper])
    machine = spm.Manipulator.of_stages(below, above)
    poses = [spm.inverse_physical(stage, 0.35, roll=0.1, pitch=-0.2).pose for stage in (below, above)]
    # {n} of the upper stage turned over is that of the middle platform, at the same place.
    pose = poses[0] * OVER * poses[1].inv() * OVER
    state = spm.Configuration(machine, pose, poses[0].apply(below.legs.balls))
    assert state.is_at_home
    assert state.closure_residual < 1e-12
    halves = Configuration(below, poses[0]), Configuration(above, poses[1])
    lower_legs, upper_legs = slice(3), slice(5, 2, -1)
    place = pose * OVER
    for name in ("balls", "leg_bases", "circle_centres"):
        points = getattr(state, name)
        np.testing.assert_allclose(points[lower_legs], getattr(halves[0], name), atol=1e-12)
        np.testing.assert_allclose(points[upper_legs], place.apply(getattr(halves[1], name)), atol=1e-12)
    # Upper legs push from their balls to their circles.
    turned = halves[1].leg_vectors @ place.rotation.as_matrix().T
    np.testing.assert_allclose(state.leg_vectors[lower_legs], halves[0].leg_vectors, atol=1e-12)
    np.testing.assert_allclose(state.leg_vectors[upper_legs], -turned, atol=1e-12)
    np.testing.assert_allclose(state.tilt_cosine_sum, sum(half.tilt_cosine_sum for half in halves), atol=1e-12)
    np.testing.assert_allclose(state.readings[lower_legs], halves[0].readings, atol=1e-12)
    np.testing.assert_allclose(state.readings[upper_legs], halves[1].readings, atol=1e-12)
    assert machine.architecture == f"3{lower}-3{upper[::-1]}"
    assert below.architecture == f"3-{lower}"


def test_the_same_states_of_a_machine_with_other_limits() -> None:
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))
    states = spm.inverse_physical(stage, 0.12, tilt=[0.0, 0.2], azimuth=0.3)
    limited = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.1, 0.1))
    moved = states.with_machine(limited)
    assert moved.machine is limited
    np.testing.assert_array_equal(moved.balls, states.balls)
    np.testing.assert_array_equal((moved.limit_excess != 0.0).any(axis=-1), [True, True])
