"""Reactions of the legs' joints to a wrench onto the platform: axial loads, bending moments, forces in the balls.

A leg without weight carries a force through its ball that lies in the plane of its direction and its revolute axis: the
actuator's force along the leg, and s along the axis, which the structure carries. At the pivot, s is an axial load of
the revolute joint, and with the leg's length as lever the moment r s bends its bearing and the leg.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spm_pin.kinematics.rates_and_forces import stage_inverses
from spm_pin.mechanism import Configuration
from spm_pin.mechanism.arguments import FloatArray

_DIRECTIONS = 8
"""Directions of half a turn in which the force of a ball is looked at: its size is then known to 2 %."""


class JointReactions(NamedTuple):
    """Rows that multiply a wrench (f, m) at o in {B} [N, N m]; for `Polytope.within`, or ``rows @ wrench``."""

    axial: FloatArray
    """Force of the leg onto what it carries along its revolute axis `leg_axes`, of the six legs, shape (..., 6, 6)."""
    bending: FloatArray
    """Moment at the pivot of the six legs, about the direction of the leg x its axis [N m], shape (..., 6, 6)."""
    ball: FloatArray
    """Components of each ball's force in eight directions, over cos(π/16), shape (..., 48, 6), leg by leg: all of them
    within ±F guarantee a resultant of at most F, and a resultant of at most 0.98 F keeps them within it."""


def joint_reactions(configuration: Configuration) -> JointReactions:
    """Return the reactions at the ball and revolute joints to a wrench onto the terminal platform.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).

    Returns
    -------
    JointReactions
        Weights and friction are left out, the structure is rigid. NaN for a member that does not exist.

    Raises
    ------
    SingularConfigurationError
        At a forward or a constraint singularity, where the legs do not hold the platform.
    """
    rows = -np.swapaxes(stage_inverses(configuration), -1, -2)
    shape = rows.shape[:-3]
    along, axial = (rows[..., k, :].reshape(*shape, 6, 6) for k in (slice(3), slice(3, 6)))
    angles = np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    ball = np.cos(angles) * along[..., None, :] + np.sin(angles) * axial[..., None, :]
    bending = configuration.leg_lengths[..., None] * axial
    return JointReactions(axial, bending, ball.reshape(*shape, -1, 6) / np.cos(0.5 * np.pi / _DIRECTIONS))
