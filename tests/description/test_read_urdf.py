"""Reading a URDF: complete, or an error with the line of what is not supported."""

from __future__ import annotations

import codecs
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from description.kinematic_tree import KinematicTree, inertia
from text_files import assert_refused, written

import spm_pin as spm
from spm_pin.description import CLOSURES_PATH, URDF_PATH
from spm_pin.description.closures import Closure
from spm_pin.description.load_robot import manipulator, read_robot
from spm_pin.description.read_urdf import read_urdf, urdf_description
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Transmission
from spm_pin.description.urdf_elements import check_inertials
from spm_pin.description.write_mjcf import mjcf_text
from spm_pin.description.write_sdf import sdf_text
from spm_pin.description.write_urdf import urdf_text
from spm_pin.errors import DescriptionError

GOOD = """<?xml version="1.0"?>
<robot name="two">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="a">
    <visual>
      <geometry><box size="1 2 3"/></geometry>
      <material name="red"/>
    </visual>
  </link>
  <link name="b">
    <inertial>
      <mass value="1"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
  </link>
  <joint name="j" type="revolute">
    <origin xyz="0 0 1" rpy="0 0 0"/>
    <parent link="a"/>
    <child link="b"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="2" velocity="3"/>
  </joint>
  <transmission name="t">
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="j"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
    <actuator name="m"><mechanicalReduction>1</mechanicalReduction></actuator>
  </transmission>
</robot>
"""
BALL = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="a"/><drake:ball_constraint_p_AP value="0 0 0"/>'
    '<drake:ball_constraint_body_B name="b"/><drake:ball_constraint_p_BQ value="0 0 0"/></drake:ball_constraint>'
)


def test_description_of_the_package_is_read() -> None:
    tree, robot = KinematicTree(Path(URDF_PATH).read_text(encoding="utf-8")), read_urdf(URDF_PATH)
    assert robot.base == tree.base
    assert {joint.name for joint in robot.joints} == tree.joints.keys()
    values = tree.random_values(np.random.default_rng(30))
    for link, pose in robot.frames(values).items():
        np.testing.assert_allclose(pose, tree.frames(values)[link], atol=1e-14)
    for name, link in robot.link.items():
        assert link.inertial is not None
        mass, frame, moments = inertia(tree.links[name])
        assert link.inertial.mass == mass
        assert (link.inertial.matrix == moments).all()
        np.testing.assert_allclose(link.inertial.placement.matrix, frame, atol=1e-16)
    for joint in robot.moving:
        limit = tree.moving[joint.name].limit
        found = (joint.limit.lower, joint.limit.upper, joint.limit.effort, joint.limit.velocity)
        assert found == tuple(limit[key] for key in ("lower", "upper", "effort", "velocity"))


def test_smallest_grid(tmp_path: Path) -> None:
    robot = read_urdf(written(tmp_path / "robot.urdf", GOOD))
    assert (robot.name, robot.base, [joint.name for joint in robot.moving]) == ("two", "a", ["j"])
    assert robot.transmissions == (Transmission("t", "j", "m"),)
    (shape,) = robot.link["a"].visuals
    assert shape.material is not None
    assert shape.material.rgba == (1.0, 0.0, 0.0, 1.0)
    assert urdf_description(GOOD) == robot


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("</robot>", "", 29, "XML, got no element found"),
        ("<robot name", "<model name", 28, "XML, got mismatched tag"),
        ("</robot>", "<xacro:arg/></robot>", 28, "got <xacro:arg>. Not expanded yet?"),
        ("</robot>", "<gazebo/></robot>", 28, "got <gazebo>. It would be lost"),
        ("</robot>", '<link name="c"><sensor/></link></robot>', 28, "in <link>, got <sensor>"),
        ('<link name="b">', '<link type="x" name="b">', 10, "no attributes of <link> but name, got type"),
        ('<link name="b">', "<link>", 10, "the attribute name of <link>, got none"),
        ('<link name="b">', '<link name="">', 10, "the attribute name of <link>, got none"),
        ('<joint name="j"', '<joint name=""', 16, "the attribute name of <joint>, got none"),
        ('size="1 2 3"', 'size="1 2"', 6, "3 finite numbers as size of <box>, got '1 2'"),
        ('size="1 2 3"', 'size="1 2 -3"', 6, "positive dimensions"),
        ('size="1 2 3"', 'size="1 2 nan"', 6, "3 finite numbers"),
        ('<box size="1 2 3"/>', "", 6, "one shape in <geometry>, got 0"),
        ('<box size="1 2 3"/>', '<capsule radius="1"/>', 6, "<capsule>"),
        ('<box size="1 2 3"/>', '<mesh filename="none.stl"/>', 6, "a mesh file, got 'none.stl': there is no"),
        ('<box size="1 2 3"/>', '<mesh filename="package://p/n.stl"/>', 6, "Say with packages where p is"),
        ('name="red"/>', 'name="blue"/>', 7, "a material of the robot, got 'blue'"),
        ('rgba="1 0 0 1"', 'rgba="1 0 0"', 3, "4 finite numbers as rgba"),
        ('<color rgba="1 0 0 1"/>', "<texture/>", 3, "<texture>"),
        ('<mass value="1"/>', "", 11, "a <mass> in <inertial>, got none"),
        ('<mass value="1"/>', '<mass value="1"/><mass value="2"/>', 12, "one <mass> in <inertial>, got 2"),
        ('<mass value="1"/>', '<mass value="-5"/>', 12, "a mass from 0 to 1e+12 kg, got -5"),
        ('<mass value="1"/>', '<mass value="1e300"/>', 12, "a mass from 0 to 1e+12 kg, got 1e300"),
        ('<mass value="1"/>', '<mass value="nan"/>', 12, "a finite number as value of <mass>, got 'nan'"),
        ('<mass value="1"/>', '<mass value="inf"/>', 12, "a finite number as value of <mass>, got 'inf'"),
        ('<mass value="1"/>', '<mass value="1_0"/>', 12, "a finite number as value of <mass>, got '1_0'"),
        ('<mass value="1"/>', '<mass value=" 5 "/>', 12, "a finite number as value of <mass>, got ' 5 '"),
        ('<mass value="1"/>', '<mass value="٣"/>', 12, "a finite number as value of <mass>, got '٣'"),
        ('<mass value="1"/>', '<mass value="1e400"/>', 12, "a finite number as value of <mass>, got '1e400'"),
        ("<inertial>", '<inertial><origin xyz="0 1e160 0"/>', 11, "a centre of mass up to 1e+12 m away, got 1e+160 m"),
        ('ixx="1"', 'ixx="-1"', 13, "moments of inertia of which none is negative, got principal moment -1"),
        ('ixy="0"', 'ixy="2"', 13, "moments of inertia of which none is negative, got principal moment -1"),
        ('ixx="1"', 'ixx="1e300"', 13, "moments of inertia up to 1e+12 kg m², got 1e+300"),
        ('ixx="1"', 'ixx="inf"', 13, "a finite number as ixx of <inertia>, got 'inf'"),
        (' izz="1"', "", 13, "the attribute izz of <inertia>, got none"),
        ('type="revolute"', 'type="floating"', 16, "a joint of type fixed, revolute, continuous, prismatic, got"),
        ('type="revolute"', 'type="continuous"', 21, "no attributes of <limit> but effort, velocity, got lower"),
        ('<axis xyz="0 0 1"/>', '<mimic joint="k"/>', 20, "<mimic>"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', 20, "an axis that is not zero"),
        ('<parent link="a"/>', "", 16, "a <parent> in <joint>, got none"),
        ('lower="-1" upper="1"', 'lower="1" upper="-1"', 21, "lower <= upper, got [1, -1]. Exchanged?"),
        ('<limit lower="-1" upper="1" effort="2" velocity="3"/>', "", 16, "a <limit> of the revolute joint, got none"),
        ('velocity="3"', "", 21, "the attribute velocity of <limit>, got none"),
        ("/SimpleTransmission", "/DifferentialTransmission", 24, "transmission_interface/SimpleTransmission, got"),
        (">EffortJoint", ">PositionJoint", 25, "an EffortJointInterface, got 'PositionJointInterface'"),
        ("<mechanicalReduction>1", "<mechanicalReduction>50", 26, "a mechanicalReduction of 1, got '50'"),
        ("</robot>", BALL + BALL + "</robot>", 28, "each pair of frames once, got a and b again"),
        ("</robot>", BALL.replace("0 0 0", "0 0 1", 1) + "</robot>", 28, "the origins of the two links, 0 0 0"),
        ("</robot>", BALL.replace('"b"', '"a"') + "</robot>", 28, "another frame than frame_a, got 'a'"),
        ("</robot>", '<constraint name="c" type="universal"/></robot>', 28, "a constraint of type spherical"),
    ],
)
def test_elements_that_cannot_be_represented_are_refused(
    old: str, new: str, line: int, said: str, tmp_path: Path
) -> None:
    assert old in GOOD
    assert_refused(read_urdf, written(tmp_path / "robot.urdf", GOOD.replace(old, new, 1)), line, said)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<parent link="a"/>', '<parent link="z"/>', "links of two, got 'z' in the joint j"),
        ('<link name="b">', '<link name="a">', "names that occur once, got 'a' twice"),
        ('<joint name="j"', '<joint name="universe"', "Pinocchio's of the root, got 'universe'"),
        ('<parent link="a"/>', '<parent link="b"/>', "a tree"),
        ("</robot>", '<link name="c"/></robot>', "a tree with one root link, got 2: a, c"),
        ("</robot>", GOOD[GOOD.index("  <joint") : GOOD.index("  <trans")] + "</robot>", "occur once, got 'j' twice"),
        (
            "</robot>",
            '<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint></robot>',
            "links carried that occur once, got 'b' twice",
        ),
        ('<joint name="j"><hardware', '<joint name="x"><hardware', "moving joints of two, got 'x' in t"),
        ("</robot>", BALL.replace('"b"', '"x"') + "</robot>", "no link 'x'. Named by the closure a_x"),
    ],
)
def test_files_that_describe_no_robot_are_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in GOOD
    with pytest.raises(DescriptionError) as caught:
        read_urdf(written(tmp_path / "robot.urdf", GOOD.replace(old, new, 1)))
    assert said in str(caught.value)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    """Editors on Windows write one before the text."""
    marked = tmp_path / "robot.urdf", tmp_path / "closures.yaml"
    for path, source in zip(marked, (URDF_PATH, CLOSURES_PATH), strict=True):
        path.write_bytes(codecs.BOM_UTF8 + Path(source).read_bytes())
    (tmp_path / "meshes").symlink_to(Path(URDF_PATH).parent / "meshes")
    assert read_robot(*marked).closures == read_robot(URDF_PATH, CLOSURES_PATH).closures
    assert spm.ClosedChain.from_urdf(marked[0]).geometry == spm.ClosedChain.from_urdf(URDF_PATH).geometry


def test_loops_in_the_tree_are_refused() -> None:
    links = tuple(Link(name) for name in "abcd")
    joints = (Joint("ab", "fixed", "a", "b"), Joint("cd", "fixed", "c", "d"), Joint("dc", "fixed", "d", "c"))
    with pytest.raises(DescriptionError, match=r"a circle through c, d\. A loop is cut"):
        RobotDescription("r", links, joints)
    with pytest.raises(DescriptionError, match="none: the joints run in a circle"):
        RobotDescription("r", links[2:], joints[1:])


def test_closures_twice_or_at_odds_with_the_file() -> None:
    text = GOOD.replace("</robot>", BALL + "</robot>")
    mine = Closure("mine", "point", "b", "a")
    assert urdf_description(text, [mine]).closures == (mine,)
    with pytest.raises(DescriptionError, match="a weld, as the closure mine, got a point"):
        urdf_description(text, [Closure("mine", "weld", "a", "b")])
    with pytest.raises(DescriptionError, match="each pair of frames once, got b and a in one and in two"):
        urdf_description(GOOD, [Closure("one", "point", "a", "b"), Closure("two", "point", "b", "a")])
    robot = urdf_description(text, [mine])
    rigid = replace(robot, joints=(Joint("j", "fixed", "a", "b"),), transmissions=())
    with pytest.raises(DescriptionError, match="closures between links that move apart, got mine"):
        mjcf_text(rigid)


def test_states_name_every_joint() -> None:
    robot = urdf_description(GOOD)
    assert replace(robot, states={"up": {"j": 0.5}}).states["up"]["j"] == 0.5
    cases = (({}, "j missing or too much in up"), ({"j": 0.0, "k": 0.0}, "k missing"), ({"j": np.nan}, "finite"))
    for values, said in cases:
        with pytest.raises(DescriptionError, match=said):
            replace(robot, states={"up": values})
    with pytest.raises(DescriptionError, match="other names than home"):
        mjcf_text(replace(robot, states={"home": {"j": 0.5}}))


def test_frames_want_joints_of_the_robot() -> None:
    robot = urdf_description(GOOD)
    for name in ("k", "a"):
        with pytest.raises(DescriptionError, match=f"values: expected moving joints of two, got {name}"):
            robot.frames({name: 0.0})


def test_colours_of_one_name() -> None:
    """A colour said in one link is known in the next; another one under its name would have to be one of the two."""
    again = GOOD.replace(
        '<link name="b">',
        '<link name="b"><visual>{}</visual>'.format(
            '<geometry><sphere radius="1"/></geometry><material name="red"><color rgba="1 0 0 1"/></material>'
        ),
    )
    assert urdf_description(urdf_text(urdf_description(again))) == urdf_description(again)
    darker = urdf_description(
        again.replace('<color rgba="1 0 0 1"/></material></visual>', '<color rgba="0 0 0 1"/></material></visual>')
    )
    with pytest.raises(DescriptionError, match="one colour of each material, got two of red"):
        urdf_text(darker)
    colours = [m.attrib["rgba"] for m in ElementTree.fromstring(mjcf_text(darker)).findall("asset/material")]
    assert colours == ["1.0 0.0 0.0 1.0", "0.0 0.0 0.0 1.0"]
    local = (
        again.replace('<material name="red"><color rgba="1 0 0 1"/></material>\n', "", 1)
        .replace('<material name="red"/>', '<material name="red"><color rgba="1 0 0 1"/></material>')
        .replace('<material name="red"><color rgba="1 0 0 1"/></material></visual>', '<material name="red"/></visual>')
    )
    assert urdf_description(local).links == urdf_description(again).links


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="a readable URDF file"):
        read_urdf(tmp_path / "none.urdf")
    (tmp_path / "robot.urdf").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(DescriptionError, match="a readable URDF file"):
        read_urdf(tmp_path / "robot.urdf")
    with pytest.raises(DescriptionError, match="<robot>, got <mujoco>"):
        urdf_description("<mujoco/>")


@pytest.fixture
def mesh_robot(tmp_path: Path) -> tuple[Path, Path]:
    trimesh = pytest.importorskip("trimesh")
    package = tmp_path / "my_robot"
    (package / "meshes").mkdir(parents=True)
    mesh = package / "meshes" / "part.stl"
    mesh.write_bytes(trimesh.creation.icosphere().export(file_type="stl"))
    text = GOOD.replace('<box size="1 2 3"/>', '<mesh filename="package://my_robot/meshes/part.stl" scale="2 2 2"/>')
    (package / "urdf").mkdir()
    return written(package / "urdf" / "robot.urdf", text), mesh


def test_meshes_are_found_and_kept(mesh_robot: tuple[Path, Path], tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path, mesh = mesh_robot
    robot = read_urdf(path)
    (shape,) = robot.link["a"].visuals
    assert shape.mesh is not None
    assert (shape.kind, shape.size, shape.mesh.path) == ("mesh", (2.0, 2.0, 2.0), mesh.resolve())
    assert 'filename="package://my_robot/meshes/part.stl" scale="2.0 2.0 2.0"' in urdf_text(robot)
    model = mujoco.MjModel.from_xml_string(mjcf_text(robot))
    extent = np.ptp(model.mesh_vert, axis=0)
    np.testing.assert_allclose(extent, 4.0, rtol=0.05)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = written(elsewhere / "robot.urdf", path.read_text(encoding="utf-8"))
    with pytest.raises(DescriptionError, match="Say with packages where my_robot is"):
        read_urdf(moved)
    assert read_urdf(moved, packages={"my_robot": tmp_path / "my_robot"}) == read_urdf(
        moved, packages={"my_robot": str(tmp_path / "my_robot")}
    )
    beside = written(mesh.parent / "robot.urdf", path.read_text(encoding="utf-8").replace("my_robot/meshes", ""))
    (shape,) = read_urdf(beside).link["a"].visuals
    assert shape.mesh is not None
    assert shape.mesh.path == mesh.resolve()
    mesh.unlink()
    with pytest.raises(DescriptionError, match=r"robot.urdf:6: expected a mesh file, got 'package://my_robot/meshes"):
        read_urdf(path)


def test_meshes_that_mujoco_cannot_read(mesh_robot: tuple[Path, Path]) -> None:
    path, mesh = mesh_robot
    mesh.rename(mesh.with_suffix(".dae"))
    path.write_text(path.read_text(encoding="utf-8").replace("part.stl", "part.dae"), encoding="utf-8")
    with pytest.raises(
        DescriptionError, match=r"meshes in \.stl, \.obj, \.msh, got package://my_robot/meshes/part\.dae"
    ):
        mjcf_text(read_urdf(path))
    with pytest.raises(DescriptionError, match="an absolute path of a mesh"):
        urdf_description(GOOD.replace('<box size="1 2 3"/>', '<mesh filename="part.stl"/>'))


def test_reserved_names_are_refused() -> None:
    robot = urdf_description(GOOD.replace('name="j"', 'name="b"'))
    with pytest.raises(DescriptionError, match=r"names of their own for links, joints and closures.*, got b"):
        sdf_text(robot)
    with pytest.raises(DescriptionError, match="links with other names than world"):
        mjcf_text(urdf_description(GOOD.replace('"a"', '"world"')))


def test_names_with_special_characters(tmp_path: Path) -> None:
    odd = 'x--"y<&ü'
    robot = manipulator()
    renamed = replace(robot, name=odd)
    assert urdf_description(urdf_text(renamed)).name == odd


def test_reading_time_is_linear_in_the_number_of_lines(tmp_path: Path) -> None:
    """Quadratic, it took most of a minute."""
    path = written(tmp_path / "robot.urdf", GOOD.replace("</robot>", "\n" * 2_000_000 + "</robot>"))
    assert read_urdf(path) == read_urdf(written(tmp_path / "robot.urdf", GOOD))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<mass value="1"/>', '<mass value="-5"/>', "urdf:12: expected a mass from 0 to"),
        ('<mass value="1"/>', '<mass value="nan"/>', "urdf:12: expected a finite number"),
        ('iyy="1"', 'iyy="-3"', "urdf:13: expected moments of inertia of which none is negative"),
        ('<joint name="j"', '<joint name="a"', "urdf:16: expected a name that no link has, got 'a'"),
    ],
)
def test_inertials_are_checked_beside_another_reader(old: str, new: str, said: str) -> None:
    check_inertials(GOOD.replace("</robot>", "<gazebo/></robot>"), "urdf")
    with pytest.raises(DescriptionError, match=re.escape(said)):
        check_inertials(GOOD.replace(old, new, 1), "urdf")
