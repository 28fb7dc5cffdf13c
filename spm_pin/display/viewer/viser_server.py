"""viser's server: started where the address is free, without announcements of its own, guarded, with our page."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Collection, Iterator
from typing import Any

import rich

from spm_pin.display.viewer.connection_guard import LARGEST_MESSAGE, limited_receiver, origin_allowed
from spm_pin.display.viewer.page_style import branded
from spm_pin.errors import ArgumentError, MissingExtraError

__all__ = ["free_port", "quiet_server", "start", "stop"]

_TRIES = 100
_STARTING = 60.0  # seconds
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EACCES)
_CONSOLE = threading.Lock()


def free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that is free on `host`; 0 stays 0, which lets the system choose.

    `ArgumentError` is raised if the host is no address of this machine, the port no port, or none is free.
    """
    if not isinstance(port, int) or isinstance(port, bool) or not 0 <= port <= 65535:
        raise ArgumentError("port", "a port from 0 to 65535", repr(port))
    expected = "an address of this machine"
    if not isinstance(host, str) or not host:
        raise ArgumentError("host", f"{expected}, such as '127.0.0.1'", repr(host))
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, ValueError) as error:
        raise ArgumentError("host", expected, repr(host), str(getattr(error, "strerror", error))) from error
    last: OSError | None = None
    for candidate in range(port, min(port + _TRIES, 65536)):
        with socket.socket(family, kind, protocol) as probe:
            # As the server itself does it: a port whose last connection is winding down is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((address[0], candidate, *address[2:]))
                # Bound but not listened to, two sockets of this kind may share a port.
                probe.listen(1)
            except OSError as error:
                last = error
                if error.errno in _NOT_HERE:
                    raise ArgumentError("host", expected, repr(host), str(error.strerror)) from None
                continue
            return candidate
    cause = str(last.strerror) if last is not None else ""
    raise ArgumentError("port", f"a free port among the {_TRIES} from it on", port, cause)


def start(host: str, port: int, allowed_origins: Collection[str] = ()) -> Any:
    """Start a server; `port` was free a moment ago, and viser takes a later one if it is no longer.

    Pages of `allowed_origins` may open its websocket, beside its own. If it does not start, raises `ArgumentError`.
    """
    try:
        import viser
        import websockets.asyncio.server as sockets
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] not in ("viser", "websockets"):
            raise
        raise MissingExtraError("viewer", "viser") from missing
    serve, servers = sockets.serve, []

    def guarded(handler: Any, *arguments: Any, process_request: Any = None, **options: Any) -> Any:
        if not getattr(process_request, "__module__", "").startswith("viser."):
            return serve(handler, *arguments, process_request=process_request, **options)

        async def handle(connection: Any) -> None:
            connection.recv = limited_receiver(connection.recv)
            await handler(connection)

        def respond(connection: Any, request: Any) -> Any:
            headers = request.headers
            if "Upgrade" not in headers:
                return branded(process_request(connection, request))
            if origin_allowed(headers.get_all("Origin"), headers.get_all("Host"), host, allowed_origins):
                return process_request(connection, request)
            return connection.respond(403, "This origin may not connect.\n")

        options |= {"max_size": LARGEST_MESSAGE, "max_queue": 4}
        server = serve(handle, *arguments, process_request=respond, **options)
        servers.append(server)
        return server

    started: list[Any] = []
    with _silence():
        # viser has no option for these, so its call of `serve` is intercepted while it starts.
        sockets.serve = guarded  # type: ignore[assignment,misc]
        try:
            # In a thread, since viser waits for ever where its own thread fails.
            work = threading.Thread(
                target=lambda: started.append(viser.ViserServer(host=host, port=port, verbose=False)), daemon=True
            )
            work.start()
            work.join(timeout=_STARTING)
        finally:
            sockets.serve = serve  # type: ignore[misc]
    if not started:
        raise ArgumentError("host", "an address at which a server starts", repr(host))
    if not servers:
        stop(started[0])
        raise RuntimeError(f"viser {viser.__version__} serves in a way that is not known here, and unguarded")
    return started[0]


def stop(server: Any) -> None:
    """Stop a server and its threads."""
    with _silence():
        server.stop()


@contextlib.contextmanager
def quiet_server(host: str, port: int) -> Iterator[Any]:
    """Run a server while the block is executed."""
    server = start(host, port)
    try:
        yield server
    finally:
        stop(server)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    # viser announces itself, and its end, through rich's global console, whatever its `verbose` says.
    console = rich.get_console()
    with _CONSOLE:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before
