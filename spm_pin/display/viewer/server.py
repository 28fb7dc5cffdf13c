"""The viewer: a server of one page, with a session of its own for every client."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Collection
from pathlib import Path
from typing import Any

from spm_pin.display.viewer import viser_server
from spm_pin.display.viewer.recording import Recording, demo_motion
from spm_pin.display.viewer.robot_meshes import RobotMeshes
from spm_pin.display.viewer.session import Session, SessionConfig
from spm_pin.display.viewer.state import StateMachine
from spm_pin.display.viewer.workspace_layer import WorkspaceLayer
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import starting_configuration
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.configuration import check_configuration
from spm_pin.multibody.chain import ClosedChain


class Viewer:
    """An interactive page of a manipulator, served until `stop`.

    Parameters
    ----------
    start : Configuration or Geometry, optional
        What the page shows at first: a single configuration that exists; or the manipulator, in a regular
        configuration near its home. By default the paper's.
    host : str
        Address to listen at. By default only this machine can reach it.
    port : int
        First port to try; the next free one is taken, 0 lets the system choose.
    recording : Recording, optional
        A path, which plays when a page is opened.
    dark : bool
        Whether pages are dark at first.
    geometry_file : Path, optional
        Where the geometry came from, for exported command lines.
    demo : bool, optional
        Whether a page moves from the beginning, until it is touched; by default where no configuration and no path is
        given.
    allowed_origins : collection of str
        Other sites whose pages may connect, such as ``https://robots.example`` where a proxy serves the viewer. By
        default a browser's page connects to the server it came from and to no other.

    Raises
    ------
    ArgumentError
        If `start` is something else, the host is no address of this machine, or no port is free.

    Notes
    -----
    Every client has a session of its own, which ends with its connection. A session's work is done in one worker
    thread of a pool, one event at a time, and of events that come faster than they are done the latest counts.
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
        allowed_origins: Collection[str] = (),
    ) -> None:
        if start is None or isinstance(start, Geometry):
            configuration = starting_configuration(start or Geometry.paper())
        else:
            configuration = check_configuration(start, "start", single=True, existing=True)
        free = viser_server.free_port(host, port)
        if isinstance(allowed_origins, str) or not all(isinstance(origin, str) for origin in allowed_origins):
            raise ArgumentError("allowed_origins", "origins such as ['https://robots.example']", repr(allowed_origins))
        origins = tuple(origin.rstrip("/").lower() for origin in allowed_origins)
        geometry = configuration.geometry
        chain = ClosedChain.from_urdf(geometry=geometry)
        chain.joint_values(configuration)  # raises where its loops do not close
        # Kernels are compiled when first called: now, so that no client waits for it.
        StateMachine(configuration).set_legs(configuration.leg_lengths)
        if demo is None:
            demo = not isinstance(start, Configuration) and recording is None
        self._config = SessionConfig(
            chain,
            RobotMeshes(geometry),
            configuration,
            WorkspaceLayer(geometry),
            recording,
            demo_motion(configuration) if demo else None,
            geometry_file,
            dark,
        )
        self._sessions: dict[int, Session] = {}
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self.host = host
        self.server = viser_server.start(host, free, origins)
        self.server.gui.set_panel_label("3RPS-3SPR")
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._disconnected)

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
    def sessions(self) -> tuple[Session, ...]:
        """The sessions of the clients that are connected, oldest first."""
        with self._lock:
            return tuple(self._sessions[key] for key in sorted(self._sessions))

    async def _connected(self, client: Any) -> None:
        session = await asyncio.to_thread(Session, client, self._config, asyncio.get_running_loop())
        # The client may have disconnected while its page was made.
        if client.client_id in self.server.get_clients():
            with self._lock:
                self._sessions[client.client_id] = session
            session.begin()
        else:
            session.close()

    async def _disconnected(self, client: Any) -> None:
        with self._lock:
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
            viser_server.stop(self.server)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
