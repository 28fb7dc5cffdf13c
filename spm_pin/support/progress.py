"""Progress of long work: reported to a given function, or shown in a line on the terminal."""

from __future__ import annotations

import sys
import time

from spm_pin.support.arguments import Progress, check_progress

_PATIENCE, _PERIOD = 5.0, 0.5
"""Seconds before the line appears, and between its updates."""


def shown_progress(progress: Progress | None) -> Progress:
    """Return `progress`, or a function that shows a line on stderr if that is a terminal or a notebook.

    The line appears after five seconds and disappears when the work is done.
    """
    check_progress(progress)
    return _Line() if progress is None else progress


class _Line:
    """A line that is overwritten repeatedly."""

    def __init__(self) -> None:
        self._next = time.monotonic() + _PATIENCE
        self._width = 0

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._width and done >= total:
            self._write("")
        elif done < total and time.monotonic() >= self._next:
            self._next = time.monotonic() + _PERIOD
            self._write(f"{what}: {done} of {total}, {100.0 * done / total:.0f} %")

    def _write(self, text: str) -> None:
        if sys.stderr.isatty() or "ipykernel" in sys.modules:
            print(f"\r{' ' * self._width}\r{text}", end="", file=sys.stderr, flush=True)
            self._width = len(text)
