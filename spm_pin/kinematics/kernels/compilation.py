"""Kernels, compiled by Numba when first called and kept on disk, and the formulas that they are made of."""

from __future__ import annotations

import hashlib
import inspect
import logging
import pkgutil
import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numba.core import event
from numba.extending import register_jitable

from spm_pin.formulas import operations
from spm_pin.formulas.operations import F
from spm_pin.formulas.vectors import Rows, Vector
from spm_pin.mechanism.arguments import FloatArray

ByteArray = npt.NDArray[np.uint8]
ComplexArray = npt.NDArray[np.complex128]
OK, UNREACHABLE, DEGENERATE, UNSOLVED = 0, 1, 2, 3
"""The numbers of `Status`, which stands in a file that the digest of kernels does not cover."""
TILE = 16
"""Problems computed side by side: two or more registers' worth on every processor, and small enough for its cache."""

_config: Any = numba.config
_LOG = logging.getLogger("spm_pin")
# Numba's cache looks at a kernel's own file alone, but a kernel is made of formulas from many files. So the name under
# which a kernel is kept ends with a digest of all of them: when one changes, no kernel that was kept before is found.
_FORMULAS = Path(operations.__file__).parent
_FOLDERS = Path(__file__).parent, _FORMULAS
_SOURCES = hashlib.sha256(b"".join(p.read_bytes() for folder in _FOLDERS for p in sorted(folder.glob("*.py"))))

jit: Callable[[F], F] = register_jitable(error_model="numpy")
"""Let kernels call a function that is too long to be copied to every place it is called from."""
# Passed on to `njit`. Left to LLVM, formulas stay calls in the loop, which then takes one problem at a time.
jit_inline: Callable[[F], F] = register_jitable(error_model="numpy", forceinline=True)
"""Let kernels call a function, which becomes part of their loops."""


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


for _module in pkgutil.iter_modules([str(_FORMULAS)], f"{operations.__package__}."):
    for _formula in vars(import_module(_module.name)).values():
        if inspect.isfunction(_formula) and _formula.__module__ == _module.name:
            jit_inline(_formula)


def kernel(signature: str) -> Callable[[Callable[..., Any]], Kernel]:
    """Mark a kernel, compiled for one Numba signature."""
    return lambda function: Kernel(function, signature)


def readonly_array(axes: int) -> str:
    """Return the signature of an array of floats that is only read: of any strides."""
    return f"Array(f8, {axes}, 'A', True)"


class Kernel:
    """A function compiled at its first call, or loaded from Numba's cache if it has been compiled before.

    The cache is `NUMBA_CACHE_DIR` if set, else beside the source, else in the user's cache directory; without a place
    that can be written, every process compiles for itself.
    """

    def __init__(self, function: Callable[..., Any], signature: str) -> None:
        self.py_func = function
        self._signature = signature
        self._lock = threading.Lock()
        self._compiled: Callable[..., Any] | None = None

    def __call__(self, *args: Any) -> Any:
        """Run the compiled function, without the interpreter's lock."""
        return (self._compiled or self.compile())(*args)

    def compile(self) -> Callable[..., Any]:
        """Return the compiled function, loaded from the cache if it is there."""
        with self._lock:
            if self._compiled is None:
                self._compiled = self.py_func if _config.DISABLE_JIT else self._compile()
            return self._compiled

    def _compile(self) -> Callable[..., Any]:
        function = self.py_func
        function.__qualname__ = f"{function.__name__}_{_SOURCES.hexdigest()[:16]}"
        try:
            with event.install_listener("numba:compile", _Announcement(self.py_func.__name__)):
                return self._dispatcher(cache=True)
        except Exception as error:  # nowhere to keep it, or a damaged file, which may raise anything
            _LOG.warning("spm_pin: Numba's cache cannot be used, see NUMBA_CACHE_DIR: %r", error)
            _announce(function.__name__, "at every start")
            return self._dispatcher(cache=False)

    def _dispatcher(self, cache: bool) -> Callable[..., Any]:
        compiled: Callable[..., Any] = numba.njit(self._signature, error_model="numpy", nogil=True, cache=cache)(
            self.py_func
        )
        return compiled


class _Announcement(event.Listener):
    """Log that Numba begins to compile a function, not that it loads what is kept."""

    def __init__(self, name: str) -> None:
        self._name = name

    def on_start(self, event: Any) -> None:
        _announce(self._name, "for this machine, once")

    def on_end(self, event: Any) -> None:
        pass


_announced: set[str] = set()


def _announce(name: str, when: str) -> None:
    """Log once that a kernel is compiled, and the first time in a process how long that takes."""
    if name in _announced:
        return
    advice = " (1 to 20 s; spm_pin.kinematics.compile_kernels() compiles all functions in advance, in a minute)"
    _LOG.warning("spm_pin: compiling %s %s%s", name, when, "" if _announced else advice)
    _announced.add(name)
