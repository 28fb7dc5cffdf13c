"""URDF, its loops closed by Drake's ball constraints and, optionally, by the constraints proposed for ROS."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from spm_pin.description.closures import Closure
from spm_pin.description.read_urdf import TRANSMISSION
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Material, Placement, Shape
from spm_pin.description.xml_nodes import document, numbers
from spm_pin.errors import DescriptionError

__all__ = ["urdf_text"]

DRAKE = "http://drake.mit.edu"


def urdf_text(robot: RobotDescription, *, ros_constraints: bool = False, folder: Path | None = None) -> str:
    """Return a robot as a URDF.

    Parameters
    ----------
    robot : RobotDescription
        Its states are not part of a URDF: they are the SRDF's.
    ros_constraints : bool
        Close the loops by `<constraint>` as well, as proposed in https://github.com/ros/urdfdom/pull/264. Readers
        of today pass over it.
    folder : Path, optional
        Where the file will lie, if it is to name its meshes relative to that; by default their paths are absolute.

    Raises
    ------
    DescriptionError
        If a closure is a weld, for which Drake has no element in a URDF, and `ros_constraints` is not set; if a
        joint that is not continuous has no limits; if two materials share a name.

    Notes
    -----
    Drake: `<drake:ball_constraint>` and an actuator for each `<transmission>`,
    https://drake.mit.edu/doxygen_cxx/group__multibody__parsing.html. MuJoCo's element keeps it from merging fixed
    links and from dropping what is only seen.
    """
    root = Element("robot", {"name": robot.name, "xmlns:drake": DRAKE})
    compiler = SubElement(SubElement(root, "mujoco"), "compiler")
    compiler.attrib.update(fusestatic="false", discardvisual="false")
    for material in _materials(robot):
        colour = SubElement(SubElement(root, "material", name=material.name), "color")
        colour.set("rgba", numbers(material.rgba))
    for link in robot.links:
        root.append(_link(link, folder))
    for joint in robot.joints:
        root.append(_joint(joint))
    for transmission in robot.transmissions:
        element = SubElement(root, "transmission", name=transmission.name)
        SubElement(element, "type").text = TRANSMISSION
        driven = SubElement(element, "joint", name=transmission.joint)
        SubElement(driven, "hardwareInterface").text = "hardware_interface/EffortJointInterface"
        actuator = SubElement(element, "actuator", name=transmission.actuator)
        SubElement(actuator, "mechanicalReduction").text = "1"
    for closure in robot.closures:
        if closure.kind == "point":
            root.append(_ball(closure))
        elif not ros_constraints:
            expected = "closures of kind point, the only one that a URDF's reader takes today"
            raise DescriptionError("robot", expected, f"the {closure.kind} {closure.name}")
        if ros_constraints:
            root.append(_constraint(closure))
    return document(root)


def _materials(robot: RobotDescription) -> list[Material]:
    """Return the materials with a name, each once."""
    found: dict[str, Material] = {}
    for material in (shape.material for link in robot.links for shape in link.visuals):
        if material is not None and material.name and found.setdefault(material.name, material) != material:
            raise DescriptionError("robot", "one colour of each material", f"two of {material.name}")
    return list(found.values())


def _origin(parent: Element, placement: Placement) -> None:
    SubElement(parent, "origin", xyz=numbers(placement.xyz), rpy=numbers(placement.rpy))


def _link(link: Link, folder: Path | None) -> Element:
    element = Element("link", name=link.name)
    if link.inertial is not None:
        inertial = SubElement(element, "inertial")
        _origin(inertial, link.inertial.placement)
        SubElement(inertial, "mass", value=numbers([link.inertial.mass]))
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        moments = {key: numbers([value]) for key, value in zip(keys, link.inertial.moments, strict=True)}
        SubElement(inertial, "inertia", moments)
    for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
        for shape in shapes:
            element.append(_shape(tag, shape, folder))
    return element


def _shape(tag: str, shape: Shape, folder: Path | None) -> Element:
    element = Element(tag)
    _origin(element, shape.placement)
    solid = SubElement(SubElement(element, "geometry"), shape.kind)
    if shape.mesh is not None:
        uri = shape.mesh.reference(folder)
        solid.attrib.update(filename=uri, scale=numbers(shape.size))
    elif shape.kind == "box":
        solid.set("size", numbers(shape.size))
    else:
        for key, value in zip(("radius", "length"), shape.size, strict=False):
            solid.set(key, numbers([value]))
    if shape.material is not None:
        material = SubElement(element, "material", name=shape.material.name)
        if not shape.material.name:
            SubElement(material, "color", rgba=numbers(shape.material.rgba))
    return element


def _joint(joint: Joint) -> Element:
    element = Element("joint", name=joint.name, type=joint.kind)
    _origin(element, joint.placement)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if not joint.moves:
        return element
    SubElement(element, "axis", xyz=numbers(joint.axis))
    limit = joint.limit
    values = {"effort": limit.effort, "velocity": limit.velocity}
    if joint.kind != "continuous":
        values = {"lower": limit.lower, "upper": limit.upper} | values
    finite = [math.isfinite(value) for value in values.values()]
    if all(finite):
        SubElement(element, "limit", {key: numbers([value]) for key, value in values.items()})
    elif any(finite) or joint.kind != "continuous":
        raise DescriptionError("robot", "finite limits, which a URDF cannot do without", f"{limit} of {joint.name}")
    if joint.damping or joint.friction:
        SubElement(element, "dynamics", damping=numbers([joint.damping]), friction=numbers([joint.friction]))
    return element


def _ball(closure: Closure) -> Element:
    element = Element("drake:ball_constraint")
    for body, point, frame in (("body_A", "p_AP", closure.frame_a), ("body_B", "p_BQ", closure.frame_b)):
        SubElement(element, f"drake:ball_constraint_{body}", name=frame)
        SubElement(element, f"drake:ball_constraint_{point}", value="0 0 0")
    return element


def _constraint(closure: Closure) -> Element:
    kind = {"point": "spherical_joint", "weld": "link"}[closure.kind]
    element = Element("constraint", name=closure.name, type=kind)
    for end, frame in (("parent", closure.frame_a), ("child", closure.frame_b)):
        SubElement(element, end, link=frame)
        SubElement(element, f"{end}_origin", xyz="0 0 0", rpy="0 0 0")
    return element
