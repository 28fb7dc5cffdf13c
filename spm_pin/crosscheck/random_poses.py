"""Random poses for comparisons, made without any of the methods compared."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.mechanism import Geometry, LegLimits, pose
from spm_pin.mechanism.arguments import BoolArray, FloatArray, check_instance, generator, whole_number
from spm_pin.mechanism.legs import triangle_frames
from spm_pin.mechanism.pose import homogeneous

_STEPS = 30
"""Steps of Newton's method for each stage."""


def in_leg_space(geometry: Geometry, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) by leg lengths uniform within the limits, on the side of the symmetric home.

    Each stage is a 3RPS of its own: its three lengths, three leg planes and three sides fix its ball joints, by
    Newton's method from the level position. The two stages are then joined at the middle platform. Without
    limits, lengths are drawn within 15 % of those at a height of d.
    """
    count, rng = _checked(geometry, count, rng)
    limits = geometry.limits or _around_home(geometry)
    matrices: list[FloatArray] = []
    while len(matrices) < count:
        lengths = rng.uniform(limits.minimum, limits.maximum, (2 * (count - len(matrices)) + 4, 6))
        lower, closed_lower = _stage(geometry, geometry.base_radius, lengths[:, :3], 1.0)
        # Seen from {m} the middle platform hangs below.
        upper, closed_upper = _stage(geometry, geometry.platform_radius, lengths[:, 3:], -1.0)
        both = closed_lower & closed_upper
        below, above = (homogeneous(triangle_frames(b), b.mean(axis=1)) for b in (lower[both], upper[both]))
        matrices.extend(below @ np.linalg.inv(above))
    return RigidTransform.from_matrix(np.array(matrices[:count]).reshape(-1, 4, 4))


def on_all_rotations(geometry: Geometry, count: int, rng: np.random.Generator | int) -> RigidTransform:
    """Draw poses (count,) with rotations uniform on SO(3), near enough to the axis that about half have branches."""
    count, rng = _checked(geometry, count, rng)
    far = 1.5 * geometry.middle_radius * np.sqrt(rng.uniform(size=count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    height = rng.uniform(-3.0, 3.0, count) * geometry.middle_side
    position = np.stack([far * np.cos(azimuth), far * np.sin(azimuth), height], axis=-1)
    return pose(position, rotation=Rotation.random(count, rng=rng))


def _checked(geometry: Geometry, count: int, rng: np.random.Generator | int) -> tuple[int, np.random.Generator]:
    check_instance(geometry, Geometry, "geometry")
    return whole_number(count, "count", "a number of poses up to 10⁹", most=10**9), generator(rng)


def printable(poses: RigidTransform) -> tuple[RigidTransform, FloatArray, FloatArray]:
    """Return poses (N,) that the command line reproduces to the last bit, equal to those given up to rounding.

    And the numbers to type: translations (N, 3) [m], and X-Y-X Euler angles (N, 3) in degrees.
    """
    translation = np.asarray(poses.translation)
    xyx = np.asarray(poses.rotation.as_euler("XYX", degrees=True))
    return pose(translation, xyx=np.deg2rad(xyx)), translation, xyx


def _around_home(geometry: Geometry) -> LegLimits:
    def pair(radius: float) -> tuple[float, float]:
        home = math.hypot(geometry.middle_side, radius - geometry.middle_radius)
        return 0.85 * home, 1.15 * home

    return LegLimits.stages(pair(geometry.base_radius), pair(geometry.platform_radius))


def _stage(geometry: Geometry, radius: float, lengths: FloatArray, side: float) -> tuple[FloatArray, BoolArray]:
    """Return ball joints (n, 3, 3) [m] of stages with leg lengths (n, 3) [m], and whether Newton's method converged."""
    axes, radial, d = geometry.revolute_axes, geometry.radial_directions, geometry.middle_side
    bases = radius * radial
    mean = np.sqrt((lengths**2).mean(axis=-1))
    rise = np.sqrt(np.maximum(mean**2 - (radius - geometry.middle_radius) ** 2, (0.1 * d) ** 2))
    b = geometry.middle_radius * radial + side * rise[:, None, None] * np.array([0.0, 0.0, 1.0])
    error = np.full((len(b), 9), np.inf)
    i, following = np.array([0, 1, 2]), np.array([1, 2, 0])
    for _ in range(_STEPS):
        leg, between = b - bases, b - b[:, following]
        off_plane = np.stack([joint @ axis for joint, axis in zip(b.swapaxes(0, 1), axes, strict=True)], axis=-1)
        too_long = ((leg**2).sum(axis=-1) - lengths**2) / (2.0 * d)
        too_far = ((between**2).sum(axis=-1) - d**2) / (2.0 * d)
        error = np.concatenate([np.stack([off_plane, too_long], axis=-1).reshape(-1, 6), too_far], axis=-1)
        derivatives = np.zeros((len(b), 9, 3, 3))
        derivatives[:, 2 * i, i], derivatives[:, 2 * i + 1, i] = axes, leg / d
        derivatives[:, 6 + i, i], derivatives[:, 6 + i, following] = between / d, -between / d
        jacobian = derivatives.reshape(-1, 9, 9)
        regular = np.abs(np.linalg.det(jacobian)) > 0.0
        jacobian = np.where(regular[:, None, None], jacobian, np.eye(9))
        b = b - np.linalg.solve(jacobian, error[..., None])[..., 0].reshape(-1, 3, 3)
    closed = (np.abs(error).max(axis=-1) < 1e-12 * d) & (side * b[..., 2].mean(axis=-1) > 0.0)
    return b, closed
