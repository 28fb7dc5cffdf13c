"""Typed wrapper around Numba: inlined formulas, and kernels compiled when first called and kept on disk."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numba
from numba.core import caching, runtime

P = ParamSpec("P")
R = TypeVar("R")

TILE = 16
"""Problems computed side by side: two or more registers' worth on every processor, and small enough for its cache."""

_OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
# Numba's own annotations are partial.
_njit: Any = numba.njit
_numba_cache: Any = caching.FunctionCache
_config: Any = numba.config
_runtime: Any = runtime
_types: Any = numba.types
_LOG = logging.getLogger("spm_pin")
# What one kernel is made of is spread over these files, and Numba's cache looks at the kernel's own alone.
_SOURCES = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()


def jit_inline(function: Callable[P, R]) -> Formula[P, R]:
    """Mark a formula that kernels call; it becomes part of their loops."""
    return Formula(function, inline=True)


def jit(function: Callable[P, R]) -> Formula[P, R]:
    """Mark a function that kernels call as such, for it is too long to be copied to every place it is called from."""
    return Formula(function, inline=False)


def kernel(signature: str) -> Callable[[Callable[P, R]], Kernel[P, R]]:
    """Mark a kernel, compiled for one Numba signature."""
    return lambda function: Kernel(function, signature)


def readonly_array(axes: int) -> str:
    """Return the signature of an array of floats that is only read: of any strides."""
    return f"Array(f8, {axes}, 'A', True)"


class Formula(Generic[P, R]):
    """A function that kernels call: compiled as part of them, interpreted where Python calls it, on any numbers."""

    def __init__(self, function: Callable[P, R], inline: bool) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._inline = inline

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the function as Python does."""
        return self.py_func(*args, **kwargs)

    @functools.cached_property
    def _numba_type_(self) -> Any:
        """The type of this function in the source of a kernel."""
        dispatcher = _njit(forceinline=self._inline, no_cpython_wrapper=True, **_OPTIONS)(self.py_func)
        of_literals = dispatcher.get_call_template
        # Compiled once for all values of a whole number, not for each that some call contains.
        dispatcher.get_call_template = lambda args, kws: of_literals(tuple(map(_types.unliteral, args)), kws)
        self._dispatcher = dispatcher  # its type refers to it weakly
        return _types.Dispatcher(dispatcher)


class Kernel(Generic[P, R]):
    """A function compiled at its first call, or loaded from Numba's cache if it has been compiled before.

    The cache is `NUMBA_CACHE_DIR` if set, else beside the source, else in the user's cache directory; without a place
    that can be written, every process compiles for itself.
    """

    def __init__(self, function: Callable[P, R], signature: str) -> None:
        self.py_func = function
        self._signature = signature
        self._lock = threading.Lock()
        self._compiled: Callable[P, R] | None = None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the compiled function, without the interpreter's lock."""
        return (self._compiled or self.compile())(*args, **kwargs)

    def compile(self) -> Callable[P, R]:
        """Return the compiled function, loaded from the cache if it is there."""
        with self._lock:
            if self._compiled is None and _config.DISABLE_JIT:
                self._compiled = self.py_func
            elif self._compiled is None:
                dispatcher = _njit(**_OPTIONS)(self.py_func)
                try:
                    dispatcher._cache = _Cache(self.py_func)
                except RuntimeError:  # no place for a cache
                    _announce("at every start, for no cache can be written, see NUMBA_CACHE_DIR")
                dispatcher.compile(self._signature)
                dispatcher.disable_compile()
                self._compiled = dispatcher
            return self._compiled

    def assembly(self) -> str:
        """Compile anew, and return the machine code as assembly language."""
        dispatcher = _njit(**_OPTIONS)(self.py_func)
        dispatcher.compile(self._signature)
        return "".join(dispatcher.inspect_asm().values())


class _Cache:
    """Numba's cache on disk, keyed by all sources of the kernels, that no file system can turn into an error."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._inner = _numba_cache(function)
        own_key = self._inner._index_key
        self._inner._index_key = lambda sig, codegen: (*own_key(sig, codegen), _SOURCES)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = None
        try:
            # Not Numba's own `load_overload`: that imports, for a third of a first call, all that compiling needs.
            _runtime.rtsys.initialize(target_context)
            with self._inner._guard_against_spurious_io_errors():
                found = self._inner._load_overload(sig, target_context)
        except Exception as error:  # a damaged file may raise anything
            _LOG.info("spm_pin: the cache of compiled kernels cannot be read, and is emptied: %r", error)
            found = None
            with contextlib.suppress(OSError):
                self._inner.flush()
        if found is None:
            _announce("for this machine, once")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            self._inner.save_overload(sig, data)
        except OSError as error:
            _LOG.warning("spm_pin: the compiled kernel cannot be kept, see NUMBA_CACHE_DIR: %s", error)


@functools.cache
def _announce(when: str) -> None:
    """Log, once in a process, that kernels are compiled, and how long that takes."""
    _LOG.warning(
        "spm_pin: compiling %s. A function's first call takes 1 to 20 s, all functions together a minute, more on a "
        "busy machine; spm_pin.kinematics.compile_kernels() compiles everything in advance",
        when,
    )
