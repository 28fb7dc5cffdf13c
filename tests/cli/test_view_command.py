from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import drained
from cli.running import COMMAND, POSE, run
from error_fields import with_fields
from PIL import Image

import spm_pin as spm
from spm_pin.display import Viewer
from spm_pin.display.viewer.page import EventQueue
from spm_pin.machine import LEGS


def started(*arguments: str) -> tuple[subprocess.Popen[str], str, list[str]]:
    """Return a viewer's process, the address it names, and the lines before."""
    process = subprocess.Popen(
        [*COMMAND, "view", "--no-open", *arguments], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    lines: list[str] = []
    assert process.stderr is not None
    for line in process.stderr:
        lines.append(line)
        found = re.search(r"viewer at (\S+),", line)
        if found:
            return process, found[1], lines
    raise AssertionError("".join(lines))


def test_a_taken_port_is_named_and_another_used_until_ctrl_c() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        process, url, lines = started("--port", str(port))
        try:
            assert f"port {port} is taken" in "".join(lines)
            assert not url.endswith(f":{port}")
            with urllib.request.urlopen(url, timeout=120) as page:
                assert b"<html" in page.read(2000)
            # Loopback only: the machine's other addresses do not answer.
            assert url.startswith("http://127.0.0.1:")
        finally:
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Traceback" not in errors


def test_draw_names_the_legs_beyond_their_limits(tmp_path: Path) -> None:
    pose = ["--translation", "0", "0", "9", "--rpy", "1", "2", "3"]
    picture = tmp_path / "far.png"
    branches = json.loads(run("inverse", *pose, "--json").stdout)["branches"]
    # None is physical: the first is drawn.
    legs = [LEGS[leg] for leg in branches[0]["beyond_limits"]]
    assert legs
    done = run("draw", *pose, "--out", str(picture), "--width", "200")
    assert done.returncode == 0
    beyond = f"legs beyond their limits: {', '.join(legs)}"
    assert done.message == f"no branch of this pose is physical wrote {picture} {beyond}"


def test_draw_one_branch_or_all(tmp_path: Path) -> None:
    one, every, some = tmp_path / "one.png", tmp_path / "all.png", tmp_path / "some.svg"
    assert run("draw", "--out", str(one), "--width", "120").returncode == 0  # too small for names
    assert run("draw", "--out", str(one), "--width", "200").message == f"wrote {one}"
    assert run("draw", "--out", str(every), "--all", "--width", "400").returncode == 0
    arguments = [*POSE, "--unit", "cm", "--branch", "TT-", "--branch", "FF+", "--width", "240"]
    assert run("draw", "--out", str(some), *arguments).returncode == 0
    with Image.open(one) as single, Image.open(every) as gallery:
        assert single.width == 200 < single.height
        assert gallery.width == 400
        # Six branches, three in a row: something is drawn in each of the six places.
        ink = 255 - np.asarray(gallery.convert("L"), dtype=float)
        places = [place for row in np.array_split(ink, 2) for place in np.array_split(row, 3, axis=1)]
        assert min(place.mean() for place in places) > 5.0
    assert some.read_text(encoding="utf-8").startswith("<?xml")
    assert some.read_text(encoding="utf-8").count("<image") == 2


def test_event_queue_replaces_pending_events_of_a_kind_and_stops_when_closed() -> None:
    import asyncio
    import threading

    done: list[str] = []
    errors: list[Exception] = []
    gate = threading.Event()

    async def scenario() -> None:
        queue = EventQueue(errors.append)
        queue.post("first", lambda: gate.wait(300.0))
        await asyncio.sleep(0.05)
        for k in range(5):
            queue.post("drag", lambda k=k: done.append(f"drag {k}"))
        queue.post("select", lambda: done.append("select"))
        queue.post("fault", lambda: 1 / 0)
        gate.set()
        await drained(queue)
        assert done == ["drag 4", "select"]
        assert isinstance(errors[0], ZeroDivisionError)

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("options", "argument"),
    [
        ({"port": 80.5}, "port"),
        ({"host": b"127.0.0.1"}, "host"),
        ({"host": "x" * 70}, "host"),
        ({"start": 3}, "start"),
    ],
)
def test_a_viewer_refuses(options: dict[str, Any], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        Viewer(**options)
