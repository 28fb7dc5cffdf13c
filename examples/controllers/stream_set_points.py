"""Stream set-points to a board that runs follow_set_points.ino: a plate that tilts in a circle, or your own points.

    python stream_set_points.py /dev/ttyACM0 --tilt 10 --height 0.12

Needs nothing but Python, on Linux or macOS. The protocol is described in follow_set_points/set_points.h.
"""

from __future__ import annotations

import argparse
import binascii
import contextlib
import math
import os
import struct
import sys
import termios
import time
import tty
from collections import Counter
from collections.abc import Iterable, Iterator

STATUSES = {
    0: "ok",
    1: "unreachable",
    2: "beyond limits",
    3: "singular",
    4: "unsafe",
    255: "bad input",
    16: "repeated",
}
"""Statuses with which a board answers set-points, by their numbers: see set_points.h."""


def frame(number: int, normal_x: float, normal_y: float, height: float) -> bytes:
    """Return a set-point as bytes: components of the platform's normal, and the height of its centre [m]."""
    numbers = (round(1e6 * x) for x in (normal_x, normal_y, height))
    body = struct.pack("<BBiii", 0xA5, number % 256, *numbers)
    return body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def answers(received: bytearray) -> Iterator[tuple[int, str]]:
    """Take whole answers off what was received; yield of each the frame's number and the status."""
    while len(received) >= 5:
        body, crc = received[:3], int.from_bytes(received[3:5], "little")
        if body[0] == 0x5A and binascii.crc_hqx(bytes(body), 0xFFFF) == crc:
            del received[:5]
            yield body[1], STATUSES.get(body[2], f"status {body[2]}")
        else:
            del received[0]


def stream(port: str, points: Iterable[tuple[float, float, float]], rate: float = 50.0) -> Counter[str]:
    """Send set-points (normal x, normal y, height) at a fixed rate [1/s]; return how many had which status.

    Of each set-point the first answer counts. "unanswered" are those whose answer did not come, within half a second of
    the last, "not sent" those that the line had no room for. If the port vanishes, that is an OSError.
    """
    line = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    counts: Counter[str] = Counter()
    received, waiting = bytearray(), set[int]()
    try:
        tty.setraw(line)
        settings = termios.tcgetattr(line)
        settings[4] = settings[5] = termios.B115200
        termios.tcsetattr(line, termios.TCSANOW, settings)
        termios.tcflush(line, termios.TCIOFLUSH)  # what is left of another run
        start, sent = time.monotonic(), 0
        for sent, point in enumerate(points, 1):
            _receive_until(line, start + (sent - 1) / rate, received, counts, waiting)
            try:
                os.write(line, frame(sent, *point))
                waiting.add(sent % 256)
            except BlockingIOError:
                counts["not sent"] += 1
        _receive_until(line, time.monotonic() + 0.5, received, counts, waiting)
        counts["unanswered"] = sent - counts.total()
        return +counts
    except termios.error as error:
        raise OSError(*error.args) from error
    finally:
        os.close(line)


def _receive_until(line: int, end: float, received: bytearray, counts: Counter[str], waiting: set[int]) -> None:
    while True:
        with contextlib.suppress(BlockingIOError):
            received += os.read(line, 4096)
        for number, status in answers(received):
            if number in waiting:
                waiting.remove(number)
                counts[status] += 1
        if (left := end - time.monotonic()) <= 0.0:
            return
        time.sleep(min(left, 0.002))


def circle(tilt: float, height: float, seconds: float, rate: float, period: float = 4.0) -> Iterator[tuple]:
    """Yield set-points of a normal that leans by `tilt` [rad] to all sides in turn."""
    for k in range(round(seconds * rate)):
        azimuth = 2.0 * math.pi * k / (rate * period)
        yield math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), height


def main() -> None:
    """Stream a circle."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("port", help="of the board, such as /dev/ttyACM0")
    parser.add_argument("--tilt", type=float, default=10.0, help="in degrees")
    parser.add_argument("--height", type=float, required=True, help="of the platform's centre, in metres")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=50.0, help="set-points in a second")
    given = parser.parse_args()
    points = circle(math.radians(given.tilt), given.height, given.seconds, given.rate)
    try:
        counts = stream(given.port, points, given.rate)
    except OSError as error:
        sys.exit(f"{given.port}: {error.strerror}. Is the board plugged in, and may you open its port (group dialout)?")
    for status, count in counts.most_common():
        print(f"{status}: {count}")


if __name__ == "__main__":
    main()
