"""SDFormat, its loops closed by joints whose child already has a parent."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import ASSEMBLED, RobotDescription
from spm_pin.description.robot_parts import Joint, Link, Placement, Shape
from spm_pin.description.xml_nodes import document, element, texts
from spm_pin.errors import DescriptionError
from spm_pin.mechanism.arguments import choice

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
    choice(loops, "loops", ("joints", "drake"))
    names = [*robot.link, *(joint.name for joint in robot.joints)]
    if loops == "joints":
        names += [closure.name for closure in robot.closures]
    mount = f"{robot.base}_to_world"
    shared = {name for name in (*names, mount) if [*names, mount].count(name) > 1} | ({"world"} & set(names))
    if shared:
        expected = "names of their own for links, joints and closures, none of them world"
        raise DescriptionError("robot", expected, ", ".join(sorted(shared)))
    links = [_link(link, robot.joint_to.get(link.name), folder) for link in robot.links]
    driven = {transmission.joint for transmission in robot.transmissions}
    for joint in robot.joints:
        if joint.moves and (joint.name in driven) == (joint.limit.effort == 0.0):
            expected = "effort in the joints with a transmission, and none in the others"
            raise DescriptionError("robot", expected, f"{joint.limit.effort:g} in {joint.name}")
    gaps = robot.open_closures()
    for name in gaps if loops == "joints" else ():
        expected = f"closures that are closed to {ASSEMBLED:g} m at zero"
        raise DescriptionError("robot", expected, f"{name}, open by {gaps[name]:.2g} m")
    model = element(
        "model",
        element("joint", *texts(parent="world", child=robot.base), name=mount, type="fixed"),
        *links,
        *map(_joint, robot.joints),
        *map(_drake_ball if loops == "drake" else _closing_joint, robot.closures),
        name=robot.name,
    )
    return document(element("sdf", model, **{"version": VERSION, "xmlns:drake": "http://drake.mit.edu"}))


def _pose(placement: Placement, **relative: str) -> Element:
    return element("pose", text=(*placement.xyz, *placement.rpy), **relative)


def _link(link: Link, carrier: Joint | None, folder: Path | None) -> Element:
    if link.inertial is None or link.inertial.mass <= 0.0:
        raise DescriptionError("robot", "mass in every link", f"none in {link.name}", "SDFormat would take 1 kg")
    inertia = element("inertia", *texts(**link.inertial.named_moments))
    shapes = [("visual", i, shape) for i, shape in enumerate(link.visuals, start=1)]
    shapes += [("collision", i, shape) for i, shape in enumerate(link.collisions, start=1)]
    return element(
        "link",
        None if carrier is None else _pose(Placement(), relative_to=carrier.name),
        element("inertial", _pose(link.inertial.placement), *texts(mass=link.inertial.mass), inertia),
        *(_shape(tag, f"{link.name}_{tag}_{i}", shape, folder) for tag, i, shape in shapes),
        name=link.name,
    )


def _shape(tag: str, name: str, shape: Shape, folder: Path | None) -> Element:
    if shape.mesh is not None:
        solid = texts(uri=shape.mesh.reference(folder), scale=shape.size)
    elif shape.kind == "box":
        solid = texts(size=shape.size)
    else:
        solid = texts(**dict(zip(("radius", "length"), shape.size, strict=False)))
    colour = None if shape.material is None else shape.material.rgba
    material = None if colour is None else element("material", *texts(ambient=colour, diffuse=colour))
    return element(tag, _pose(shape.placement), element("geometry", element(shape.kind, *solid)), material, name=name)


def _joint(joint: Joint) -> Element:
    axis = None
    if joint.moves:
        limits = vars(joint.limit).items()
        finite = element("limit", *texts(**{key: value for key, value in limits if math.isfinite(value)}))
        resists = bool(joint.damping or joint.friction)
        dynamics = element("dynamics", *texts(damping=joint.damping, friction=joint.friction)) if resists else None
        axis = element("axis", *texts(xyz=joint.axis), finite, dynamics)
    ends = texts(parent=joint.parent, child=joint.child)
    kind = joint.kind if joint.moves else "fixed"
    pose = _pose(joint.placement, relative_to=joint.parent)
    return element("joint", pose, *ends, axis, name=joint.name, type=kind)


def _closing_joint(closure: Closure) -> Element:
    kind = {"point": "ball", "weld": "fixed"}[closure.kind]
    return element("joint", *texts(parent=closure.frame_a, child=closure.frame_b), name=closure.name, type=kind)


def _drake_ball(closure: Closure) -> Element:
    if closure.kind != "point":
        expected = "closures of kind point, the only one that Drake reads"
        raise DescriptionError("robot", expected, f"the {closure.kind} {closure.name}")
    ends = {"body_A": closure.frame_a, "p_AP": "0 0 0", "body_B": closure.frame_b, "p_BQ": "0 0 0"}
    return element(
        "drake:ball_constraint", *texts(**{f"drake:ball_constraint_{key}": end for key, end in ends.items()})
    )
