"""A stage alone as xacro, URDF, MJCF, SDF and SRDF: its loops, servos and ball, in other programs."""

from __future__ import annotations

import itertools
import re
import subprocess
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml
from balancers import HEIGHTS, STAGES
from engines import Drake, Mujoco, Pinocchio, Yourdfpy
from error_fields import with_fields

import spm_pin as spm
from spm_pin.description import (
    Ball,
    Masses,
    RigidBody,
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
from spm_pin.description.source_files import MESHES, description_directory
from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.machine.joint_angles import home_readings, joint_angles

Array = np.ndarray
LIMITS = {"RRS": (-0.6, 1.2), "RRS inwards": (1.6, 3.0), "RPS": (0.8, 1.4), "PRS hanging": (0.6, 1.0)}
DRAWN = {name: spm.Stage(*stage.stage_radii[0], stage.kind, LIMITS.get(name)) for name, stage in STAGES.items()}
DRAWN["PRS below its pivots"] = STAGES["PRS hanging"]
KINDS = "RPS", "PRS inclined", "RRS"
MACHINES = {name: (name, False) for name in (*KINDS, "PRS below its pivots", "RRS inwards")}
MACHINES |= {f"{name} as built": (name, True) for name in KINDS}
BALANCER = DRAWN["RRS"]


def stage_and_states(machine: str, count: int = 6) -> tuple[spm.Stage, spm.Configuration]:
    """Return one of `MACHINES`, and states of it that lean by up to 0.2 rad."""
    name, built = MACHINES[machine]
    stage, height = DRAWN[name], -0.4 if "below" in name else HEIGHTS.get(name, 0.5)
    if built:
        stage = stage.perturbed(3, length=5e-3 * stage.size, angle=5e-3)
    rng = np.random.default_rng(7)
    tilt, azimuth = rng.uniform(0.0, 0.2, count), rng.uniform(-np.pi, np.pi, count)
    states = spm.inverse_physical(stage, height * rng.uniform(0.97, 1.03, count), tilt=tilt, azimuth=azimuth)
    assert states.exists.all()
    return stage, states


def is_closed(frames: dict[str, Array], state: spm.Configuration, tolerance: float = 1e-13) -> None:
    """The platform is in the pose of the closed form, whose balls are where the legs end."""
    np.testing.assert_allclose(frames["platform"], state.pose.as_matrix(), atol=tolerance)
    for leg in range(3):
        np.testing.assert_allclose(frames[f"leg_{leg + 1}_tip"][:3, 3], state.balls[leg], atol=tolerance)
        np.testing.assert_allclose(frames[f"platform_b{leg + 1}"][:3, 3], state.balls[leg], atol=tolerance)


@pytest.mark.parametrize("machine", MACHINES)
def test_loops_close_at_the_joint_values_of_a_state(machine: str, tmp_path: Path) -> None:
    stage, states = stage_and_states(machine)
    robot, file = read_robot(stage), tmp_path / "stage.urdf"
    file.write_text(urdf_text(stage), encoding="utf-8")
    peer = Yourdfpy(file)
    assert {joint.name for joint in robot.moving} == set(joint_names(stage)) == set(peer.joints)
    assert tuple(robot.motors) == actuated_joints(stage)
    assert robot.is_assembled() == stage.is_nominal
    for state in states:
        values = joint_values(state)
        assert tuple(values) == joint_names(stage)
        is_closed(robot.frames(values), state)
        is_closed(peer.frames(values), state)
        moved = state.readings - stage.legs.offsets - home_readings(stage)
        np.testing.assert_allclose([values[name] for name in actuated_joints(stage)], moved, atol=1e-13)


def test_a_batch_has_the_joint_angles_of_its_members_and_of_the_lower_stage_of_a_robot() -> None:
    stage, states = stage_and_states("RRS")
    angles = joint_angles(states)
    np.testing.assert_array_equal(angles.values, [joint_angles(state).values for state in states])
    with pytest.raises(ArgumentError, check=with_fields(argument="configuration")):
        joint_values(states)
    assert angles.passive.shape == angles.actuated.shape == angles.ball_x.shape == (6, 3)
    robot = spm.Manipulator.of_stages(stage, stage)
    both = joint_angles(spm.Configuration(robot, states.pose, states.balls))
    for name in ("passive", "ball_x", "ball_y", "ball_z", "actuated"):
        np.testing.assert_allclose(getattr(angles, name), getattr(both, name)[..., :3], atol=1e-14, err_msg=name)


def test_the_xacro_command_gives_the_same_tree(tmp_path: Path) -> None:
    stage, _ = stage_and_states("PRS inclined as built")
    stage.to_yaml(tmp_path / "mine.yaml")
    source = description_directory() / "stage.urdf.xacro"
    command = [str(Path(sysconfig.get_path("scripts")) / "xacro"), str(source), f"stage:={tmp_path / 'mine.yaml'}"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    by_hand, ours = (
        ElementTree.canonicalize(x, strip_text=True) for x in (answer.stdout, urdf_text(stage, meshes=MESHES))
    )
    assert by_hand == ours


def test_the_file_that_comes_with_the_sources_is_a_stage_and_numbers_left_out_are_the_usual_ones() -> None:
    """The sources in xacro read it by themselves, and know what a leg's numbers are by default."""
    file = description_directory() / "config" / "stage.yaml"
    assert spm.Stage.from_yaml(file) == spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
    assert "sign" not in yaml.safe_load(file.read_text(encoding="utf-8"))["legs"]
    command = [str(Path(sysconfig.get_path("scripts")) / "xacro"), str(description_directory() / "stage.urdf.xacro")]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    expected = urdf_text(spm.Stage.from_yaml(file), meshes=MESHES)
    assert ElementTree.canonicalize(answer.stdout, strip_text=True) == ElementTree.canonicalize(
        expected, strip_text=True
    )


@pytest.mark.parametrize(
    ("engine", "suffix", "machine"),
    [(Pinocchio, "urdf", "RRS"), (Mujoco, "urdf", "RRS"), (Drake, "xml", "PRS inclined")],
)
def test_loops_hold_in_other_engines(engine: type, suffix: str, machine: str, tmp_path: Path) -> None:
    pytest.importorskip({Pinocchio: "pinocchio", Mujoco: "mujoco", Drake: "pydrake"}[engine])
    stage, states = stage_and_states(machine)
    file = tmp_path / f"stage.{suffix}"
    # Drake has no servos whose controls are not the values of joints.
    actuators = "motors" if engine is Drake else "servos"
    text = urdf_text(stage) if suffix == "urdf" else mjcf_text(stage, actuators=actuators)
    file.write_text(text, encoding="utf-8")
    names = [joint.name for joint in read_robot(stage).moving]
    robot = {
        Pinocchio: lambda: Pinocchio(file, stage),
        Mujoco: lambda: Mujoco(file, names, machine=stage),
        Drake: lambda: Drake(file, names),
    }[engine]()
    assert sorted(robot.joints) == sorted(names)
    for state in states:
        values = joint_values(state)
        gaps = robot.gaps(values)
        assert gaps.shape == (2, 3)
        np.testing.assert_allclose(gaps, 0.0, atol=1e-12)
    if engine is Drake:
        assert robot.plant.num_actuators() == 3


@pytest.mark.parametrize("machine", ["RRS as built", "PRS inclined as built", "RPS"])
def test_servos_in_mujoco_lead_the_platform_where_the_closed_form_has_it(machine: str) -> None:
    """MuJoCo settles by its own dynamics; what its servos then read gives the pose of its platform in closed form."""
    stage, states = stage_and_states(machine)
    model = mujoco.MjModel.from_xml_string(mjcf_text(stage, states={"first": states[0]}))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("first").id)
    np.testing.assert_allclose(data.ctrl, states[0].readings, atol=1e-14)
    zeros, opened = home_readings(stage) + stage.legs.offsets, 0.0
    order = [int(model.joint(name).qposadr[0]) for name in actuated_joints(stage)]
    for before, after in itertools.pairwise(states):
        # From one state to the next in 0.2 s, and 0.3 s at rest.
        for share in np.clip(np.linspace(0.0, 2.5, 500), 0.0, 1.0):
            data.ctrl[:] = before.readings + share * (after.readings - before.readings)
            mujoco.mj_step(model, data)
            opened = max(opened, float(np.abs(data.efc_pos[: data.ne]).max()))
        mujoco.mj_forward(model, data)
        found = spm.forward_physical(stage, data.qpos[order] + zeros)
        assert np.abs(data.efc_pos[: data.ne]).max() < 1e-8
        np.testing.assert_allclose(data.body("platform").xpos, found.translation, atol=1e-8)
        np.testing.assert_allclose(data.body("platform").xmat.reshape(3, 3), found.rotation, atol=1e-7)
        # The servos give way by a quarter of a millimetre, in the plane of the leg.
        given_way = np.abs(found.readings - after.readings) * stage.legs.largest_slopes
        assert (given_way < 3e-4).all()
    assert opened < 1e-4 * stage.size


@pytest.mark.parametrize(("sign", "limits"), [(1, (0.1, 0.4)), (-1, (-0.8, -0.5))])
def test_the_keyframe_home_of_a_stage_below_its_pivots_is_the_middle_of_its_limits(
    sign: int, limits: tuple[float, float]
) -> None:
    stage = spm.Stage(0.35, 0.20, spm.PRS(rod=0.40, sign=sign), limits=limits)
    model = mujoco.MjModel.from_xml_string(mjcf_text(stage))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.ctrl, np.mean(limits), atol=1e-14)
    assert np.abs(data.efc_pos[: data.ne]).max() < 1e-12
    level = spm.inverse_physical(stage, data.body("platform").xpos[2])
    np.testing.assert_allclose(level.readings, data.ctrl, atol=1e-12)


def test_servos_have_the_limits_of_the_stage() -> None:
    stage = BALANCER.perturbed(3, length=1e-3, angle=5e-3)
    model = mujoco.MjModel.from_xml_string(mjcf_text(stage))
    np.testing.assert_allclose(model.actuator_ctrlrange, np.tile([-0.6, 1.2], (3, 1)), atol=1e-12)
    assert [model.actuator(k).name for k in range(3)] == ["leg_1_servo", "leg_2_servo", "leg_3_servo"]
    # A comment has the differences of readings and joint values.
    (zeros,) = re.findall(r"the value of its joint plus (.*?)\. Their", mjcf_text(stage))
    np.testing.assert_array_equal(np.array(zeros.split(), float), home_readings(stage) + stage.legs.offsets)
    assert (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE).all()
    small = spm.Stage(0.04, 0.045, spm.RRS(crank=0.025, rod=0.055))
    efforts = mujoco.MjModel.from_xml_string(mjcf_text(small)).jnt_actfrcrange
    assert np.count_nonzero(efforts[:, 1] > 0.0) == 3
    assert efforts.max() < 1.0
    motors = mujoco.MjModel.from_xml_string(mjcf_text(stage, actuators="motors"))
    assert (motors.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE).all()
    robot = mujoco.MjModel.from_xml_string(mjcf_text(actuators="servos"))
    assert (robot.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE).all()
    with pytest.raises(ArgumentError, check=with_fields(argument="actuators")):
        mjcf_text(stage, actuators="muscles")


@pytest.mark.parametrize(
    "stage",
    [BALANCER, spm.Stage(0.08, 0.09, spm.RRS(crank=0.02, rod=0.11)), DRAWN["PRS inclined"], DRAWN["RPS"]],
    ids=repr,
)
def test_actuators_of_a_stage_are_as_strong_as_it_is_heavy(stage: spm.Stage) -> None:
    """Whatever its size: their efforts hold about ten times the weight of what moves."""
    robot = read_robot(stage)
    weight = 9.81 * sum(link.mass for name, link in robot.links.items() if robot.carrier(name)[0] != "base")
    efforts = np.array([robot.joints[joint].limits["effort"] for joint in robot.motors])
    times = efforts / stage.legs.largest_slopes / weight
    assert ((times > 4.0) & (times < 25.0)).all(), times
    if stage is BALANCER:  # as one of hobby servos
        assert 0.1 < sum(link.mass for link in robot.links.values()) < 1.0  # [kg]
        assert 0.3 < efforts[0] < 3.0  # [N m]


def test_sdf_closes_its_loops_by_joints_or_by_elements_of_drake(tmp_path: Path) -> None:
    root = ElementTree.fromstring(sdf_text(BALANCER))
    assert [model.get("name") for model in root.iter("model")] == ["stage"]
    kinds = [joint.get("type") for joint in root.iter("joint")]
    assert kinds.count("ball") == 2
    assert kinds.count("revolute") == 9
    pytest.importorskip("pydrake")
    file = tmp_path / "stage.sdf"
    file.write_text(sdf_text(BALANCER, loops="drake"), encoding="utf-8")
    robot = Drake(file, [joint.name for joint in read_robot(BALANCER).moving])
    for state in stage_and_states("RRS")[1]:
        np.testing.assert_allclose(robot.gaps(joint_values(state)), 0.0, atol=1e-12)


def test_srdf_and_extended_urdf_name_joints_and_links_of_the_stage() -> None:
    _, states = stage_and_states("RRS")
    root = ElementTree.fromstring(srdf_text({"mine": states[0]}, prefix="left_"))
    robot = read_robot(BALANCER, prefix="left_")
    assert root.get("name") == robot.name == "stage"
    groups = {g.get("name"): [j.get("name") for j in g.findall("joint")] for g in root.findall("group")}
    assert groups["legs"] == [f"left_{name}" for name in actuated_joints(BALANCER)]
    pairs = {frozenset((p.get("link1"), p.get("link2"))) for p in root.findall("disable_collisions")}
    assert {link for pair in pairs for link in pair} <= robot.links.keys()
    assert all({joint.parent, joint.child} in pairs for joint in robot.joints.values())
    content = yaml.safe_load(extended_urdf_text(BALANCER))
    assert content["name_mot"] == list(actuated_joints(BALANCER))
    assert content["closed_loop"] == [[c.frame_a, c.frame_b] for c in read_closures(BALANCER)]


def test_a_payload_is_on_the_platform() -> None:
    masses = Masses({"leg_*_rod": {"mass": 0.5}}, RigidBody(2.0, (0.0, 0.0, 0.1)))
    bare, loaded = read_robot(BALANCER), read_robot(BALANCER, masses=masses)
    assert loaded.links["platform"].mass == pytest.approx(bare.links["platform"].mass + 2.0)
    assert loaded.links["leg_2_rod"].mass == 0.5


def test_a_stage_that_does_not_stand_level_has_no_description() -> None:
    with pytest.raises(spm.GeometryError, check=with_fields(argument="machine")):
        urdf_text(spm.Stage(0.3, 0.2, spm.PRS(rod=0.4, direction=0.0, sign=-1)))


def test_states_of_another_stage_are_refused() -> None:
    _, states = stage_and_states("RRS")
    with pytest.raises(DescriptionError, check=with_fields(argument="states")):
        mjcf_text(DRAWN["RPS"], states={"mine": states[0]})
    with pytest.raises(ArgumentError, check=with_fields(argument="machine")):
        urdf_text("stage.yaml")  # type: ignore[arg-type]


# The ball


def test_a_ball_lies_on_a_level_plate_and_rolls_to_where_a_tilted_one_is_low() -> None:
    """Down an incline a solid ball that does not slip has 5/7 of the acceleration g sin(tilt) of a sliding body."""
    level = spm.inverse_physical(BALANCER, 0.12)
    leaning = spm.inverse_physical(BALANCER, 0.12, tilt=0.1, azimuth=0.7)
    states = {"level": level, "leaning": leaning}
    model = mujoco.MjModel.from_xml_string(mjcf_text(BALANCER, states=states, ball=Ball()))
    data, moved = mujoco.MjData(model), {}
    for name, state in states.items():
        mujoco.mj_resetDataKeyframe(model, data, model.key(name).id)
        mujoco.mj_forward(model, data)
        np.testing.assert_array_equal(model.key(name).qpos[-4:], [1.0, 0.0, 0.0, 0.0])
        start = data.body("ball").xpos.copy()
        assert (start - state.translation) @ state.normal == pytest.approx(0.2 * 0.09 + 0.02)
        for _ in range(300):
            mujoco.mj_step(model, data)
        moved[name] = data.body("ball").xpos - start
    assert np.abs(moved["level"]).max() < 1e-3
    assert np.arctan2(moved["leaning"][1], moved["leaning"][0]) == pytest.approx(0.7, abs=0.02)
    way = np.linalg.norm(moved["leaning"])
    # Less the rolling friction of 0.1 mm / 20 mm of the weight.
    assert way == pytest.approx(0.5 * 5.0 / 7.0 * 9.81 * (np.sin(0.1) - 0.005) * 0.3**2, rel=0.03)


def test_a_plate_of_its_own_and_what_no_ball_is() -> None:
    ball = Ball(radius=0.03, mass=0.1, plate_radius=0.2, plate_height=0.05)
    model = mujoco.MjModel.from_xml_string(mjcf_text(BALANCER, ball=ball, prefix="left_"))
    assert model.geom("left_platform_plate").size[0] == 0.2
    assert model.body("left_ball").mass[0] == pytest.approx(0.1)
    assert model.body("left_ball").inertia[0] == pytest.approx(0.4 * 0.1 * 0.03**2)
    with pytest.raises(ArgumentError, check=with_fields(argument="radius")):
        Ball(radius=-1.0)
    with pytest.raises(DescriptionError, check=with_fields(argument="ball")):
        mjcf_text(ball=Ball())
    with pytest.raises(ArgumentError, check=with_fields(argument="ball")):
        mjcf_text(BALANCER, ball=0.02)  # type: ignore[arg-type]
