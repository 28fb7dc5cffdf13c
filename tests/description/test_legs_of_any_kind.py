"""The robot of RPS, PRS and RRS legs: its home, its files, and its loops in other programs."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from engines import Drake, Mujoco, Pinocchio, Yourdfpy
from kinds_of_legs import EACH_KIND, machine_of_kinds, states

import spm_pin as spm
from spm_pin.description import (
    actuated_joints,
    extended_urdf_text,
    joint_names,
    joint_values,
    mjcf_text,
    read_closures,
    sdf_text,
    srdf_text,
    urdf_text,
)
from spm_pin.description.robot import read_robot
from spm_pin.machine import PRS, RPS, RRS, Legs, Stage
from spm_pin.machine.joint_angles import home_readings

SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(-0.5, 1.5))
SCREWS = Stage(0.20, 0.25, PRS(rod=0.30), limits=(-0.05, 0.25))
ROBOT = spm.Manipulator.of_stages(SERVOS, SCREWS)
STATE = [0.4, 0.5, 0.6, 0.10, 0.12, 0.14]
STAGES = {
    "without limits": Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35)),
    "knees inside": Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35, sign=1), limits=(1.2, 2.6)),
    "a long way round": Stage(0.10, 0.25, RRS(crank=0.15, rod=0.20, sign=1)),
    "screws without limits": SCREWS,
    "carriages above": Stage(0.20, 0.25, PRS(rod=0.30, sign=1), limits=(0.4, 0.6)),
    "slides level": Stage(0.50, 0.25, PRS(rod=0.30, direction=np.pi), limits=(0.0, 0.1)),
    "slides inclined": Stage(0.50, 0.25, PRS(rod=0.40, direction=2.0), limits=(-0.1, 0.1)),
    "cylinders": Stage(0.30, 0.25, RPS(), limits=(0.3, 0.4)),
    "cylinders without limits": Stage(0.30, 0.25),
}


def closed(frames: dict[str, np.ndarray], state: spm.Configuration) -> None:
    """Frames of all links are those of a closed state."""
    np.testing.assert_allclose(frames["terminal_platform"], state.pose.as_matrix(), atol=1e-13)
    np.testing.assert_allclose(frames["middle_platform"], state.middle_pose.as_matrix(), atol=1e-13)
    for closure in read_closures():
        np.testing.assert_allclose(frames[closure.frame_a][:3, 3], frames[closure.frame_b][:3, 3], atol=1e-13)


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), EACH_KIND)
def test_loops_close_at_the_joint_values_of_a_state(lower: str, upper: str, built: bool, tmp_path: Path) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    robot, file = read_robot(machine), tmp_path / "robot.urdf"
    file.write_text(urdf_text(machine), encoding="utf-8")
    peer = Yourdfpy(file)
    assert {joint.name for joint in robot.moving} == set(joint_names(machine)) == set(peer.joints)
    assert tuple(robot.motors) == actuated_joints(machine)
    assert robot.is_assembled() == (not built)
    for state in states(machine)[:3]:
        closed(robot.frames(joint_values(state)), state)
        closed(peer.frames(joint_values(state)), state)


@pytest.mark.parametrize("name", STAGES)
def test_the_robot_stands_assembled_at_the_home_of_its_stages(name: str) -> None:
    """The sources in xacro and the joint values in Python take the same place for home: level, on one axis."""
    is_above = list(STAGES).index(name) % 2
    stages = (SCREWS, STAGES[name]) if is_above else (STAGES[name], SERVOS)
    machine = spm.Manipulator.of_stages(*stages)
    robot, home = read_robot(machine), home_readings(machine)
    assert robot.is_assembled()
    if STAGES[name].limits:
        limits = machine.limits
        np.testing.assert_allclose(home, 0.5 * np.add(limits.minimum, limits.maximum))
    frames = robot.frames()
    np.testing.assert_allclose(frames["terminal_platform"][:3, :3], np.eye(3), atol=1e-14)
    pose = spm.pose(frames["terminal_platform"][:3, 3], rpy=[0.0, 0.0, 0.0])
    state = spm.Configuration(machine, pose, np.array([frames[f"middle_b{i}"][:3, 3] for i in "123"]))
    assert state.closure_residual < 1e-13
    np.testing.assert_allclose(state.readings, home, atol=1e-12)
    np.testing.assert_allclose(list(joint_values(state).values()), 0.0, atol=1e-12)


def test_a_leg_of_the_other_working_mode_has_its_own_reading_at_home() -> None:
    kinds = RRS(crank=0.15, rod=0.35, sign=(-1, 1, -1)), PRS(rod=0.30)
    mixed = spm.Manipulator(*ROBOT.dimensions, legs=Legs(*ROBOT.legs.arrays, kinds))
    home = home_readings(mixed)
    assert home[0] == home[2] != home[1]
    assert read_robot(mixed).is_assembled()


def test_limits_and_efforts_of_actuated_joints_are_those_of_the_readings() -> None:
    built = ROBOT.perturbed(1)
    joints = [read_robot(built).joints[name] for name in actuated_joints(built)]
    zero = home_readings(built) + built.legs.offsets
    np.testing.assert_allclose([joint.limits["lower"] for joint in joints] + zero, ROBOT.limits.minimum, atol=1e-12)
    np.testing.assert_allclose([joint.limits["upper"] for joint in joints] + zero, ROBOT.limits.maximum, atol=1e-12)
    force = joints[3].limits["effort"]
    np.testing.assert_allclose(
        [joint.limits["effort"] for joint in joints[:3]], force * built.legs.kinds[0].numbers[:, 0]
    )
    free = read_robot(spm.Manipulator.of_stages(Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35)), SCREWS))
    ends = free.joints["leg_b1_hip"].limits
    assert ends["upper"] - ends["lower"] == pytest.approx(2.0 * np.pi)


def test_srdf_and_extended_urdf_name_the_joints_and_links_of_the_robot() -> None:
    state = spm.forward_physical(ROBOT, STATE)
    root, robot = ElementTree.fromstring(srdf_text({"mine": state}, prefix="left_")), read_robot(ROBOT, prefix="left_")
    groups = {g.get("name"): [j.get("name") for j in g.findall("joint")] for g in root.findall("group")}
    assert groups["legs"] == [f"left_{name}" for name in actuated_joints(ROBOT)]
    assert groups["mechanism"] == [f"left_{name}" for name in joint_names(ROBOT)]
    pairs = {frozenset((p.get("link1"), p.get("link2"))) for p in root.findall("disable_collisions")}
    assert {link for pair in pairs for link in pair} <= robot.links.keys()
    assert all({joint.parent, joint.child} in pairs for joint in robot.joints.values())
    motors = yaml.safe_load(extended_urdf_text(ROBOT))["name_mot"]
    assert motors == list(actuated_joints(ROBOT))
    far = spm.forward_physical(ROBOT, [-0.52, 0.5, 0.6, 0.10, 0.12, 0.14])
    assert "outside the leg limits, by 20.0 mrad" in srdf_text({"far": far})


@pytest.mark.parametrize("engine", [Pinocchio, Mujoco, Drake])
@pytest.mark.parametrize("suffix", ["urdf", "xml"])
def test_loops_hold_in_other_engines(engine: type, suffix: str, tmp_path: Path) -> None:
    pytest.importorskip({Pinocchio: "pinocchio", Mujoco: "mujoco", Drake: "pydrake"}[engine])
    state, file = spm.forward_physical(ROBOT, STATE), tmp_path / f"robot.{suffix}"
    file.write_text(urdf_text(ROBOT) if suffix == "urdf" else mjcf_text(ROBOT), encoding="utf-8")
    names = [joint.name for joint in read_robot(ROBOT).moving]
    robot = engine(file) if engine is Pinocchio else engine(file, names)
    assert sorted(robot.joints) == sorted(names)
    np.testing.assert_allclose(robot.gaps(dict.fromkeys(names, 0.0)), 0.0, atol=1e-12)
    np.testing.assert_allclose(robot.gaps(joint_values(state)), 0.0, atol=1e-12)
    frames = robot.frames(joint_values(state))
    np.testing.assert_allclose(
        frames["terminal_c1"], read_robot(ROBOT).frames(joint_values(state))["terminal_c1"], atol=1e-12
    )


def test_check_urdf_accepts_it(tmp_path: Path) -> None:
    program, file = shutil.which("check_urdf"), tmp_path / "robot.urdf"
    if program is None:
        pytest.skip("check_urdf, of liburdfdom-tools, is not installed")
    file.write_text(urdf_text(ROBOT), encoding="utf-8")
    answer = subprocess.run([program, str(file)], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert "Successfully Parsed" in answer.stdout


def test_sdf_closes_its_loops_by_joints() -> None:
    root = ElementTree.fromstring(sdf_text(ROBOT))
    kinds = [joint.get("type") for joint in root.iter("joint")]
    assert kinds.count("ball") == 4
    assert kinds.count("revolute") + kinds.count("prismatic") == 18


def test_a_stage_that_does_not_stand_level_has_no_description() -> None:
    level = Stage(0.20, 0.25, PRS(rod=0.30, direction=np.pi))
    with pytest.raises(spm.GeometryError, match="Is a rod too short, a sign wrong"):
        urdf_text(spm.Manipulator.of_stages(level, SCREWS))
