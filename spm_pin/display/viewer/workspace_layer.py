"""What is reached: the paper's shell and points in a scene, and the ranges of the sliders around a state."""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.display.viewer.model import pose_coordinates
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.path_following import physical_mode_share
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.joint_angles import home_lengths
from spm_pin.workspace.paper_shell import workspace_shell

_NEIGHBOURS = 400
"""Sampled states, those nearest to the one shown, whose coordinates a slider spans."""
_STEPS = 48
_SAMPLES = 4000
_RESOLUTION = 14
_COLOUR = (86, 180, 233)


class WorkspaceLayer:
    """The workspace of a manipulator, computed once for all sessions, when it is first used."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self._lock = threading.Lock()

    @cached_property
    def states(self) -> Configuration:
        """Physical states (n,) for leg lengths spread evenly over their limits, always the same.

        Without limits the lengths are those at home, a third more or less.
        """
        home, limits = np.repeat(home_lengths(self.geometry), 3), self.geometry.limits
        low, high = home / 1.33, home * 1.33
        if limits is not None:
            low, high = np.maximum(limits.minimum, 0.3 * home), np.minimum(limits.maximum, 3.0 * home)
        lengths = np.random.default_rng(0).uniform(low, np.maximum(low, high), (_SAMPLES, 6))
        states = forward_physical(self.geometry, lengths)
        return states[states.exists]

    @cached_property
    def shell(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """Vertices [m] and faces of `workspace_shell`, coarse enough to be sent to a page."""
        limits = self.geometry.limits
        if limits is None or not np.isfinite(limits.maximum).all():
            raise ArgumentError("geometry", "leg limits, which make a workspace", "none")
        shell = workspace_shell(self.geometry, resolution=_RESOLUTION)
        return np.asarray(shell.vertices, np.float32), np.asarray(shell.faces, np.uint32)

    def show(self, scene: Any, layer: str, shown: bool) -> None:
        """Add the positions of o of the states, "points", or the "shell" to a viser scene, or remove them."""
        name = f"/{layer}"
        if not shown:
            scene.remove_by_name(name)
        elif layer == "points":
            points = np.asarray(self.states.translation, np.float32)
            scene.add_point_cloud(name, points, colors=_COLOUR, point_size=0.008, point_shape="circle")
        else:
            with self._lock:
                vertices, faces = self.shell
            scene.add_mesh_simple(name, vertices, faces, color=_COLOUR, opacity=0.25, side="double", cast_shadow=False)


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
    """Return the least and the largest reading of each leg (6, 2) [m]: its limits, or as far as the mode lasts."""
    geometry, now = configuration.geometry, np.array(configuration.readings)
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
