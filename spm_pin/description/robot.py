"""A machine's links, joints and closures as data, read from the URDF that xacro makes, for writers and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.description.masses import Masses, Numbers, Placement, numbers, read_inertial, read_placement
from spm_pin.description.source_files import Closure, machine_or_paper, read_closures, urdf_text
from spm_pin.errors import DescriptionError
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import FloatArray
from spm_pin.support.pose import homogeneous

_EPS = float(np.finfo(np.float64).eps)
_CLOSED = 1e-14
"""Largest gap of a closed loop, over the size of the machine."""


class Shape(NamedTuple):
    """A visual shape, which has a material, or a collision shape."""

    kind: str  # "box", "cylinder", "sphere" or "mesh"
    size: Numbers  # sides of a box, radius and length of a cylinder about z, radius of a sphere [m]; scales of a mesh
    placement: Placement  # of the centre, or of the mesh's origin, in the link
    mesh: str  # the file of a mesh, as the URDF names it; empty for the others
    material: str  # name of the colour


class Link(NamedTuple):
    """A body; its moments of inertia (ixx, iyy, izz) are the principal ones, in the inertial frame."""

    mass: float
    moments: Numbers
    inertial: Placement
    visuals: tuple[Shape, ...]
    collisions: tuple[Shape, ...]


class Joint(NamedTuple):
    """A joint of type "fixed", "revolute" or "prismatic"; limits: lower, upper [rad or m], effort, velocity."""

    name: str
    kind: str
    parent: str
    child: str
    placement: Placement
    axis: Numbers
    limits: dict[str, float]

    @property
    def moves(self) -> bool:
        """True if it has a degree of freedom."""
        return self.kind != "fixed"

    def motion(self, value: float) -> FloatArray:
        """Return the pose (4, 4) of the child in the joint's frame at a value [rad or m]."""
        step = value * np.array(self.axis)
        if self.kind == "prismatic":
            return homogeneous(np.eye(3), step)
        return homogeneous(Rotation.from_rotvec(step).as_matrix(), np.zeros(3))


@dataclass(frozen=True)
class Robot:
    """A spanning tree, with its closures and actuators."""

    name: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    closures: tuple[Closure, ...]
    motors: dict[str, str]  # names of the actuators, by the joints that they drive, in the order of the legs
    materials: dict[str, Numbers]  # red, green, blue and opacity, from 0 to 1, by name

    @cached_property
    def joint_to(self) -> dict[str, Joint]:
        """The parent joint of each link, by the link's name; none for the base."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def base(self) -> str:
        """Name of the root link."""
        (root,) = self.links.keys() - self.joint_to.keys()
        return root

    @cached_property
    def order(self) -> tuple[Joint, ...]:
        """The joints depth first, those of one link sorted by name: Pinocchio's order when it reads a URDF."""
        ordered: list[Joint] = []

        def visit(link: str) -> None:
            for joint in sorted(self.joints.values()):
                if joint.parent == link:
                    ordered.append(joint)
                    visit(joint.child)

        visit(self.base)
        return tuple(ordered)

    @property
    def moving(self) -> tuple[Joint, ...]:
        """The joints with a degree of freedom, in the order of `order`: q of the exports."""
        return tuple(joint for joint in self.order if joint.moves)

    def frames(self, values: Mapping[str, float] | None = None) -> dict[str, FloatArray]:
        """Return the pose (4, 4) of each link in the base, at joint values by name; other joints are at zero."""
        values = values or {}
        frames = {self.base: np.eye(4)}
        for joint in self.order:
            motion = joint.motion(values.get(joint.name, 0.0)) if joint.moves else np.eye(4)
            frames[joint.child] = frames[joint.parent] @ joint.placement.matrix @ motion
        return frames

    def carrier(self, link: str) -> tuple[str, FloatArray]:
        """Return the link that moves with a link, itself or the one to which it is fixed, and its pose (4, 4) there."""
        pose = np.eye(4)
        while link in self.joint_to and not self.joint_to[link].moves:
            pose = self.joint_to[link].placement.matrix @ pose
            link = self.joint_to[link].parent
        return link, pose

    def gaps(self, values: Mapping[str, float] | None = None) -> FloatArray:
        """Return the gaps of the loops at joint values (number of closures, 3) [m]."""
        frames = self.frames(values)
        return np.array([frames[c.frame_a][:3, 3] - frames[c.frame_b][:3, 3] for c in self.closures])

    def is_assembled(self) -> bool:
        """Return whether all loops are closed at zero to 1e-9 m, as in a nominal machine."""
        return float(np.linalg.norm(self.gaps(), axis=-1).max()) <= 1e-9

    def closed_home(self) -> dict[str, float]:
        """Return the values of all moving joints, by name, for closed loops and actuated joints at 0."""
        values = {joint.name: 0.0 for joint in self.moving}
        if self.is_assembled():
            return values
        passive = [name for name in values if name not in self.motors]

        def gaps_at(angles: FloatArray) -> FloatArray:
            return self.gaps(values | dict(zip(passive, angles.tolist(), strict=True))).ravel()

        from scipy.optimize import least_squares  # which takes a tenth of a second to import

        scale = max(float(np.abs(pose[:3, 3]).max()) for pose in self.frames().values())
        fit = least_squares(gaps_at, np.zeros(len(passive)), method="lm", xtol=_EPS, ftol=_EPS, gtol=_EPS)
        if float(np.abs(fit.fun).max()) > _CLOSED * scale:
            expected = "a machine that can be assembled at its home"
            raise DescriptionError("machine", expected, "a machine whose loops do not close there")
        return values | dict(zip(passive, fit.x.tolist(), strict=True))


def read_robot(
    machine: Machine | None = None, *, prefix: str = "", meshes: str | None = None, masses: Masses | None = None
) -> Robot:
    """Return a manipulator, or a stage alone, as data; arguments are those of `urdf_text`."""
    root = ElementTree.fromstring(urdf_text(machine, prefix=prefix, meshes=meshes, masses=masses))
    return Robot(
        machine_or_paper(machine).file_stem,
        {_name(node): _link(node) for node in root.iter("link")},
        {joint.name: joint for joint in map(_joint, root.findall("joint"))},
        read_closures(machine, prefix=prefix),
        {_name(node.find("joint")): _name(node.find("actuator")) for node in root.iter("transmission")},
        {_name(node): numbers(node.find("color"), "rgba") for node in root.findall("material")},
    )


def _name(node: Any, key: str = "name") -> str:
    return str(node.get(key))


def _link(node: Element) -> Link:
    inertial = node.find("inertial")
    assert inertial is not None, "every link of the description has a mass"
    mass, placement, moments = read_inertial(inertial)
    visuals, collisions = (tuple(map(_shape, node.findall(tag))) for tag in ("visual", "collision"))
    return Link(mass, tuple(moments.diagonal().tolist()), placement, visuals, collisions)


def _shape(node: Element) -> Shape:
    ((solid,),) = node.findall("geometry")
    keys = {"mesh": ("scale",), "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[solid.tag]
    size = tuple(number for key in keys for number in numbers(solid, key))
    material = "".join(map(_name, node.findall("material")))
    return Shape(solid.tag, size, read_placement(node), solid.get("filename", ""), material)


def _joint(node: Element) -> Joint:
    parent, child = (_name(node.find(end), "link") for end in ("parent", "child"))
    axis = tuple(number for axis in node.findall("axis") for number in numbers(axis, "xyz"))
    limits = {key: float(value) for limit in node.findall("limit") for key, value in limit.items()}
    return Joint(_name(node), _name(node, "type"), parent, child, read_placement(node), axis, limits)
