"""The viewer's page: a server, and a session for every client, whose events run one after another."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rich
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.description.visuals import visual_parts
from spm_pin.display.viewer.model import ViewerModel, reading_units
from spm_pin.display.viewer.panel import Panel
from spm_pin.display.viewer.playback import Player, Recording, demo_motion
from spm_pin.display.viewer.robot_scene import FIELD_OF_VIEW, VIEWS, RobotScene, fit_camera, robot_points
from spm_pin.display.viewer.stage_model import StageModel
from spm_pin.display.writing import to_json
from spm_pin.errors import ArgumentError, SpmError, require_extra
from spm_pin.kinematics import inverse_physical
from spm_pin.kinematics.forward_displacement import starting_configuration
from spm_pin.machine import Configuration, Machine, Manipulator, Stage
from spm_pin.machine.configuration import check_configuration
from spm_pin.support.arguments import Progress
from spm_pin.workspace import home_height

_log = logging.getLogger(__name__)

_CLOSED = 1e-9  # largest closure residual of the start over the side of the triangle of balls
_TRIES = 100
_MOTIONS = ("gizmo", "coordinate", "leg", "branch", "reset", "back", "time")  # events that stop a path being played
_PHONE_ASPECT = 0.9  # a picture narrower than this fraction of its height is a phone's
_PHONE_PANEL = 0.55  # fraction of a phone's page that viser's panel covers at its lower edge; at most it is 0.6
_FARTHEST = 10.0  # distance from {B} over the machine's size, beyond which the gizmo is not followed


class Viewer:
    """An interactive page of a manipulator, or a stage alone, served until `stop`.

    Every client has a session of its own, which ends with its connection.

    Parameters
    ----------
    start : Configuration, Manipulator or Stage, optional
        State shown at first: a single configuration that exists, for a stage a physical one; or the machine, in
        a regular configuration near its home. By default the paper's manipulator.
    host : str
        Address to listen at; by default only this machine can reach it. There is no password.
    port : int
        First port to try; the next free one is taken, 0 lets the system choose.
    recording : Recording, optional
        A path of a manipulator, which plays when a page is opened.
    dark : bool
        Whether pages are dark initially.
    machine_file : Path, optional
        File of the machine, for exported command lines.
    demo : bool, optional
        Whether a manipulator moves until the user moves it; by default if neither a configuration nor a path is given.
    progress : callable, optional
        Called with a description of the preparation, the number done and the total.
    """

    def __init__(
        self,
        start: Configuration | Manipulator | Stage | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        recording: Recording | None = None,
        dark: bool = False,
        machine_file: Path | None = None,
        demo: bool | None = None,
        progress: Progress | None = None,
    ) -> None:
        progress = progress or (lambda step, done, total: None)
        progress("robot", 0, 2)
        free = free_port(host, port)
        self.new_model: Callable[[], ViewerModel | StageModel]
        self.demo, self.recording = None, recording
        self.start = _first_state(Manipulator.paper() if start is None else start)
        if self.start.machine.is_stage:
            if recording is not None:
                raise ArgumentError("recording", "no recording with a stage", recording)
            self.new_model = partial(StageModel, self.start, machine_file)
        else:
            self.new_model = partial(ViewerModel, self.start, machine_file)
            if (not isinstance(start, Configuration) if demo is None else demo) and recording is None:
                self.demo = demo_motion(self.start)
        gap = float(self.start.closure_residual)
        if not gap <= _CLOSED * self.start.machine.ball_side:
            raise ArgumentError("start", "a closed mechanism", f"a closure residual of {gap:.1e} m", "Rounded numbers?")
        visual_parts(self.start.machine)  # raises an error for a machine that the description cannot express
        progress("page", 1, 2)
        self.dark = dark
        self._sessions: dict[int, Session] = {}
        self._opening: set[asyncio.Task[Any]] = set()
        self._stopped = threading.Event()
        self.host = host
        require_extra("viewer", "viser")
        import viser

        # A tab may be closed while its page is being changed; this is no error.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        with _silence():
            self.server = viser.ViserServer(host=host, port=free, verbose=False)
        self.server.gui.set_panel_label(self.start.machine.architecture)
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._disconnected)

    def _repr_html_(self) -> str:
        """Return the page, for a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="640" style="border:0"></iframe>'

    @property
    def port(self) -> int:
        """TCP port of the page."""
        return int(self.server.get_port())

    @property
    def url(self) -> str:
        """Address of the page, for a browser on this machine."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self.host, self.host)
        return f"http://{host}:{self.port}"

    @property
    def sessions(self) -> tuple[Any, ...]:
        """The sessions of the clients that are connected, oldest first."""
        return tuple(self._sessions.values())

    async def _connected(self, client: Any) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._opening.add(task)
        try:
            session = await asyncio.to_thread(Session, client, self, asyncio.get_running_loop())
        finally:
            self._opening.remove(task)
        # The client may have disconnected, or the viewer been stopped, while its page was made.
        if client.client_id not in self.server.get_clients() or self._stopped.is_set():
            await session.close()
            return
        self._sessions[client.client_id] = session
        if session.player is not None:
            session.queue.post("play", session._on_play)

    async def _disconnected(self, client: Any) -> None:
        session = self._sessions.pop(client.client_id, None)
        if session is not None:
            await session.close()

    async def _close_sessions(self) -> None:
        # The event loop ends with the server, and would drop unfinished tasks.
        await asyncio.gather(*self._opening, *(session.close() for session in self.sessions))

    def wait(self) -> None:
        """Serve until `stop` is called, or the process interrupted."""
        # With a timeout: on some systems a wait without one cannot be interrupted by Ctrl-C.
        while not self._stopped.wait(timeout=0.5):
            pass

    def stop(self) -> None:
        """Stop serving; running events are finished."""
        if not self._stopped.is_set():
            self._stopped.set()
            asyncio.run_coroutine_threadsafe(self._close_sessions(), self.server.get_event_loop()).result()
            with _silence():
                self.server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _first_state(start: Configuration | Machine) -> Configuration:
    """Return the state shown at first: the one given, or one of a machine near its home."""
    if isinstance(start, Stage):
        return inverse_physical(start, home_height(start))
    if isinstance(start, Manipulator):
        return starting_configuration(start)
    state = check_configuration(start, "start", single=True, existing=True)
    if state.machine.is_stage and not state.is_at_home:
        raise ArgumentError("start", "a physical state of a stage", state)
    return state


def free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that is free on `host`; 0 stays 0, which lets the system choose."""
    if not isinstance(port, int) or isinstance(port, bool) or not 0 <= port <= 65535:
        raise ArgumentError("port", "a port from 0 to 65535", repr(port))
    expected = "an address of this machine, such as '127.0.0.1'"
    if not isinstance(host, str) or not host:
        raise ArgumentError("host", expected, repr(host))
    try:
        family, _, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        socket.create_server(address, family=family).close()
    except (OSError, ValueError) as error:
        raise ArgumentError("host", expected, repr(host), str(getattr(error, "strerror", error))) from error
    for candidate in range(port, min(port + _TRIES, 65536)):
        # As the server does: a port whose last connection is being closed is free.
        with contextlib.suppress(OSError):
            socket.create_server((address[0], candidate, *address[2:]), family=family).close()
            return candidate
    raise ArgumentError("port", f"a free port among the {_TRIES} from it on", port)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    # viser announces its start and end through rich's global console, whatever its `verbose` is.
    console = rich.get_console()
    console.quiet = True
    try:
        yield
    finally:
        console.quiet = False


class EventQueue:
    """Runs actions one after another in a worker thread, while the event loop receives messages.

    A drag sends poses faster than they can be shown: a waiting action is replaced by a later one with the same key.
    `post` and `close` must be called in the event loop's thread; `on_error` is called with an exception of an action.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: dict[str, Callable[[], Any]] = {}
        self._task: asyncio.Task[None] | None = None
        self.closed = False

    def post(self, key: str, action: Callable[[], Any]) -> bool:
        """Run an action after those posted before, in place of one with the same key; return False if closed."""
        if self.closed:
            return False
        self._waiting[key] = action
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._work())
        return True

    async def close(self) -> None:
        """Drop waiting actions and wait for the running one."""
        self.closed = True
        self._waiting.clear()
        if self._task is not None:
            await self._task

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


class Session:
    """One client's state, scene and panel. Its queue and its player belong to the event loop's thread."""

    def __init__(self, client: Any, viewer: Viewer, loop: asyncio.AbstractEventLoop) -> None:
        self.client, self.viewer, self._loop = client, viewer, loop
        self.queue = EventQueue(self._failed)
        self.model: Any = viewer.new_model()
        self._coordinates = self.model.coordinates(viewer.start.pose, next(iter(self.model.conventions)))
        self._legs = np.array(viewer.start.readings)
        self._narrow = client.camera.image_width < _PHONE_ASPECT * client.camera.image_height
        self.playback = viewer.demo
        self.player: Player | None = None
        path = viewer.recording or viewer.demo
        if path is not None:
            self.player = Player(self.queue.post, self._show_frame, float(path.times[-1]), repeat=path is viewer.demo)
        self.scene = RobotScene(client.scene, viewer.start.machine, partial(self.report, "branch"))
        self.panel = Panel(client.gui, viewer, self.model, self.report, narrow=self._narrow)
        self.gizmo = client.scene.add_transform_controls(
            "/gizmo", scale=1.1 * self.scene.size, line_width=3.0, depth_test=False, opacity=0.9
        )
        self.gizmo.on_update(self._gizmo_moved)
        self.show()
        self._on_view("Home")
        client.camera.on_update(self._camera_moved)

    async def _camera_moved(self, camera: Any) -> None:
        """Fit the robot into a picture of another size, unless the user has moved the camera since."""
        view, size, position = self._fitted
        if size != (camera.image_width, camera.image_height) and np.allclose(camera.position, position, atol=1e-4):
            self.queue.post("view", partial(self._on_view, view))

    async def _gizmo_moved(self, event: Any) -> None:
        if event.phase != "start":
            await self.report("gizmo", event.phase)

    async def report(self, name: str, value: Any) -> None:
        """Take an event of the page; on the event loop."""
        if self.player is not None and name in _MOTIONS:
            self.player.stop()
        key = f"{name} {value[0]}" if isinstance(value, tuple) else name
        self.queue.post(key, partial(getattr(self, f"_on_{name}"), value))

    async def close(self) -> None:
        """Stop the player and the event queue; on the event loop."""
        if self.player is not None:
            self.player.stop()
        await self.queue.close()

    def _failed(self, error: Exception) -> None:
        if isinstance(error, SpmError) and not self.queue.closed:
            self._notify("Not possible", error)
        elif not self.queue.closed:
            _log.error("an event of the page failed", exc_info=error)

    def _notify(self, title: str, error: Exception) -> None:
        self.client.add_notification(title, str(error), color="orange", auto_close_seconds=8.0)

    def show(self, moved: tuple[str, int] = ("", 0)) -> None:
        """Update the page; `moved` is the gizmo or the slider that the user holds, which is not changed."""
        state = self.model.state
        with self.client.atomic():
            self.scene.show(state)
            if moved[0] != "gizmo":
                self.gizmo.position = state.target.translation
                self.gizmo.wxyz = state.target.rotation.as_quat(scalar_first=True)
        # The robot is sent before slower results are computed.
        with self.client.atomic():
            self.scene.show_forces(state)
            self.panel.show(state, moved)
        if moved[0] != "coordinate":
            self._coordinates = self.model.coordinates(state.target, self.panel.angles)
        if moved[0] != "leg":
            self._legs = np.array(state.shown.readings)

    # One method per event, named after it; they run in the session's worker.

    def _on_gizmo(self, phase: str) -> None:
        farthest = _FARTHEST * (self.scene.size + float(self.viewer.start.translation[2]))
        position = np.clip(self.gizmo.position, -farthest, farthest)
        turn = Rotation.from_quat(self.gizmo.wxyz, scalar_first=True)
        self.model.drag(RigidTransform.from_components(position, turn))
        # When released, it returns from where a stage cannot follow: sideways, and about its normal.
        self.show(("gizmo", 0) if phase != "end" else ("", 0))

    def _on_coordinate(self, value: tuple[int, float]) -> None:
        self._coordinates[value[0]] = value[1]
        self.model.drag(self.model.pose_of(self._coordinates, self.panel.angles))
        self.show(("coordinate", value[0]))

    def _on_angles(self, angles: str) -> None:
        self.panel.set_angles(angles)
        self.show()

    def _on_leg(self, value: tuple[int, float]) -> None:
        self._legs[value[0]] = value[1] / reading_units(self.viewer.start.machine)[value[0]].factor
        self.model.set_readings(self._legs)
        self.show(("leg", value[0]))

    def _on_branch(self, label: str) -> None:
        if label in self.model.state.labels and label != self.model.state.label:
            self.model.select(label)
            self.scene.clear_trail()
            self.show()

    def _on_hold(self, hold: bool) -> None:
        self.model.hold_limits = hold
        if self.model.state.distance > 0.0:
            self.model.drag(self.model.state.target)
            self.show()

    def _on_back(self, _: None) -> None:
        self._place(self.model.state.shown)

    def _on_reset(self, _: None) -> None:
        self.scene.clear_trail()
        self._place(self.viewer.start)

    def _place(self, configuration: Configuration) -> None:
        self.model.place(configuration)
        self.show()

    def _on_view(self, view: str) -> None:
        """Place the camera so that the robot fills the picture; see `VIEWS`."""
        camera = self.client.camera
        size = camera.image_width, camera.image_height
        points = robot_points(self.model.state.shown, 0.3 * self.scene.size)
        covered = _PHONE_PANEL if self._narrow else 0.0
        position, look_at = fit_camera(points, VIEWS[view], size[0] / size[1], covered)
        self._fitted = view, size, position
        with self.client.atomic():
            camera.fov = FIELD_OF_VIEW
            camera.up_direction = (0.0, 0.0, 1.0)
            camera.position = position
            camera.look_at = look_at

    def _on_load(self, _: Any) -> None:
        self.model.load([*self.panel.force.value, *self.panel.moment.value])
        self.show()

    def _on_layer(self, value: tuple[str, bool]) -> None:
        name, shown = value
        if name == "gizmo":
            self.gizmo.visible = shown
        elif name in ("shell", "points"):
            self.scene.show_workspace(name, shown)
        else:
            self.scene.layers[name] = shown
            self.show()

    def _on_dark(self, dark: bool) -> None:
        self.panel.theme(dark)

    def _on_play(self, _: None = None) -> None:
        assert self.player is not None
        self._follow_path()
        self._loop.call_soon_threadsafe(self.player.toggle)

    def _on_time(self, time: float) -> None:
        assert self.player is not None
        self._follow_path()
        self.player.time = time
        self._show_frame(time)

    def _follow_path(self) -> None:
        """Follow the branch shown, if it is real at the start of the path, otherwise the physical one."""
        recording, state = self.viewer.recording, self.model.state
        if recording is None or self.playback is not None:
            return
        self.panel.show_path("Following the branch along the path …")
        # A path of leg lengths needs an assembly mode, not the label of a branch: start from the state shown.
        start = state.shown if isinstance(recording.points, np.ndarray) else (state.label or None)
        try:
            try:
                self.playback = recording.follow(state.shown.machine, start)
            except ArgumentError:
                self.playback = recording.follow(state.shown.machine)
        except SpmError as error:
            self.panel.show_path(f"⚠ {error}")
            raise
        self.scene.clear_trail()
        self.scene.show_path(self.playback.path.configurations.translation)

    def _show_frame(self, time: float) -> None:
        if self.playback is None:
            return
        self._place(self.playback.state_at(time))
        if self.viewer.recording is not None:
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
        text = to_json(self.model.data())
        self.client.send_file_download("spm_pin_state.json", f"{text}\n".encode(), save_immediately=True)
