"""An index: one number per point of a sweep, with its unit, its meaning and its identity."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import CodeType
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.sweeps.points import Points

__all__ = ["Index"]


@dataclass(frozen=True)
class Index:
    """A quantity that a sweep maps.

    Attributes
    ----------
    name : str
        Name of the variable in the results, an identifier.
    unit : str
        As udunits writes it, "1" if there is none.
    description : str
        One line that says what it is and where it is NaN.
    evaluate : callable
        Takes `Points` and returns an array of shape (N,). It is sent to worker processes.
    dtype : str
        How it is stored: a float, or a signed integer.
    flags : mapping of str to int
        Meanings of integers, where they stand for something.
    parameters : mapping
        What `evaluate` depends on besides the points, as JSON: with other parameters it is another sweep.

    Raises
    ------
    ArgumentError
        If the name is no identifier, or the type neither a float nor a signed integer.
    """

    name: str
    unit: str
    description: str
    evaluate: Callable[[Points], npt.ArrayLike] = field(repr=False)
    dtype: str = "float64"
    flags: Mapping[str, int] = field(default_factory=dict, repr=False)
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise ArgumentError("name", "letters, digits and underscores", repr(self.name))
        if not callable(self.evaluate):
            raise ArgumentError("evaluate", "a function of Points", type(self.evaluate).__name__)
        try:
            kind = np.dtype(self.dtype)
        except TypeError:
            kind = np.dtype(object)
        if kind.kind not in ("f", "i"):
            raise ArgumentError("dtype", "a float or a signed integer, such as 'float64' or 'int16'", repr(self.dtype))
        object.__setattr__(self, "dtype", kind.name)

    @property
    def not_computed(self) -> float | int:
        """What the results hold where nothing has been computed: NaN, or the least integer."""
        return math.nan if np.dtype(self.dtype).kind == "f" else int(np.iinfo(self.dtype).min)

    def __call__(self, points: Points) -> npt.NDArray[Any]:
        """Return the index at `points` in its own type, shape (N,).

        Raises
        ------
        ArgumentError
            If `evaluate` returns another shape, or what the type cannot hold.
        """
        try:
            values = np.asarray(self.evaluate(points))
        except Exception as error:
            error.add_note(f"while evaluating the index {self.name!r}")
            raise
        argument, kind = f"index {self.name}", np.dtype(self.dtype)
        if values.shape != (len(points),):
            raise ArgumentError(argument, f"an array of shape ({len(points)},)", f"shape {values.shape}")
        if values.dtype.kind not in ("biuf" if kind.kind == "f" else "biu"):
            raise ArgumentError(argument, f"values that {kind} can hold", f"values of type {values.dtype}")
        if kind.kind == "i" and values.size:
            least, most = int(values.min()), int(values.max())
            if least <= self.not_computed or most > np.iinfo(kind).max:
                raise ArgumentError(argument, f"values that {kind} can hold", f"values from {least} to {most}")
        return values.astype(kind)

    def definition(self) -> dict[str, Any]:
        """Return what tells it from other indices, as JSON: two that differ here do not share a store."""
        return {
            "name": self.name,
            "unit": self.unit,
            "dtype": self.dtype,
            "parameters": dict(self.parameters),
            "function": _origin(self.evaluate),
        }


def _origin(function: Callable[..., Any]) -> str:
    """Return the name of a function of this package, or a digest of what another does."""
    if isinstance(function, partial):
        return f"{_origin(function.func)}{_plain((*function.args, *sorted(function.keywords.items())))}"
    module, name = getattr(function, "__module__", ""), getattr(function, "__qualname__", type(function).__qualname__)
    if str(module).startswith("spm_pin.") and "<" not in name:
        return f"{module}.{name}"
    method = function if hasattr(function, "__code__") else vars(type(function)).get("__call__")
    code = getattr(method, "__code__", None)
    if not isinstance(code, CodeType):
        return f"{module}.{name}"
    cells = [cell.cell_contents for cell in getattr(method, "__closure__", None) or ()]
    bound = _plain((*(getattr(method, "__defaults__", None) or ()), *cells))
    return f"code {hashlib.sha256((_told(code) + bound).encode()).hexdigest()[:16]}"


def _plain(values: tuple[Any, ...]) -> str:
    """Tell values that a function is bound to, those whose text is the same in every process."""
    kept = [value for value in values if isinstance(value, bool | int | float | str | tuple | None)]
    return repr(kept) if kept else ""


def _told(code: CodeType) -> str:
    """Tell what a function does in a text that does not depend on addresses, lines, or the order of sets."""

    def constant(value: object) -> str:
        if isinstance(value, CodeType):
            return _told(value)
        return repr(sorted(map(repr, value))) if isinstance(value, frozenset) else repr(value)

    return "\n".join([code.co_code.hex(), *map(constant, code.co_consts), *code.co_names, *code.co_varnames])
