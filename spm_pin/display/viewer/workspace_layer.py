"""The workspace as something to look at: the paper's shell, and points that are reached."""

from __future__ import annotations

import threading
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.geometry import Geometry
from spm_pin.workspace.table_6.shell import workspace_shell

__all__ = ["WorkspaceLayer"]

_POINTS = 4000
_RESOLUTION = 14


class WorkspaceLayer:
    """The workspace of a manipulator with leg limits, computed once for all sessions and not before it is asked for."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        self._lock = threading.Lock()

    @cached_property
    def points(self) -> npt.NDArray[np.float32]:
        """Positions of o [m] for leg lengths spread evenly over their limits, (n, 3)."""
        limits = self._limits()
        lengths = np.random.default_rng(0).uniform(limits.minimum, limits.maximum, (_POINTS, 6))
        states = forward_physical(self.geometry, lengths)
        return np.asarray(states.translation[states.exists], np.float32)

    @cached_property
    def shell(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
        """Vertices [m] and faces of `workspace_shell`, coarse enough to be sent to a page."""
        self._limits()
        shell = workspace_shell(self.geometry, resolution=_RESOLUTION)
        return np.asarray(shell.vertices, np.float32), np.asarray(shell.faces, np.uint32)

    def _limits(self) -> Any:
        limits = self.geometry.limits
        if limits is None or not np.isfinite(limits.maximum).all():
            raise ArgumentError("geometry", "leg limits, which make a workspace", "none")
        return limits

    def show_points(self, scene: Any, shown: bool) -> None:
        """Add the points to a viser scene, or remove them."""
        if not shown:
            scene.remove_by_name("/points")
            return
        with self._lock:
            points = self.points
        scene.add_point_cloud("/points", points, colors=(86, 180, 233), point_size=0.008, point_shape="circle")

    def show_shell(self, scene: Any, shown: bool) -> None:
        """Add the shell to a viser scene, or remove it."""
        if not shown:
            scene.remove_by_name("/shell")
            return
        with self._lock:
            vertices, faces = self.shell
        scene.add_mesh_simple(
            "/shell", vertices, faces, color=(86, 180, 233), opacity=0.25, side="double", cast_shadow=False
        )
