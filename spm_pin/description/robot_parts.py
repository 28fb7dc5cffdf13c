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

__all__ = ["MOVING", "Inertial", "Joint", "Limit", "Link", "Material", "Mesh", "Placement", "Shape", "Transmission"]

MOVING = ("revolute", "continuous", "prismatic")
"""Kinds of joint with a degree of freedom."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Placement:
    """Placement of a frame in another: `xyz` [m] and roll, pitch, yaw `rpy` [rad] about the fixed x, y and z axes."""

    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)

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
    """Mass [kg] and moments ixx, ixy, ixz, iyy, iyz, izz [kg m²] about the centre of mass, in a frame placed there."""

    mass: float
    moments: tuple[float, float, float, float, float, float]
    placement: Placement = Placement()

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
    """A name and red, green, blue and opacity from 0 to 1."""

    name: str
    rgba: tuple[float, float, float, float]


@dataclass(frozen=True)
class Mesh:
    """A mesh file: the URI in the source, and the path."""

    uri: str = field(compare=False)
    path: Path

    def reference(self, folder: Path | None, *, uri: bool = True) -> str:
        """Return the path as a file in `folder` names it, absolute without one; the `uri` if it is no plain path."""
        if uri and "://" in self.uri:
            return self.uri
        path = self.path if folder is None else Path(os.path.relpath(self.path, folder))
        return path.as_posix()


@dataclass(frozen=True)
class Shape:
    """A visual or a collision shape."""

    kind: str  # "box", "cylinder", "sphere" or "mesh"
    size: tuple[float, ...]
    """Sides of a box, radius and length of a cylinder about z, radius of a sphere [m]; scales of a mesh."""
    placement: Placement = Placement()  # of its centre, or of the mesh's origin, in the link
    material: Material | None = None  # colour of what is seen
    mesh: Mesh | None = None  # for kind "mesh"


@dataclass(frozen=True)
class Link:
    """A body; massless without `inertial`."""

    name: str
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Limit:
    """Range [rad or m], effort [N m or N] and velocity [rad/s or m/s]; infinite where there is none."""

    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    velocity: float = math.inf


@dataclass(frozen=True)
class Joint:
    """A joint of the spanning tree; `placement` is its frame, and the child's at zero, in the parent.

    `kind` is "fixed", "revolute", "continuous" or "prismatic", `axis` a unit vector in the child; `damping` and
    `friction` are those of URDF: N m s/rad or N s/m, and N m or N.
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: Placement = Placement()
    axis: Triple = (1.0, 0.0, 0.0)
    limit: Limit = Limit()
    damping: float = 0.0
    friction: float = 0.0

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
    joint: str
    actuator: str
