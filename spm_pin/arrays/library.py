"""Arrays of any library that follows the Array API standard, as numbers that the formulas run on."""

from __future__ import annotations

import functools
import importlib
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.formulas.operations import bind, mapped
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import check_shapes, type_and_value

try:
    import array_api_compat as compat
except ImportError as error:
    raise MissingExtraError("arrays", "array_api_compat") from error

Array = Any
"""An array of any library that follows the standard."""
_AXES = {"rotation": (3, 3), "translation": (3,), "middle_joints": (3, 3), "readings": (6,), "wrench": (6,)}
"""The last axes of arrays by their names."""
quietly = np.errstate(all="ignore")
"""Decorates functions in which numbers of what does not exist are no reason for NumPy's warnings."""


class Library:
    """A library of arrays with one type of floats: runs formulas on tuples of arrays, entry by entry."""

    def __init__(self, namespace: Any, dtype: Any) -> None:
        self.xp, self.dtype = namespace, dtype
        self.eps = float(namespace.finfo(dtype).eps)
        self.is_jax = compat.is_jax_namespace(namespace)
        self.has_derivatives = self.is_jax or compat.is_torch_namespace(namespace)
        self.least = self.eps**2.5
        self._bound: dict[Any, Callable[..., Any]] = {}

    def run(self, formula: Callable[..., Any], *arguments: Any) -> Any:
        """Run a formula of `spm_pin.formulas` on numbers, arrays, and tuples of them."""
        if formula not in self._bound:
            self._bound[formula] = bind(formula, sqrt=self.sqrt, where=self.where, cos=self.xp.cos, sin=self.xp.sin)
        return self._bound[formula](*arguments)

    def sqrt(self, x: Any) -> Any:
        """Return the square root, of zero and less a tiny number: derivatives stay finite."""
        if type(x) is float:
            return math.sqrt(x)
        return self.xp.sqrt(self.xp.where(x > self.least, x, self.least))

    def where(self, condition: Any, yes: Any, no: Any) -> Any:
        """Select entry by entry."""
        if isinstance(condition, bool):
            return yes if condition else no
        if type(yes) is float and type(no) is float:
            yes = self.xp.full_like(condition, yes, dtype=self.dtype)
        return self.xp.where(condition, yes, no)

    def select(self, condition: Array, yes: Any, no: Any) -> Any:
        """Select between nested tuples of equal structure, entry by entry."""
        return mapped(functools.partial(self.where, condition), yes, no)

    def zeros(self, *numbers: Any) -> Array:
        """Return zeros of the shape that numbers have together, through which no derivative goes."""
        return self.xp.zeros_like(sum(numbers))

    def together(self, trees: Sequence[Any], zero: Array) -> Any:
        """Return nested tuples of equal structure as one, along a first axis.

        So a formula runs once for all branches: compilers take long for many lines, not for large arrays.
        """
        return mapped(lambda *parts: self.xp.stack([x + zero for x in parts]), *trees)

    def repeated(self, step: Callable[[Any], Any], state: Any, times: int) -> Any:
        """Apply a step to nested tuples of arrays several times."""
        if self.is_jax:
            return importlib.import_module("jax.lax").fori_loop(0, times, lambda _, x: step(x), state)
        for _ in range(times):
            state = step(state)
        return state

    def constant(self, tree: Any) -> Any:
        """Return nested tuples through which no derivative goes."""
        if not self.has_derivatives:
            return tree
        stop = importlib.import_module("jax.lax").stop_gradient if self.is_jax else operator.methodcaller("detach")
        return mapped(lambda x: stop(x) if hasattr(x, "dtype") else x, tree)

    def stacked(self, entries: Sequence[Any], zero: Array) -> Array:
        """Return nested sequences of numbers or arrays as one array whose last axes count them."""
        parts = [self.stacked(x, zero) if isinstance(x, tuple | list) else x + zero for x in entries]
        return self.xp.stack(parts, axis=zero.ndim - parts[0].ndim - 1)


_library = functools.cache(Library)


def library_of(**arguments: Array | Geometry) -> Library:
    """Return the library of arguments, arrays of floats of one library whose shapes fit their names."""
    arrays = {name: x for name, x in arguments.items() if not isinstance(x, Geometry)}
    for name, x in arrays.items():
        if not compat.is_array_api_obj(x):
            raise ArgumentError(name, "an array of a library that follows the Array API standard", type_and_value(x))
    spaces = {name: compat.array_namespace(x) for name, x in arrays.items()}
    kinds = {name: space.__name__.removeprefix("array_api_compat.") for name, space in spaces.items()}
    if len(set(kinds.values())) > 1:
        received = ", ".join(f"{name} is {kind}" for name, kind in kinds.items())
        cause = f"Convert them, as by {max(kinds.values(), key='numpy'.__ne__)}.asarray"
        raise ArgumentError(", ".join(arrays), "arrays of one library", received, cause)
    namespace = next(iter(spaces.values()))
    for name, x in arrays.items():
        if not namespace.isdtype(x.dtype, "real floating") or namespace.finfo(x.dtype).bits < 32:
            raise ArgumentError(name, "an array of floating-point numbers of 32 or 64 bits", f"dtype {x.dtype}")
    check_shapes({name: tuple(x.shape) for name, x in arrays.items()}, _AXES)
    return _library(namespace, namespace.result_type(*arrays.values()))
