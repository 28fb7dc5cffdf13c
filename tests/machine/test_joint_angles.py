"""Joint values of configurations: the rotations they stand for, batches, middle angles of 90°."""

from __future__ import annotations

import kinds_of_legs
import numpy as np
import pytest
from kinds_of_legs import PAIRS, machine_of_kinds
from problems import MANIPULATORS, as_built, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.formulas.leg_constants import TANGENT_SIGNS
from spm_pin.machine import FAMILIES, PRS, RRS, Stage, joint_angles
from spm_pin.machine.joint_angles import home_readings

PAPER = MANIPULATORS["paper"]
NAMES = ("passive", "actuated", "ball_x", "ball_y", "ball_z", "closure_residual")


def frame_about(axis: np.ndarray) -> np.ndarray:
    """x along a revolute axis, z as near to the platform's normal as that allows, as columns."""
    y = np.cross([0.0, 0.0, 1.0], axis)
    y = y / np.linalg.norm(y)
    return np.stack([axis, y, np.cross(axis, y)], axis=-1)


def check_turns(states: spm.Configuration) -> None:
    """The values of a leg's joints lead from its platform to the middle one."""
    machine, angles, home = states.machine, joint_angles(states), home_readings(states.machine)
    middle, terminal = states.middle_pose.rotation.as_matrix(), states.rotation
    at_home, _ = machine.nominal.legs.circles(home + machine.nominal.legs.offsets)
    centres, radii = machine.legs.circles(angles.actuated + home + machine.legs.offsets)
    for leg in range(6):
        stage, sign = leg // 3, -TANGENT_SIGNS[leg % 3] * (1.0 - 2.0 * (leg // 3))
        frame, corner = frame_about(machine.legs.axes[leg]), frame_about(machine.revolute_axes[leg % 3])
        ball, turned = states.balls[:, leg], middle
        if stage:
            ball = ((ball - states.translation)[:, None] @ terminal)[:, 0]
            turned = np.swapaxes(terminal, -1, -2) @ turned
        # At home the balls are above their triangle, or below it where they hang, on the circles of the drawing's legs.
        kind, corner_place = machine.legs.kinds[stage].nominal, machine.nominal.legs.balls[leg] * [1.0, 1.0, 0.0]
        _, radius = kind.circles(home[3 * stage : 3 * stage + 3])
        rod = corner_place - at_home[leg] * [1.0, 1.0, 0.0]
        rise = kind.up * np.sqrt(radius[leg % 3] ** 2 - rod @ rod)
        _, y, z = np.array([rod[0], rod[1], (1.0 - 2.0 * stage) * rise]) @ corner
        lean = np.arctan2(-y, z)
        # A servo turns the passive joint with the crank.
        carried = angles.actuated[:, leg] if kind.unit == "rad" else 0.0
        turn = Rotation.from_euler("x", (angles.passive[:, leg] + sign * carried)[:, None])
        expected = radii[:, leg, None] * turn.apply([0.0, -np.sin(lean), np.cos(lean)])
        assert (ball - centres[:, leg]) @ frame == pytest.approx(expected, abs=1e-13 * max(radii.max(), 1.0))
        x, y, z = (getattr(angles, f"ball_{axis}")[:, leg] for axis in "xyz")
        turns = turn * Rotation.from_euler("XYZ", np.stack([x, y, z], axis=-1))
        if stage:
            turns = turn * Rotation.from_euler("ZYX", np.stack([z, y, x], axis=-1)).inv()
        assert frame @ turns.as_matrix() @ corner.T == pytest.approx(turned, abs=1e-13)


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), PAIRS)
def test_the_turns_of_legs_of_any_kind_lead_to_the_middle_platform(lower: str, upper: str, built: bool) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    found = kinds_of_legs.states(machine)
    check_turns(found)
    together = joint_angles(found).values
    for k in range(3):
        np.testing.assert_array_equal(joint_angles(found[k]).values, together[k])
    np.testing.assert_allclose(
        joint_angles(found).actuated + home_readings(machine), found.readings - machine.legs.offsets
    )


def test_homes_of_right_triangles() -> None:
    screws = Stage(4.0, 1.0, PRS(rod=5.0), limits=(0.0, 2.0))
    servos = Stage(3.0, 1.0, RRS(crank=2.0, rod=3.0), limits=(1.0, np.pi - 1.0))
    both = spm.Manipulator.of_stages(screws, servos)
    np.testing.assert_allclose(home_readings(both), [1.0] * 3 + [0.5 * np.pi] * 3)
    # Carriages at 1, rods of 5 over a distance of 3; cranks upright, rods of 3 over one of 2.
    found = spm.forward_physical(both, home_readings(both))
    assert found.translation == pytest.approx([0.0, 0.0, 1.0 + 4.0 + 2.0 + np.sqrt(5.0)])
    assert joint_angles(found).values == pytest.approx(0.0, abs=1e-14)
    # With the carriages above, a leg of the other working mode has its carriage 8 higher in the same place.
    mixed = spm.Manipulator.of_stages(Stage(4.0, 1.0, PRS(rod=5.0, sign=(-1, 1, -1)), limits=(0.0, 2.0)), servos)
    np.testing.assert_allclose(home_readings(mixed)[:3], [1.0, 9.0, 1.0])


def test_a_ball_out_of_reach_has_no_joint_values() -> None:
    machine = machine_of_kinds("RRS", "RPS")
    state = kinds_of_legs.states(machine)[0]
    far = spm.Configuration(machine, state.pose, state.middle_joints + np.array([0.0, 0.0, 5.0]))
    for found in (joint_angles(far), joint_angles(spm.Configuration(machine, far.pose, far.middle_joints[None]))):
        assert np.isnan(found.actuated[..., :3]).all()
        assert np.isfinite(found.actuated[..., 3:]).all()


def test_a_stage_that_stands_level_neither_at_its_limits_nor_without_is_refused() -> None:
    """With carriages on level slides at the pivots the balls would be behind them, in the other working mode."""
    level = Stage(0.20, 0.25, PRS(rod=0.30, direction=np.pi))
    with pytest.raises(spm.GeometryError, match=r"level at the middle of its limits.* Is a rod too short"):
        home_readings(spm.Manipulator.of_stages(level, Stage(0.20, 0.25)))


@pytest.mark.parametrize("name", list(MANIPULATORS))
@pytest.mark.parametrize("family", FAMILIES)
def test_the_turns_of_a_leg_s_joints_lead_from_its_platform_to_the_middle_one(name: str, family: str) -> None:
    check_turns(random_branches(MANIPULATORS[name], family, 12, 1).configuration)


@pytest.mark.parametrize("size", [1e-3, 5e-2])
def test_the_turns_of_a_machine_as_built_are_about_its_own_axes(size: float) -> None:
    built = as_built(PAPER, size, seed=1)
    states = spm.forward_physical(built, np.random.default_rng(2).uniform(1.2, 1.4, (12, 6)))
    states = states[states.exists]
    check_turns(states)
    torn = spm.Configuration(built, states.pose, states.middle_joints + 1e-3 * np.sin(np.arange(9.0)).reshape(3, 3))
    assert joint_angles(torn).closure_residual == pytest.approx(torn.closure_residual, rel=1e-12)
    for k in range(3):
        np.testing.assert_array_equal(joint_angles(states[k]).values, joint_angles(states).values[k])


def test_absent_members_are_nan_everywhere() -> None:
    states = random_branches(PAPER, "TT", 3, 7).configuration
    joints = states.middle_joints.copy()
    joints[1] = np.nan
    found = joint_angles(spm.Configuration(PAPER, states.pose, joints))
    for name in NAMES:
        values = getattr(found, name)
        assert np.isnan(values[1]).all()
        assert np.isfinite(values[[0, 2]]).all()
    assert np.isnan(joint_angles(spm.Configuration(PAPER, states.pose[0], np.full((3, 3), np.nan))).passive).all()


@pytest.mark.parametrize("batch", [False, True])
def test_balls_in_one_place_have_no_angles(batch: bool) -> None:
    joints = np.ones((2, 3, 3)) if batch else np.ones((3, 3))
    found = joint_angles(spm.Configuration(PAPER, spm.pose([0.0, 0.0, 2.0], xyx=[0.0, 0.0, 0.0]), joints))
    assert np.isnan(found.ball_x).all()


@pytest.mark.parametrize("batch", [False, True])
def test_a_middle_angle_of_ninety_degrees_leaves_the_rotation_right(batch: bool) -> None:
    """The first and the third angle are one there; together they still make the rotation."""
    frame = frame_about(PAPER.revolute_axes[0])
    platform = frame @ Rotation.from_euler("XYZ", [0.0, np.pi / 2, 0.7]).as_matrix() @ frame.T
    local = PAPER.middle_radius * PAPER.radial_directions
    joints = local @ platform.T + [0.0, 0.0, 1.2]
    pose = spm.pose([0.0, 0.0, 2.4], xyx=[0.0, 0.0, 0.0])
    found = joint_angles(spm.Configuration(PAPER, pose, np.stack([joints] * 2) if batch else joints))
    values = [np.atleast_2d(part)[0, 0] for part in (found.passive, found.ball_x, found.ball_y, found.ball_z)]
    turned = Rotation.from_euler("x", values[0]) * Rotation.from_euler("XYZ", values[1:])
    assert frame @ turned.as_matrix() @ frame.T == pytest.approx(platform, abs=1e-12)
    assert abs(values[2]) == pytest.approx(np.pi / 2, abs=1e-7)
