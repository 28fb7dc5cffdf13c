"""The data that all sessions of a viewer share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spm_pin.display.viewer.recording import Playback, Recording
from spm_pin.display.viewer.robot_meshes import RobotMeshes
from spm_pin.display.viewer.workspace_layer import WorkspaceLayer
from spm_pin.mechanism.configuration import Configuration
from spm_pin.multibody.chain import ClosedChain

__all__ = ["SessionConfig"]


@dataclass(frozen=True)
class SessionConfig:
    """The data that all sessions of a viewer share; read-only. Options are those of `Viewer`."""

    chain: ClosedChain
    """The manipulator in Pinocchio, for its joint values."""
    robot: RobotMeshes
    start: Configuration
    """The state at first."""
    workspace: WorkspaceLayer
    recording: Recording | None = None
    demo: Playback | None = None
    """The motion that a page begins with."""
    geometry_file: Path | None = None
    dark: bool = False
