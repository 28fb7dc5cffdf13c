"""One client's session: its model, its scene, its panel, and what happens between them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.display.viewer.event_queue import EventQueue
from spm_pin.display.viewer.panel import Panel
from spm_pin.display.viewer.playback import Player
from spm_pin.display.viewer.recording import Playback, Recording
from spm_pin.display.viewer.robot_meshes import Robot
from spm_pin.display.viewer.robot_scene import RobotScene
from spm_pin.display.viewer.state import Drive, Model, State
from spm_pin.display.viewer.state_export import json_text
from spm_pin.display.viewer.workspace_layer import WorkspaceLayer
from spm_pin.errors import SpmError
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.pose import pose as make_pose

__all__ = ["Session", "SessionConfig"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SessionConfig:
    """The data that all sessions of a viewer share; read-only.

    Attributes
    ----------
    robot : Robot
        The manipulator's meshes.
    start : Configuration
        The state at first.
    workspace : WorkspaceLayer
        Its workspace.
    recording : Recording or None
        A path to play.
    geometry_file : Path or None
        Where the geometry came from, for the exported command.
    dark : bool
        Whether pages are dark at first.
    """

    robot: Robot
    start: Configuration
    workspace: WorkspaceLayer
    recording: Recording | None = None
    geometry_file: Path | None = None
    dark: bool = False


class Session:
    """One client's state, scene, panel and events. Nothing of it is shared with another client.

    Parameters
    ----------
    client : viser.ClientHandle
        The page.
    config : SessionConfig
        What it begins with.
    loop : asyncio.AbstractEventLoop
        The server's event loop.
    """

    def __init__(self, client: Any, config: SessionConfig, loop: asyncio.AbstractEventLoop) -> None:
        self.client = client
        self._loop = loop
        self.config = config
        self.model = Model(config.start)
        self.queue = EventQueue(self._failed)
        self._asked = self._coordinates()
        self._legs = self.model.state.readings.leg_lengths.copy()
        robot = config.robot
        duration = None
        if config.recording is not None:
            duration = float(config.recording.times[-1])
        limited = robot.geometry.limits is not None
        self.scene = RobotScene(client.scene, robot, self._ghost_clicked)
        self.panel = Panel(client.gui, robot.geometry, self.report, dark=config.dark, duration=duration, clouds=limited)
        self.playback: Playback | None = None
        self.player = Player(self.queue, self._show_frame, duration) if duration is not None else None
        self.gizmo = client.scene.add_transform_controls(
            "/gizmo", scale=0.75 * self.scene.size, line_width=3.0, depth_test=False, opacity=0.9
        )
        self.gizmo.on_update(self._gizmo_moved)
        self.show()
        self.look()

    @property
    def state(self) -> State:
        """What is shown."""
        return self.model.state

    def look(self) -> None:
        """Place the camera so that the robot fills what the panel leaves of the page."""
        camera, shown = self.client.camera, self.config.start
        height = float(shown.translation[2]) + 0.5 * self.scene.size
        narrow = camera.image_height > 1.1 * camera.image_width
        # On a phone the panel is a sheet over the lower part; elsewhere it stands on the right.
        away, lift = (2.9, -0.45) if narrow else (1.5, 0.47)
        direction = np.array([np.cos(np.deg2rad(-60.0)), np.sin(np.deg2rad(-60.0)), 0.32])
        centre = np.array([*(0.5 * shown.translation[:2]), lift * height])
        right = np.array([-direction[1], direction[0], 0.0])
        centre += (0.0 if narrow else 0.22) * height * right
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.position = centre + away * height * direction
        camera.look_at = centre

    async def report(self, name: str, value: Any) -> None:
        """Take an event of the panel; on the event loop."""
        key = f"{name} {value[0]}" if isinstance(value, tuple) else name
        self.queue.post(key, lambda: self._act(name, value))

    async def _ghost_clicked(self, label: str) -> None:
        await self.report("branch", label)

    async def _gizmo_moved(self, event: Any) -> None:
        if event.phase != "start":
            self.queue.post("gizmo", lambda: self._act("gizmo", None))

    def _act(self, name: str, value: Any) -> None:
        """Do what an event asks for; in the session's worker."""
        action: Callable[[Any], None] = getattr(self, f"_on_{name}")
        action(value)

    def close(self) -> None:
        """End: nothing of the session runs any longer; on the event loop."""
        self.queue.close()
        if self.player is not None:
            self.player.stop()

    def _failed(self, error: Exception) -> None:
        if self.queue.closed:
            return
        if isinstance(error, SpmError):
            self.client.add_notification("Not possible", str(error), color="orange", auto_close_seconds=8.0)
        else:
            _log.error("an event of the page failed", exc_info=error)

    def show(self, moved: str = "") -> None:
        """Bring the page up to date; `moved` names the sliders that are in the user's hands."""
        state, robot = self.state, self.config.robot
        with self.client.atomic():
            self.scene.show(state)
            self.panel.show(state, robot.q(state.shown), self.config.geometry_file, moved=moved)
            if moved != "gizmo":
                self.gizmo.position = state.target.translation
                self.gizmo.wxyz = state.target.rotation.as_quat(scalar_first=True)
            if moved != "coordinate":
                self._asked = self._coordinates()
            if moved != "leg":
                self._legs = state.readings.leg_lengths.copy()

    def _coordinates(self) -> list[float]:
        target = self.model.state.target
        angles = target.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)
        return [*target.translation, *angles]

    # One method per event, named after it.

    def _on_gizmo(self, _: None) -> None:
        rotation = Rotation.from_quat(self.gizmo.wxyz, scalar_first=True)
        self.model.drag(make_pose(self.gizmo.position, rotation=rotation))
        self.show("gizmo")

    def _on_coordinate(self, value: tuple[int, float]) -> None:
        self._asked[value[0]] = value[1]
        self.model.drag(make_pose(self._asked[:3], xyx=np.deg2rad(self._asked[3:])))
        self.show("coordinate")

    def _on_leg(self, value: tuple[int, float]) -> None:
        self._legs[value[0]] = value[1]
        self.model.set_legs(self._legs)
        self.show("leg")

    def _on_branch(self, label: str) -> None:
        if label in self.state.labels and label != self.state.label:
            self.model.select(label)
            self.show()

    def _on_drive(self, drive: Drive) -> None:
        self.panel.show_drive(drive)
        self.gizmo.visible = drive is Drive.POSE
        if drive is Drive.LEGS:
            self.model.set_legs(self.state.shown.leg_lengths)
        self.show()

    def _on_hold(self, hold: bool) -> None:
        self.model.hold_limits = hold
        if self.state.drive is Drive.POSE:
            self.model.drag(self.state.target)
        self.show()

    def _on_reset(self, _: None) -> None:
        self.model.place(self.config.start)
        self.show()

    def _on_load(self, _: Any) -> None:
        self.model.load(self.panel.wrench)
        self.show()

    def _on_ghosts(self, shown: bool) -> None:
        self.scene.show_ghosts = shown
        self.scene.show(self.state)

    def _on_labels(self, shown: bool) -> None:
        self.scene.show_labels = shown
        self.scene.show(self.state)

    def _on_gizmo_shown(self, shown: bool) -> None:
        self.gizmo.visible = shown

    def _on_dark(self, dark: bool) -> None:
        self.panel.theme(dark)

    def _on_shell(self, shown: bool) -> None:
        self.config.workspace.show_shell(self.client.scene, shown)

    def _on_points(self, shown: bool) -> None:
        self.config.workspace.show_points(self.client.scene, shown)

    def _on_play(self, _: None) -> None:
        assert self.player is not None
        self._follow_path()
        self._loop.call_soon_threadsafe(self.player.toggle)

    def _on_time(self, time: float) -> None:
        assert self.player is not None
        self._follow_path()
        self.player.time = time
        self._show_frame(time, moved=True)

    def _follow_path(self) -> None:
        """Follow the branch that is shown, if it is real where the path begins, else the physical one."""
        recording, panel = self.config.recording, self.panel
        if recording is None or self.playback is not None:
            return
        panel.show_path("Following the branch along the path …")
        # A path of leg lengths begins in an assembly mode, which has other names; the nearest is meant.
        start = self.state.shown if isinstance(recording.points, np.ndarray) else (self.state.label or None)
        try:
            self.playback = recording.follow_from(self.model.geometry, start)
        except SpmError as error:
            panel.show_path(f"⚠ {error}")
            raise
        self.scene.show_path(self.playback.path.configurations.translation)

    def _show_frame(self, time: float, moved: bool = False) -> None:
        if self.playback is None:
            return
        configuration, _ = self.playback.at(time)
        self.model.place(configuration)
        self.show()
        if not moved:
            self.panel.time.value = time
        self.panel.show_path(*self.playback.report(time))

    def _on_json(self, _: None) -> None:
        text = json_text(self.state, self.config.robot, self.config.geometry_file)
        self.client.send_file_download("spm_pin_state.json", text.encode(), save_immediately=True)

    def _on_snapshot(self, _: None) -> None:
        from spm_pin.display.viewer.snapshot import snapshot_html

        page = snapshot_html(self.state, self.config.robot, geometry_file=self.config.geometry_file)
        self.client.send_file_download("spm_pin.html", page.encode(), save_immediately=True)
