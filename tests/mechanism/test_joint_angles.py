"""Joint values of configurations: the rotations they stand for, batches, middle angles of 90°."""

from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES, as_built, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.mechanism import FAMILIES, joint_angles
from spm_pin.mechanism.joint_angles import home_lengths

PAPER = GEOMETRIES["paper"]
NAMES = ("hip", "slide", "ball_x", "ball_y", "ball_z", "closure_residual")


def frame_about(axis: np.ndarray) -> np.ndarray:
    """x along a revolute axis, z as near to the platform's normal as that allows, as columns."""
    y = np.cross([0.0, 0.0, 1.0], axis)
    y = y / np.linalg.norm(y)
    return np.stack([axis, y, np.cross(axis, y)], axis=-1)


def check_turns(states: spm.Configuration) -> None:
    """The turns of a leg's joints lead from its platform to the middle one."""
    geometry, angles = states.geometry, joint_angles(states)
    homes, reach = np.repeat(home_lengths(geometry), 3), np.repeat(geometry.dimensions[:2], 3) - geometry.middle_radius
    leans = np.arctan2(reach * [-1, 1, 1, -1, 1, 1], np.sqrt(homes**2 - reach**2) * [1, 1, 1, -1, -1, -1])
    middle, terminal = states.middle_pose.rotation.as_matrix(), states.rotation
    for leg in range(6):
        frame, corner = frame_about(geometry.legs.axes[leg]), frame_about(geometry.revolute_axes[leg % 3])
        ball, turned = states.balls[:, leg], middle
        if leg >= 3:
            ball = ((ball - states.translation)[:, None] @ terminal)[:, 0]
            turned = np.swapaxes(terminal, -1, -2) @ turned
        hip = Rotation.from_euler("x", angles.hip[:, leg, None])
        # The leg's direction: its lean at home, turned by the hip.
        direction = hip.apply([0.0, -np.sin(leans[leg]), np.cos(leans[leg])])
        length = angles.slide[:, leg] + homes[leg]
        expected = length[:, None] * direction
        assert (ball - geometry.legs.pivots[leg]) @ frame == pytest.approx(expected, abs=1e-13 * max(length.max(), 1.0))
        x, y, z = (getattr(angles, f"ball_{axis}")[:, leg] for axis in "xyz")
        turns = hip * Rotation.from_euler("XYZ", np.stack([x, y, z], axis=-1))
        if leg >= 3:
            turns = hip * Rotation.from_euler("ZYX", np.stack([z, y, x], axis=-1)).inv()
        assert frame @ turns.as_matrix() @ corner.T == pytest.approx(turned, abs=1e-13)


@pytest.mark.parametrize("name", list(GEOMETRIES))
@pytest.mark.parametrize("family", FAMILIES)
def test_the_turns_of_a_leg_s_joints_lead_from_its_platform_to_the_middle_one(name: str, family: str) -> None:
    check_turns(random_branches(GEOMETRIES[name], family, 12, 1).configuration)


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


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)], ids=str)
def test_a_member_has_the_same_bits_in_any_batch(shape: tuple[int, ...]) -> None:
    states = random_branches(PAPER, "TF", 5000, 2).configuration
    together = joint_angles(states)
    size = int(np.prod(shape))
    chosen = np.random.default_rng(3).integers(5000, size=shape)
    alone = joint_angles(states[chosen])
    for name in NAMES:
        assert getattr(alone, name).shape[: len(shape)] == shape
        assert np.array_equal(getattr(alone, name), getattr(together, name)[chosen])
    assert size == alone.closure_residual.size


def test_the_balls_of_some_corners_are_those_of_all() -> None:
    states = random_branches(PAPER, "TT", 9, 4).configuration
    every, some = joint_angles(states), joint_angles(states, corners=(2, 0))
    for name in ("ball_x", "ball_y", "ball_z"):
        assert np.array_equal(getattr(some, name), getattr(every, name)[:, [2, 0, 5, 3]])


def test_absent_members_are_nan_everywhere() -> None:
    states = random_branches(PAPER, "TT", 3, 7).configuration
    joints = states.middle_joints.copy()
    joints[1] = np.nan
    found = joint_angles(spm.Configuration(PAPER, states.pose, joints))
    for name in NAMES:
        values = getattr(found, name)
        assert np.isnan(values[1]).all()
        assert np.isfinite(values[[0, 2]]).all()
    assert np.isnan(joint_angles(spm.Configuration(PAPER, states.pose[0], np.full((3, 3), np.nan))).hip).all()


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
    values = [np.atleast_2d(part)[0, 0] for part in (found.hip, found.ball_x, found.ball_y, found.ball_z)]
    turned = Rotation.from_euler("x", values[0]) * Rotation.from_euler("XYZ", values[1:])
    assert frame @ turned.as_matrix() @ frame.T == pytest.approx(platform, abs=1e-12)
    assert abs(values[2]) == pytest.approx(np.pi / 2, abs=1e-7)
