"""Operations of formulas besides + - * / and comparisons, for floats, and their replacement by other backends."""

from __future__ import annotations

import math
import types
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

COS_30 = float(np.sqrt(0.75))
"""The cosine of 30°. If floats are not exact enough, a backend binds another number to this name."""
RIGHT_ANGLE = float(np.pi / 2.0)
"""The angle π/2, likewise."""
INFINITY = float("inf")

sqrt: Callable[[float], float] = np.sqrt
"""The square root, NaN of a negative number."""
cos: Callable[[float], float] = np.cos
sin: Callable[[float], float] = np.sin
arctan2: Callable[[float, float], float] = math.atan2
# The same bits as compiled: NumPy's own function may differ.


ARRAYS: dict[str, Any] = {
    "sqrt": np.sqrt,
    "arctan2": np.arctan2,
    "where": np.where,
    "both": np.logical_and,
    "either": np.logical_or,
}
"""The operations for NumPy arrays, elementwise."""


def where(condition: bool, yes: float, no: float) -> float:
    """Select one of two numbers, both of which are computed."""
    return yes if condition else no


def both(a: bool, b: bool) -> bool:
    """Return whether both conditions hold."""
    return a & b


def either(a: bool, b: bool) -> bool:
    """Return whether one of two conditions holds."""
    return a | b


def bind(formula: F, **operations: Any) -> F:
    """Return a copy of a formula, and of all formulas that it calls, with other operations.

    In the copies `operations` replace `sqrt`, `cos`, `sin`, `arctan2`, `where`, `both`, `either`, and optionally
    `COS_30` and `RIGHT_ANGLE`. Operations that are not given remain those for floats.
    """
    copy: F = _copied(formula, operations, {})
    return copy


def on_arrays(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Return a formula as an elementwise function of NumPy arrays."""
    return bind(formula, **ARRAYS)


def rows_of(array: Any) -> tuple[tuple[Any, ...], ...]:
    """Return matrices (..., 3, 3) as arguments of formulas: nine arrays (...), row by row."""
    return tuple(tuple(array[..., i, j] for j in range(3)) for i in range(3))


def mapped(function: Callable[..., Any], tree: Any, *trees: Any) -> Any:
    """Apply a function to the entries of nested tuples, or to those of several of equal structure."""
    if not isinstance(tree, tuple):
        return function(tree, *trees)
    entries = [mapped(function, *parts) for parts in zip(tree, *trees, strict=True)]
    return type(tree)(*entries) if hasattr(tree, "_fields") else tuple(entries)


def vector_of(array: Any) -> tuple[Any, Any, Any]:
    """Return vectors (..., 3) as arguments of formulas: three arrays (...)."""
    return array[..., 0], array[..., 1], array[..., 2]


def _copied(formula: Any, operations: dict[str, Any], copies: dict[Any, Any]) -> Any:
    if formula not in copies:
        own = dict(formula.__globals__)
        for name in formula.__code__.co_names:
            if name in operations:
                own[name] = operations[name]
            elif isinstance(own.get(name), types.FunctionType) and own[name].__module__.startswith(__package__):
                own[name] = _copied(own[name], operations, copies)
        copies[formula] = types.FunctionType(formula.__code__, own, formula.__name__)
    return copies[formula]
