"""Playing a recorded path back in a session."""

from __future__ import annotations

import asyncio
import time as clock
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from spm_pin.closed_form.path_events import Event
from spm_pin.display.viewer.recording import Playback
from spm_pin.errors import ArgumentError

if TYPE_CHECKING:
    from spm_pin.display.viewer.session import Session

__all__ = ["Player"]

_INTERVAL = 1.0 / 25.0


class Player:
    """Runs the time of one session's recorded path. It follows the branch that is shown where the path begins."""

    def __init__(self, session: Session) -> None:
        assert session.exhibit.recording is not None
        self.session = session
        self.recording = session.exhibit.recording
        self.playback: Playback | None = None
        self.time = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def playing(self) -> bool:
        """Whether time runs."""
        return self._task is not None

    def bind(self, loop: asyncio.AbstractEventLoop) -> None:
        """Name the event loop on which time runs."""
        self._loop = loop

    def close(self) -> None:
        """Stop for good; on the event loop."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def toggle(self) -> None:
        """Play or pause; in the session's worker."""
        self._follow()
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._start_or_stop)

    def seek(self, time: float) -> None:
        """Show the path at a time [s]; in the session's worker."""
        self._follow()
        self.time = time
        self._show(moved=True)

    def _start_or_stop(self) -> None:
        if self._task is not None:
            self.close()
        elif not self.session.inbox.closed:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def _run(self) -> None:
        assert self.playback is not None
        duration = self.playback.duration
        start = clock.perf_counter() - (self.time if self.time < duration else 0.0)
        while True:
            self.time = min(clock.perf_counter() - start, duration)
            self.session.inbox.post("frame", self._show)
            if self.time >= duration:
                break
            await asyncio.sleep(_INTERVAL)
        self._task = None

    def _follow(self) -> None:
        """Follow the branch that is shown, if it is real where the path begins, else the physical one."""
        if self.playback is not None:
            return
        panel, geometry = self.session.panel, self.session.exhibit.robot.geometry
        panel.path_note.content = _note("Following the branch along the path …")
        # A path of leg lengths begins in an assembly mode, which has other names; the nearest is meant.
        state = self.session.state
        start = state.shown if isinstance(self.recording.points, np.ndarray) else (state.label or None)
        try:
            self.playback = self.recording.follow(geometry, start)
        except ArgumentError:
            try:
                self.playback = self.recording.follow(geometry)
            except ArgumentError as error:
                panel.path_note.content = _note(f"⚠ {error}")
                raise
        points = np.asarray(self.playback.path.configurations.translation, np.float32)
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        if len(pieces):
            self.session.client.scene.add_line_segments("/path", pieces, colors=(204, 121, 167))

    def _show(self, moved: bool = False) -> None:
        if self.playback is None:
            return
        configuration, _ = self.playback.at(self.time)
        self.session.model.place(configuration)
        self.session.show()
        panel = self.session.panel
        if not moved:
            panel.time.value = self.time
        panel.path_note.content = self._events(self.playback)

    def _events(self, playback: Playback) -> str:
        events = playback.path.events
        lines = [f"{len(playback.path.parameters)} configurations of {playback.path.labels[0]}"]
        if not playback.path.complete:
            last = playback.time(float(playback.path.parameters[-1]))
            lines.append(f"⚠ The solution ends at {last:.2f} s; the last is shown from there on.")
        lines += [_line(event, playback.time(event.parameter), self.time) for event in events[:12]]
        if len(events) > 12:
            lines.append(f"… and {len(events) - 12} more events")
        return _note(*lines)


def _line(event: Event, at: float, now: float) -> str:
    return f"{'●' if at <= now else '○'} {at:.2f} s: {event.kind}, {event.detail}"


def _note(*lines: str) -> str:
    text = "<br>".join(escape(line) for line in lines)
    return f'<div data-spm="path" style="padding:0.35em 0.6em;font-size:0.8rem">{text}</div>'
