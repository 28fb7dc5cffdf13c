"""Functions that are interpreted for little work, and compiled by Numba, once for all robots, for more.

Numba is imported, and all functions are registered with it, when the first kernel is compiled or loaded from its cache.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.support.compiling import COMPILING

_LOG = logging.getLogger("spm_pin")
_pending: list[tuple[Callable[..., Any], Callable[..., Any], dict[str, Any]]] = []
"""Functions that kernels call, what is compiled for each, and options, as far as Numba does not have them yet."""


def compiled_as(function: Any, **options: Any) -> Callable[[Any], Any]:
    """Let the decorated function be compiled where kernels call `function`, which is interpreted."""

    def mark(implementation: Any) -> Any:
        _pending.append((function, implementation, options))
        return implementation

    return mark


def jit(function: Any) -> Any:
    """Let kernels call a function."""
    return compiled_as(function)(function)


def inlined(function: Any) -> Any:
    """Let kernels call a small function of small arrays, of which the compiler then keeps the elements in registers."""
    return compiled_as(function, forceinline=True)(function)


class Kernel:
    """A function, `interpreted`, and the same as `call`, compiled or loaded from Numba's cache at its first call."""

    def __init__(self, function: Callable[..., Any], *modules: str) -> None:
        """`modules` are the files that the function is compiled from."""
        self._function, self._modules = function, modules
        self.is_loaded = False  # whether a call starts at once
        self.call: Callable[..., Any] = self._first_call

    def interpreted(self, *arguments: Any) -> Any:
        """Run the function without Numba: on numbers that are not finite it is as silent as compiled."""
        with np.errstate(all="ignore"):
            return self._function(*arguments)

    def is_kept(self) -> bool:
        """Return whether Numba's cache has the function, so that a first call only loads it."""
        import numba

        try:
            place = Path(str(numba.njit(cache=True)(self._named).stats.cache_path))
        except RuntimeError:  # nowhere to keep it
            return False
        return any(place.glob(f"*{self._function.__qualname__}-*.nbi"))

    @cached_property
    def _named(self) -> Callable[..., Any]:
        """The function, its name with a digest of all that is compiled: Numba's cache looks at one file alone."""
        digest = hashlib.sha256(b"".join(Path(module).read_bytes() for module in self._modules)).hexdigest()
        self._function.__qualname__ = f"{self._function.__name__}_{digest[:16]}"
        return self._function

    def _first_call(self, *arguments: Any) -> Any:
        import numba
        from numba.core import event

        from spm_pin.loops.numba_types import Announcement, register

        with COMPILING:
            if not self.is_loaded:
                while _pending:
                    register(*_pending.pop())
                signature = tuple(map(numba.typeof, arguments))
                compiled: Any
                try:
                    with event.install_listener("numba:compile", Announcement()):
                        compiled = numba.njit(signature, error_model="numpy", nogil=True, cache=True)(self._named)
                except Exception as error:  # nowhere to keep it, or a damaged file, which may raise anything
                    _LOG.warning("spm_pin: Numba's cache cannot be used, see NUMBA_CACHE_DIR: %r", error)
                    compiled = numba.njit(signature, error_model="numpy", nogil=True)(self._named)
                # The function behind the dispatcher, which looks for the types of all arguments in a microsecond.
                self.call, self.is_loaded = next(iter(compiled.overloads.values())).entry_point, True
        return self.call(*arguments)
