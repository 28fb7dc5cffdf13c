"""The reader of SDF files: poses and axes in every frame the format has, loops closed by joints, faults named."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from loops.damaged_files import count_refused

from spm_pin.description import SDF_PATH, URDF_PATH, sdf_text
from spm_pin.errors import DescriptionError
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import JointEquality, RobotDescription
from spm_pin.loops.read_sdf import read_sdf
from spm_pin.loops.read_urdf import read_urdf
from tests.loops.robots import ends_of, pose_of

CASSIE = ("cassie", "cassie_reduced", "cassie_simple", "cassie_v2", "cassie_wo_gearbox_spring")
LINKS = "".join(f'<link name="{name}">{{{name}}}</link>' for name in ("base", "crank", "coupler", "rocker"))


def model(joints: str, version: str = "1.9", above: str = "", **poses: str) -> str:
    links = {name: poses.get(name, "") for name in ("base", "crank", "coupler", "rocker")}
    return f'<sdf version="{version}"><model name="linkage">{above}{LINKS.format(**links)}{joints}</model></sdf>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "<axis><xyz>0 0 1</xyz></axis>") -> str:
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'


POSES = {
    "crank": "<pose>0 0 0.1 0 0 0</pose>",
    "coupler": "<pose>0.1 0 0.1 0 0 0</pose>",
    "rocker": "<pose>0.4 0 0 0 0.2 0</pose>",
}
GROUND = joint("ground", "fixed", "world", "base", "")
TREE = joint("turn", "revolute", "base", "crank") + joint("elbow", "revolute", "crank", "coupler")
FOUR_BAR = TREE + joint("swing", "revolute", "base", "rocker")
LOOP = joint("tip", "ball", "coupler", "rocker", "<pose>0 0 0.3 0 0 0</pose>")


def places(robot: RobotDescription, q: Any = None) -> dict[str, Any]:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.q0 if q is None else q)
    return {frame.name: data.oMf[i].copy() for i, frame in enumerate(robot.model.frames)}


def gaps(robot: RobotDescription) -> Any:
    ends = (ends_of(robot.model, robot.q0, closure) for closure in robot.closures)
    return [pin.log6(first.inverse() * second).vector for first, second in ends]


def test_this_robot_is_that_of_its_urdf() -> None:
    found, true = read_sdf(SDF_PATH), read_urdf(URDF_PATH)
    assert list(found.model.names) == list(true.model.names)
    assert found.actuated == true.actuated
    assert [closure.kind for closure in found.closures] == ["point"] * 4
    q = np.random.default_rng(1).normal(size=18)
    expected, actual = places(true, q), places(found, q)
    for name in (frame.name for frame in true.model.frames if frame.type == pin.FrameType.BODY):
        np.testing.assert_allclose(actual[name].homogeneous, expected[name].homogeneous, atol=1e-13)
    assert np.abs(gaps(found)).max() < 1e-13
    for one, other in zip(found.model.inertias, true.model.inertias, strict=True):
        np.testing.assert_allclose(one.toDynamicParameters(), other.toDynamicParameters(), atol=1e-8)
    assert [(c.kind, c.first.frame) for c in read_sdf(sdf_text(loops="drake")).closures] == [
        ("point", end) for end in ("middle_b2", "middle_b3", "middle_b2_upper", "middle_b3_upper")
    ]


@pytest.mark.parametrize("name", CASSIE)
def test_every_cassie_stands_with_its_loops_closed(name: str) -> None:
    data = pytest.importorskip("example_robot_data")
    path = f"cassie_description/robots/{name}.sdf"
    file = Path(data.getModelPath(path)) / path
    robot = read_sdf(file)
    assert len(robot.closures) == (6 if name == "cassie" else 4)
    assert np.abs(gaps(robot)).max() < 1e-13
    assert ("root_joint" in list(robot.model.names)) == ("static" not in list(robot.model.names))
    # Links stand where the file has them, in the model's frame.
    poses = {link.get("name"): link.findtext("pose") for link in ElementTree.parse(file).getroot().iter("link")}
    at = places(robot)
    for link, text in poses.items():
        x, y, z, *rpy = map(float, text.split())
        expected = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z]))
        np.testing.assert_allclose(at[link].homogeneous, expected.homogeneous, atol=1e-13)


def test_gearboxes_of_cassie_turn_as_the_specification_says() -> None:
    data = pytest.importorskip("example_robot_data")
    path = "cassie_description/robots/cassie.sdf"
    robot = read_sdf(Path(data.getModelPath(path)) / path)
    assert len(robot.equalities) == 10
    assert robot.equalities[0] == JointEquality("left-roll-op", "left-roll-ip", (0.0, -0.04), name="left-roll-joint")
    # Turning the rotor by θ₁ about the gearbox's axis turns the output by −ratio θ₁ about the same axis of the model.
    q = robot.q0.copy()
    index = {name: robot.model.joints[robot.model.getJointId(name)].idx_q for name in robot.model.names}
    q[index["left-roll-ip"]], q[index["left-roll-op"]] = 1.0, -0.04
    before, after = places(robot), places(robot, q)
    for link, angle in (("left-roll-reference", 1.0), ("left-hip-roll", -0.04)):
        turned = pin.log3(after[link].rotation @ before[link].rotation.T)
        np.testing.assert_allclose(turned, [angle, 0.0, 0.0], atol=1e-12)


def test_a_joint_whose_child_has_a_parent_closes_a_loop() -> None:
    robot = read_sdf(model(GROUND + FOUR_BAR + LOOP, **POSES))
    assert list(robot.model.names) == ["universe", "turn", "elbow", "swing"]
    (closure,) = robot.closures
    assert (closure.kind, closure.name, closure.first.frame, closure.second.frame) == (
        "point",
        "tip",
        "coupler",
        "rocker",
    )
    tip = np.array([0.4 + 0.3 * np.sin(0.2), 0.0, 0.3 * np.cos(0.2)])
    np.testing.assert_allclose(closure.first.placement.translation, tip - [0.1, 0.0, 0.1], atol=1e-15)
    np.testing.assert_allclose(closure.second.placement.translation, [0.0, 0.0, 0.3], atol=1e-15)


def test_a_hinge_closes_about_its_axis_and_a_slide_is_kept_in_the_tree() -> None:
    slide = joint("rail", "prismatic", "coupler", "rocker", "<axis><xyz>1 0 0</xyz></axis>")
    tilted = joint("swing", "revolute", "base", "rocker", "<axis><xyz>0 3 4</xyz></axis>")
    robot = read_sdf(model(GROUND + TREE + tilted + slide, **POSES))
    assert list(robot.model.names) == ["universe", "turn", "elbow", "rail"]
    (closure,) = robot.closures
    assert (closure.kind, closure.name) == ("hinge", "swing")
    assert np.abs(gaps(robot)).max() < 1e-15
    np.testing.assert_allclose(closure.second.placement.rotation[:, 2], [0.0, 0.6, 0.8], atol=1e-15)


@pytest.mark.parametrize(
    ("inside", "version", "axis"),
    [
        ("<axis><xyz>1 0 0</xyz></axis>", "1.9", [0.0, 1.0, 0.0]),
        ("<axis><xyz expressed_in='__model__'>1 0 0</xyz></axis>", "1.9", [1.0, 0.0, 0.0]),
        ("<axis><xyz expressed_in='base'>1 0 0</xyz></axis>", "1.9", [0.0, -1.0, 0.0]),
        ("<axis><xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>", "1.6", [1.0, 0.0, 0.0]),
        ("<axis><xyz>1 0 0</xyz></axis>", "1.4", [1.0, 0.0, 0.0]),
        ("<axis><xyz>1 0 0</xyz></axis>", "latest", [0.0, 1.0, 0.0]),
        ("<pose>0 0 0 0 0 1.5707963267948966</pose><axis><xyz>1 0 0</xyz></axis>", "1.9", [-1.0, 0.0, 0.0]),
        ("<pose degrees='true'>0 0 0 0 0 90</pose><axis><xyz>1 0 0</xyz></axis>", "1.9", [-1.0, 0.0, 0.0]),
        ("<pose relative_to='base'/><axis><xyz>1 0 0</xyz></axis>", "1.9", [0.0, -1.0, 0.0]),
        (
            "<pose rotation_format='quat_xyzw'>0 0 0 0 0 1 1</pose><axis><xyz>1 0 0</xyz></axis>",
            "1.9",
            [-1.0, 0.0, 0.0],
        ),
    ],
)
def test_axes_are_in_the_frame_that_the_file_says(inside: str, version: str, axis: list[float]) -> None:
    """The crank stands turned by 90° about z, the base by −90°; axes are compared in the model's frame."""
    quarter = np.pi / 2
    poses = {"base": f"<pose>0 0 0 0 0 {-quarter}</pose>", "crank": f"<pose>0.1 0 0 0 0 {quarter}</pose>"}
    rest = joint("a", "fixed", "base", "coupler", "") + joint("b", "fixed", "base", "rocker", "")
    robot = read_sdf(model(GROUND + joint("turn", "revolute", "base", "crank", inside) + rest, version, **poses))
    before, after = places(robot), places(robot, np.array([0.3]))
    np.testing.assert_allclose(before["crank"].translation, [0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        pin.log3(after["crank"].rotation @ before["crank"].rotation.T), 0.3 * np.array(axis), atol=1e-14
    )


def test_floating_and_static_models_frames_limits_and_motors() -> None:
    limits = "<limit><lower>-1</lower><upper>1e16</upper><effort>5</effort><velocity>-1</velocity></limit>"
    inside = f"<axis><xyz>0 0 1</xyz>{limits}<dynamics><damping>0.2</damping></dynamics></axis>"
    frame = '<frame name="socket" attached_to="base"><pose>0 0 1 0 0 0</pose></frame>'
    joints = joint("turn", "revolute", "socket", "crank", inside) + joint(
        "u", "universal", "crank", "coupler", "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    )
    pose = "<pose>1 2 3 0 0 0</pose>"
    robot = read_sdf(model(joints + frame, above=pose, **POSES))
    assert list(robot.model.names) == ["universe", "base_root_joint", "turn", "u_1", "u_2", "rocker_root_joint"]
    assert robot.actuated == ("turn",)
    np.testing.assert_array_equal(robot.q0[:7], [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(places(robot)["coupler"].translation, [1.1, 2.0, 3.1])
    turn = robot.model.joints[robot.model.getJointId("turn")]
    assert (robot.model.lowerPositionLimit[turn.idx_q], robot.model.upperPositionLimit[turn.idx_q]) == (-1.0, np.inf)
    assert (robot.model.upperEffortLimit[turn.idx_v], robot.model.upperVelocityLimit[turn.idx_v]) == (5.0, np.inf)
    assert robot.model.damping[turn.idx_v] == 0.2
    unlimited = robot.model.joints[robot.model.getJointId("u_1")].idx_q
    assert (robot.model.lowerPositionLimit[unlimited], robot.model.upperPositionLimit[unlimited]) == (-np.inf, np.inf)
    fixed = read_sdf(model(joints + frame, above=pose + "<static>true</static>", **POSES))
    assert list(fixed.model.names) == ["universe", "turn", "u_1", "u_2"]
    np.testing.assert_allclose(places(fixed)["rocker"].translation, [1.4, 2.0, 3.0])


def test_a_mimic_joint() -> None:
    values = "<multiplier>2</multiplier><offset>0.1</offset><reference>0.3</reference>"
    mimic = f"<axis><xyz>0 0 1</xyz><mimic joint='turn'>{values}</mimic></axis>"
    robot = read_sdf(model(GROUND + TREE + joint("swing", "revolute", "base", "rocker", mimic)))
    assert robot.equalities == (JointEquality("swing", "turn", (0.1, 2.0), driver_zero=0.3),)


FAULTS = {
    "not XML": ("<sdf><model>", "well-formed XML"),
    "another root": ("<robot/>", "whose root is <sdf>"),
    "no model": ('<sdf version="1.9"/>', "one model"),
    "no links": ('<sdf version="1.9"><model name="m"/></sdf>', "a model with links"),
    "a model inside": (model("<include><uri>model://x</uri></include>"), "without others in it"),
    "an unknown end": (model(joint("j", "revolute", "base", "gone")), "a link of the model as its child"),
    "no parent": (
        model('<joint name="j" type="fixed"><child>base</child></joint>'),
        "a link of the model as its parent",
    ),
    "an unknown kind": (model(joint("j", "screw", "base", "crank")), "one of the types"),
    "no axis": (model(joint("j", "revolute", "base", "crank", "")), "an <axis>"),
    "a zero axis": (model(joint("j", "revolute", "base", "crank", "<axis><xyz>0 0 0</xyz></axis>")), "a direction"),
    "poses in a ring": (
        model("", crank="<pose relative_to='coupler'/>", coupler="<pose relative_to='crank'/>"),
        "a link, joint or frame",
    ),
    "an unknown frame": (model("", crank="<pose relative_to='gone'/>"), "a link, joint or frame"),
    "five numbers": (model("", crank="<pose>0 0 0 0 0</pose>"), "6 finite numbers"),
    "a joint twice": (
        model(joint("j", "ball", "base", "crank") + joint("j", "ball", "base", "rocker")),
        "a different name",
    ),
    "slides in a loop": (
        model(joint("a", "prismatic", "base", "crank") + joint("b", "prismatic", "rocker", "crank")),
        "that a joint of the types",
    ),
    "a loop of fixed joints": (
        model(GROUND + joint("a", "fixed", "base", "crank", "") + joint("b", "fixed", "base", "crank", "")),
        "move against each other",
    ),
    "a joint to itself": (model(joint("a", "revolute", "base", "base")), "move against each other"),
    "a gearbox on nothing": (
        model(TREE + joint("g", "gearbox", "crank", "rocker", "<axis/><axis2/>")),
        "links that hinges carry",
    ),
}


@pytest.mark.parametrize(("text", "expected"), FAULTS.values(), ids=FAULTS)
def test_faults_are_named(text: str, expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        read_sdf(text)
    assert expected in caught.value.expected


def test_without_any_of_its_elements_a_file_is_read_or_refused() -> None:
    refused, count = count_refused(read_sdf, sdf_text(), 60)
    assert 0 < refused < count


def test_pose_of_a_model_is_that_of_its_placement_frame() -> None:
    frame = "<frame name='grip' attached_to='arm'><pose>0.1 0.2 0.3 0.4 0.5 0.6</pose></frame>"
    links = "<link name='base'/><link name='arm'><pose>1 0 0 0 0 1</pose></link>"
    joints = "<joint name='foot' type='fixed'><parent>world</parent><child>base</child></joint>"
    joints += "<joint name='hinge' type='revolute'><parent>base</parent><child>arm</child><axis/></joint>"
    text = f"<sdf version='1.9'><model name='m' placement_frame='grip'><pose>3 2 1 0.3 0.2 0.1</pose>{links}{frame}"
    chain = ClosedChain.from_sdf(f"{text}{joints}</model></sdf>", actuated=["hinge"])
    arm, grip, pose = (
        pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(place))
        for place, angles in (
            ([1.0, 0.0, 0.0], (0.0, 0.0, 1.0)),
            ([0.1, 0.2, 0.3], (0.4, 0.5, 0.6)),
            ([3.0, 2.0, 1.0], (0.3, 0.2, 0.1)),
        )
    )
    assert (pose_of(chain.model, np.zeros(1), "arm") * grip).isApprox(pose, 1e-12)
    assert pose_of(chain.model, np.zeros(1), "base").isApprox(pose * (arm * grip).inverse(), 1e-12)
