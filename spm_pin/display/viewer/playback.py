"""Recorded paths, read from CSV files, followed on a branch and played back by a clock; and the demo motion."""

from __future__ import annotations

import asyncio
import csv
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.kinematics.path_following import FollowedPath, follow
from spm_pin.mechanism import LEGS, Configuration, Geometry, pose
from spm_pin.mechanism.arguments import FloatArray, file_path
from spm_pin.proofs import Certificate, certify

_POSITION, _XYX, _QUATERNION = ("x", "y", "z"), ("alpha_deg", "beta_deg", "lambda_deg"), ("qx", "qy", "qz", "qw")
_KNOWN = {*LEGS, *_POSITION, *_XYX, *_QUATERNION, "t"}
_KNOWN |= {f"{leg}.{kind}" for leg in LEGS for kind in ("rate", "acceleration", "force")}
_COLUMNS = f"{', '.join(LEGS)}; or {', '.join(_POSITION)} with {', '.join(_XYX)}, or with {', '.join(_QUATERNION)}"
_SECONDS = 10.0
"""Duration of the demo motion, and of a path without times."""
_POINTS = 81
_INTERVAL = 1.0 / 25.0  # between two moments of a path that is played [s]
# Directions of the six legs' motion, found by a search for large motions of the paper's machine: the legs go along the
# first and back, and swing along the second meanwhile.
_ALONG = np.array([0.52, 0.05, 0.25, 0.75, -0.11, -0.30])
_ACROSS = np.array([-0.45, 0.61, -0.25, -0.32, 0.34, 0.37])


@dataclass(frozen=True)
class Recording:
    """A recorded path: poses (n,) of {m} in {B}, or readings (n, 6) [m]."""

    points: RigidTransform | FloatArray
    """Poses (n,) of {m} in {B}, or readings of the encoders [m], shape (n, 6)."""
    times: FloatArray
    """When it was at each (n,) [s], increasing from 0."""

    def follow(self, geometry: Geometry, start: Configuration | str | None = None) -> Playback:
        """Follow a solution along the path, by default the physical one; see `spm_pin.follow`."""
        return Playback(follow(geometry, self.points, start, certificate=_certificate(geometry)), self.times)


def read_recording(path: str | Path) -> Recording:
    """Read a recorded path from a CSV file.

    Parameters
    ----------
    path : str or Path
        The file: a header naming its columns, then numbers. ``r_b1`` to ``r_c3``, the readings [m]; or ``x, y, z`` [m]
        with ``alpha_deg, beta_deg, lambda_deg``, the X-Y-X angles in degrees, or with the quaternion
        ``qx, qy, qz, qw``. With a column ``t``, times [s]; else the path takes ten seconds. The further columns of
        ``spm-pin move`` are not shown.
    """
    path = file_path(path, suffixes=(".csv",))
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.reader(line for line in file if line.strip() and not line.lstrip().startswith("#"))
            header = [name.strip() for name in next(rows, [])]
            table = np.array([[float(cell) for cell in row] for row in rows])
    except OSError as error:
        raise ArgumentError("path", "a readable file", path, str(error.strerror or error)) from error
    except UnicodeDecodeError as error:
        raise ArgumentError("path", "a text file in UTF-8", path, str(error)) from error
    except ValueError as error:
        raise ArgumentError(str(path), "a header, then numbers only", str(error)) from error
    if not header or len({*header} & _KNOWN) != len(header):
        raise ArgumentError(str(path), f"a header of the columns {_COLUMNS}; and t", ", ".join(header) or "none")
    if table.ndim != 2 or table.shape[1] != len(header) or len(table) < 2 or not np.isfinite(table).all():
        raise ArgumentError(str(path), f"two rows or more of {len(header)} finite numbers", f"shape {table.shape}")
    columns = dict(zip(header, table.T, strict=True))
    groups = [names for names in (LEGS, _POSITION, _XYX, _QUATERNION) if {*names} <= {*header}]
    values = [np.stack([columns[name] for name in names], axis=-1) for names in groups]
    points: RigidTransform | FloatArray
    if groups == [LEGS]:
        points = values[0]
    elif groups == [_POSITION, _XYX]:
        points = pose(values[0], xyx=np.deg2rad(values[1]))
    elif groups == [_POSITION, _QUATERNION]:
        norms = np.linalg.norm(values[1], axis=-1)
        worst = int(np.abs(norms - 1.0).argmax())
        if not abs(norms[worst] - 1.0) <= 1e-3:
            raise ArgumentError(str(path), "unit quaternions", f"length {norms[worst]:g} in row {worst + 1}")
        points = pose(values[0], rotation=Rotation.from_quat(values[1]))
    else:
        raise ArgumentError(str(path), f"the columns {_COLUMNS}", ", ".join(header))
    times = columns.get("t", np.linspace(0.0, _SECONDS, len(table)))
    if not (np.diff(times) > 0.0).all():
        raise ArgumentError(f"t in {path}", "growing times in seconds", "others", "Not in order, or one twice?")
    return Recording(points, times - times[0])


@lru_cache
def _certificate(geometry: Geometry) -> Certificate | None:
    """Return the certificate of a geometry's leg limits; None if it has none that holds."""
    try:
        certificate = certify(geometry, boxes=100_000)
    except SpmError:
        return None
    return certificate if certificate.holds else None


@dataclass(frozen=True)
class Playback:
    """A followed path, to be shown at any time."""

    path: FollowedPath
    """The solution followed along the recorded points."""
    times: FloatArray
    """When the recorded points (n,) were reached [s]."""

    @property
    def duration(self) -> float:
        """Time of the last recorded point [s], whether or not the solution lasts so long."""
        return float(self.times[-1])

    def time(self, parameter: float | FloatArray) -> FloatArray:
        """Return when the path is at parameters (...) from 0 to 1 [s]."""
        return np.asarray(np.interp(parameter, np.linspace(0.0, 1.0, len(self.times)), self.times))

    def state_at(self, time: float) -> tuple[Configuration, str]:
        """Return the solved configuration nearest to a time [s], its last where the solution ended, and its label."""
        index = int(np.abs(self.time(self.path.parameters) - time).argmin())
        return self.path.configurations[index], self.path.labels[index]

    def report(self, now: float, most: int = 12) -> list[str]:
        """Return lines on how far the solution lasts and on its first events; ● marks those before `now` [s]."""
        events = self.path.events
        lines = [f"{len(self.path.parameters)} configurations of {self.path.labels[0]}"]
        if not self.path.complete:
            last = self.time(self.path.parameters[-1])
            lines.append(f"⚠ The solution ends at {last:.2f} s; the last is shown from there on.")
        if self.path.certified is not None:
            inside = int(self.path.certified.sum())
            share = "All" if self.path.certified.all() else f"{inside}"
            lines.append(f"{share} of them in certified limits: the only ones of their leg lengths.")
        for event in events[:most]:
            time = self.time(event.parameter)
            lines.append(f"{'●' if time <= now else '○'} {time:.2f} s: {event.kind}, {event.detail}")
        if len(events) > most:
            lines.append(f"… and {len(events) - most} more events")
        return lines


class EventQueue:
    """Runs actions one after another in a worker thread, while the event loop goes on taking messages.

    A drag sends poses faster than pictures can be made of them: an action still waiting is replaced by a later one
    under the same key, in its place. `post` and `close` belong to the event loop's thread. There is a task only as
    long as there is something to do.

    `on_error` is called with an exception that an action raised.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: dict[str, Callable[[], Any]] = {}
        self._task: asyncio.Task[None] | None = None
        self.closed = False

    def post(self, key: str, action: Callable[[], Any]) -> None:
        """Run an action after those posted before; it replaces one of the same key that has not begun."""
        if self.closed:
            return
        self._waiting[key] = action
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._work())

    def close(self) -> None:
        """Drop waiting actions; the running one is completed."""
        self.closed = True
        self._waiting.clear()

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


class Player:
    """Runs the time of a path from 0 to its duration [s]; all methods belong to the event loop's thread.

    `show` shows the path at a time [s], in the worker of `queue`; with `repeat` the path begins again at the end.
    """

    def __init__(
        self, queue: EventQueue, show: Callable[[float], None], duration: float, *, repeat: bool = False
    ) -> None:
        self._queue = queue
        self._show = show
        self.duration = duration
        self.repeat = repeat
        self.time = 0.0
        self._task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """True while the path is played."""
        return self._task is not None

    def stop(self) -> None:
        """Stop where it is."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def play(self) -> None:
        """Run on from where it is, or from the beginning where it has ended."""
        if self._task is None and not self._queue.closed:
            self._task = asyncio.get_running_loop().create_task(self._run())

    def toggle(self) -> None:
        """Play or stop."""
        if self.playing:
            self.stop()
        else:
            self.play()

    async def _run(self) -> None:
        start = clock.perf_counter() - (self.time if self.time < self.duration else 0.0)
        while True:
            elapsed = clock.perf_counter() - start
            self.time = elapsed % self.duration if self.repeat else min(elapsed, self.duration)
            self._queue.post("frame", lambda time=self.time: self._show(time))  # type: ignore[misc]
            if elapsed >= self.duration and not self.repeat:
                break
            await asyncio.sleep(_INTERVAL)
        self._task = None


def demo_motion(start: Configuration) -> Playback | None:
    """Return a small loop of leg lengths from a configuration and back, followed; None where there is no such path.

    Its size is halved until no singularity and no leg limit lies on it.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS)[:, None]
    swing = (1.0 - np.cos(angles)) * (_ALONG + 0.5 * np.sin(2.0 * angles) * _ACROSS)
    times = np.linspace(0.0, _SECONDS, _POINTS)
    for size in (0.1375, 0.07, 0.035):
        lengths = start.readings + size * start.geometry.middle_side * swing
        if lengths.min() <= 0.0:
            continue
        try:
            playback = Recording(lengths, times).follow(start.geometry, start)
        except SpmError:
            return None
        if playback.path.complete and not playback.path.events:
            return playback
    return None
