"""URDF, its loops closed by Drake's ball constraints and, optionally, by the constraints proposed for ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from spm_pin.description.closures import Closure
from spm_pin.description.read_urdf import TRANSMISSION
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Material, Placement, Shape, Transmission
from spm_pin.description.xml_nodes import document, element
from spm_pin.errors import DescriptionError

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
    return document(
        element(
            "robot",
            element("mujoco", element("compiler", fusestatic="false", discardvisual="false")),
            *(element("material", element("color", rgba=each.rgba), name=each.name) for each in _materials(robot)),
            *(_link(link, folder) for link in robot.links),
            *map(_joint, robot.joints),
            *map(_transmission, robot.transmissions),
            *(part for closure in robot.closures for part in _closure(closure, ros_constraints)),
            **{"name": robot.name, "xmlns:drake": DRAKE},
        )
    )


def _materials(robot: RobotDescription) -> list[Material]:
    """Return the materials with a name, each once."""
    found: dict[str, Material] = {}
    for material in (shape.material for link in robot.links for shape in link.visuals):
        if material is not None and material.name and found.setdefault(material.name, material) != material:
            raise DescriptionError("robot", "one colour of each material", f"two of {material.name}")
    return list(found.values())


def _origin(placement: Placement) -> Element:
    return element("origin", xyz=placement.xyz, rpy=placement.rpy)


def _link(link: Link, folder: Path | None) -> Element:
    inertial = None
    if link.inertial is not None:
        parts = element("mass", value=link.inertial.mass), element("inertia", **link.inertial.named_moments)
        inertial = element("inertial", _origin(link.inertial.placement), *parts)
    visuals = (_shape("visual", shape, folder) for shape in link.visuals)
    return element(
        "link", inertial, *visuals, *(_shape("collision", s, folder) for s in link.collisions), name=link.name
    )


def _shape(tag: str, shape: Shape, folder: Path | None) -> Element:
    if shape.mesh is not None:
        solid = element(shape.kind, filename=shape.mesh.reference(folder), scale=shape.size)
    elif shape.kind == "box":
        solid = element(shape.kind, size=shape.size)
    else:
        solid = element(shape.kind, **dict(zip(("radius", "length"), shape.size, strict=False)))
    colour = shape.material
    material = None
    if colour is not None:
        material = element("material", None if colour.name else element("color", rgba=colour.rgba), name=colour.name)
    return element(tag, _origin(shape.placement), element("geometry", solid), material)


def _joint(joint: Joint) -> Element:
    parts = [element("parent", link=joint.parent), element("child", link=joint.child)]
    if joint.moves:
        parts.append(element("axis", xyz=joint.axis))
        limit = joint.limit
        values = {"effort": limit.effort, "velocity": limit.velocity}
        if joint.kind != "continuous":
            values = {"lower": limit.lower, "upper": limit.upper} | values
        finite = [math.isfinite(value) for value in values.values()]
        if all(finite):
            parts.append(element("limit", **values))
        elif any(finite) or joint.kind != "continuous":
            expected = "finite limits, which a URDF cannot do without"
            raise DescriptionError("robot", expected, f"{limit} of {joint.name}")
        if joint.damping or joint.friction:
            parts.append(element("dynamics", damping=joint.damping, friction=joint.friction))
    return element("joint", _origin(joint.placement), *parts, name=joint.name, type=joint.kind)


def _transmission(transmission: Transmission) -> Element:
    interface = element("hardwareInterface", text="hardware_interface/EffortJointInterface")
    return element(
        "transmission",
        element("type", text=TRANSMISSION),
        element("joint", interface, name=transmission.joint),
        element("actuator", element("mechanicalReduction", text="1"), name=transmission.actuator),
        name=transmission.name,
    )


def _closure(closure: Closure, ros_constraints: bool) -> Iterator[Element]:
    """Return Drake's element for a closure, and the one of the ROS proposal."""
    if closure.kind == "point":
        yield element(
            "drake:ball_constraint",
            element("drake:ball_constraint_body_A", name=closure.frame_a),
            element("drake:ball_constraint_p_AP", value="0 0 0"),
            element("drake:ball_constraint_body_B", name=closure.frame_b),
            element("drake:ball_constraint_p_BQ", value="0 0 0"),
        )
    elif not ros_constraints:
        expected = "closures of kind point, the only one that a URDF's reader takes today"
        raise DescriptionError("robot", expected, f"the {closure.kind} {closure.name}")
    if ros_constraints:
        yield element(
            "constraint",
            element("parent", link=closure.frame_a),
            element("parent_origin", xyz="0 0 0", rpy="0 0 0"),
            element("child", link=closure.frame_b),
            element("child_origin", xyz="0 0 0", rpy="0 0 0"),
            name=closure.name,
            type={"point": "spherical_joint", "weld": "link"}[closure.kind],
        )
