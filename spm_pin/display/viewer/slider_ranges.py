"""Ranges of the sliders: coordinates and leg lengths of reachable states around the one that is shown."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.kinematics.path_following import physical_mode_share
from spm_pin.mechanism import Configuration
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import physical

_NEIGHBOURS = 400
"""Sampled states, those nearest to the one shown, whose coordinates a slider spans."""
_STEPS = 48


def pose_coordinates(pose: RigidTransform) -> FloatArray:
    """Return x, y, z [m] and the X-Y-X angles [degrees] of poses (..., 6)."""
    angles = pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)
    return np.concatenate([pose.translation, angles], axis=-1) + 0.0


def pose_ranges(states: Configuration, target: RigidTransform) -> FloatArray:
    """Return the least and the largest coordinates of those states of (n,) that are nearest to a pose, (6, 2).

    x, y, z [m] and the X-Y-X angles [degrees], those around the pose's own.
    """
    now = pose_coordinates(target)
    gaps = np.linalg.norm(states.platform_joints - target.apply(states.geometry.platform_joints), axis=-1).max(axis=-1)
    nearest = states.pose[np.argsort(gaps)[:_NEIGHBOURS]] if len(gaps) else target
    steps = np.atleast_2d(pose_coordinates(nearest) - now)
    steps[:, 3:] = (steps[:, 3:] + 180.0) % 360.0 - 180.0
    ends = now + np.stack([steps.min(axis=0, initial=0.0), steps.max(axis=0, initial=0.0)])
    ends[:, 3:] = np.clip(ends[:, 3:], -180.0, 180.0)
    return np.asarray(ends.T)


def leg_ranges(configuration: Configuration) -> FloatArray:
    """Return the least and the largest length of each leg (6, 2) [m]: its limits, or as far as the mode lasts."""
    geometry, now = configuration.geometry, np.array(configuration.leg_lengths)
    longest = 3.0 * (geometry.base_radius + geometry.platform_radius + geometry.middle_side)
    low, high = np.full(6, 0.05 * geometry.middle_side), np.full(6, longest)
    limits = geometry.limits
    if limits is not None:
        low, high = np.maximum(low, limits.minimum), np.minimum(high, limits.maximum)
    low, high = np.minimum(low, now), np.maximum(high, now)
    if physical(configuration) and (limits is None or not np.isfinite(limits.maximum).all()):
        for ends in (low, high):
            shares = physical_mode_share(geometry, now, now + np.diag(ends - now), parts=_STEPS, rounds=1)
            ends[:] = now + shares * (ends - now)
    return np.stack([low, high], axis=-1)
