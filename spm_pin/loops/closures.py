"""Closures and joint equalities, which a `ClosedChain` adds to the tree of a `pinocchio.Model`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin

from spm_pin.errors import ArgumentError
from spm_pin.support.arguments import check_instance, choice, real_array, real_number
from spm_pin.support.pose import checked_pose

ClosureKind = Literal["point", "hinge", "planar", "weld"]


@dataclass(frozen=True, eq=False)
class Anchor:
    """A place on a link: a frame of the model by its name, and a placement (`pinocchio.SE3`) in that frame."""

    frame: str
    placement: Any = field(default_factory=pin.SE3.Identity)

    def __post_init__(self) -> None:
        check_instance(self.frame, str, "frame")
        placement = check_instance(self.placement, pin.SE3, "placement")
        checked_pose(placement.rotation, placement.translation, "placement")


@dataclass(frozen=True, eq=False)
class Closure:
    """A joint that closes a loop: two anchors on two links, and the kind of joint between them.

    `point`: the origins coincide, as in a ball joint (3 equations). `hinge`: the origins and the z axes coincide (5).
    `planar`: the origins coincide as seen along the z axis of the first anchor (2), the hinge of a planar linkage whose
    other joints keep it in its plane already. `weld`: the frames coincide (6).
    """

    kind: ClosureKind
    first: Anchor
    second: Anchor
    name: str = ""

    def __post_init__(self) -> None:
        choice(self.kind, "kind", get_args(ClosureKind))
        check_instance(self.first, Anchor, "first")
        check_instance(self.second, Anchor, "second")


@dataclass(frozen=True)
class JointEquality:
    """A joint that follows another by a polynomial, as a gear or a mimic joint does.

    q_joint - zero = Σ_k coefficients[k] (q_driver - driver_zero)^k; without a driver q_joint = zero + coefficients[0].
    Both are joints of one degree of freedom, values in rad or m.
    """

    joint: str
    driver: str | None
    coefficients: tuple[float, ...]
    zero: float = 0.0
    driver_zero: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        if real_array(self.coefficients, "coefficients", (), "lowest power first").ndim != 1:
            raise ArgumentError("coefficients", "a sequence of numbers, lowest power first", f"{self.coefficients}")
        real_number(self.zero, "zero", "a finite number")
        real_number(self.driver_zero, "driver_zero", "a finite number")


class RobotDescription(NamedTuple):
    """Result of a reader: the tree, closures, joint equalities and actuators of a file."""

    model: Any
    """`pinocchio.Model` with all frames."""
    closures: tuple[Closure, ...]
    equalities: tuple[JointEquality, ...]
    actuated: tuple[str, ...]
    """Names of the actuated joints, in the order of the file's actuators."""
    q0: np.ndarray
    """Start (nq,) of `close`: the first keyframe or group state of the file, otherwise its rest pose."""
    configurations: dict[str, np.ndarray]
    """Named configurations of the file (nq,): keyframes, group states."""
    source: str
    """Path of the file, for messages."""


def find_frame(model: Any, name: str) -> int | None:
    """Return the number of a frame by its name, that of a link or a site before that of a joint; None without one."""
    for kinds in (pin.FrameType.BODY, pin.FrameType.OP_FRAME, pin.FrameType.SENSOR, pin.FrameType.JOINT):
        if model.existFrame(name, kinds):
            return int(model.getFrameId(name, kinds))
    return int(model.getFrameId(name)) if model.existFrame(name) else None
