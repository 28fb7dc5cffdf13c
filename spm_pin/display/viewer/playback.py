"""The clock of a recorded path, or of the demo motion, in one session."""

from __future__ import annotations

import asyncio
import time as clock
from collections.abc import Callable

from spm_pin.display.viewer.event_queue import EventQueue

__all__ = ["Player"]

_INTERVAL = 1.0 / 25.0


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
