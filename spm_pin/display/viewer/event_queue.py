"""A serial queue of a session's events; a later event replaces a pending one of its kind."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

Action = Callable[[], Any]


class EventQueue:
    """Runs actions one after another in a worker thread, while the event loop goes on taking messages.

    A drag sends poses faster than pictures can be made of them: an action still waiting is replaced by a later one
    under the same key, in its place. `post` and `close` belong to the event loop's thread. There is a task only as
    long as there is something to do.

    `on_error` is called with an exception that an action raised.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._waiting: dict[str, Action] = {}
        self._task: asyncio.Task[None] | None = None
        self.closed = False

    def post(self, key: str, action: Action) -> None:
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
