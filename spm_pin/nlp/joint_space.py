"""The loop equations in joint space: a symbolic forward kinematics over joint placements handed in as data.

`pinocchio.casadi` is in none of Pinocchio's wheels. Where each joint sits is plain data, and a page of CasADi makes
of it the same forward kinematics; nothing here imports pinocchio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import real_array
from spm_pin.nlp.loop_equations import vector

__all__ = ["Joint", "forward_kinematics", "joint_space_closure"]

KINDS = ("revolute", "prismatic", "fixed")
_UNIT = 1e-9


@dataclass(frozen=True)
class Joint:
    """One joint of a tree, or a frame fixed to one.

    Parameters
    ----------
    name : str
        Its name, unique in the tree.
    parent : str, optional
        The joint that carries it; None for the world.
    rotation : array_like, shape (3, 3)
        From the joint's frame at zero to the parent's.
    translation : array_like, shape (3,)
        The joint's origin in the parent's frame [m].
    kind : str
        "revolute", "prismatic" or "fixed".
    axis : array_like, shape (3,)
        Unit axis in the joint's frame; of no meaning where fixed.

    Raises
    ------
    ArgumentError
        If a shape, the kind or the axis' length is wrong.
    """

    name: str
    parent: str | None
    rotation: npt.ArrayLike
    translation: npt.ArrayLike
    kind: str
    axis: npt.ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ArgumentError("kind", f"one of {', '.join(KINDS)} for {self.name}", self.kind)
        for field, shape, meaning in (
            ("rotation", (3, 3), "a rotation"),
            ("translation", (3,), "a position in metres"),
            ("axis", (3,), "a unit axis"),
        ):
            array = real_array(getattr(self, field), field, shape, f"{meaning} of {self.name}")
            if array.shape != shape:
                raise ArgumentError(field, f"shape {shape} for {self.name}", array.shape)
        length = float(np.linalg.norm(np.asarray(self.axis)))
        if self.kind != "fixed" and abs(length - 1.0) > _UNIT:
            raise ArgumentError("axis", f"a unit vector for {self.name}", f"length {length}")


def forward_kinematics(joints: Sequence[Joint], frames: Sequence[str] | None = None) -> ca.Function:
    """Make the forward kinematics of a tree of joints.

    Parameters
    ----------
    joints : sequence of Joint
        Parents before their children. Those that move are the entries of q, in this order.
    frames : sequence of str, optional
        Joints whose frames are wanted; all if not given.

    Returns
    -------
    casadi.Function
        ``forward_kinematics(q) -> rotation_0, translation_0, rotation_1, …``: for each frame the rotation (3, 3)
        to the world and its origin there (3,) [m]. q in radians and metres.

    Raises
    ------
    ArgumentError
        If a name is unknown or given twice, or a parent comes after its child.
    """
    q, poses = _poses(joints)
    wanted = list(poses) if frames is None else list(frames)
    for name in wanted:
        _known(name, poses, "frames")
    outputs = [part for name in wanted for part in poses[name]]
    names = [f"{what}_{k}" for k in range(len(wanted)) for what in ("rotation", "translation")]
    return ca.Function("forward_kinematics", [q], outputs, ["q"], names)


def joint_space_closure(
    joints: Sequence[Joint], closures: Sequence[tuple[str, str]], platform: str, *, length: float = 1.0
) -> ca.Function:
    """Make the loop equations in joint space: closed loops, and the platform in a given pose.

    Parameters
    ----------
    joints : sequence of Joint
        As for `forward_kinematics`.
    closures : sequence of pairs of str
        Frames whose origins coincide.
    platform : str
        The frame that takes the pose.
    length : float
        Makes errors of the rotation a length [m]; the middle side d is of the right order.

    Returns
    -------
    casadi.Function
        ``joint_space_closure(q, rotation, translation) -> residual, jacobian``: for n closures 3n gaps, three
        errors of the platform's position and three of its rotation [m], and their Jacobian with respect to q.
        For this manipulator there are as many equations as joints, 18. The rotation's error is the axial part of
        R_platform Rᵀ, zero also at a half turn: a solution counts if its rotation is the one asked for.

    Raises
    ------
    ArgumentError
        As for `forward_kinematics`.
    """
    q, poses = _poses(joints)
    rotation, translation = ca.SX.sym("R", 3, 3), ca.SX.sym("o", 3)
    gaps = []
    for first, second in closures:
        _known(first, poses, "closures")
        _known(second, poses, "closures")
        gaps.append(poses[second][1] - poses[first][1])
    _known(platform, poses, "platform")
    reached, position = poses[platform]
    turn = reached @ rotation.T
    error = ca.inv_skew(turn - turn.T) / 2.0
    residual = ca.vertcat(*gaps, position - translation, length * error)
    return ca.Function(
        "joint_space_closure",
        [q, rotation, translation],
        [residual, ca.densify(ca.jacobian(residual, q))],
        ["q", "rotation", "translation"],
        ["residual", "jacobian"],
    )


def _poses(joints: Sequence[Joint]) -> tuple[ca.SX, dict[str, tuple[ca.SX, ca.SX]]]:
    moving = [joint.name for joint in joints if joint.kind != "fixed"]
    q = ca.SX.sym("q", len(moving))
    poses: dict[str, tuple[ca.SX, ca.SX]] = {}
    for joint in joints:
        if joint.name in poses:
            raise ArgumentError("joints", "each name once", f"{joint.name} twice")
        rotation, translation = ca.SX.eye(3), ca.SX.zeros(3)
        if joint.parent is not None:
            _known(joint.parent, poses, "joints", "A parent comes before its children")
            rotation, translation = poses[joint.parent]
        translation = translation + rotation @ vector(joint.translation)
        rotation = rotation @ vector(joint.rotation)
        if joint.kind == "revolute":
            rotation = rotation @ _turned(vector(joint.axis), q[moving.index(joint.name)])
        elif joint.kind == "prismatic":
            translation = translation + rotation @ vector(joint.axis) * q[moving.index(joint.name)]
        poses[joint.name] = rotation, translation
    return q, poses


def _turned(axis: ca.DM, angle: ca.SX) -> ca.SX:
    """Return the rotation about a unit axis, by Rodrigues' formula."""
    cross = ca.skew(axis)
    return ca.DM.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def _known(name: str, poses: dict[str, tuple[ca.SX, ca.SX]], argument: str, cause: str = "") -> None:
    if name not in poses:
        raise ArgumentError(
            argument, f"names of the tree, such as {', '.join(list(poses)[:3]) or 'none yet'}", name, cause
        )
