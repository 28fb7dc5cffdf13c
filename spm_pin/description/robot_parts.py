"""Data of a robot's parts: links and their shapes, joints, transmissions."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.pose import homogeneous

MOVING = ("revolute", "continuous", "prismatic")
"""Kinds of joint with a degree of freedom."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Placement:
    """Placement of a frame in another."""

    xyz: Triple = (0.0, 0.0, 0.0)
    """Origin in the other frame [m]."""
    rpy: Triple = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw about the fixed x, y and z axes [rad]."""

    @property
    def matrix(self) -> FloatArray:
        """The homogeneous transform, shape (4, 4)."""
        return homogeneous(Rotation.from_euler("xyz", self.rpy).as_matrix(), np.array(self.xyz))

    @property
    def quaternion(self) -> tuple[float, ...]:
        """The orientation as w, x, y, z."""
        return tuple(Rotation.from_euler("xyz", self.rpy).as_quat(scalar_first=True).tolist())


@dataclass(frozen=True)
class Inertial:
    """Mass and moments of inertia of a link."""

    mass: float
    """Mass [kg]."""
    moments: tuple[float, float, float, float, float, float]
    """Moments ixx, ixy, ixz, iyy, iyz, izz about the centre of mass [kg m²], in the inertial frame."""
    placement: Placement = Placement()
    """Placement of the inertial frame, whose origin is the centre of mass, in the link."""

    @property
    def named_moments(self) -> dict[str, float]:
        """The moments by the names that URDF and SDFormat give them."""
        return dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), self.moments, strict=True))

    @property
    def matrix(self) -> FloatArray:
        """The moments as a matrix, shape (3, 3), in the inertial frame."""
        xx, xy, xz, yy, yz, zz = self.moments
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True)
class Material:
    """A colour and its name."""

    name: str
    """Name of the material."""
    rgba: tuple[float, float, float, float]
    """Red, green, blue and opacity, from 0 to 1."""


@dataclass(frozen=True)
class Mesh:
    """A mesh file."""

    uri: str = field(compare=False)
    """The URI in the source."""
    path: Path
    """The file."""

    def reference(self, folder: Path | None, *, uri: bool = True) -> str:
        """Return the path as a file in `folder` names it, absolute without one; the `uri` if it is no plain path."""
        if uri and "://" in self.uri:
            return self.uri
        path = self.path if folder is None else Path(os.path.relpath(self.path, folder))
        return path.as_posix()


@dataclass(frozen=True)
class Shape:
    """A visual or a collision shape."""

    kind: str
    """"box", "cylinder", "sphere" or "mesh"."""
    size: tuple[float, ...]
    """Sides of a box, radius and length of a cylinder about z, radius of a sphere [m]; scales of a mesh."""
    placement: Placement = Placement()
    """Placement of the centre, or of the mesh's origin, in the link."""
    material: Material | None = None
    """Colour of what is seen; None for the reader's own."""
    mesh: Mesh | None = None
    """The file of kind "mesh"; None for the others."""


@dataclass(frozen=True)
class Link:
    """A body; massless without `inertial`."""

    name: str
    """Name of the link and of its frame."""
    inertial: Inertial | None = None
    """Mass and moments; None for a massless link."""
    visuals: tuple[Shape, ...] = ()
    """Shapes that are seen."""
    collisions: tuple[Shape, ...] = ()
    """Shapes that collide."""


@dataclass(frozen=True)
class Limit:
    """Limits of a joint; infinite where there is none."""

    lower: float = -math.inf
    """Least value [rad or m]."""
    upper: float = math.inf
    """Largest value [rad or m]."""
    effort: float = math.inf
    """Largest torque or force [N m or N]."""
    velocity: float = math.inf
    """Largest rate [rad/s or m/s]."""


@dataclass(frozen=True)
class Joint:
    """A joint of the spanning tree; damping and friction are those of URDF."""

    name: str
    """Name of the joint."""
    kind: str
    """"fixed", "revolute", "continuous" or "prismatic"."""
    parent: str
    """Name of the parent link."""
    child: str
    """Name of the child link."""
    placement: Placement = Placement()
    """Placement of the joint's frame, and of the child's at zero, in the parent."""
    axis: Triple = (1.0, 0.0, 0.0)
    """Unit vector along the axis, in the child."""
    limit: Limit = Limit()
    """Limits of value, effort and rate."""
    damping: float = 0.0
    """Damping [N m s/rad or N s/m]."""
    friction: float = 0.0
    """Friction [N m or N]."""

    @property
    def moves(self) -> bool:
        """True if it has a degree of freedom."""
        return self.kind in MOVING

    def motion(self, value: float) -> FloatArray:
        """Return the pose (4, 4) of the child in the joint's frame at a value [rad or m]."""
        transform = np.eye(4)
        if self.kind == "prismatic":
            transform[:3, 3] = value * np.array(self.axis)
        elif self.moves:
            transform[:3, :3] = Rotation.from_rotvec(value * np.array(self.axis)).as_matrix()
        return transform


@dataclass(frozen=True)
class Transmission:
    """An actuator that drives one joint directly, by force or torque up to the joint's limit of effort."""

    name: str
    """Name of the transmission."""
    joint: str
    """Name of the joint."""
    actuator: str
    """Name of the actuator."""
