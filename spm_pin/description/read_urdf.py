"""Reading a URDF into a `RobotDescription`; content that would be lost is an error that names the line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from spm_pin.description.closures import Closure
from spm_pin.description.robot_description import RobotDescription
from spm_pin.description.robot_parts import MOVING, Joint, Link, Material, Mesh, Shape, Transmission
from spm_pin.description.urdf_elements import inertial, limit, merged_closures, placement
from spm_pin.description.xml_nodes import Node, parse
from spm_pin.errors import DescriptionError

TRANSMISSION = "transmission_interface/SimpleTransmission"
"""The type of transmission that is read and written."""


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
        return RobotDescription(
            root.get("name"),
            tuple(self._link(node) for node in root.all("link")),
            tuple(self._joint(node) for node in root.all("joint")),
            merged_closures(closures, root),
            tuple(self._transmission(node) for node in root.all("transmission")),
        )

    def _link(self, node: Node) -> Link:
        node.check(children=("inertial", "visual", "collision"), attributes=("name",))
        masses = node.optional("inertial")
        return Link(
            node.get("name"),
            None if masses is None else inertial(masses),
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
        return Shape(solid.tag, size, placement(node), None if material is None else self._material(material), mesh)

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
            return Joint(name, kind, parent, child, placement(node))
        axis = node.optional("axis")
        direction = (1.0, 0.0, 0.0) if axis is None else axis.triple("xyz")
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
        return Joint(name, kind, parent, child, placement(node), direction, limit(node, kind), damping, friction)

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
