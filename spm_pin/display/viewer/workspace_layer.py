"""The workspace in a scene: the paper's shell, and points that are reached."""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.leg_frames import home_lengths
from spm_pin.workspace.paper_shell import workspace_shell

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
