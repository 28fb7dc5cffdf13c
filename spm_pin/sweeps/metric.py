"""A metric: a function that computes one number per point of a sweep, with its unit, meaning and parameters."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import check_instance, real_number
from spm_pin.sweeps.function_identity import function_identity
from spm_pin.sweeps.points import Points

DTYPES = ("float64", "float32", "float16", "int64", "int32", "int16", "int8")
"""Types in which a metric can be stored."""

_ATTRIBUTES = ("long_name", "units", "not_computed", "flag_values", "flag_meanings", "coordinates")
_NAME = re.compile(r"(?!__)[A-Za-z_][A-Za-z0-9_]*", re.ASCII)


@dataclass(frozen=True)
class Metric:
    """A number for every point of a sweep. Usually made by the decorator `metric`.

    Parameters
    ----------
    name : str
        Name of the variable in the results: letters, digits and underscores.
    unit : str
        As udunits writes it, "1" if there is none.
    description : str
        One line that says what it is and where it is NaN.
    function : callable
        Takes `Points`, and the parameters by keyword; returns an array of shape (N,). It is sent to worker processes.
    dtype : str
        How it is stored: a float, or a signed integer.
    flags : mapping of str to int
        Meanings of integers, where they stand for something.
    parameters : mapping
        Keyword arguments of the function, as JSON holds them.
    version : str or int, optional
        Identity of the function, stated by hand. If not given, it is a digest of the function's code and of everything
        it uses: closures, defaults, globals, the state of objects. A sweep whose metric has another identity, other
        parameters, another unit or type does not continue the same store.

    Raises
    ------
    ArgumentError
        If one of these is not as above.
    """

    name: str
    unit: str
    description: str
    function: Callable[..., npt.ArrayLike] = field(repr=False)
    dtype: str = "float64"
    flags: Mapping[str, int] = field(default_factory=dict, repr=False)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    version: str | int | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and _NAME.fullmatch(self.name)):
            raise ArgumentError("name", "letters, digits and underscores", repr(self.name))
        check_instance(self.unit, str, "unit")
        check_instance(self.description, str, "description")
        if not callable(self.function):
            raise ArgumentError("function", "a function of Points", type(self.function).__name__)
        try:
            dtype = "" if self.dtype is None else np.dtype(self.dtype).name
        except (TypeError, ValueError):
            dtype = ""
        if dtype not in DTYPES:
            raise ArgumentError("dtype", f"one of {', '.join(DTYPES)}", repr(self.dtype))
        if self.version is not None and type(self.version) not in (int, str):
            raise ArgumentError("version", "a text or an integer", repr(self.version))
        object.__setattr__(self, "dtype", dtype)
        object.__setattr__(self, "flags", _checked_flags(self.flags, dtype))
        object.__setattr__(self, "parameters", _checked_parameters(self.parameters))

    def __reduce__(self) -> tuple[type[Metric], tuple[Any, ...]]:
        # A mapping proxy has no pickle.
        values = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Metric, tuple(dict(value) if isinstance(value, MappingProxyType) else value for value in values)

    def __call__(self, **parameters: Any) -> Metric:
        """Return the metric with other parameters.

        Raises
        ------
        ArgumentError
            If it has no such parameter, or a parameter of this package's metrics is not a positive number.

        Examples
        --------
        >>> import spm_pin as spm
        >>> spm.sweeps.METRICS["payload"](push=900.0, pull=400.0).parameters
        mappingproxy({'push': 900.0, 'pull': 400.0})
        """
        unknown = [name for name in parameters if name not in self.parameters]
        if unknown:
            raise ArgumentError(unknown[0], f"a parameter among {', '.join(self.parameters) or 'none'}", self.name)
        if getattr(self.function, "__module__", "").startswith("spm_pin."):
            for name, value in parameters.items():
                if value is not None:
                    parameters[name] = real_number(value, name, "a positive number", above=0.0)
        return dataclasses.replace(self, parameters={**self.parameters, **parameters})

    @property
    def not_computed(self) -> float | int:
        """The value in the results where nothing has been computed: NaN, or the least integer."""
        return math.nan if self.dtype.startswith("float") else int(np.iinfo(self.dtype).min)

    def evaluate(self, points: Points) -> npt.NDArray[Any]:
        """Return the metric at `points` in its own type, shape (N,), after a check of what the function returns."""
        try:
            values = np.asanyarray(self.function(points, **self.parameters))
        except Exception as error:
            error.add_note(f"while evaluating the metric {self.name!r}")
            raise
        dtype = np.dtype(self.dtype)

        def refused(received: str, cause: str = "") -> ArgumentError:
            return ArgumentError(f"metric {self.name}", f"values that {dtype} can hold", received, cause)

        if values.shape != (len(points),):
            raise ArgumentError(f"metric {self.name}", f"an array of shape ({len(points)},)", f"shape {values.shape}")
        if values.dtype.kind not in ("biuf" if dtype.kind == "f" else "biu"):
            raise refused(f"values of type {values.dtype}")
        if dtype.kind == "i":
            if np.ma.is_masked(values):
                raise refused("masked values", "Integers have no NaN: fill the masked values.")
            values = np.asarray(values)
            if values.size and not self.not_computed < int(values.min()) <= int(values.max()) <= np.iinfo(dtype).max:
                raise refused(f"values from {values.min()} to {values.max()}")
            return values.astype(dtype)
        if isinstance(values, np.ma.MaskedArray):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        with np.errstate(over="ignore"):
            stored = np.asarray(values).astype(dtype)
        overflown = np.isinf(stored) & np.isfinite(values)
        if overflown.any():
            raise refused(f"{values[overflown][0]:g}", "Store it as another type, dtype=...")
        return stored

    def definition(self) -> dict[str, Any]:
        """Return the identity of the metric as JSON: metrics that differ here do not share a store."""
        return {
            "name": self.name,
            "unit": self.unit,
            "dtype": self.dtype,
            "parameters": dict(self.parameters),
            "function": function_identity(self.function) if self.version is None else self.version,
        }

    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the variable in a store: description, unit, flags, parameters."""
        attributes: dict[str, Any] = {"long_name": self.description, "units": self.unit}
        if not self.dtype.startswith("float"):
            attributes["not_computed"] = self.not_computed
        if self.flags:
            flags = {"not_computed": self.not_computed, **self.flags}
            attributes["flag_values"] = list(flags.values())
            attributes["flag_meanings"] = " ".join(flags)
        return attributes | {name: value for name, value in self.parameters.items() if value is not None}


def metric(
    unit: str,
    description: str,
    *,
    dtype: str = "float64",
    flags: Mapping[str, int] | None = None,
    version: str | int | None = None,
) -> Callable[[Callable[..., npt.ArrayLike]], Metric]:
    """Make a metric of a function of `Points`; its name is the function's, its parameters the keyword-only ones.

    Parameters
    ----------
    unit, description, dtype, flags, version
        As for `Metric`.

    Examples
    --------
    >>> import spm_pin as spm
    >>> @spm.sweeps.metric("m", "length of the longest leg beyond a length; NaN where not reachable")
    ... def excess(points, *, length=1.4):
    ...     return points.physical.leg_lengths.max(axis=-1) - length
    >>> excess(length=1.3).parameters
    mappingproxy({'length': 1.3})
    """

    def decorate(function: Callable[..., npt.ArrayLike]) -> Metric:
        if not callable(function):
            raise ArgumentError("function", "a function of Points", type(function).__name__)
        signature = inspect.signature(function).parameters.values()
        parameters = {keyword.name: keyword.default for keyword in signature if keyword.kind is keyword.KEYWORD_ONLY}
        for name, default in parameters.items():
            if default is inspect.Parameter.empty:
                raise ArgumentError(name, "a default for every parameter of a metric", "none")
        # So that pickle finds the function below the name that the metric takes.
        function.__qualname__ = f"{function.__qualname__}.function"
        return Metric(function.__name__, unit, description, function, dtype, flags or {}, parameters, version)

    return decorate


def _checked_flags(flags: Mapping[str, int], dtype: str) -> Mapping[str, int]:
    expected = "texts without blanks, each with an integer that the type can hold; none for floats"
    if not isinstance(flags, Mapping) or (flags and dtype.startswith("float")):
        raise ArgumentError("flags", expected, repr(flags))
    for text, value in flags.items():
        fits = isinstance(text, str) and len(text.split()) == 1 and type(value) is int
        if not fits or not np.iinfo(dtype).min < value <= np.iinfo(dtype).max:
            raise ArgumentError("flags", expected, f"{text!r}: {value!r}")
    return MappingProxyType(dict(flags))


def _checked_parameters(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    expected = f"names other than {', '.join(_ATTRIBUTES)}, with values that JSON can hold"
    try:
        # A copy, of plain types, that no caller changes afterwards.
        copy = json.loads(json.dumps(dict(parameters), allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        raise ArgumentError("parameters", expected, repr(parameters), str(error)) from error
    if not isinstance(parameters, Mapping) or copy.keys() != set(parameters) or set(_ATTRIBUTES) & set(copy):
        raise ArgumentError("parameters", expected, repr(parameters))
    return MappingProxyType(copy)
