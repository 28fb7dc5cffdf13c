"""A user's robot: a parallelogram, whose closed states are known, read from a URDF and exported."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from description.engine_loaders import Drake, Mujoco, Pinocchio
from text_files import written

from spm_pin.description.closures import Closure
from spm_pin.description.extended_urdf import extended_urdf_text
from spm_pin.description.load_robot import read_robot
from spm_pin.description.read_urdf import read_urdf, urdf_description
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.write_mjcf import mjcf_text
from spm_pin.description.write_sdf import sdf_text
from spm_pin.description.write_urdf import urdf_text
from spm_pin.errors import ArgumentError, DescriptionError

INERTIAL = (
    '<inertial><origin xyz="0.01 0.02 0.03" rpy="0.4 0.5 0.6"/><mass value="2"/>'
    '<inertia ixx="0.3" ixy="0.01" ixz="-0.02" iyy="0.4" iyz="0.03" izz="0.5"/></inertial>'
)
"""Inertias in oblique frames, with products of inertia."""


def link(name: str) -> str:
    return f'<link name="{name}">{INERTIAL}</link>'


def joint(name: str, parent: str, child: str, xyz: str, kind: str = "revolute", rpy: str = "0 0 0") -> str:
    limit = '<limit lower="-2" upper="2" effort="7" velocity="3"/>' if kind == "revolute" else ""
    axis = "" if kind == "fixed" else '<axis xyz="0 -2 0"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>'
        f'<parent link="{parent}"/><child link="{child}"/>{axis}{limit}</joint>'
    )


TRANSMISSION = (
    '<transmission name="drive"><type>transmission_interface/SimpleTransmission</type><joint name="crank">'
    '</joint><actuator name="motor"/></transmission>'
)


def parallelogram(kind: str, *, zero: float = 0.0) -> str:
    """Bars of 1 m upright, 2 m apart. "point": cut at the joint of coupler and rocker; "ground": at the rocker's
    foot; "weld": in the middle of the rocker. At zero the crank leans by `zero` from upright."""
    parts = [link("base"), link("crank_link"), link("coupler_link"), link("rocker_link")]
    parts += [joint("crank", "base", "crank_link", "0 0 0", rpy=f"0 {-zero} 0")]
    parts += [joint("coupler", "crank_link", "coupler_link", "0 0 1", "continuous")]
    if kind == "ground":
        parts += [joint("rocker", "coupler_link", "rocker_link", "2 0 0"), link("foot"), link("ground")]
        parts += [joint("foot_mount", "rocker_link", "foot", "0 0 -1", "fixed")]
        parts += [joint("ground_mount", "base", "ground", "2 0 0", "fixed", rpy="0.3 0.2 0.1")]
    else:
        parts += [joint("rocker", "base", "rocker_link", "2 0 0"), link("head"), link("elbow")]
        length = 1.0 if kind == "point" else 0.5
        parts += [joint("head_mount", "rocker_link", "head", f"0 0 {length}", "fixed")]
        if kind == "point":
            parts += [joint("elbow_mount", "coupler_link", "elbow", "2 0 0", "fixed")]
        else:
            parts += [link("upper_rocker"), joint("wrist", "coupler_link", "upper_rocker", "2 0 0")]
            parts += [joint("elbow_mount", "upper_rocker", "elbow", "0 0 -0.5", "fixed")]
    return f'<robot name="four_bar">{"".join(parts)}{TRANSMISSION}</robot>'


CLOSURE = {
    "point": Closure("loop", "point", "elbow", "head"),
    "ground": Closure("loop", "point", "ground", "foot"),
    "weld": Closure("loop", "weld", "elbow", "head"),
}


def robot(kind: str, *, zero: float = 0.0) -> RobotDescription:
    return urdf_description(parallelogram(kind, zero=zero), [CLOSURE[kind]])


def closed(kind: str, angle: float) -> dict[str, float]:
    """The coupler stays level, the rocker leans as the crank."""
    values = {"crank": angle, "coupler": -angle, "rocker": angle}
    return values | ({"wrist": angle} if kind == "weld" else {})


@pytest.mark.parametrize("kind", CLOSURE)
def test_frames_and_closures_in_memory(kind: str) -> None:
    description = robot(kind)
    assert description.base == "base"
    assert description.open_closures() == {}
    assert description.open_closures(closed(kind, 0.7)) == {}
    assert description.open_closures(closed(kind, 0.7) | {"crank": 0.8}).keys() == {"loop"}
    elbow = description.frames(closed(kind, 0.7))["coupler_link"]
    np.testing.assert_allclose(elbow[:3, 3], [-math.sin(0.7), 0.0, math.cos(0.7)], atol=1e-15)
    np.testing.assert_allclose(elbow[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("engine", "kind", "anchors"),
    [
        (engine, kind, anchors)
        for engine, kind, anchors in itertools.product((Mujoco, Pinocchio), CLOSURE, ("bodies", "sites"))
        if (engine, kind, anchors) != (Pinocchio, "ground", "sites")  # it reads no sites of the base
    ],
)
def test_mjcf(engine: type[Mujoco] | type[Pinocchio], kind: str, anchors: str, tmp_path: Path) -> None:
    there = engine(written(tmp_path / "own.xml", mjcf_text(robot(kind), anchors=anchors)))
    assert there.joints == [joint.name for joint in robot(kind).moving]
    for angle in (0.0, 0.7, -1.1):
        assert np.abs(there.gaps(closed(kind, angle))).max() < 1e-12
    assert np.abs(there.gaps(closed(kind, 0.7) | {"crank": 0.5})).max() > 0.05


@pytest.mark.parametrize("kind", CLOSURE)
def test_full_inertias_are_exported(kind: str, tmp_path: Path) -> None:
    description = robot(kind)
    values = closed(kind, 0.3) | {"crank": -0.4}
    urdf = Pinocchio(written(tmp_path / "own.urdf", parallelogram(kind)), ())
    mjcf = written(tmp_path / "own.xml", mjcf_text(description))
    for there in (Mujoco(mjcf), Pinocchio(mjcf)):
        np.testing.assert_allclose(there.mass_matrix(values), urdf.mass_matrix(values), rtol=1e-12)


@pytest.mark.parametrize("kind", ["point", "ground"])
def test_drake(kind: str, tmp_path: Path) -> None:
    description, values = robot(kind), closed(kind, 0.7)
    for text, name in ((urdf_text(description), "own.urdf"), (mjcf_text(description), "own.xml")):
        there = Drake(written(tmp_path / name, text))
        assert np.abs(there.gaps(values)).max() < 1e-12
        assert np.abs(there.gaps(values | {"rocker": 0.5})).max() > 0.05


def test_a_robot_that_is_open_at_zero(tmp_path: Path) -> None:
    passive = parallelogram("point", zero=0.2).replace('effort="7"', 'effort="0"').replace(TRANSMISSION, "")
    passive = passive.replace('type="continuous">', 'type="continuous"><limit effort="0" velocity="3"/>')
    description = urdf_description(passive, [CLOSURE["point"]])
    for writer in (mjcf_text, sdf_text):
        with pytest.raises(DescriptionError, match=r"closed to 1e-09 m at zero, got loop, open by 0\."):
            writer(description)
    for engine in (Mujoco, Pinocchio):
        there = engine(written(tmp_path / "own.xml", mjcf_text(description, anchors="sites")))
        assert np.abs(there.gaps({"crank": 0.5, "coupler": -0.7, "rocker": 0.7})).max() < 1e-12
        assert np.abs(there.gaps({})).max() > 0.1


def test_closures_that_a_format_cannot_express() -> None:
    weld = robot("weld")
    with pytest.raises(DescriptionError, match="the weld loop"):
        urdf_text(weld)
    assert '<constraint name="loop" type="link">' in urdf_text(weld, ros_constraints=True)
    with pytest.raises(DescriptionError, match="effort in the joints with a transmission, and none in the others, got"):
        sdf_text(robot("point"))
    with pytest.raises(ArgumentError, match="anchors"):
        mjcf_text(weld, anchors="corners")
    with pytest.raises(ArgumentError, match="loops"):
        sdf_text(weld, loops="none")


def test_empty_ranges() -> None:
    text = parallelogram("point").replace('lower="-2" upper="2"', 'lower="0" upper="0"')
    with pytest.raises(DescriptionError, match=r"MJCF has no empty ranges, got \[0, 0\] of crank"):
        mjcf_text(urdf_description(text, [CLOSURE["point"]]))


def test_sdf_of_welds() -> None:
    passive = parallelogram("weld").replace('effort="7"', 'effort="0"').replace(TRANSMISSION, "")
    passive = passive.replace('type="continuous">', 'type="continuous"><limit effort="0" velocity="3"/>')
    weld = urdf_description(passive, [CLOSURE["weld"]])
    assert '<joint name="loop" type="fixed">' in sdf_text(weld)
    with pytest.raises(DescriptionError, match="the weld loop"):
        sdf_text(weld, loops="drake")


def test_massless_links() -> None:
    text = parallelogram("point").replace(link("crank_link"), '<link name="crank_link"/>')
    description = urdf_description(text, [CLOSURE["point"]])
    with pytest.raises(DescriptionError, match="mass in every link that a joint moves, got none in crank_link"):
        mjcf_text(description)
    with pytest.raises(DescriptionError, match="none in crank_link"):
        sdf_text(urdf_description(text.replace('effort="7"', 'effort="0"').replace(TRANSMISSION, "")))
    bare = parallelogram("point").replace(link("head"), '<link name="head"/>')
    mjcf_text(urdf_description(bare, [CLOSURE["point"]]))  # fixed to a link with mass


def test_written_urdf_reads_back(tmp_path: Path) -> None:
    for kind, description in ((kind, robot(kind)) for kind in CLOSURE):
        text = urdf_text(description, ros_constraints=True)
        path = written(tmp_path / f"{kind}.urdf", text)
        assert read_urdf(path) == description
        assert read_urdf(path, description.closures) == description
    dynamics = '<dynamics damping="2" friction="3"/>'
    dynamics = parallelogram("point").replace('type="revolute">', f'type="revolute">{dynamics}')
    description = urdf_description(dynamics, [CLOSURE["point"]])
    assert urdf_description(dynamics.replace("<dynamics", "<joint_properties"), description.closures) == description
    assert urdf_description(urdf_text(description, ros_constraints=True)) == description
    there = Mujoco(written(tmp_path / "own.xml", mjcf_text(description)))
    assert there.model.joint("crank").damping[0] == 2.0
    assert there.model.joint("crank").frictionloss[0] == 3.0
    assert there.model.joint("coupler").limited[0] == 0


@pytest.mark.parametrize("kind", CLOSURE)
def test_urdf_and_extended_urdf_make_the_robot(kind: str, tmp_path: Path) -> None:
    urdf = written(tmp_path / "robot.urdf", parallelogram(kind).replace(TRANSMISSION, ""))
    extended = written(tmp_path / "robot.yaml", extended_urdf_text(robot(kind)))
    description = read_robot(urdf, extended)
    assert [(c.kind, c.frame_a, c.frame_b) for c in description.closures] == [
        (c.kind, c.frame_a, c.frame_b) for c in robot(kind).closures
    ]
    assert [transmission.joint for transmission in description.transmissions] == ["crank"]
    both = written(tmp_path / "both.urdf", parallelogram(kind))
    assert read_robot(both, extended).transmissions == robot(kind).transmissions
    assert read_robot(both).closures == ()
    c = CLOSURE[kind]
    ours = f"closures:\n- {{name: {c.name}, kind: {c.kind}, frame_a: {c.frame_a}, frame_b: {c.frame_b}}}\n"
    assert read_robot(both, written(tmp_path / "closures.yaml", ours)) == robot(kind)
