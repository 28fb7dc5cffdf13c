"""SDFormat, its loops closed by joints whose child already has a parent."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import ASSEMBLED, RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Placement, Shape
from spm_pin.description.xml_nodes import document, numbers
from spm_pin.errors import ArgumentError, DescriptionError

__all__ = ["sdf_text"]

VERSION = "1.9"


def sdf_text(robot: RobotDescription, *, loops: str = "joints", folder: Path | None = None) -> str:
    """Return a robot as an SDFormat model, its base fixed to the world.

    Parameters
    ----------
    robot : RobotDescription
        Its states and the names of its actuators have no place in the format.
    loops : str
        "joints": a ball joint, or a fixed one for a weld, between the two frames of each closure, as the format's
        graph of links has it. "drake": Drake's ball constraints, for Drake takes no loops of joints.
    folder : Path, optional
        Where the file will lie, if it is to name its meshes relative to that; by default their paths are absolute.

    Raises
    ------
    DescriptionError
        If a link has no mass, for which the format would put 1 kg; if the robot does not stand assembled at zero,
        where a joint is placed, or a closure is a weld and `loops` is "drake"; if a link and a joint share a name,
        or a joint has effort without a transmission.

    Notes
    -----
    http://sdformat.org/spec, version 1.9. Every joint is placed in its parent link and every link in its joint. A joint
    is driven if its limit of effort is not zero: passive joints must say zero.
    """
    if loops not in ("joints", "drake"):
        raise ArgumentError("loops", "joints or drake", repr(loops))
    names = [*robot.link, *(joint.name for joint in robot.joints)]
    if loops == "joints":
        names += [closure.name for closure in robot.closures]
    mount = f"{robot.base}_to_world"
    shared = {name for name in (*names, mount) if [*names, mount].count(name) > 1} | ({"world"} & set(names))
    if shared:
        expected = "names of their own for links, joints and closures, none of them world"
        raise DescriptionError("robot", expected, ", ".join(sorted(shared)))
    root = Element("sdf", {"version": VERSION, "xmlns:drake": "http://drake.mit.edu"})
    model = SubElement(root, "model", name=robot.name)
    fixed = SubElement(model, "joint", name=mount, type="fixed")
    _ends(fixed, "world", robot.base)
    for link in robot.links:
        model.append(_link(link, robot.joint_to.get(link.name), folder))
    driven = {transmission.joint for transmission in robot.transmissions}
    for joint in robot.joints:
        if joint.moves and (joint.name in driven) == (joint.limit.effort == 0.0):
            expected = "effort in the joints with a transmission, and none in the others"
            raise DescriptionError("robot", expected, f"{joint.limit.effort:g} in {joint.name}")
        model.append(_joint(joint))
    gaps = robot.open_closures()
    for closure in robot.closures:
        if loops == "drake":
            model.append(_ball(closure))
        elif closure.name in gaps:
            expected = f"closures that are closed to {ASSEMBLED:g} m at zero"
            raise DescriptionError("robot", expected, f"{closure.name}, open by {gaps[closure.name]:.2g} m")
        else:
            kind = {"point": "ball", "weld": "fixed"}[closure.kind]
            _ends(SubElement(model, "joint", name=closure.name, type=kind), closure.frame_a, closure.frame_b)
    return document(root)


def _text(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text


def _ends(joint: Element, parent: str, child: str) -> None:
    _text(joint, "parent", parent)
    _text(joint, "child", child)


def _pose(parent: Element, placement: Placement, relative_to: str = "") -> None:
    pose = SubElement(parent, "pose", {"relative_to": relative_to} if relative_to else {})
    pose.text = numbers((*placement.xyz, *placement.rpy))


def _link(link: Link, carrier: Joint | None, folder: Path | None) -> Element:
    element = Element("link", name=link.name)
    if carrier is not None:
        _pose(element, Placement(), carrier.name)
    if link.inertial is None or link.inertial.mass <= 0.0:
        raise DescriptionError("robot", "mass in every link", f"none in {link.name}", "SDFormat would take 1 kg")
    inertial = SubElement(element, "inertial")
    _pose(inertial, link.inertial.placement)
    _text(inertial, "mass", numbers([link.inertial.mass]))
    inertia = SubElement(inertial, "inertia")
    for key, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), link.inertial.moments, strict=True):
        _text(inertia, key, numbers([value]))
    for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
        for i, shape in enumerate(shapes, start=1):
            element.append(_shape(tag, f"{link.name}_{tag}_{i}", shape, folder))
    return element


def _shape(tag: str, name: str, shape: Shape, folder: Path | None) -> Element:
    element = Element(tag, name=name)
    _pose(element, shape.placement)
    solid = SubElement(SubElement(element, "geometry"), shape.kind)
    if shape.mesh is not None:
        _text(solid, "uri", shape.mesh.reference(folder))
        _text(solid, "scale", numbers(shape.size))
    elif shape.kind == "box":
        _text(solid, "size", numbers(shape.size))
    else:
        for key, value in zip(("radius", "length"), shape.size, strict=False):
            _text(solid, key, numbers([value]))
    if shape.material is not None:
        material = SubElement(element, "material")
        for light in ("ambient", "diffuse"):
            _text(material, light, numbers(shape.material.rgba))
    return element


def _joint(joint: Joint) -> Element:
    element = Element("joint", name=joint.name, type="fixed" if not joint.moves else joint.kind)
    _pose(element, joint.placement, joint.parent)
    _ends(element, joint.parent, joint.child)
    if joint.moves:
        axis = SubElement(element, "axis")
        _text(axis, "xyz", numbers(joint.axis))
        limit = SubElement(axis, "limit")
        for key in ("lower", "upper", "effort", "velocity"):
            value = getattr(joint.limit, key)
            if math.isfinite(value):
                _text(limit, key, numbers([value]))
        if joint.damping or joint.friction:
            dynamics = SubElement(axis, "dynamics")
            _text(dynamics, "damping", numbers([joint.damping]))
            _text(dynamics, "friction", numbers([joint.friction]))
    return element


def _ball(closure: Closure) -> Element:
    if closure.kind != "point":
        expected = "closures of kind point, the only one that Drake reads"
        raise DescriptionError("robot", expected, f"the {closure.kind} {closure.name}")
    element = Element("drake:ball_constraint")
    for body, point, frame in (("body_A", "p_AP", closure.frame_a), ("body_B", "p_BQ", closure.frame_b)):
        _text(element, f"drake:ball_constraint_{body}", frame)
        _text(element, f"drake:ball_constraint_{point}", "0 0 0")
    return element
