"""The workspace in a scene: the paper's shell, and points that are reached."""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.display.viewer.slider_ranges import sample_states
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.workspace.table_6.shell import workspace_shell

__all__ = ["WorkspaceLayer"]

_RESOLUTION = 14
_COLOUR = (86, 180, 233)


class WorkspaceLayer:
    """The workspace of a manipulator, computed once for all sessions, when it is first used."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self._lock = threading.Lock()

    @cached_property
    def states(self) -> Configuration:
        """States (n,) that are reached; see `sample_states`."""
        return sample_states(self.geometry)

    @cached_property
    def shell(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """Vertices [m] and faces of `workspace_shell`, coarse enough to be sent to a page."""
        limits = self.geometry.limits
        if limits is None or not np.isfinite(limits.maximum).all():
            raise ArgumentError("geometry", "leg limits, which make a workspace", "none")
        shell = workspace_shell(self.geometry, resolution=_RESOLUTION)
        return np.asarray(shell.vertices, np.float32), np.asarray(shell.faces, np.uint32)

    def show_points(self, scene: Any, shown: bool) -> None:
        """Add the positions of o of the states to a viser scene, or remove them."""
        if not shown:
            scene.remove_by_name("/points")
            return
        points = np.asarray(self.states.translation, np.float32)
        scene.add_point_cloud("/points", points, colors=_COLOUR, point_size=0.008, point_shape="circle")

    def show_shell(self, scene: Any, shown: bool) -> None:
        """Add the shell to a viser scene, or remove it."""
        if not shown:
            scene.remove_by_name("/shell")
            return
        with self._lock:
            vertices, faces = self.shell
        scene.add_mesh_simple("/shell", vertices, faces, color=_COLOUR, opacity=0.25, side="double", cast_shadow=False)
