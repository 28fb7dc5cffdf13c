"""PyBullet reads the URDF; its closures are made from the description's pairs, at the centres of mass.

It hands poses over in single precision, at 2.6 m: what the other engines hold to 1e-12 is known to 1e-6 here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from description.kinematic_tree import STATES, TREE, Array, inertia

import spm_pin as spm
from spm_pin.description import URDF_PATH, joint_values, read_closures, urdf_text

pybullet = pytest.importorskip("pybullet")

from pybullet_utils.bullet_client import BulletClient  # noqa: E402

CLOSURES = read_closures()
SINGLE = 1e-6


class Robot:
    def __init__(self, path: str = URDF_PATH) -> None:
        self.client = BulletClient(pybullet.DIRECT)
        self.body = self.client.loadURDF(path, useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
        self.joints, self.links = {}, {}
        for i in range(self.client.getNumJoints(self.body)):
            info = self.client.getJointInfo(self.body, i)
            self.links[info[12].decode()] = i
            if info[2] != pybullet.JOINT_FIXED:
                self.joints[info[1].decode()] = i

    def frames(self) -> dict[str, Array]:
        poses = {}
        for link, i in self.links.items():
            state = self.client.getLinkState(self.body, i, computeForwardKinematics=1)
            poses[link] = np.eye(4)
            poses[link][:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
            poses[link][:3, 3] = state[4]
        return poses

    def set(self, values: Mapping[str, float]) -> None:
        for joint, value in values.items():
            self.client.resetJointState(self.body, self.joints[joint], value)

    def gap(self) -> float:
        frames = self.frames()
        return max(float(np.linalg.norm(frames[c.frame_a][:3, 3] - frames[c.frame_b][:3, 3])) for c in CLOSURES)


@pytest.fixture
def robot() -> Iterator[Robot]:
    robot = Robot()
    yield robot
    robot.client.disconnect()


def test_same_joints_frames_and_masses(robot: Robot) -> None:
    assert robot.joints.keys() == TREE.moving.keys()
    assert robot.links.keys() | {"base"} == TREE.links.keys()
    rng = np.random.default_rng(40)
    for values in [*STATES.values(), TREE.random_values(rng), TREE.random_values(rng)]:
        robot.set(values)
        expected = TREE.frames(values)
        for link, pose in robot.frames().items():
            np.testing.assert_allclose(pose, expected[link], atol=SINGLE, err_msg=link)
    for link, i in robot.links.items():
        dynamics = robot.client.getDynamicsInfo(robot.body, i)
        mass, _, moments = inertia(TREE.links[link])
        assert dynamics[0] == pytest.approx(mass, rel=SINGLE)
        np.testing.assert_allclose(dynamics[2], np.diag(moments), rtol=SINGLE)


@pytest.mark.parametrize("closed", [True, False])
def test_falling_the_loops_hold(robot: Robot, closed: bool) -> None:
    here = robot.client
    robot.set(STATES["reference"])
    here.setGravity(0.0, 0.0, -9.81)
    here.setTimeStep(1e-3)
    for i in robot.joints.values():  # the motors that PyBullet puts everywhere
        here.setJointMotorControl2(robot.body, i, pybullet.VELOCITY_CONTROL, force=0.0)
    for closure in CLOSURES if closed else ():
        a, b = (robot.links[frame] for frame in (closure.frame_a, closure.frame_b))
        states = (here.getLinkState(robot.body, link, computeForwardKinematics=1) for link in (a, b))
        # The frames' origins as the centres of mass see them.
        at_a, at_b = (pybullet.invertTransform(state[2], state[3])[0] for state in states)
        ends = (robot.body, a, robot.body, b, pybullet.JOINT_POINT2POINT, [0, 0, 0], at_a, at_b)
        here.changeConstraint(here.createConstraint(*ends), maxForce=1e7)
    gap = 0.0
    for _ in range(50):
        here.stepSimulation()
        gap = max(gap, robot.gap())
    now = {name: here.getJointState(robot.body, i)[0] for name, i in robot.joints.items()}
    assert max(abs(value - STATES["reference"][name]) for name, value in now.items()) > 1e-2
    assert gap < 1e-5 if closed else gap > 1e-3


def test_a_stage_alone_stands_where_the_closed_form_has_it(tmp_path: Path) -> None:
    stage = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11))
    state, file = spm.inverse_physical(stage, 0.12, tilt=0.2, azimuth=1.0), tmp_path / "stage.urdf"
    file.write_text(urdf_text(stage), encoding="utf-8")
    robot = Robot(str(file))
    try:
        robot.set(joint_values(state))
        frames = robot.frames()
    finally:
        robot.client.disconnect()
    np.testing.assert_allclose(frames["platform"], state.pose.as_matrix(), atol=SINGLE)
    for leg, ball in enumerate(state.balls, start=1):
        np.testing.assert_allclose(frames[f"leg_{leg}_tip"][:3, 3], ball, atol=SINGLE)


def test_the_page_says_how() -> None:
    page = Path(__file__).parents[2] / "docs" / "howto" / "load_elsewhere.md"
    (block,) = re.findall(r"```\n(import pybullet.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict[str, Any] = {}
    try:
        exec(block, names)
        assert pybullet.getNumConstraints() == 4
        for joint in pybullet.getConstraintUniqueId(0), pybullet.getConstraintUniqueId(3):
            assert pybullet.getConstraintInfo(joint)[0] == names["robot"]
    finally:
        pybullet.disconnect()
