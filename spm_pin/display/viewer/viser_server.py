"""viser's server, started without its own announcements and only where the address is free."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Iterator
from typing import Any

import rich

from spm_pin.errors import ArgumentError, MissingExtraError

__all__ = ["free_port", "quiet_server", "start", "stop"]

_TRIES = 100
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EACCES)
_CONSOLE = threading.Lock()


def free_port(host: str, port: int) -> int:
    """Return the first port from `port` on that is free on `host`; 0 stays 0, which lets the system choose.

    Raises
    ------
    ArgumentError
        If the host is none of this machine's, or no port is free.
    """
    if not 0 <= port <= 65535:
        raise ArgumentError("port", "a port from 0 to 65535", port)
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise ArgumentError("host", "an address of this machine", repr(host), str(error.strerror)) from error
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
                    raise ArgumentError("host", "an address of this machine", repr(host), str(error.strerror)) from None
                continue
            return candidate
    cause = str(last.strerror) if last is not None else ""
    raise ArgumentError("port", f"a free port among the {_TRIES} from it on", port, cause)


def start(host: str, port: int) -> Any:
    """Start a server; `port` was free a moment ago, and viser takes a later one if it is no longer.

    Raises
    ------
    MissingExtraError
        If viser is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] != "viser":
            raise
        raise MissingExtraError("viewer", "viser") from missing
    with _silence():
        return viser.ViserServer(host=host, port=port, verbose=False)


def stop(server: Any) -> None:
    """Stop a server and its threads."""
    with _silence():
        server.stop()


@contextlib.contextmanager
def quiet_server(host: str, port: int) -> Iterator[Any]:
    """Have a server for as long as the block lasts."""
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
