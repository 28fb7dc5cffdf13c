"""Robots of all kinds of legs, nominal and calibrated: home, limits, and loops that close in other programs."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from engines import Drake, Yourdfpy
from error_fields import with_fields
from kinds_of_legs import SCREWS, SERVOS, machine_of_kinds, states
from kinds_of_legs import SERVOS_AND_SCREWS as ROBOT

import spm_pin as spm
from spm_pin.description import (
    actuated_joints,
    joint_names,
    joint_values,
    mjcf_text,
    read_closures,
    urdf_text,
)
from spm_pin.description.robot import read_robot
from spm_pin.errors import DescriptionError
from spm_pin.machine import PRS, RPS, RRS, Legs, Stage
from spm_pin.machine.joint_angles import home_readings

BUILT = machine_of_kinds("RPS", "RPS", built=True)
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)).perturbed(1, length=1e-3, angle=1e-2)
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


def state_of(machine: spm.Manipulator | spm.Stage) -> spm.Configuration:
    return spm.forward_physical(machine, [0.2, 0.1, 0.3]) if isinstance(machine, spm.Stage) else states(machine)[0]


def closed(frames: dict[str, np.ndarray], state: spm.Configuration) -> None:
    """Frames of all links are those of a closed state."""
    np.testing.assert_allclose(frames["terminal_platform"], state.pose.as_matrix(), atol=1e-13)
    np.testing.assert_allclose(frames["middle_platform"], state.middle_pose.as_matrix(), atol=1e-13)
    for closure in read_closures():
        np.testing.assert_allclose(frames[closure.frame_a][:3, 3], frames[closure.frame_b][:3, 3], atol=1e-13)


@pytest.mark.parametrize(
    ("lower", "upper", "built"), [("RPS", "RPS", True), ("PRS", "RRS", False), ("RRS", "PRS", True)]
)
def test_loops_close_at_the_joint_values_of_a_state(lower: str, upper: str, built: bool, tmp_path: Path) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    robot, file = read_robot(machine), tmp_path / "robot.urdf"
    file.write_text(urdf_text(machine), encoding="utf-8")
    peer = Yourdfpy(file)
    assert {joint.name for joint in robot.moving} == set(joint_names(machine)) == set(peer.joints)
    assert tuple(robot.motors) == actuated_joints(machine)
    assert robot.is_assembled() == (not built)
    for state in states(machine)[:3]:
        values = joint_values(state)
        closed(robot.frames(values), state)
        closed(peer.frames(values), state)
        moved = state.readings - machine.legs.offsets - home_readings(machine)
        np.testing.assert_allclose([values[name] for name in actuated_joints(machine)], moved, atol=1e-13)


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


def test_a_state_named_in_the_description_is_of_its_machine() -> None:
    machine, state = BUILT, states(BUILT)[0]
    root = ElementTree.fromstring(mjcf_text(machine, states={"measured": state}))
    keys = {key.get("name"): key.get("qpos") for key in root.iter("key")}
    assert list(keys) == ["home", "measured"]
    values = joint_values(state)
    assert keys["measured"] == " ".join(repr(values[joint.name]) for joint in read_robot(machine).moving)
    with pytest.raises(DescriptionError, check=with_fields(argument="states")):
        mjcf_text(states={"measured": state})


def test_leg_forces_balance_in_mujoco() -> None:
    """Slide forces and forces of MuJoCo's constraints together hold the wrench, in all eighteen joints."""
    mujoco = pytest.importorskip("mujoco")
    machine = BUILT
    model = mujoco.MjModel.from_xml_string(mjcf_text(machine))
    data = mujoco.MjData(model)
    loads = np.random.default_rng(2).standard_normal((12, 6))
    chain = spm.ClosedChain.from_urdf(machine=machine)
    for state, load in zip(states(machine), loads, strict=False):
        for joint, value in joint_values(state).items():
            data.qpos[model.joint(joint).qposadr[0]] = value
        mujoco.mj_forward(model, data)
        body = model.body("terminal_c1").id  # MuJoCo has fused the platform with its corner
        linear, angular = np.zeros((2, 3, model.nv))
        mujoco.mj_jac(model, data, linear, angular, state.translation, body)
        applied = linear.T @ load[:3] + angular.T @ load[3:]
        # Before the rows of joint limits come those of the four closures.
        constraints = data.efc_J.reshape(-1, model.nv)[:12]
        assert np.abs(data.efc_pos[:12]).max() < 1e-12
        actuated = np.zeros((model.nv, 6))
        actuated[[model.joint(slide).dofadr[0] for slide in actuated_joints(machine)], range(6)] = 1.0
        unknown = np.linalg.solve(np.concatenate([actuated, constraints.T], axis=1), -applied)
        np.testing.assert_allclose(unknown[:6], spm.leg_forces(state, load), rtol=1e-7, atol=1e-7)
        q = chain.joint_values(state)
        np.testing.assert_allclose(unknown[:6], chain.state(q).leg_forces(load), rtol=1e-7, atol=1e-7)
        # MuJoCo's constraints act onto the first frame of a closure.
        np.testing.assert_allclose(-unknown[6:].reshape(4, 3), chain.state(q).cut_forces(load), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("name", ["robot", "stage"])
def test_the_home_of_an_mjcf_and_its_states_are_closed_in_mujoco(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    machine = BALANCER if name == "stage" else BUILT
    state = state_of(machine)
    model = mujoco.MjModel.from_xml_string(mjcf_text(machine, states={"mine": state}))
    data, count = mujoco.MjData(model), 3 * model.neq
    assert count == (6 if name == "stage" else 12)
    actuated = actuated_joints(machine)
    for key in ("home", "mine"):
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[:count]).max() < 1e-13
        driven = [data.qpos[model.joint(joint).qposadr[0]] for joint in actuated]
        expected = [0.0] * len(actuated) if key == "home" else [joint_values(state)[joint] for joint in actuated]
        assert driven == expected
    # The platform is where the tree of the URDF has it.
    site = data.site("platform_site" if name == "stage" else "terminal_platform_site")
    np.testing.assert_allclose(site.xpos, state.translation, atol=1e-13)
    np.testing.assert_allclose(site.xmat.reshape(3, 3), state.rotation, atol=1e-13)


@pytest.mark.parametrize("name", ["robot", "stage"])
def test_drake_closes_the_loops_of_an_mjcf_in_its_states(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    machine = BALANCER if name == "stage" else BUILT
    (tmp_path / "robot.xml").write_text(mjcf_text(machine, actuators="motors", collisions="none"), encoding="utf-8")
    tree = read_robot(machine)
    robot = Drake(tmp_path / "robot.xml", [joint.name for joint in tree.moving])
    assert robot.plant.num_constraints() == (2 if name == "stage" else 4)
    home = tree.closed_home()
    default = robot.plant.GetPositions(robot.plant.CreateDefaultContext())
    assert default.tolist() == [home[joint] for joint in robot.joints]
    for values in (home, joint_values(state_of(machine))):
        gaps = robot.gaps(values)
        assert gaps.shape == (2 if name == "stage" else 4, 3)
        np.testing.assert_allclose(gaps, 0.0, atol=1e-12)
