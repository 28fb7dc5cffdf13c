"""Rates, forces and singularities of machines as built, from the 6 x 6 matrices of forces through their six balls.

The equations are those of `spm_pin.kinematics.jacobians`. The two balls at a corner need not coincide, so the
determinants have no short form, and the matrices are decomposed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spm_pin.kinematics.stage_wrenches import SINGULAR, StageWrenches, regular_wrenches, stage_inverses
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration

# States that do not exist are NaN throughout.
_ABSENT = np.errstate(invalid="ignore")


@_ABSENT
def as_built_inverse_jacobian(configuration: Configuration) -> FloatArray:
    """Return J_f (..., 6, 6); see `inverse_jacobian`."""
    wrenches = regular_wrenches(configuration, "inverse")
    lower, upper = wrenches.constraints[..., 0, :, :], wrenches.constraints[..., 1, :, :]
    structure = np.concatenate([lower, upper], axis=-2)
    # X = K⁻¹ [0; K_c], the twist of the middle platform for that of the terminal one.
    middle = np.linalg.inv(structure)[..., 3:] @ upper
    found = np.concatenate(
        [wrenches.legs[..., 0, :, :] @ middle, wrenches.legs[..., 1, :, :] @ (np.eye(6) - middle)], axis=-2
    )
    # Rows that take (v, dω) at the middle platform's centre p, as rows that take (v, ω) at o:
    # f · (ω x (p - o)) = ω · ((p - o) x f)
    linear = found[..., :3]
    moments = wrenches.side * found[..., 3:] + np.cross(-wrenches.lever[..., None, :], linear)
    return np.concatenate([linear, moments], axis=-1)


def as_built_platform_jacobian(configuration: Configuration) -> FloatArray:
    """Return G (..., 6, 6); see `platform_jacobian`."""
    inverses = stage_inverses(configuration)
    return np.concatenate([inverses[..., 0, :, :3], inverses[..., 1, :, :3]], axis=-1)


@_ABSENT
def as_built_determinants(configuration: Configuration) -> FloatArray:
    """Return det J_b, det J_c, det K (..., 3) [m³]; see `determinants`."""
    wrenches = StageWrenches.of(configuration, short_legs=True)
    return np.asarray(np.linalg.det(_matrices(wrenches)) * wrenches.side**3)


def as_built_singularities(configuration: Configuration, tolerance: float) -> tuple[Any, ...]:
    """Return the results of the kernel `describe_singularities`, with the leading axes of the states."""
    wrenches = StageWrenches.of(configuration)
    exists, side, lever = wrenches.exists, wrenches.side, wrenches.lever
    # LAPACK does not take NaN.
    matrices = np.where(exists[..., None, None, None], _matrices(wrenches), np.eye(6))
    absent = np.where(exists, 0.0, np.nan)[..., None]
    left, values, right = np.linalg.svd(matrices)
    rank = np.where(exists[..., None], (values > tolerance * values[..., :1]).sum(axis=-1), 0).astype(np.int8)
    structure = np.linalg.svd(
        np.where(exists[..., None, None, None], wrenches.constraints, np.eye(3, 6)), compute_uv=False
    )
    dependent = exists & (structure[..., 2] <= tolerance * structure[..., 0]).any(axis=-1)
    least = right[..., 5, :]
    angular = least[..., 3:] / side
    linear = least[..., :3] + np.cross(angular, lever[..., None, :])
    twists = np.concatenate([linear, angular], axis=-1) + absent[..., None]
    carried = (left[..., 2, None, 3:, 5] @ wrenches.constraints[..., 1, :, :])[..., 0, :]
    force = carried[..., :3]
    moment = side * carried[..., 3:] - np.cross(lever, force)
    size, couple = (np.linalg.norm(part, axis=-1, keepdims=True) for part in (force, moment))
    wrench = np.concatenate([force, moment], axis=-1) / np.where(size > SINGULAR * couple / side, size, couple)
    flags = np.stack([dependent, np.zeros_like(dependent)], axis=-1)
    volumes = np.linalg.det(matrices) * side**3 + absent
    return volumes, values[..., 0] + absent, values[..., 5] + absent, rank, flags, twists, wrench + absent


def _matrices(wrenches: StageWrenches) -> FloatArray:
    """Return J_b, J_c and K (..., 3, 6, 6)."""
    return np.concatenate([wrenches.matrices("forward"), wrenches.matrices("inverse")], axis=-3)
