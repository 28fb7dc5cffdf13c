"""The reader of URDF files: the tree is Pinocchio's, loops come from YAML or Drake's tags, faults are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from loops.damaged_files import count_refused

from spm_pin.description import CLOSURES_PATH, URDF_PATH, urdf_text
from spm_pin.errors import ArgumentError, DescriptionError
from spm_pin.loops import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, JointEquality
from spm_pin.loops.read_urdf import read_urdf
from tests.loops.robots import ends_of

INERTIAL = (
    '<inertial><origin xyz="0.1 0 0" rpy="0 0 1"/><mass value="1"/><inertia ixx="1" iyy="2" izz="2.5"/></inertial>'
)
LINKAGE = f"""<robot name="linkage" xmlns:drake="http://drake.mit.edu">
  <link name="ground"/>
  <link name="crank">{INERTIAL}</link>
  <link name="coupler">{INERTIAL}</link>
  <link name="rocker">{INERTIAL}</link>
  <link name="tip"/>
  <link name="end"/>
  <joint name="turn" type="continuous"><parent link="ground"/><child link="crank"/><axis xyz="0 0 2"/>
    <dynamics damping="0.3" friction="0.4"/></joint>
  <joint name="elbow" type="revolute"><parent link="crank"/><child link="coupler"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="3" velocity="4"/></joint>
  <joint name="follow" type="prismatic"><parent link="ground"/><child link="rocker"/><origin xyz="0.3 0 0" rpy="0 0 2"/>
    <axis xyz="0.6 0.8 0"/><limit lower="0" upper="1" effort="3" velocity="4"/>
    <mimic joint="turn" multiplier="0.5" offset="0.1"/></joint>
  <joint name="t" type="fixed"><parent link="coupler"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
  <joint name="e" type="fixed"><parent link="rocker"/><child link="end"/><origin xyz="0.2 0 0.1"/></joint>
  <transmission name="m"><joint name="turn"/></transmission>
  <drake:ball_constraint>
    <drake:ball_constraint_body_A name="tip"/><drake:ball_constraint_p_AP value="0 0.1 0"/>
    <drake:ball_constraint_body_B name="rocker"/><drake:ball_constraint_p_BQ value="0.2 0 0.1"/>
  </drake:ball_constraint>
</robot>"""
LOOPS = "closed_loop: [['tip', 'end'], ['coupler', 'end']]\ntype: ['6D', 'planar']\nname_mot: ['elbow', 'turn']\n"


def assert_same_tree(model: pin.Model, expected: pin.Model) -> None:
    assert list(model.names) == list(expected.names)
    assert list(model.parents) == list(expected.parents)
    for found, true in zip(model.jointPlacements, expected.jointPlacements, strict=True):
        np.testing.assert_allclose(found.homogeneous, true.homogeneous, atol=1e-14)
    for found, true in zip(model.inertias, expected.inertias, strict=True):
        np.testing.assert_allclose(found.toDynamicParameters(), true.toDynamicParameters(), atol=1e-13)
    for found, true in zip(model.joints, expected.joints, strict=True):
        assert found.shortname() == true.shortname()
    # The lower limits of velocity and friction have the wrong sign in Pinocchio 4.1.
    upper = [f"upper{name}Limit" for name in ("Position", "Effort", "Velocity", "DryFriction")]
    for name in ("lowerPositionLimit", *upper):
        np.testing.assert_array_equal(getattr(model, name), getattr(expected, name))
    np.testing.assert_array_equal(model.damping, expected.damping)
    for frame in expected.frames:
        if frame.type == pin.FrameType.BODY and frame.name != "universe":
            found = model.frames[model.getFrameId(frame.name, pin.FrameType.BODY)]
            assert found.parentJoint == frame.parentJoint
            np.testing.assert_allclose(found.placement.homogeneous, frame.placement.homogeneous, atol=1e-14)


def test_the_tree_of_this_robot_is_pinocchios() -> None:
    assert_same_tree(read_urdf(URDF_PATH).model, pin.buildModelFromUrdf(URDF_PATH))
    free = pin.buildModelFromUrdf(URDF_PATH, pin.JointModelFreeFlyer())
    floating = read_urdf(Path(URDF_PATH), free_base=True).model
    assert list(floating.names) == list(free.names)
    assert floating.nq == free.nq


@pytest.mark.parametrize(
    "path",
    ["talos_data/robots/talos_full_v2.urdf", "icub_description/robots/icub.urdf", "romeo_description/urdf/romeo.urdf"],
)
def test_trees_of_published_robots_are_pinocchios(path: str) -> None:
    data = pytest.importorskip("example_robot_data")
    file = Path(data.getModelPath(path)) / path
    assert_same_tree(read_urdf(file).model, pin.buildModelFromUrdf(str(file)))


def test_a_joint_without_axis_and_limits_has_the_defaults_of_urdf() -> None:
    joint = '<parent link="a"/><child link="b"/><limit effort="3" velocity="4"/><dynamics damping="2"/>'
    text = f'<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute">{joint}</joint></robot>'
    assert_same_tree(read_urdf(text).model, pin.buildModelFromXML(text))


def test_moments_that_no_body_has_are_kept_as_pinocchio_keeps_them() -> None:
    moments = '<inertia ixx="-1" ixy="0.1" ixz="0.2" iyy="2" iyz="0.3" izz="2.5"/>'
    inertial = f'<inertial><origin xyz="0.1 0.2 0.3" rpy="0 0 0.1"/><mass value="2"/>{moments}</inertial>'
    joint = (
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit effort="3" velocity="4"/></joint>'
    )
    text = f'<robot name="r"><link name="a"/><link name="b">{inertial}</link>{joint}</robot>'
    assert_same_tree(read_urdf(text).model, pin.buildModelFromXML(text))


def test_a_mimic_without_numbers_has_the_value_of_its_joint() -> None:
    text = LINKAGE.replace(' multiplier="0.5" offset="0.1"', "")
    assert read_urdf(text).equalities == (JointEquality("follow", "turn", (0.0, 1.0)),)


def test_loops_of_this_robot_are_read_from_its_yaml_and_from_drakes_tags() -> None:
    by_yaml, by_tags = read_urdf(URDF_PATH, CLOSURES_PATH), read_urdf(URDF_PATH)
    assert (
        by_yaml.actuated
        == by_tags.actuated
        == tuple(f"leg_{leg}_slide" for leg in ("b1", "b2", "b3", "c1", "c2", "c3"))
    )
    assert [closure.kind for closure in by_yaml.closures] == ["point"] * 4
    q = pin.integrate(by_yaml.model, by_yaml.q0, np.random.default_rng(1).normal(size=by_yaml.model.nv))
    for one, other in zip(by_yaml.closures, by_tags.closures, strict=True):
        for robot, closure in ((by_yaml, one), (by_tags, other)):
            first, second = ends_of(robot.model, robot.q0, closure)
            np.testing.assert_allclose(first.translation, second.translation, atol=1e-12)
        for found, true in zip(ends_of(by_yaml.model, q, one), ends_of(by_tags.model, q, other), strict=True):
            np.testing.assert_array_equal(found.translation, true.translation)


def test_joints_mimics_transmissions_and_tags() -> None:
    robot = read_urdf(LINKAGE)
    assert list(robot.model.names) == ["universe", "follow", "turn", "elbow"]
    assert robot.model.nq == robot.model.nv == 3
    assert robot.actuated == ("turn",)
    assert robot.equalities == (JointEquality("follow", "turn", (0.1, 0.5)),)
    np.testing.assert_array_equal(robot.model.upperPositionLimit, [1.0, np.inf, 2.0])
    np.testing.assert_array_equal(robot.model.damping, [0.0, 0.3, 0.0])
    (closure,) = robot.closures
    first, second = ends_of(robot.model, np.array([0.0, np.pi / 2, -np.pi / 2]), closure)
    np.testing.assert_allclose(first.translation, [0.3, 0.2, 0.0], atol=1e-15)
    turned = np.array([[np.cos(2.0)], [np.sin(2.0)]]) * 0.2
    np.testing.assert_allclose(second.translation, [0.3 + turned[0, 0], turned[1, 0], 0.1], atol=1e-15)


def test_a_yaml_file_names_loops_motors_and_other_joints(tmp_path: Path) -> None:
    file = tmp_path / "loops.yaml"
    file.write_text(
        LOOPS + "joint_name: ['elbow', 'follow']\njoint_type: ['UJOINT_ZX', 'SPHERICAL']\nname_mot: ['turn']\n", "utf-8"
    )
    robot = read_urdf(LINKAGE.replace('<mimic joint="turn" multiplier="0.5" offset="0.1"/>', ""), file)
    assert list(robot.model.names) == ["universe", "follow", "turn", "elbow_Z", "elbow_X"]
    assert [joint.shortname()[10:] for joint in robot.model.joints[1:]] == ["Spherical", "RZ", "RZ", "RX"]
    assert [(c.kind, c.first.frame, c.second.frame) for c in robot.closures] == [
        ("weld", "tip", "end"),
        ("planar", "coupler", "end"),
    ]
    assert read_urdf(LINKAGE, LOOPS).actuated == ("elbow", "turn")
    assert read_urdf(LINKAGE, LOOPS, actuated=["turn"]).actuated == ("turn",)


def test_closures_given_replace_those_of_the_file() -> None:
    mine = Closure("hinge", Anchor("tip"), Anchor("end"), "mine")
    assert read_urdf(LINKAGE, [mine]).closures == (mine,)


def test_configurations_of_an_srdf(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "robot.srdf"
    values = '<joint name="elbow" value="0.5"/><joint name="gone" value="1"/>'
    state = f'<group_state name="up" group="all">{values}</group_state>'
    file.write_text(f'<robot name="linkage"><group name="all"/>{state}</robot>', encoding="utf-8")
    robot = read_urdf(LINKAGE, srdf=file)
    assert capfd.readouterr() == ("", "")
    np.testing.assert_array_equal(robot.configurations["up"], [0.0, 0.0, 0.5])
    np.testing.assert_array_equal(robot.q0, [0.0, 0.0, 0.5])
    chain = ClosedChain.from_urdf(LINKAGE, free_base=True, actuated=["elbow"], srdf=file, held=["turn"])
    assert (chain.joint_names[0], chain.actuated, chain.held) == ("root_joint", ("elbow",), ("turn",))
    assert chain.q0[chain.indices_in_q("elbow")] == 0.5


RING = LINKAGE.replace('<parent link="ground"/><child link="crank"/>', '<parent link="coupler"/><child link="crank"/>')
# What is replaced in the linkage, by what, and what was expected instead.
CHANGES = {
    "two roots": ('<link name="ground"/>', '<link name="ground"/><link name="other"/>', "one link without a parent"),
    "a link twice": ('<link name="tip"/>', '<link name="end"/>', "a different name"),
    "a joint twice": ('name="elbow"', 'name="turn"', "a different name"),
    "a child twice": ('<child link="end"/>', '<child link="tip"/>', "child without another parent"),
    "no such link": ('<child link="tip"/>', '<child link="gone"/>', "a link of the file as its child"),
    "no child": ('<child link="tip"/>', "", "a link of the file as its child"),
    "a planar joint": ('"prismatic"', '"planar"', "one of the types"),
    "no axis": ('"0 0 2"', '"0 0 0"', "a direction"),
    "not numbers": ('xyz="0.1 0 0"', 'xyz="0.1 0 zero"', "3 finite numbers"),
    "infinite": ('xyz="0.3 0 0"', 'xyz="inf 0 0"', "3 finite numbers"),
    "negative mass": ('mass value="1"', 'mass value="-1"', "not negative"),
    "no mass": ('<mass value="1"/>', "", "<mass> and <inertia> in <inertial>"),
    "a mimic of nothing": ('mimic joint="turn"', 'mimic joint="gone"', "names of joints"),
    "a motor of nothing": ('"m"><joint name="turn"', '"m"><joint name="gone"', "names of joints"),
    "a drake joint": ("</robot>", '<drake:joint name="b" type="ball"/></robot>', "a joint of URDF"),
    "half a tag": ('<drake:ball_constraint_body_B name="rocker"/>', "", "a tag drake:ball_constraint_body_B"),
    "a tag on nothing": ('body_B name="rocker"', 'body_B name="gone"', "links or frames"),
}
FAULTS = {
    "not XML": (LINKAGE[:-3], None, "well-formed XML"),
    "another root": ("<model/>", None, "whose root is <robot>"),
    "no links": ("<robot/>", None, "one link without a parent"),
    "a ring": (RING, None, "one root"),
    **{name: (LINKAGE.replace(old, new), None, expected) for name, (old, new, expected) in CHANGES.items()},
    "not YAML": (LINKAGE, "closed_loop: [['tip', 'end']\ntype", "well-formed YAML"),
    "a file of something else": (LINKAGE, "closed_loops: [['tip', 'end']]\ntype: ['3d']", "the key closed_loop"),
    "a list": (LINKAGE, "closed_loop:\n- [tip]\ntype: ['3d']", "a pair of links"),
    "a kind too few": (LINKAGE, "closed_loop: [['tip', 'end']]\ntype: []", "1 entries"),
    "an unknown kind": (LINKAGE, "closed_loop: [['tip', 'end']]\ntype: ['4d']", "one of 3d"),
    "a loop on nothing": (LINKAGE, "closed_loop: [['tip', 'gone']]\ntype: ['3d']", "links or frames"),
    "a loop of fixed joints": (LINKAGE, "closed_loop: [['tip', 'coupler']]\ntype: ['3d']", "move against each other"),
    "an unknown joint": (LINKAGE, LOOPS + "joint_name: ['gone']\njoint_type: ['SPHERICAL']", "a joint of"),
    "an unknown type": (LINKAGE, LOOPS + "joint_name: ['elbow']\njoint_type: ['SCREW']", "the type SPHERICAL"),
}


@pytest.mark.parametrize(("urdf", "loops", "expected"), FAULTS.values(), ids=FAULTS)
def test_faults_are_named(urdf: str, loops: str | None, expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        read_urdf(urdf, loops)
    assert expected in caught.value.expected


def test_forgotten_closures_are_asked_for_and_none_are_taken() -> None:
    tree = LINKAGE[: LINKAGE.index("  <drake:ball_constraint>")] + "</robot>"
    tree = tree.replace('<mimic joint="turn" multiplier="0.5" offset="0.1"/>', "")
    with pytest.raises(ArgumentError) as caught:
        ClosedChain.from_urdf(tree)
    assert caught.value.argument == "closures"
    chain = ClosedChain.from_urdf(tree, closures=[])
    assert chain.closures == ()
    assert chain.mobility(chain.q0).dof == chain.model.nv


def test_files_that_are_not_there(tmp_path: Path) -> None:
    for arguments in ((tmp_path / "gone.urdf",), (LINKAGE, tmp_path / "gone.yaml"), (str(tmp_path),)):
        with pytest.raises(DescriptionError):
            read_urdf(*arguments)


def test_without_any_of_its_elements_a_file_is_read_or_refused() -> None:
    refused, count = count_refused(read_urdf, urdf_text(), 60)
    assert 0 < refused < count
