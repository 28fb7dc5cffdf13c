"""What states of stages and of manipulators have in common: a manipulator's legs are where those of its stages are."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

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
    halves = spm.Configuration(below, poses[0]), spm.Configuration(above, poses[1])
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


def test_both_have_a_tilt_and_a_height_of_their_platform() -> None:
    stage, machine = spm.Stage(0.7, 0.46), spm.Manipulator.paper()
    for tilt, azimuth, torsion in ((0.3, 0.4, 0.0), (0.2, -2.0, 0.3)):
        axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        turn = Rotation.from_rotvec(tilt * axis) * Rotation.from_euler("z", torsion)
        pose = RigidTransform.from_components([0.1, -0.2, 1.3], turn)
        for state in (spm.Configuration(stage, pose), spm.Configuration(machine, pose, np.eye(3))):
            found = [state.tilt, state.azimuth, state.torsion, state.height, *state.shift]
            np.testing.assert_allclose(found, [tilt, azimuth, torsion, 1.3, 0.1, -0.2], atol=1e-15)
            turns = Rotation.from_euler("XYZ", [state.roll, state.pitch, 0.0])
            np.testing.assert_allclose(turns.apply([0.0, 0.0, 1.0]), state.normal, atol=1e-15)


def test_the_middle_joints_of_a_stage_are_its_balls_and_it_has_no_upper_legs() -> None:
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))
    states = spm.inverse_displacement(stage, [0.11, 0.12], tilt=0.2, azimuth=1.0)
    np.testing.assert_array_equal(states.middle_joints, states.configurations.balls)
    np.testing.assert_array_equal(states.configurations.middle_pose.as_matrix(), states.configurations.pose.as_matrix())
    level = spm.inverse_physical(stage, 0.12)
    for name in ("platform_joints", "platform_axes"):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="machine")):
            getattr(level, name)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="middle_joints")):
        spm.Configuration(stage, level.pose, level.balls)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="middle_joints")):
        spm.Configuration(spm.Manipulator.paper(), level.pose)


def test_states_of_another_kind_of_machine_are_refused() -> None:
    stage, machine = spm.Stage(0.7, 0.46), spm.Manipulator.paper()
    level, state = spm.inverse_physical(stage, 1.2), spm.forward_physical(machine, [1.2, 1.3, 1.25, 1.3, 1.2, 1.25])
    calls = {
        "near": (
            lambda: spm.inverse_displacement(stage, 1.2).nearest(state),
            lambda: spm.inverse_displacement(machine, state.pose).nearest(level),
            lambda: spm.forward_physical(stage, level.readings, near=state),
        ),
        "configuration": (
            lambda: spm.kinematics.parasitic_jacobian(state),
            lambda: spm.kinematics.determinant_gradients(level),
        ),
        "machine": (lambda: state.with_machine(spm.Manipulator(1.0, 0.5, 0.6)), lambda: level.with_machine(machine)),
        "mask": (lambda: state.where([True, False]), lambda: level.where("all")),
        "start": (lambda: spm.follow(stage, [level.readings, level.readings + 0.01], start=state),),
    }
    for argument, refused in calls.items():
        for call in refused:
            with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
                call()


@pytest.mark.parametrize("machine", [*LEGS, "manipulator"])
def test_empty_batches_have_empty_answers(machine: str) -> None:
    own = spm.Manipulator.paper() if machine == "manipulator" else spm.Stage(0.30, 0.25, LEGS[machine])
    none, legs = spm.forward_physical(own, np.zeros((0, len(own.legs.names)))), len(own.legs.names)
    assert none.is_at_home.shape == none.exists.shape == (0,)
    assert spm.inverse_jacobian(none).shape == spm.stiffness(none, 1e6).shape == (0, legs, legs)
    assert spm.kinematics.compliance(none, 1e6).shape == (0, 6, 6)
    assert spm.determinants(none).shape[0] == spm.singularities(none).kind.shape[0] == 0
    assert spm.kinematics.joint_loads(none, np.ones(6)).rods.shape == (0, legs)
    assert spm.capability.joint_reactions(none).axial.shape == (0, legs, 6)
