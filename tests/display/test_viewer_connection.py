"""Connections to the viewer: foreign pages, scripted clients, malformed addresses."""

from __future__ import annotations

import asyncio
import gzip
import urllib.request

import msgspec
import pytest
import viser
import websockets

import spm_pin as spm
from spm_pin.display.viewer import Viewer
from spm_pin.display.viewer.connection_guard import acceptable, origin_allowed

PROTOCOL = f"viser-v{viser.__version__}"
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [3.0, 0.0, 1.0],
    "look_at": [0.0, 0.0, 1.0],
    "up_direction": [0.0, 0.0, 1.0],
    "fov": 1.0,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 640,
    "image_width": 1000,
}
GIZMO = {
    "type": "TransformControlsUpdateMessage",
    "name": "/gizmo",
    "owner": "",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.1, 0.2, 2.0],
}
SLIDER = {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1.5}}


@pytest.fixture(scope="module")
def viewer():
    with Viewer(port=0, demo=False) as started:
        yield started


def connect(viewer, origin=None):
    return websockets.connect(f"ws://127.0.0.1:{viewer.port}", origin=origin, subprotocols=[PROTOCOL], max_size=None)


def encoded(message):
    return msgspec.msgpack.encode(message)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:1", "null", "http://localhost.evil.example"]
)
def test_a_websocket_of_another_site_is_refused(viewer, origin):
    async def opened():
        async with connect(viewer, origin):
            pass

    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
        asyncio.run(opened())
    assert not viewer.sessions


def test_the_viewer_s_own_page_and_programs_may_connect(viewer):
    async def opened(origin):
        async with connect(viewer, origin) as socket:
            return await asyncio.wait_for(socket.recv(), timeout=20.0)

    assert asyncio.run(opened(f"http://127.0.0.1:{viewer.port}"))
    assert asyncio.run(opened(None))


@pytest.mark.parametrize(
    ("origin", "host", "address", "allowed", "expected"),
    [
        ("http://localhost:8080", "localhost:8080", "127.0.0.1", (), True),
        ("http://[::1]:8080", "[::1]:8080", "::1", (), True),
        ("http://192.0.2.7", "192.0.2.7:80", "0.0.0.0", (), True),
        ("http://localhost:8080", "127.0.0.1:8080", "127.0.0.1", (), False),
        # A name that its owner points at this machine: the page is the owner's.
        ("http://rebound.example:8080", "rebound.example:8080", "127.0.0.1", (), False),
        ("https://robots.example", "127.0.0.1:8080", "127.0.0.1", ("https://robots.example",), True),
        ("http://localhost:x", "localhost:8080", "127.0.0.1", (), False),
        ("file://", "localhost:8080", "127.0.0.1", (), False),
    ],
)
def test_only_the_server_s_own_origin_is_allowed(origin, host, address, allowed, expected):
    assert origin_allowed([origin], [host], address, allowed) is expected
    assert not origin_allowed([origin, origin], [host], address, allowed)


def test_messages_of_the_page_are_acceptable():
    for message in (CAMERA, GIZMO, SLIDER, {**SLIDER, "updates": {"value": [0, 0, -500]}}):
        assert acceptable(encoded(message))


@pytest.mark.parametrize(
    "message",
    [
        {**GIZMO, "position": [float("nan"), 0.0, 0.0]},
        {**GIZMO, "position": [1e300, 0.0, 0.0]},
        {**GIZMO, "position": [0.0, 0.0]},
        {**GIZMO, "position": [0.0] * 1000},
        {**GIZMO, "wxyz": [0.0, 0.0, 0.0, 0.0]},
        {**GIZMO, "extra": 1},
        {**SLIDER, "updates": {"value": float("inf")}},
        {**SLIDER, "updates": {"value": "x" * 2000}},
        {**SLIDER, "updates": {"value": {"a": 1}}},
        {**SLIDER, "updates": {"max": 1e9}},
        {**SLIDER, "updates": {"value": 1.0, "update_cb": []}},
        {**CAMERA, "image_width": 10**9},
        {**CAMERA, "fov": -1.0},
        {"type": "ShareUrlRequest"},
        {"type": "FileTransferStartUpload", "size_bytes": 10**12},
        {"type": "NoSuchMessage"},
        {},
        [1, 2],
    ],
    ids=lambda message: str(message)[:60],
)
def test_other_messages_are_dropped(message):
    assert not acceptable(encoded(message))


def test_what_is_no_message_is_dropped():
    assert not acceptable("text")
    assert not acceptable(b"\xc1\xff")
    assert not acceptable(b"\x91" * 100_000)


def test_malformed_messages_of_a_client_change_nothing(viewer):
    async def scenario():
        async with connect(viewer) as socket:
            reading = asyncio.create_task(_read(socket))
            await socket.send(encoded(CAMERA))
            while not viewer.sessions:
                await asyncio.sleep(0.05)
            (session,) = viewer.sessions
            sliders = [*session.panel.pose_sliders, *session.panel.leg_sliders, session.panel.force]
            before = [slider.value for slider in sliders]
            for value in (1e300, -1e300, float("nan"), [1e300] * 3, "x" * 100_000, None, {}):
                for slider in sliders:
                    await socket.send(encoded({**SLIDER, "uuid": slider._impl.uuid, "updates": {"value": value}}))
                await socket.send(encoded({**GIZMO, "position": [value] * 3}))
            await socket.send(encoded({"type": "ShareUrlRequest"}))
            await asyncio.sleep(1.0)
            assert [slider.value for slider in sliders] == before
            assert session.state.shown is viewer._config.start
            # It still listens.
            slider = session.panel.pose_sliders[2]
            await socket.send(encoded({**SLIDER, "uuid": slider._impl.uuid, "updates": {"value": before[2] - 0.01}}))
            while session.state.shown is viewer._config.start:
                await asyncio.sleep(0.05)
            reading.cancel()

    asyncio.run(asyncio.wait_for(scenario(), timeout=60.0))


async def _read(socket):
    async for _ in socket:
        pass


def test_page_has_the_title_of_the_package(viewer):
    for encoding in ("identity", "gzip"):
        request = urllib.request.Request(viewer.url, headers={"Accept-Encoding": encoding})
        with urllib.request.urlopen(request, timeout=20) as answer:
            body = answer.read()
            assert len(body) == int(answer.headers["Content-Length"])
        page = (gzip.decompress(body) if encoding == "gzip" else body).decode()
        assert "<title>spm_pin</title>" in page
        assert "<title>Viser" not in page


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"port": "x"}, "port: expected a port"),
        ({"port": True}, "port: expected a port"),
        ({"port": 80.5}, "port: expected a port"),
        ({"host": b"127.0.0.1"}, "host: expected an address"),
        ({"host": ""}, "host: expected an address"),
        ({"host": None}, "host: expected an address"),
        ({"host": "a\0b"}, "host: expected an address"),
        ({"host": "x" * 70}, "host: expected an address"),
        ({"allowed_origins": "https://robots.example"}, "allowed_origins: expected"),
        ({"start": 3}, "start: expected a Configuration"),
    ],
)
def test_arguments_of_the_wrong_kind_are_refused(options, says):
    with pytest.raises(spm.ArgumentError, match=says):
        Viewer(**options)
