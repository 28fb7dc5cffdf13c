"""The viewer: a server of one page, with a session of its own for every client."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rich

from spm_pin.display.viewer.model import ViewerModel
from spm_pin.display.viewer.playback import Recording, demo_motion
from spm_pin.display.viewer.session import Session, SessionConfig
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.kinematics.forward_displacement import starting_configuration
from spm_pin.mechanism import Configuration, Geometry, pose
from spm_pin.mechanism.arguments import Progress
from spm_pin.mechanism.configuration import check_configuration
from spm_pin.multibody.chain import ClosedChain

_TRIES = 100


class Viewer:
    """An interactive page of a manipulator, served until `stop`.

    Every client has a session of its own, which ends with its connection.

    Parameters
    ----------
    start : Configuration or Geometry, optional
        What the page shows at first: a single configuration that exists; or the manipulator, in a regular
        configuration near its home. By default the paper's.
    host : str
        Address to listen at; by default only this machine can reach it. There is no password.
    port : int
        First port to try; the next free one is taken, 0 lets the system choose.
    recording : Recording, optional
        A path, which plays when a page is opened.
    dark : bool
        Whether pages are dark at first.
    geometry_file : Path, optional
        Where the geometry came from, for exported command lines.
    demo : bool, optional
        Whether the robot moves until the user moves it; by default where no configuration and no path is given.
    progress : callable, optional
        Called with what is made ready, how much is and of how much: kernels are compiled the first time, for a minute.
    """

    def __init__(
        self,
        start: Configuration | Geometry | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        recording: Recording | None = None,
        dark: bool = False,
        geometry_file: Path | None = None,
        demo: bool | None = None,
        progress: Progress | None = None,
    ) -> None:
        progress = progress or (lambda step, done, total: None)
        progress("robot", 0, 4)
        if start is None or isinstance(start, Geometry):
            configuration = starting_configuration(start or Geometry.paper())
        else:
            configuration = check_configuration(start, "start", single=True, existing=True)
        free = free_port(host, port)
        geometry = configuration.geometry
        chain = ClosedChain.from_urdf(geometry=geometry)
        chain.joint_values(configuration)  # raises where its loops do not close
        # Kernels are compiled when first called, also those for what is out of reach: now, so that no client waits.
        progress("branches and singularities", 1, 4)
        model = ViewerModel(configuration)
        progress("poses out of reach", 2, 4)
        model.set_readings(configuration.readings)
        model.drag(pose(2.0 * configuration.translation, rotation=configuration.pose.rotation))
        progress("page", 3, 4)
        if demo is None:
            demo = not isinstance(start, Configuration)
        motion = demo_motion(configuration) if demo and recording is None else None
        self._config = SessionConfig(chain, configuration, recording, motion, geometry_file, dark)
        self._sessions: dict[int, Session] = {}
        self._stopped = threading.Event()
        self.host = host
        require_extra("viewer", "viser")
        import viser

        with _silence():
            self.server = viser.ViserServer(host=host, port=free, verbose=False)
        self.server.gui.set_panel_label("3RPS-3SPR")
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
        session = await asyncio.to_thread(Session, client, self._config, asyncio.get_running_loop())
        # The client may have disconnected while its page was made.
        if client.client_id in self.server.get_clients():
            self._sessions[client.client_id] = session
            session.begin()
        else:
            session.close()

    async def _disconnected(self, client: Any) -> None:
        session = self._sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    def wait(self) -> None:
        """Serve until `stop` is called, or the process interrupted."""
        # With a timeout: a wait without one cannot be interrupted by Ctrl-C on every system.
        while not self._stopped.wait(timeout=0.5):
            pass

    def stop(self) -> None:
        """Stop serving; what runs comes to its end."""
        if not self._stopped.is_set():
            self._stopped.set()
            with _silence():
                self.server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


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
        try:
            # As the server itself does it: a port whose last connection is winding down is free.
            socket.create_server((address[0], candidate, *address[2:]), family=family).close()
        except OSError:
            continue
        return candidate
    raise ArgumentError("port", f"a free port among the {_TRIES} from it on", port)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    # viser announces itself, and its end, through rich's global console, whatever its `verbose` says.
    console = rich.get_console()
    console.quiet = True
    try:
        yield
    finally:
        console.quiet = False
