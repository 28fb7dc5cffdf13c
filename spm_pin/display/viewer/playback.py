"""Recorded paths, read from CSV files, followed on a branch and played, and the motion of the demo."""

from __future__ import annotations

import asyncio
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.kinematics.path_following import follow
from spm_pin.kinematics.tracking import FollowedPath
from spm_pin.machine import LEGS, Configuration, Manipulator
from spm_pin.machine.machine import unit_hint
from spm_pin.support.arguments import FloatArray
from spm_pin.support.motion_table import POSITION, QUATERNION, MotionTable

_SECONDS = 10.0  # duration of the demo motion, and of a path without times
_POINTS = 81
_INTERVAL = 1.0 / 25.0  # between two moments of a path being played [s]
# Directions of the six legs' motion, found by a search for large motions of the paper's machine: the legs move along
# the first and back, and swing along the second meanwhile.
_ALONG = np.array([0.52, 0.05, 0.25, 0.75, -0.11, -0.30])
_ACROSS = np.array([-0.45, 0.61, -0.25, -0.32, 0.34, 0.37])


@dataclass(frozen=True)
class Recording:
    """A recorded path."""

    points: RigidTransform | FloatArray
    """Poses (n,) of {m} in {B}, or readings of the encoders [m], shape (n, 6)."""
    times: FloatArray
    """Times of the points (n,) [s], increasing from 0."""

    def follow(self, machine: Manipulator, start: Configuration | str | None = None) -> Playback:
        """Follow a solution along the path, by default the physical one; see `spm_pin.follow`."""
        self.check_unit(machine)
        return Playback(follow(machine, self.points, start), self.times)

    def check_unit(self, machine: Manipulator) -> None:
        """Raise `ArgumentError` if lengths are out of proportion to the machine."""
        lengths = self.points.translation if isinstance(self.points, RigidTransform) else self.points
        if hint := unit_hint(machine, lengths):
            raise ArgumentError("points", "lengths in metres", f"values up to {np.abs(lengths).max():g}", hint)


def read_recording(path: str | Path) -> Recording:
    """Read a recorded path from a CSV file, as `spm-pin move` and `JointTrajectory.to_csv` write them.

    Parameters
    ----------
    path : str or Path
        The file: a heading that names the columns, then numbers. ``r_b1`` to ``r_c3``, the readings [m]; or ``x``,
        ``y``, ``z`` [m] with the quaternion ``qx``, ``qy``, ``qz``, ``qw``. With a column ``time`` [s] the path is
        timed; otherwise it takes ten seconds. Other columns are ignored.
    """
    table = MotionTable(path)
    points = table.columns(LEGS) if table.has(LEGS) else table.poses()
    if points is None or (isinstance(points, np.ndarray) and points.shape[-1] == len(POSITION)):
        expected = f"the columns {', '.join(LEGS)}; or {', '.join((*POSITION, *QUATERNION))}"
        raise ArgumentError(str(path), expected, "positions alone" if points is not None else "neither")
    if len(table) < 2:
        raise ArgumentError(str(path), "at least two rows", "one row")
    times = table.times()
    if times is None:
        times = np.linspace(0.0, _SECONDS, len(table))
    return Recording(points, times - times[0])


@dataclass(frozen=True)
class Playback:
    """A followed path, to be shown at any time."""

    path: FollowedPath
    """The solution followed along the recorded points."""
    times: FloatArray
    """Times of the recorded points (n,) [s]."""

    def time(self, parameter: float | FloatArray) -> FloatArray:
        """Return the times of the path at parameters (...) from 0 to 1 [s]."""
        return np.asarray(np.interp(parameter, np.linspace(0.0, 1.0, len(self.times)), self.times))

    def state_at(self, time: float) -> Configuration:
        """Return the solved configuration nearest to a time [s], or the last one after the end of the solution."""
        return self.path.configurations[int(np.abs(self.time(self.path.parameters) - time).argmin())]

    def report(self, now: float, most: int = 12) -> list[str]:
        """Return lines on the extent of the solution and on its first events; ● marks those before `now` [s]."""
        events = self.path.events
        lines = [f"{len(self.path.parameters)} configurations of {self.path.labels[0]}"]
        if not self.path.complete:
            last = self.time(self.path.parameters[-1])
            lines.append(f"⚠ The solution ends at {last:.2f} s; the last is shown from there on.")
        for event in events[:most]:
            time = self.time(event.parameter)
            lines.append(f"{'●' if time <= now else '○'} {time:.2f} s: {event.kind}, {event.detail}")
        if len(events) > most:
            lines.append(f"… and {len(events) - most} more events")
        return lines


def demo_motion(start: Configuration) -> Playback | None:
    """Return the path of a small closed loop of readings that meets no singularity and no limit, or None."""
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS)[:, None]
    swing = (1.0 - np.cos(angles)) * (_ALONG + 0.5 * np.sin(2.0 * angles) * _ACROSS)
    times = np.linspace(0.0, _SECONDS, _POINTS)
    for size in (0.1375, 0.07, 0.035):
        readings = start.readings + size * start.machine.middle_side * swing / start.slopes
        if (readings <= start.machine.legs.least_readings).any():
            continue
        try:
            playback = Recording(readings, times).follow(start.machine, start)
        except SpmError:
            return None
        if playback.path.complete and not playback.path.events:
            return playback
    return None


class Player:
    """Runs the time of a path from 0 to its duration [s]; all methods must be called in the event loop's thread.

    `show` shows the path at a time [s]; `post` puts it into an event queue, and returns False once that is closed. With
    `repeat` the path begins again at the end.
    """

    def __init__(
        self,
        post: Callable[[str, Callable[[], Any]], bool],
        show: Callable[[float], None],
        duration: float,
        *,
        repeat: bool,
    ) -> None:
        self._post, self._show, self._duration, self._repeat = post, show, duration, repeat
        self.time = 0.0
        self._task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """True while the path is played."""
        return self._task is not None

    def stop(self) -> None:
        """Stop at the present time."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def toggle(self) -> None:
        """Stop, or continue from the present time, after the end from the beginning."""
        if self.playing:
            self.stop()
        else:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def _run(self) -> None:
        start = clock.perf_counter() - (self.time if self.time < self._duration else 0.0)
        while True:
            elapsed = clock.perf_counter() - start
            self.time = elapsed % self._duration if self._repeat else min(elapsed, self._duration)
            is_open = self._post("frame", partial(self._show, self.time))
            if not is_open or (elapsed >= self._duration and not self._repeat):
                break
            await asyncio.sleep(_INTERVAL)
        self._task = None
