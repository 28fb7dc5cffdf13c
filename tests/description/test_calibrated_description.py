"""The robot of a machine as built: its loops close, and engines find its rates and forces."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli.running import run
from description.kinematic_tree import SLIDES, KinematicTree
from engines import Drake

import spm_pin as spm
from spm_pin.description import joint_values, mjcf_text, read_closures, sdf_text, urdf_text
from spm_pin.description.robot import read_robot
from spm_pin.errors import DescriptionError

PAPER = spm.Manipulator.paper()
MACHINES = {
    "without errors": PAPER,
    "a millimetre": PAPER.perturbed(1, length=1e-3, angle=1e-3),
    "centimetres": PAPER.perturbed(2, length=2e-2, angle=5e-2),
}
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)).perturbed(1, length=1e-3, angle=1e-2)
LEGS = np.random.default_rng(0).uniform(1.2, 1.4, (12, 6))


def states(machine: spm.Manipulator) -> spm.Configuration:
    found = spm.forward_physical(machine, LEGS)
    assert found.exists.sum() > 8
    return found[found.exists]


def state_of(machine: spm.Manipulator | spm.Stage) -> spm.Configuration | spm.machine.StageConfiguration:
    if isinstance(machine, spm.Stage):
        return spm.forward_physical(machine, [0.2, 0.1, 0.3])
    return states(machine)[0]


@pytest.mark.parametrize("prefix", ["", "left_"])
@pytest.mark.parametrize("name", MACHINES)
def test_loops_close_to_rounding_at_the_joint_values_of_a_state(name: str, prefix: str) -> None:
    machine = MACHINES[name]
    robot = read_robot(machine, prefix=prefix)
    for state in states(machine):
        values = {prefix + joint: value for joint, value in joint_values(state).items()}
        frames = robot.frames(values)
        np.testing.assert_allclose(frames[f"{prefix}terminal_platform"], state.pose.as_matrix(), atol=1e-14)
        np.testing.assert_allclose(frames[f"{prefix}middle_platform"], state.middle_pose.as_matrix(), atol=1e-14)
        for closure in robot.closures:
            gap = frames[closure.frame_a][:3, 3] - frames[closure.frame_b][:3, 3]
            np.testing.assert_allclose(gap, 0.0, atol=1e-14)
        # What a slide says is the length without the offset, less the length at home.
        for slide, reading, offset in zip(SLIDES, state.readings, machine.legs.offsets, strict=True):
            assert values[prefix + slide] == pytest.approx(reading - offset - 1.3, abs=1e-14)


def test_a_state_named_in_the_description_is_of_its_machine() -> None:
    machine = MACHINES["a millimetre"]
    state = states(machine)[0]
    root = ElementTree.fromstring(mjcf_text(machine, states={"measured": state}))
    keys = {key.get("name"): key.get("qpos") for key in root.iter("key")}
    assert list(keys) == ["home", "measured"]
    values = joint_values(state)
    assert keys["measured"] == " ".join(repr(values[joint.name]) for joint in read_robot(machine).moving)
    with pytest.raises(DescriptionError, match="states"):
        mjcf_text(PAPER, states={"measured": state})


@pytest.mark.parametrize("name", MACHINES)
def test_leg_forces_balance_in_mujoco(name: str) -> None:
    """Slide forces and forces of MuJoCo's constraints together hold the wrench, in all eighteen joints."""
    mujoco = pytest.importorskip("mujoco")
    pytest.importorskip("pinocchio")
    machine = MACHINES[name]
    model = mujoco.MjModel.from_xml_string(mjcf_text(machine, anchors="sites"))
    data = mujoco.MjData(model)
    loads = np.random.default_rng(2).standard_normal((len(LEGS), 6))
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
        actuated[[model.joint(slide).dofadr[0] for slide in SLIDES], range(6)] = 1.0
        unknown = np.linalg.solve(np.concatenate([actuated, constraints.T], axis=1), -applied)
        np.testing.assert_allclose(unknown[:6], spm.leg_forces(state, load), rtol=1e-7, atol=1e-7)
        q = chain.joint_values(state)
        np.testing.assert_allclose(unknown[:6], chain.state(q).leg_forces(load), rtol=1e-7, atol=1e-7)
        # MuJoCo's constraints act onto the first frame of a closure.
        np.testing.assert_allclose(-unknown[6:].reshape(4, 3), chain.state(q).cut_forces(load), rtol=1e-7, atol=1e-7)


def test_files_of_a_machine(tmp_path: Path) -> None:
    machine = MACHINES["centimetres"]
    file = tmp_path / "machine.yaml"
    machine.to_yaml(file)
    for kind, text in (("urdf", urdf_text), ("mjcf", mjcf_text), ("sdf", sdf_text)):
        done = run("export", kind, "--machine", str(file))
        assert done.returncode == 0, done.stderr
        assert done.stdout == text(machine)
    tree, state = KinematicTree(urdf_text(machine)), states(machine)[0]
    values = joint_values(state)
    assert tree.gap(values, read_closures()) < 1e-13
    np.testing.assert_allclose(tree.frames(values)["terminal_platform"], state.pose.as_matrix(), atol=1e-13)
    # Limits of the slides are those of the readings.
    for end, limits in (("lower", PAPER.limits.minimum), ("upper", PAPER.limits.maximum)):
        slides = [tree.moving[name].limit[end] for name in SLIDES] + machine.legs.offsets + 1.3
        np.testing.assert_allclose(slides, limits, rtol=1e-9)


@pytest.mark.parametrize("anchors", ["bodies", "sites"])
@pytest.mark.parametrize("name", [*MACHINES, "stage"])
def test_the_home_of_an_mjcf_and_its_states_are_closed_in_mujoco(name: str, anchors: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    machine = BALANCER if name == "stage" else MACHINES[name]
    state = state_of(machine)
    model = mujoco.MjModel.from_xml_string(mjcf_text(machine, states={"mine": state}, anchors=anchors))
    data, count = mujoco.MjData(model), 3 * model.neq
    assert count == (6 if name == "stage" else 12)
    actuated = spm.description.actuated_joints(machine)
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


@pytest.mark.parametrize("name", [*MACHINES, "stage"])
def test_drake_closes_the_loops_of_an_mjcf_in_its_states(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pydrake")
    machine = BALANCER if name == "stage" else MACHINES[name]
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
