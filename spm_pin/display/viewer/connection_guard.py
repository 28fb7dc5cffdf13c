"""Which websockets a viewer accepts, and which of their messages.

A page of another site may not open a websocket to the viewer: the browser names the page's origin, which has to be the
viewer's own. Of viser's messages, those that the viewer's page sends are let through, with numbers that are
finite and of a size that means something; anything else is dropped before viser reads it.
"""

from __future__ import annotations

import asyncio
import ipaddress
import math
import socket
import time
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any
from urllib.parse import urlsplit

LARGEST_MESSAGE = 32 * 1024 * 1024
"""Bytes of the largest message: a rendered picture. All others are at most `_LARGEST_EVENT`."""

_LARGEST_EVENT = 16 * 1024
_LARGEST_NUMBER = 1e6
_LONGEST_TEXT = 1000
_RATE, _BURST = 300.0, 600.0
"""Messages a second, and how many may come at once; a client that sends more waits."""

_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_PORTS = {"http": 80, "https": 443}

Check = Callable[[Any], bool]


def origin_allowed(origins: Collection[str], hosts: Collection[str], address: str, allowed: Collection[str]) -> bool:
    """Return whether the page that requests a websocket may open it.

    `origins` and `hosts` are the request's ``Origin`` and ``Host`` headers; a request without an origin comes from no
    browser's page. The origin must be the server's own: the same host and port, under a name that no foreign name
    server can give it (an IP address, ``localhost``, this machine's name, or `address`, where the server listens); or
    one of the further origins `allowed`, such as ``https://robots.example``.
    """
    if not origins:
        return True
    if len(origins) != 1 or len(hosts) != 1:
        return False
    (origin,), (host,) = origins, hosts
    if origin in allowed:
        return True
    try:
        page, server = urlsplit(origin), urlsplit(f"//{host}")
        port = _PORTS[page.scheme]
        same = (page.hostname, page.port or port) == (server.hostname, server.port or port)
    except (ValueError, KeyError):
        return False
    return same and page.hostname is not None and _own_name(page.hostname, address)


def _own_name(name: str, address: str) -> bool:
    try:
        return bool(ipaddress.ip_address(name))
    except ValueError:
        return name in (*_LOOPBACK, address.lower(), socket.gethostname().lower(), socket.getfqdn().lower())


def _number(value: Any) -> bool:
    # False and True are no numbers here; NaN compares false.
    return type(value) in (int, float) and -_LARGEST_NUMBER <= value <= _LARGEST_NUMBER


def _vector(count: int) -> Check:
    return lambda value: isinstance(value, list) and len(value) == count and all(map(_number, value))


def _quaternion(value: Any) -> bool:
    return _vector(4)(value) and 0.5 < math.hypot(*value) < 2.0


def _text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST_TEXT


def _value(updates: Any) -> bool:
    """Return whether the update of a widget sets its value, and to one that a widget of the panel can have."""
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    value = updates["value"]
    return isinstance(value, bool) or _number(value) or _text(value) or _vector(3)(value)


def _count(value: Any) -> bool:
    return type(value) is int and 0 <= value <= 100_000


def _or_none(check: Check) -> Check:
    return lambda value: value is None or check(value)


_NODE: Mapping[str, Check] = {"name": _text, "owner": _text}
_MESSAGES: Mapping[str, Mapping[str, Check]] = {
    "ViewerCameraMessage": {
        "wxyz": _quaternion,
        "position": _vector(3),
        "look_at": _vector(3),
        "up_direction": _vector(3),
        "fov": lambda value: _number(value) and 0.0 < value < math.pi,
        "near": _number,
        "far": _number,
        "image_height": lambda value: _count(value) and value > 0,
        "image_width": lambda value: _count(value) and value > 0,
    },
    "GuiUpdateMessage": {"uuid": _text, "updates": _value},
    "TransformControlsUpdateMessage": {**_NODE, "wxyz": _quaternion, "position": _vector(3)},
    "TransformControlsDragStartMessage": _NODE,
    "TransformControlsDragEndMessage": _NODE,
    "SceneNodeClickMessage": {
        **_NODE,
        "instance_index": _or_none(_count),
        "ray_origin": _vector(3),
        "ray_direction": _vector(3),
        "screen_pos": _vector(2),
        "modifier": _or_none(_text),
    },
    "GetRenderResponseMessage": {"payload": lambda value: isinstance(value, bytes), "render_uuid": _text},
    "FileTransferPartAck": {
        "source_component_uuid": _or_none(_text),
        "transfer_uuid": _text,
        "transferred_bytes": lambda value: type(value) is int,
        "total_bytes": lambda value: type(value) is int,
    },
}
"""The messages that the viewer's page sends, and what each of their fields may be."""


def acceptable(raw: Any) -> bool:
    """Return whether a message, as it came from the websocket, is one that the viewer's page may send."""
    import msgspec

    if not isinstance(raw, bytes):
        return False
    try:
        message = msgspec.msgpack.decode(raw)
    except (msgspec.DecodeError, RecursionError):
        return False
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        return False
    kind = message.pop("type")
    checks = _MESSAGES.get(kind)
    if checks is None or (len(raw) > _LARGEST_EVENT and kind != "GetRenderResponseMessage"):
        return False
    return set(message) <= set(checks) and all(
        (name in message and check(message[name])) or (name == "owner" and name not in message)
        for name, check in checks.items()
    )


def limited_receiver(receive: Callable[[], Awaitable[Any]]) -> Callable[[], Awaitable[Any]]:
    """Return a connection's `recv` that passes on acceptable messages alone, and no more than `_RATE` a second."""
    budget, last = _BURST, time.monotonic()

    async def received() -> Any:
        nonlocal budget, last
        while True:
            raw = await receive()
            now = time.monotonic()
            budget, last = min(_BURST, budget + _RATE * (now - last)) - 1.0, now
            if budget < 0.0:
                await asyncio.sleep(-budget / _RATE)
            if acceptable(raw):
                return raw

    return received
