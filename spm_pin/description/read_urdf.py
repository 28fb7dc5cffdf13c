"""Reading a URDF into a `RobotDescription`; content that would be lost is an error that names the line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import (
    MOVING,
    Inertial,
    Joint,
    Limit,
    Link,
    Material,
    Mesh,
    Placement,
    RobotDescription,
    Shape,
    Transmission,
)
from spm_pin.description.xml_nodes import Node, parse
from spm_pin.errors import DescriptionError

__all__ = ["check_inertials", "read_urdf", "urdf_description"]

KINDS_OF_CONSTRAINT = {"spherical": "point", "spherical_joint": "point", "link": "weld"}
"""Kinds of closure by the names in the ROS proposal's `<constraint>`."""

LARGEST = 1e12
"""Largest mass [kg], moment of inertia [kg m²] and distance of a centre of mass [m] accepted."""

TRANSMISSION = "transmission_interface/SimpleTransmission"


def read_urdf(
    path: str | Path,
    closures: Iterable[Closure] = (),
    *,
    packages: Mapping[str, str | Path] | None = None,
) -> RobotDescription:
    """Read a URDF file.

    Parameters
    ----------
    path : str or Path
        The file.
    closures : iterable of Closure
        Closures beside the file; together with those that the file holds in Drake's ball constraints or the ROS
        proposal's constraints. A pair of frames in several of them is one closure.
    packages : mapping of str to path, optional
        Folders of the packages that meshes are named in. By default a folder of that name above the file.

    Raises
    ------
    DescriptionError
        If the file cannot be read, is malformed, or has anything that would be lost: joints other than fixed,
        revolute, continuous and prismatic, mimic joints, textures, sensors and extensions; if a mesh is missing.
        The error names the line. And as `RobotDescription` raises.

    Notes
    -----
    Passed over are the `<mujoco>` element, with MuJoCo's settings for reading the file, and the colours of collision
    shapes. `<joint_properties>`, as onshape-to-robot writes it, is read as `<dynamics>`.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), "a readable URDF file", str(error)) from error
    return _Reader(str(path), path.parent, packages or {}).robot(text, tuple(closures))


def urdf_description(text: str, closures: Iterable[Closure] = ()) -> RobotDescription:
    """Return the robot of a URDF's text; as `read_urdf`, but meshes must have absolute paths."""
    return _Reader("urdf", None, {}).robot(text, tuple(closures))


class _Reader:
    def __init__(self, source: str, folder: Path | None, packages: Mapping[str, str | Path]) -> None:
        self._source = source
        self._folder = folder
        self._packages = packages
        self._materials: dict[str, Material] = {}

    def robot(self, text: str, closures: tuple[Closure, ...]) -> RobotDescription:
        root = parse(text, self._source)
        if root.tag != "robot":
            raise root.error("<robot>", f"<{root.tag}>")
        known = ("link", "joint", "material", "transmission", "mujoco", "drake:ball_constraint", "constraint")
        extensions = [key for key in root.attributes if key.startswith("xmlns")]
        root.check(children=known, attributes=("name", "version", *extensions))
        for node in root.all("material"):
            node.get("name")
            self._material(node)
        # Named materials first.
        inside = [*map(_constraint, root.all("constraint")), *map(_ball, root.all("drake:ball_constraint"))]
        return RobotDescription(
            root.get("name"),
            tuple(self._link(node) for node in root.all("link")),
            tuple(self._joint(node) for node in root.all("joint")),
            _merged(closures, inside),
            tuple(self._transmission(node) for node in root.all("transmission")),
        )

    def _link(self, node: Node) -> Link:
        node.check(children=("inertial", "visual", "collision"), attributes=("name",))
        inertial = node.optional("inertial")
        return Link(
            node.get("name"),
            None if inertial is None else _inertial(inertial),
            tuple(self._shape(shape) for shape in node.all("visual")),
            tuple(self._shape(shape) for shape in node.all("collision")),
        )

    def _shape(self, node: Node) -> Shape:
        node.check(children=("origin", "geometry", "material"))
        geometry = node.one("geometry")
        geometry.check(children=("box", "cylinder", "sphere", "mesh"))
        if len(geometry.children) != 1:
            raise geometry.error("one shape in <geometry>", len(geometry.children))
        solid = geometry.children[0]
        mesh = None
        if solid.tag == "mesh":
            solid.check(attributes=("filename", "scale"))
            size = solid.floats("scale", 3, "1 1 1")
            mesh = self._mesh(solid)
        elif solid.tag == "box":
            solid.check(attributes=("size",))
            size = solid.floats("size", 3)
        else:
            keys = ("radius", "length") if solid.tag == "cylinder" else ("radius",)
            solid.check(attributes=keys)
            size = tuple(solid.number(key) for key in keys)
        if mesh is None and not all(value > 0.0 for value in size):
            raise solid.error("positive dimensions", size)
        material = node.optional("material") if node.tag == "visual" else None
        return Shape(solid.tag, size, _origin(node), None if material is None else self._material(material), mesh)

    def _material(self, node: Node) -> Material:
        node.check(children=("color",), attributes=("name",))
        colour = node.optional("color")
        if colour is None:
            name = node.get("name")
            if name not in self._materials:
                raise node.error("a material of the robot", repr(name))
            return self._materials[name]
        colour.check(attributes=("rgba",))
        red, green, blue, opacity = colour.floats("rgba", 4)
        material = Material(node.attributes.get("name", ""), (red, green, blue, opacity))
        self._materials.setdefault(material.name, material)
        return material

    def _mesh(self, node: Node) -> Mesh:
        uri = node.get("filename")
        expected = "a mesh file"
        if uri.startswith("package://"):
            package, _, rest = uri.removeprefix("package://").partition("/")
            above = [] if self._folder is None else [self._folder.resolve(), *self._folder.resolve().parents]
            folders = [Path(self._packages[package])] if package in self._packages else []
            # Some tools name no package and mean the folder of the URDF.
            folders += [folder for folder in above if not package or folder.name == package]
            if not folders:
                raise node.error(expected, f"{uri!r}", f"Say with packages where {package} is")
            path = folders[0] / rest
        else:
            path = Path(uri.removeprefix("file://"))
            if not path.is_absolute():
                if self._folder is None:
                    raise node.error("an absolute path of a mesh", repr(uri), "A text has no folder to count from")
                path = self._folder.resolve() / path
        if not path.is_file():
            raise node.error(expected, f"{uri!r}: there is no {path}")
        return Mesh(uri, path)

    def _joint(self, node: Node) -> Joint:
        node.check(
            children=("origin", "parent", "child", "axis", "limit", "dynamics", "joint_properties"),
            attributes=("name", "type"),
        )
        name, kind = node.get("name"), node.get("type")
        if kind != "fixed" and kind not in MOVING:
            raise node.error(f"a joint of type fixed, {', '.join(MOVING)}", f"{kind!r} of {name}")
        ends = [node.one(end) for end in ("parent", "child")]
        for end in ends:
            end.check(attributes=("link",))
        parent, child = (end.get("link") for end in ends)
        if kind == "fixed":
            return Joint(name, kind, parent, child, _origin(node))
        axis = node.optional("axis")
        direction = (1.0, 0.0, 0.0) if axis is None else _triple(axis, "xyz")
        length = math.hypot(*direction)
        if length == 0.0 and axis is not None:
            raise axis.error("an axis that is not zero", repr(axis.get("xyz")))
        if abs(length - 1.0) > 1e-15:
            direction = (direction[0] / length, direction[1] / length, direction[2] / length)
        dynamics = node.optional("dynamics") or node.optional("joint_properties")
        damping = friction = 0.0
        if dynamics is not None:
            dynamics.check(attributes=("damping", "friction"))
            damping, friction = dynamics.number("damping", "0"), dynamics.number("friction", "0")
        return Joint(name, kind, parent, child, _origin(node), direction, _limit(node, kind), damping, friction)

    def _transmission(self, node: Node) -> Transmission:
        node.check(children=("type", "joint", "actuator"), attributes=("name",))
        kind = node.one("type").text.strip()
        if kind != TRANSMISSION:
            raise node.one("type").error(TRANSMISSION, repr(kind))
        joint, actuator = node.one("joint"), node.one("actuator")
        joint.check(children=("hardwareInterface",), attributes=("name",))
        actuator.check(children=("mechanicalReduction", "hardwareInterface"), attributes=("name",))
        for interface in (*joint.all("hardwareInterface"), *actuator.all("hardwareInterface")):
            if interface.text.strip().rpartition("/")[2] != "EffortJointInterface":
                raise interface.error("an EffortJointInterface", repr(interface.text.strip()))
        reduction = actuator.optional("mechanicalReduction")
        if reduction is not None and reduction.text.strip() not in ("1", "1.0"):
            cause = "The limits of effort and velocity are the joint's"
            raise reduction.error("a mechanicalReduction of 1", repr(reduction.text.strip()), cause)
        return Transmission(node.get("name"), joint.get("name"), actuator.get("name"))


def _triple(node: Node, attribute: str, default: str | None = None) -> tuple[float, float, float]:
    x, y, z = node.floats(attribute, 3, default)
    return x, y, z


def _origin(node: Node) -> Placement:
    origin = node.optional("origin")
    if origin is None:
        return Placement()
    origin.check(attributes=("xyz", "rpy"))
    return Placement(_triple(origin, "xyz", "0 0 0"), _triple(origin, "rpy", "0 0 0"))


def _inertial(node: Node) -> Inertial:
    node.check(children=("origin", "mass", "inertia"))
    mass, inertia = node.one("mass"), node.one("inertia")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    mass.check(attributes=("value",))
    inertia.check(attributes=keys)
    xx, xy, xz, yy, yz, zz = (inertia.number(key) for key in keys)
    value = mass.number("value")
    if not 0.0 <= value <= LARGEST:
        raise mass.error(f"a mass from 0 to {LARGEST:g} kg", mass.get("value"))
    inertial = Inertial(value, (xx, xy, xz, yy, yz, zz), _origin(node))
    if max(map(abs, inertial.placement.xyz)) > LARGEST:
        raise node.error(f"a centre of mass up to {LARGEST:g} m away", f"{max(inertial.placement.xyz, key=abs):g} m")
    if max(map(abs, inertial.moments)) > LARGEST:
        raise inertia.error(f"moments of inertia up to {LARGEST:g} kg m²", f"{max(inertial.moments, key=abs):g}")
    smallest, largest = np.linalg.eigvalsh(inertial.matrix)[[0, -1]]
    # A negligible violation comes from the digits of an exporter.
    if smallest < -1e-9 * largest or largest < 0.0:
        cause = "Products of inertia with the wrong sign, or not about the centre of mass?"
        raise inertia.error("moments of inertia of which none is negative", f"principal moment {smallest:g}", cause)
    return inertial


def check_inertials(text: str, source: str) -> None:
    """Check masses and moments of inertia of a URDF's text, and that no joint has the name of a link.

    For readers that take what else is in the file from another library. Pinocchio keeps both kinds of names in one
    list, and takes a mass of NaN for none.

    Parameters
    ----------
    text : str
        The URDF.
    source : str
        What errors call it.

    Raises
    ------
    DescriptionError
        As `read_urdf` for masses and inertias, which must be possible; if a joint and a link share a name. The error
        names the line.
    """
    root = parse(text, source)
    links = {link.attributes.get("name") for link in root.all("link")}
    for joint in root.all("joint"):
        if joint.attributes.get("name") in links:
            raise joint.error("a name that no link has", repr(joint.get("name")), "Pinocchio keeps both in one list")
    for link in root.all("link"):
        inertial = link.optional("inertial")
        if inertial is not None:
            _inertial(inertial)


def _limit(node: Node, kind: str) -> Limit:
    limit = node.optional("limit")
    if limit is None:
        if kind == "continuous":
            return Limit()
        raise node.error(f"a <limit> of the {kind} joint", "none")
    limit.check(attributes=("lower", "upper", "effort", "velocity"))
    effort, velocity = limit.number("effort"), limit.number("velocity")
    if kind == "continuous":
        limit.check(attributes=("effort", "velocity"))
        return Limit(effort=effort, velocity=velocity)
    lower, upper = limit.number("lower", "0"), limit.number("upper", "0")
    if not lower <= upper:
        raise limit.error("lower <= upper", f"[{lower:g}, {upper:g}]", "Exchanged?")
    return Limit(lower, upper, effort, velocity)


def _ball(node: Node) -> tuple[Node, Closure]:
    tags = [f"drake:ball_constraint_{part}" for part in ("body_A", "p_AP", "body_B", "p_BQ")]
    node.check(children=tags)
    a, at_a, b, at_b = (node.one(tag) for tag in tags)
    for point in (at_a, at_b):
        if any(point.floats("value", 3)):
            raise point.error("the origins of the two links, 0 0 0", repr(point.get("value")), "Make a link there")
    return node, _closure(node, "", "point", a.get("name"), b.get("name"))


def _constraint(node: Node) -> tuple[Node, Closure]:
    tags = ("parent", "child", "parent_origin", "child_origin", "parent_axis", "child_axis")
    node.check(children=tags, attributes=("name", "type"))
    if node.get("type") not in KINDS_OF_CONSTRAINT:
        raise node.error(f"a constraint of type {', '.join(KINDS_OF_CONSTRAINT)}", repr(node.get("type")))
    for tag in ("parent_origin", "child_origin"):
        origin = node.optional(tag)
        if origin is not None and any((*_triple(origin, "xyz", "0 0 0"), *_triple(origin, "rpy", "0 0 0"))):
            raise origin.error("the frames of the two links, 0 0 0", "another one", "Make a link there")
    kind = KINDS_OF_CONSTRAINT[node.get("type")]
    return node, _closure(node, node.get("name"), kind, node.one("parent").get("link"), node.one("child").get("link"))


def _closure(node: Node, name: str, kind: str, frame_a: str, frame_b: str) -> Closure:
    try:
        return Closure(name or f"{frame_a}_{frame_b}", kind, frame_a, frame_b)
    except DescriptionError as error:
        raise node.error(error.expected, error.received) from error


def _merged(beside: tuple[Closure, ...], inside: Iterable[tuple[Node, Closure]]) -> tuple[Closure, ...]:
    """Return the closures beside a file, and those inside it that are not among them."""
    closures = list(beside)
    pairs = {frozenset((closure.frame_a, closure.frame_b)): closure for closure in beside}
    seen: set[tuple[str, frozenset[str]]] = set()
    for node, closure in inside:
        pair = frozenset((closure.frame_a, closure.frame_b))
        if (node.tag, pair) in seen:
            raise node.error("each pair of frames once", f"{closure.frame_a} and {closure.frame_b} again")
        seen.add((node.tag, pair))
        if pair not in pairs:
            closures.append(closure)
            pairs[pair] = closure
        elif pairs[pair].kind != closure.kind:
            raise node.error(f"a {pairs[pair].kind}, as the closure {pairs[pair].name}", f"a {closure.kind}")
    return tuple(closures)
