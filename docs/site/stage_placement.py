"""States composed from the two stages, of the paper's dimensions: no solver of the package takes part."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from assembly_mode_changes import Array
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

GEOMETRY = spm.Geometry.paper()
SAMPLES = 50
"""States of each family or stratum."""


def quaternion(mode: str, azimuth: npt.ArrayLike, half_tilt: npt.ArrayLike) -> Array:
    """Return the middle platform's quaternion (..., 4) in a stage, scalar last, from its tilt's axis and half angle."""
    azimuth, half_tilt = np.broadcast_arrays(azimuth, half_tilt)
    zero, rest = np.zeros(azimuth.shape), np.cos(half_tilt)
    tilted = np.sin(half_tilt) * np.cos(azimuth), np.sin(half_tilt) * np.sin(azimuth)
    return np.stack([*tilted, *((zero, rest) if mode == "T" else (rest, zero))], axis=-1)


def compose(quaternions: Array, heights: Array) -> spm.Configuration:
    """Return the configurations (...) of two stages: quaternions (..., 2, 4) and heights (..., 2) [m]."""
    joints, lower = place(quaternions[..., 0, :], heights[..., 0])
    _, upper = place(quaternions[..., 1, :], heights[..., 1])
    return spm.Configuration(GEOMETRY, lower * upper.inv(), joints)


def place(turned: Array, height: Array) -> tuple[Array, RigidTransform]:
    """Return the corners (..., 3, 3) and the pose of the middle platform in one stage, at quaternions (..., 4)."""
    r, (x1, x2) = GEOMETRY.middle_radius, np.moveaxis(turned[..., :2], -1, 0)
    centre = np.stack([-2.0 * r * x1 * x2, r * (x2 * x2 - x1 * x1), height], axis=-1)
    pose = RigidTransform.from_components(centre, Rotation.from_quat(turned))
    corners = np.einsum("...ij,kj->...ki", pose.as_matrix()[..., :3, :3], r * GEOMETRY.radial_directions)
    return corners + centre[..., None, :], pose
