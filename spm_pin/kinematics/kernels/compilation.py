"""Kernels, interpreted for little work and compiled by Numba for more, and the formulas that they are made of.

Numba is imported, and all functions are registered with it, when the first kernel is compiled or loaded from its cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import logging
import pkgutil
import sys
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.formulas import operations
from spm_pin.formulas.operations import F
from spm_pin.formulas.vectors import Rows, Vector
from spm_pin.support.arguments import FloatArray
from spm_pin.support.compiling import COMPILING, forced

ByteArray = npt.NDArray[np.uint8]
ComplexArray = npt.NDArray[np.complex128]
OK, UNREACHABLE, DEGENERATE, UNSOLVED = 0, 1, 2, 3
"""The numbers of `Status`, which stands in a file that the digest of kernels does not cover."""
TILE = 16
"""Problems computed side by side: two or more registers' worth on every processor, and small enough for its cache."""
_FEW_MEMBERS, _SHORT, _LONG = 50, 0.1, 1.5
"""Members that are always few, and times [s] for which a kernel is always, and is never, interpreted."""

_LOG = logging.getLogger("spm_pin")
_FORMULAS = Path(operations.__file__).parent
_FOLDERS = Path(__file__).parent, _FORMULAS
_functions: list[tuple[Callable[..., Any], dict[str, Any]]] = []
"""Functions that kernels may call, with their options, as far as Numba does not know them yet."""
_expected: ContextVar[int] = ContextVar("spm_pin_expected_members", default=0)


def jit(function: F) -> F:
    """Let kernels call a function that is too long to be copied to every place it is called from."""
    _functions.append((function, {}))
    return function


def jit_inline(function: F) -> F:
    """Let kernels call a function, which becomes part of their loops."""
    # Passed on to `njit`. Left to LLVM, formulas stay calls in the loop, which then takes one problem at a time.
    _functions.append((function, {"forceinline": True}))
    return function


@jit_inline
def vector_at(array: FloatArray, first: int) -> Vector:
    """Return three numbers of an array (n,) from `first` on."""
    return array[first], array[first + 1], array[first + 2]


@jit_inline
def rows_at(array: FloatArray, first: int) -> Rows:
    """Return three rows of an array (n, 3) of vectors from `first` on as numbers."""
    return vector_at(array[first], 0), vector_at(array[first + 1], 0), vector_at(array[first + 2], 0)


@jit_inline
def put_rows(rows: Rows, array: FloatArray) -> None:
    """Write three vectors as the rows of an array (3, 3)."""
    for i in range(3):
        for j in range(3):
            array[i, j] = rows[i][j]


@jit_inline
def vector(tile: FloatArray, row: int, k: int) -> Vector:
    """Return the vector in the rows `row` to `row + 2` of problem k of a tile."""
    return tile[row, k], tile[row + 1, k], tile[row + 2, k]


@jit_inline
def matrix(tile: FloatArray, row: int, k: int) -> Rows:
    """Return the matrix in the nine rows from `row` on, row by row, of problem k of a tile."""
    return vector(tile, row, k), vector(tile, row + 3, k), vector(tile, row + 6, k)


def kernel(signature: str, *, seconds: float = 1e-3, few: int = _FEW_MEMBERS) -> Callable[[Callable[..., Any]], Kernel]:
    """Mark a kernel, compiled for one Numba signature, that interprets a member in about so many seconds.

    Up to `few` members are interpreted if that is not long: more than the default where one answer needs more.
    """
    return lambda function: Kernel(function, signature, seconds, few)


def readonly_array(axes: int) -> str:
    """Return the signature of an array of floats that is only read: of any strides."""
    return f"Array(f8, {axes}, 'A', True)"


class Kernel:
    """A function that is interpreted while there is little to do, and compiled, or loaded from Numba's cache, for more.

    Both give the same bits. The cache is `NUMBA_CACHE_DIR` if set, else beside the source, else in the user's cache
    directory; without a place that can be written, every process compiles for itself.
    """

    def __init__(self, function: Callable[..., Any], signature: str, seconds: float, few: int = _FEW_MEMBERS) -> None:
        self.py_func = function
        self._signature, self._few = signature, few
        self._members, self._seconds, self._pace = 0, 0.0, seconds
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *args: Any) -> Any:
        """Run the function: if it is compiled, without the interpreter's lock."""
        if self._compiled is not None:
            return self._compiled(*args)
        members = len(args[-1] if isinstance(args[-1], np.ndarray) else args[0])
        if is_worth_compiling(self._members + members, self._seconds + members * self._pace, self._few):
            purpose = "once, for " + (f"a batch of {members}" if members > self._few else "repeated or long calls")
            return self.compile(purpose)(*args)
        begin = time.thread_time()  # not the clock on the wall, which other processes delay
        with np.errstate(all="ignore"):
            result = self.py_func(*[np.float64(x) if type(x) is float else x for x in args])
        self._members, self._seconds = self._members + members, self._seconds + time.thread_time() - begin
        self._pace = self._seconds / max(self._members, 1)
        return result

    def compile(self, purpose: str = "once, in advance") -> Callable[..., Any]:
        """Return the compiled function, loaded from the cache if it is there."""
        with COMPILING:
            if self._compiled is None:
                self._compiled = self._compile(purpose)
            return self._compiled

    def dispatcher(self, cache: bool) -> Any:
        """Return the function compiled by Numba, from the cache or for it if `cache` is true."""
        import numba

        _register()
        return numba.njit(self._signature, error_model="numpy", nogil=True, cache=cache)(self.py_func)

    def _compile(self, purpose: str) -> Any:
        from numba.core import event

        function = self.py_func
        function.__qualname__ = f"{function.__name__}_{_digest()}"
        compiling = _listener(function.__name__, purpose)
        with event.install_listener("numba:compile", compiling):
            try:
                return self.dispatcher(cache=True)
            except Exception as error:
                # Whatever is raised outside of compiling is a fault of the cache: no place, or a damaged file.
                if error is compiling.error:
                    raise
                _LOG.warning("spm_pin: Numba's cache cannot be used, see NUMBA_CACHE_DIR: %r", error)
                return self.dispatcher(cache=False)


def is_worth_compiling(members: int, seconds: float, few: int = _FEW_MEMBERS) -> bool:
    """Return whether a kernel is compiled, that would have interpreted so many members in so many seconds.

    Compiling takes 0.2 to 20 s, as long as interpreting 300 to 30,000 members; importing Numba and loading what is kept
    takes about 1 s. The interpreter is used for up to 0.1 s: a loop of 10,000 calls then takes at most a tenth longer
    than with everything compiled at first. The kernels that interpret fewer than 50 members in that time are those that
    take longest to compile, so it is 50 members for them, or 1.5 s.
    """
    if way := forced():
        return way == "compiled"
    members, seconds = members + _expected.get(), seconds + 1e-3 * _expected.get()
    return seconds > _SHORT and (members > few or seconds > _LONG)


@contextlib.contextmanager
def expecting(members: int) -> Iterator[None]:
    """Compile inside a ``with`` what is worth compiling for so many members, which other processes compute later."""
    token = _expected.set(members)
    try:
        yield
    finally:
        _expected.reset(token)


def _register() -> None:
    """Register with Numba all functions that kernels may call, each once."""
    from numba.extending import register_jitable

    _add_formulas()
    while _functions:
        function, options = _functions.pop()
        # Nothing but kernels calls it: the wrapper for C would be a tenth of the time of compiling.
        register_jitable(error_model="numpy", no_cfunc_wrapper=True, **options)(function)


@cache
def _add_formulas() -> None:
    """Let kernels call all formulas."""
    for module in pkgutil.iter_modules([str(_FORMULAS)], f"{operations.__package__}."):
        for formula in vars(import_module(module.name)).values():
            if inspect.isfunction(formula) and formula.__module__ == module.name:
                jit_inline(formula)


@cache
def _digest() -> str:
    """Return a digest of all kernels and formulas.

    Numba's cache looks at a kernel's own file alone. The name under which a kernel is kept ends with the digest: when
    a formula changes, no kernel that was kept before is found.
    """
    sources = b"".join(path.read_bytes() for folder in _FOLDERS for path in sorted(folder.glob("*.py")))
    return hashlib.sha256(sources).hexdigest()[:16]


def _listener(name: str, purpose: str) -> Any:
    """Return a listener that logs when Numba begins to compile, not when it loads, and keeps the error of compiling."""
    from numba.core import event

    class Compiling(event.Listener):
        error: BaseException | None = None

        def on_start(self, event: Any) -> None:
            _announce(name, purpose)

        def on_end(self, event: Any) -> None:
            self.error = sys.exc_info()[1]

    return Compiling()


_announced: set[str] = set()


def _announce(name: str, purpose: str) -> None:
    """Log once that a kernel is compiled and what for, and the first time in a process how long that takes."""
    if name in _announced:
        return
    advice = " (1 to 20 s; spm_pin.kinematics.compile_kernels() compiles all functions in advance, in a minute)"
    _LOG.warning("spm_pin: compiling %s %s%s", name, purpose, "" if _announced else advice)
    _announced.add(name)
