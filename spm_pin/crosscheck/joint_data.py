"""From Pinocchio's model to the plain data that the joint-space loop equations take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.nlp.joint_space import Joint

__all__ = ["joint_data"]

_AXES: dict[str, npt.ArrayLike] = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def joint_data(model: Any, frames: Sequence[str] = ()) -> list[Joint]:
    """Return the joints of a Pinocchio model as data for `spm_pin.nlp.forward_kinematics`.

    Parameters
    ----------
    model : pinocchio.Model
        A model of revolute and prismatic joints.
    frames : sequence of str
        Names of frames to add behind the joints.

    Returns
    -------
    list of spm_pin.nlp.Joint
        In the order of q.

    Raises
    ------
    ArgumentError
        If a joint is of another kind, or a frame does not exist.
    """
    names = [None, *list(model.names)[1:]]
    found: list[Joint] = []
    for index in range(1, model.njoints):
        own = model.joints[index]
        kind = own.shortname().removeprefix("JointModel")
        if kind[1:] in _AXES:
            axis = _AXES[kind[1:]]
        elif kind in ("RevoluteUnaligned", "PrismaticUnaligned"):
            axis = own.extract().axis
        else:
            raise ArgumentError("model", "revolute and prismatic joints", f"{own.shortname()} {names[index]}")
        placement = model.jointPlacements[index]
        moves = "revolute" if kind[0] == "R" else "prismatic"
        parent = names[model.parents[index]]
        found.append(Joint(names[index], parent, placement.rotation, placement.translation, moves, axis))
    for name in frames:
        if not model.existFrame(name):
            raise ArgumentError("frames", "frames of the model", name)
        frame = model.frames[model.getFrameId(name)]
        parent = names[frame.parentJoint]
        found.append(Joint(name, parent, frame.placement.rotation, frame.placement.translation, "fixed"))
    return found
