"""One client's session: its state, its scene, its panel, and its events, one after another."""

from __future__ import annotations

import asyncio
import logging
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.display.viewer.model import (
    State,
    ViewerModel,
    leg_ranges,
    pose_coordinates,
    pose_of_coordinates,
    pose_ranges,
    state_data,
)
from spm_pin.display.viewer.panel import Panel
from spm_pin.display.viewer.playback import Playback, Recording
from spm_pin.display.viewer.robot_scene import FIELD_OF_VIEW, VIEWS, RobotScene, fit_camera, robot_points
from spm_pin.display.writing import to_json
from spm_pin.errors import ArgumentError, SpmError
from spm_pin.mechanism import Configuration
from spm_pin.mechanism import pose as make_pose
from spm_pin.multibody.chain import ClosedChain

_log = logging.getLogger(__name__)

_MOTIONS = ("gizmo", "coordinate", "leg", "branch", "reset", "back", "time")  # events that stop a path that is played
_PHONE_ASPECT = 0.9  # a picture narrower than this share of its height is a phone's
_PHONE_PANEL = 0.55  # share of a phone's page that viser's panel covers at its lower edge; at most it is 0.6
_FARTHEST = 10.0  # distance from {B} over the machine's size, beyond which the gizmo is not followed
_INTERVAL = 1.0 / 25.0  # between two moments of a path that is played [s]


class EventQueue:
    """Runs actions one after another in a worker thread, while the event loop goes on taking messages.

    A drag sends poses faster than they can be shown: an action that waits is replaced by a later one of the same key.
    `post` and `close` belong to the event loop's thread; `on_error` takes an exception that an action raised.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: dict[str, Callable[[], Any]] = {}
        self._task: asyncio.Task[None] | None = None
        self.closed = False

    def post(self, key: str, action: Callable[[], Any]) -> None:
        """Run an action after those posted before; it replaces one of the same key that has not begun."""
        if self.closed:
            return
        self._waiting[key] = action
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._work())

    def close(self) -> None:
        """Drop waiting actions; the running one is completed."""
        self.closed = True
        self._waiting.clear()

    async def _work(self) -> None:
        try:
            while self._waiting:
                action = self._waiting.pop(next(iter(self._waiting)))
                try:
                    await asyncio.to_thread(action)
                except Exception as error:
                    self._on_error(error)
        finally:
            self._task = None


class Player:
    """Runs the time of a path from 0 to its duration [s]; all methods belong to the event loop's thread.

    `show` shows the path at a time [s], in the worker of `queue`; with `repeat` the path begins again at the end.
    """

    def __init__(
        self, queue: EventQueue, show: Callable[[float], None], duration: float, *, repeat: bool = False
    ) -> None:
        self._queue = queue
        self._show = show
        self._duration = duration
        self._repeat = repeat
        self.time = 0.0
        self._task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """True while the path is played."""
        return self._task is not None

    def stop(self) -> None:
        """Stop where it is."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def toggle(self) -> None:
        """Stop, or run on from where it is, from the beginning where it has ended."""
        if self.playing:
            self.stop()
        elif not self._queue.closed:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def _run(self) -> None:
        start = clock.perf_counter() - (self.time if self.time < self._duration else 0.0)
        while True:
            elapsed = clock.perf_counter() - start
            self.time = elapsed % self._duration if self._repeat else min(elapsed, self._duration)
            self._queue.post("frame", partial(self._show, self.time))
            if elapsed >= self._duration and not self._repeat:
                break
            await asyncio.sleep(_INTERVAL)
        self._task = None


@dataclass(frozen=True)
class SessionConfig:
    """The data that all sessions of a viewer share; options are those of `Viewer`."""

    chain: ClosedChain  # the manipulator in Pinocchio, for its joint values
    start: Configuration  # the state at first
    recording: Recording | None = None  # the recorded path that can be played
    demo: Playback | None = None  # the motion that a page begins with
    geometry_file: Path | None = None
    dark: bool = False


class Session:
    """One client's state, scene, panel and events, on the server's event loop; none is shared with another client."""

    def __init__(self, client: Any, config: SessionConfig, loop: asyncio.AbstractEventLoop) -> None:
        self.client = client
        self.config = config
        self._loop = loop
        self.model = ViewerModel(config.start)
        self.queue = EventQueue(self._failed)
        self._coordinates = pose_coordinates(config.start.pose)
        self._legs = np.array(self.state.shown.readings)
        self._narrow = client.camera.image_width < _PHONE_ASPECT * client.camera.image_height
        self.playback = config.demo
        duration = None if config.recording is None else float(config.recording.times[-1])
        self.player: Player | None = None
        if duration is not None:
            self.player = Player(self.queue, self._show_frame, duration)
        elif config.demo is not None:
            self.player = Player(self.queue, self._show_frame, config.demo.duration, repeat=True)
        self.scene = RobotScene(client.scene, self.model.geometry, partial(self.report, "branch"))
        self.panel = Panel(
            client.gui,
            self.model.geometry,
            self.report,
            dark=config.dark,
            duration=duration,
            demo=config.demo is not None,
            narrow=self._narrow,
        )
        self.gizmo = client.scene.add_transform_controls(
            "/gizmo", scale=1.1 * self.scene.size, line_width=3.0, depth_test=False, opacity=0.9
        )
        self.gizmo.on_update(self._gizmo_moved)
        self.show()
        self.look("Home")
        client.camera.on_update(self._camera_moved)

    @property
    def state(self) -> State:
        """The state that is shown."""
        return self.model.state

    def begin(self) -> None:
        """Play the recorded path from its start, or the demo motion; on the event loop."""
        if self.player is not None:
            self.queue.post("play", partial(self._on_play, None))

    def look(self, view: str) -> None:
        """Place the camera so that the robot fills the picture; see `VIEWS`."""
        camera = self.client.camera
        size = camera.image_width, camera.image_height
        points = robot_points(self.state.shown, 0.3 * self.scene.size)
        covered = _PHONE_PANEL if self._narrow else 0.0
        position, look_at = fit_camera(points, VIEWS[view], size[0] / size[1], covered)
        self._fitted = view, size, position
        with self.client.atomic():
            camera.fov = FIELD_OF_VIEW
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position = position
            camera.look_at = look_at

    async def _camera_moved(self, camera: Any) -> None:
        """Fit the robot into a picture of another size, unless the user has moved the camera since."""
        view, size, position = self._fitted
        if size != (camera.image_width, camera.image_height) and np.allclose(camera.position, position, atol=1e-4):
            self.queue.post("view", partial(self.look, view))

    async def report(self, name: str, value: Any) -> None:
        """Take an event of the page; on the event loop."""
        if self.player is not None and name in _MOTIONS:
            self.player.stop()
        key = f"{name} {value[0]}" if isinstance(value, tuple) else name
        self.queue.post(key, partial(getattr(self, f"_on_{name}"), value))

    async def _gizmo_moved(self, event: Any) -> None:
        if event.phase != "start":
            await self.report("gizmo", None)

    def close(self) -> None:
        """Stop the event queue and the players; on the event loop."""
        self.queue.close()
        if self.player is not None:
            self.player.stop()

    def _failed(self, error: Exception) -> None:
        if self.queue.closed:
            return
        if isinstance(error, SpmError):
            self._notify("Not possible", error)
        else:
            _log.error("an event of the page failed", exc_info=error)

    def _notify(self, title: str, error: Exception) -> None:
        self.client.add_notification(title, str(error), color="orange", auto_close_seconds=8.0)

    def show(self, moved: tuple[str, int] = ("", 0)) -> None:
        """Bring the page up to date; `moved` is the gizmo or the slider that the user holds, and is left alone."""
        state, config = self.state, self.config
        ranges = pose_ranges(state.shown.pose, self.model.geometry, self.panel.angles), leg_ranges(state.shown)
        with self.client.atomic():
            self.scene.show(state)
            self.panel.show(state, config.chain.joint_values(state.shown), ranges, config.geometry_file, moved)
            if moved[0] != "gizmo":
                self.gizmo.position = state.target.translation
                self.gizmo.wxyz = state.target.rotation.as_quat(scalar_first=True)
        if moved[0] != "coordinate":
            self._coordinates = pose_coordinates(state.target, self.panel.angles)
        if moved[0] != "leg":
            self._legs = np.array(state.shown.readings)

    # One method per event, named after it; they run in the session's worker.

    def _on_gizmo(self, _: None) -> None:
        farthest = _FARTHEST * (self.scene.size + float(self.config.start.translation[2]))
        position = np.clip(self.gizmo.position, -farthest, farthest)
        self.model.drag(make_pose(position, rotation=Rotation.from_quat(self.gizmo.wxyz, scalar_first=True)))
        self.show(("gizmo", 0))

    def _on_coordinate(self, value: tuple[int, float]) -> None:
        self._coordinates[value[0]] = value[1]
        self.model.drag(pose_of_coordinates(self._coordinates, self.panel.angles))
        self.show(("coordinate", value[0]))

    def _on_angles(self, angles: str) -> None:
        self.panel.set_angles(angles)
        self.show()

    def _on_leg(self, value: tuple[int, float]) -> None:
        self._legs[value[0]] = value[1]
        self.model.set_readings(self._legs)
        self.show(("leg", value[0]))

    def _on_branch(self, label: str) -> None:
        if label in self.state.labels and label != self.state.label:
            self.model.select(label)
            self.scene.clear_trail()
            self.show()

    def _on_hold(self, hold: bool) -> None:
        self.model.hold_limits = hold
        if self.state.distance > 0.0:
            self.model.drag(self.state.target)
            self.show()

    def _on_back(self, _: None) -> None:
        self._place(self.state.shown)

    def _on_reset(self, _: None) -> None:
        self.scene.clear_trail()
        self._place(self.config.start)

    def _place(self, configuration: Configuration) -> None:
        self.model.place(configuration)
        self.show()

    def _on_view(self, view: str) -> None:
        self.look(view)

    def _on_load(self, _: Any) -> None:
        self.model.load(self.panel.wrench)
        self.show()

    def _on_layer(self, value: tuple[str, bool]) -> None:
        name, shown = value
        if name == "gizmo":
            self.gizmo.visible = shown
        elif name in ("shell", "points"):
            self.scene.show_workspace(name, shown)
        else:
            self.scene.layers[name] = shown
            self.scene.show(self.state)

    def _on_dark(self, dark: bool) -> None:
        self.panel.theme(dark)

    def _on_play(self, _: None) -> None:
        assert self.player is not None
        self._follow_path()
        self._loop.call_soon_threadsafe(self.player.toggle)

    def _on_time(self, time: float) -> None:
        assert self.player is not None
        self._follow_path()
        self.player.time = time
        self._show_frame(time)

    def _follow_path(self) -> None:
        """Follow the branch that is shown, if it is real where the path begins, else the physical one."""
        recording, panel = self.config.recording, self.panel
        if recording is None or self.playback is not None:
            return
        panel.show_path("Following the branch along the path …")
        # A path of leg lengths is followed in an assembly mode, which labels of branches do not name: take the nearest.
        start = self.state.shown if isinstance(recording.points, np.ndarray) else (self.state.label or None)
        try:
            try:
                self.playback = recording.follow(self.model.geometry, start)
            except ArgumentError:
                self.playback = recording.follow(self.model.geometry)
        except SpmError as error:
            panel.show_path(f"⚠ {error}")
            raise
        self.scene.clear_trail()
        self.scene.show_path(self.playback.path.configurations.translation)

    def _show_frame(self, time: float) -> None:
        if self.playback is None or self.player is None:
            return
        self._place(self.playback.state_at(time))
        if self.config.recording is not None:
            self.panel.time.value = time
            self.panel.show_path(*self.playback.report(time))

    def _on_png(self, _: None) -> None:
        import imageio.v3 as imageio

        camera = self.client.camera
        try:
            picture = self.client.get_render(
                int(camera.image_height), int(camera.image_width), transport_format="png", timeout=60.0
            )
        except (RuntimeError, TimeoutError) as error:
            self._notify("No picture", error)
            return
        content = imageio.imwrite("<bytes>", picture, extension=".png")
        self.client.send_file_download("spm_pin.png", content, save_immediately=True)

    def _on_json(self, _: None) -> None:
        text = to_json(state_data(self.state, self.config.chain, self.config.geometry_file))
        self.client.send_file_download("spm_pin_state.json", f"{text}\n".encode(), save_immediately=True)
