"""viser's server: started where the address is free, without announcements of its own, guarded, with our page."""

from __future__ import annotations

import contextlib
import errno
import gzip
import os
import socket
import threading
from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import Any

import rich

from spm_pin.display.viewer.connection_guard import LARGEST_MESSAGE, limited_receiver, origin_allowed
from spm_pin.errors import ArgumentError, require_extra

TITLE = "spm_pin"
"""The title of the page."""

PHONE_ASPECT = 0.9
"""A picture narrower than this share of its height is a phone's."""
PHONE_PANEL = 0.46
"""The share of a phone's page that the panel covers at its lower edge."""

_STYLE = f"""
@media (max-width: 36em) {{
  div[style*="position: fixed"][style*="width: 20em"] {{
    left: 0; width: 100% !important; max-height: {100 * PHONE_PANEL:.0f}% !important;
    border-radius: 0.8em 0.8em 0 0 !important }}
  div[style*="position: fixed"][style*="width: 20em"] div[style*="width: 20em"] {{ width: 100% !important }}
}}
"""
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
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, ValueError) as error:
        raise ArgumentError("host", expected, repr(host), str(getattr(error, "strerror", error))) from error
    cause = ""
    for candidate in range(port, min(port + _TRIES, 65536)):
        try:
            # As the server itself does it: a port whose last connection is winding down is free.
            socket.create_server((address[0], candidate, *address[2:]), family=family).close()
        except OSError as error:
            cause = os.strerror(error.errno or 0)
            if error.errno in _NOT_HERE:
                raise ArgumentError("host", expected, repr(host), cause) from None
        else:
            return candidate
    raise ArgumentError("port", f"a free port among the {_TRIES} from it on", port, cause)


def start(host: str, port: int, allowed_origins: Collection[str] = ()) -> Any:
    """Start a server; `port` was free a moment ago, and viser takes a later one if it is no longer.

    Pages of `allowed_origins` may open its websocket, beside its own. If it does not start, raises `ArgumentError`.
    """
    require_extra("viewer", "viser", "websockets")
    import viser
    import websockets.asyncio.server as sockets

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
                return _branded(process_request(connection, request))
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
def _silence() -> Iterator[None]:
    # viser announces itself, and its end, through rich's global console, whatever its `verbose` says.
    console = rich.get_console()
    with _CONSOLE:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before


def branded_html(page: str) -> str:
    """Return viser's page with the title and the style of this project."""
    head = f"<title>{TITLE}</title><style>{_STYLE}</style>"
    return page.replace("<title>Viser</title>", "", 1).replace("</head>", f"{head}</head>", 1)


@lru_cache(maxsize=4)
def _branded_body(body: bytes, encoding: str) -> bytes:
    text = gzip.decompress(body) if encoding == "gzip" else body
    changed = branded_html(text.decode()).encode()
    return gzip.compress(changed) if encoding == "gzip" else changed


def _branded(response: Any) -> Any:
    """Return an HTTP response, its title and style replaced where it is a page."""
    if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
        response.body = _branded_body(bytes(response.body), response.headers.get("Content-Encoding", ""))
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response
