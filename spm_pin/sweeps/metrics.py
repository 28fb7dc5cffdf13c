"""Metrics: functions that compute one number per point of a sweep, each with its unit, meaning and parameters.

The metrics of this package are the rows of `METRICS`, at the end. Those of a state describe the physical configuration
within the leg limits, and are NaN where there is none. Those of the Jacobian make it homogeneous: with a characteristic
length L the twist is (v, Lω), so that singular values compare speeds with speeds. By default L is the platform's radius
C: then Lω is the speed that a rotation about o gives to the joints c_i.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import forward_displacement
from spm_pin.mechanism import BRANCHES, Status
from spm_pin.mechanism.arguments import FloatArray, check_instance, real_number
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
        What you change whenever the values of the function change. A sweep continues a store only if its metrics have
        the versions of those stored; without a version a metric of your own continues none.
    """

    name: str
    unit: str
    description: str
    function: Callable[..., npt.ArrayLike] = field(repr=False)
    dtype: str = "float64"
    flags: Mapping[str, int] = field(default_factory=dict, repr=False)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    version: str | int | None = field(default=None, repr=False)
    is_of_package: bool = field(default=False, init=False, repr=False)
    """True for the rows of `METRICS`, which have the version of the package; False for a changed copy of one."""

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

    def __reduce__(self) -> tuple[Callable[..., Metric], tuple[Any, ...]]:
        if self.is_of_package:
            return _package_metric, (self.name, dict(self.parameters))
        values = (getattr(self, field.name) for field in dataclasses.fields(self) if field.init)
        # A mapping proxy has no pickle.
        return Metric, tuple(dict(value) if isinstance(value, MappingProxyType) else value for value in values)

    def __call__(self, **parameters: Any) -> Metric:
        """Return the metric with other parameters, which are positive numbers for the metrics of this package.

        Examples
        --------
        >>> import spm_pin as spm
        >>> spm.sweeps.METRICS["payload"](push=900.0, pull=400.0).parameters
        mappingproxy({'push': 900.0, 'pull': 400.0})
        """
        unknown = [name for name in parameters if name not in self.parameters]
        if unknown:
            raise ArgumentError(unknown[0], f"a parameter among {', '.join(self.parameters) or 'none'}", self.name)
        if self.is_of_package:
            for name, value in parameters.items():
                if value is not None:
                    parameters[name] = real_number(value, name, "a positive number", above=0.0)
        changed = dataclasses.replace(self, parameters={**self.parameters, **parameters})
        object.__setattr__(changed, "is_of_package", self.is_of_package)
        return changed

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
        has_overflown = np.isinf(stored) & np.isfinite(values)
        if has_overflown.any():
            raise refused(f"{values[has_overflown][0]:g}", "Store it as another type, dtype=...")
        return stored

    def definition(self) -> dict[str, Any]:
        """Return the identity of the metric as JSON: metrics that differ here do not share a store."""
        return {
            "name": self.name,
            "unit": self.unit,
            "dtype": self.dtype,
            "parameters": dict(self.parameters),
            "version": self.version,
            "is_of_package": self.is_of_package,
        }

    @staticmethod
    def from_definition(content: Mapping[str, Any]) -> Metric:
        """Make a metric from its `definition`; the function of one that is not of the package is `unavailable`."""
        if content["is_of_package"] is True:
            return _package_metric(content["name"], content["parameters"])
        dtype, parameters, version = content["dtype"], content["parameters"], content["version"]
        return Metric(content["name"], content["unit"], "", unavailable, dtype, {}, parameters, version)

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
    >>> @spm.sweeps.metric("m", "length of the longest leg beyond a length; NaN where not reachable", version=1)
    ... def excess(points, *, length=1.4):
    ...     return points.physical.readings.max(axis=-1) - length
    >>> excess(length=1.3).parameters
    mappingproxy({'length': 1.3})
    """

    def decorate(function: Callable[..., npt.ArrayLike]) -> Metric:
        if not callable(function):
            raise ArgumentError("function", "a function of Points", type(function).__name__)
        parameters = _keywords(function)
        # So that pickle finds the function below the name that the metric takes.
        function.__qualname__ = f"{function.__qualname__}.function"
        return Metric(function.__name__, unit, description, function, dtype, flags or {}, parameters, version)

    return decorate


def _keywords(function: Callable[..., npt.ArrayLike]) -> dict[str, Any]:
    """Return the keyword-only parameters of a function with their defaults."""
    signature = inspect.signature(function).parameters.values()
    parameters = {keyword.name: keyword.default for keyword in signature if keyword.kind is keyword.KEYWORD_ONLY}
    for name, default in parameters.items():
        if default is inspect.Parameter.empty:
            raise ArgumentError(name, "a default for every parameter of a metric", "none")
    return parameters


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


def unavailable(points: Points, **parameters: Any) -> npt.ArrayLike:
    """Stand for the function of a metric whose definition alone is known."""
    raise ArgumentError("metrics", f"metrics among {', '.join(METRICS)}", "one whose function is not known")


def resolve_metrics(metrics: str | Metric | Iterable[str | Metric]) -> tuple[Metric, ...]:
    """Return metrics, each given by its name or as it is."""
    is_single = isinstance(metrics, str | Metric) or not isinstance(metrics, Iterable)
    resolved: list[Metric] = []
    for item in [metrics] if is_single else metrics:  # type: ignore[union-attr]
        chosen = METRICS.get(item) if isinstance(item, str) else item
        if not isinstance(chosen, Metric):
            raise ArgumentError("metrics", f"a Metric, or names among {', '.join(METRICS)}", repr(item))
        resolved.append(chosen)
    names = [metric.name for metric in resolved]
    if not names or len(set(names)) < len(names):
        raise ArgumentError("metrics", "one or more metrics of different names", ", ".join(names) or "none")
    return tuple(resolved)


def _package_metric(name: str, parameters: Mapping[str, Any]) -> Metric:
    return METRICS[name](**parameters)


# The functions of the metrics that take more than a line.

_MODES_AT_A_TIME = 64
"""Problems of forward displacement solved together: each takes 43 kB."""


def _branch(points: Points) -> npt.ArrayLike:
    """Return the number of the branch that `Points.physical` is, -1 where there is none."""
    # Where the state was computed from leg lengths it is one of the branches up to rounding.
    gaps = np.abs(points.solutions.middle_joints - points.physical.middle_joints[:, None]).max(axis=(-1, -2))
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    return np.where(np.isfinite(gaps.min(axis=-1)), gaps.argmin(axis=-1), -1)


def _assembly_modes(points: Points) -> npt.ArrayLike:
    readings = points.reached.readings
    batches = range(0, max(1, len(readings)), _MODES_AT_A_TIME)
    counts = [forward_displacement(points.geometry, readings[k : k + _MODES_AT_A_TIME]).count for k in batches]
    return points.spread(np.concatenate(counts), absent=0.0).astype(np.int16)


def _leg_margin(points: Points) -> npt.ArrayLike:
    """Return the margin of the worst leg; of the physical branches of a pose the one with the largest margin counts."""
    if points.geometry.limits is None:
        raise ArgumentError("geometry", "one with leg limits, of which a margin can be left", "none")
    if points.space == "legs":
        return np.where(points.assembled.exists, points.limits.margin(points.coordinates), np.nan)
    margins = points.limits.margin(points.solutions.readings)
    largest = np.where(points.solutions.is_physical, margins, -np.inf).max(axis=-1)
    return np.where(np.isinf(largest), np.nan, largest)


def _conditioning(points: Points, *, length: float | None = None) -> npt.ArrayLike:
    """Return the inverse condition number: 0 at a singularity, 1 at an isotropic state.

    The local conditioning index of C. Gosselin, J. Angeles, "A global performance index for the kinematic optimization
    of robotic manipulators", Journal of Mechanical Design 113 (1991), of the homogeneous Jacobian.
    """
    values = points.singular_values(length)
    return points.spread(_zero_if_singular(values[:, -1] / values[:, 0]))


def _isotropy(points: Points, *, length: float | None = None) -> npt.ArrayLike:
    """Return geometric over arithmetic mean of the squared singular values: from 0 to 1.

    The measure of J.-O. Kim, P. K. Khosla, "Dexterity measures for design and control of manipulators", IROS 1991, of
    G, which maps leg rates to the twist (v, Lω).
    """
    values = points.singular_values(length)
    squares = (values / values[:, :1]) ** 2
    return points.spread(_zero_if_singular(squares.prod(axis=-1) ** (1.0 / 6.0) / squares.mean(axis=-1)))


def _payload(points: Points, *, push: float = 1.0, pull: float | None = None) -> npt.ArrayLike:
    """Return the force that the machine holds at o whatever its direction, without a moment.

    `push` and `pull` are the largest forces of a leg [N]; `pull` is `push` if not given. By default the metric is the
    payload per newton of leg force. A leg of force a · u under the unit force u bears at most ``|a|``, in either sense:
    the payload is the least quotient of a leg's limit and its ``|a|``, without a search over directions.
    """
    # f = -Gᵀ w: a unit force u takes -G_v[:, i] · u of leg i, at most |G_v[:, i]| in either sense.
    largest = np.linalg.norm(points.platform_jacobians[:, :3], axis=-2).max(axis=-1)
    return points.spread(_zero_if_singular(min(push, push if pull is None else pull) / largest))


def _payload_down(points: Points, *, push: float = 1.0, pull: float | None = None) -> npt.ArrayLike:
    """Return the force along -Z of {B} that the machine holds at o, without a moment: a weight."""
    forces = points.platform_jacobians[:, 2]
    share = np.maximum(forces / push, -forces / (push if pull is None else pull)).max(axis=-1)
    return points.spread(_zero_if_singular(1.0 / share))


def _least_stiffness(points: Points, rows: slice, leg_stiffness: float) -> npt.ArrayLike:
    """Return the stiffness against a force or a moment, `rows` of G, in the direction in which it is least.

    `leg_stiffness` is that of each actuator [N/m]; everything else is rigid. A force f moves o by
    ``G_v G_vᵀ f / leg_stiffness``, G_v the upper three rows of G, while the platform turns as it likes; a moment
    likewise with the lower three, while o moves as it likes.
    """
    g = points.platform_jacobians[:, rows]
    compliance = np.linalg.eigvalsh(np.nan_to_num(g @ g.swapaxes(-1, -2)))[:, -1]
    return points.spread(_zero_if_singular(leg_stiffness / np.where(np.isnan(g[:, 0, 0]), np.nan, compliance)))


def _zero_if_singular(values: FloatArray) -> FloatArray:
    """Return `values` with 0 for NaN, which stands for a forward singularity."""
    return np.where(np.isnan(values), 0.0, values)


_ABSENT = "NaN where not reachable"
_HOMOGENEOUS = "of (v, L omega), L = length or the platform radius"
_BY_LEGS = "with leg forces of at most push and pull"


def _row(
    name: str,
    unit: str,
    description: str,
    function: Callable[..., npt.ArrayLike],
    dtype: str = "float64",
    flags: Mapping[str, int] | None = None,
) -> Metric:
    made = Metric(name, unit, description, function, dtype, flags or {}, _keywords(function))
    object.__setattr__(made, "is_of_package", True)
    return made


# To add a metric, add a row: name, unit, description, function of the points; for whole numbers also their type, and
# what they stand for. Keyword-only arguments of the function are the metric's parameters: positive numbers, by default
# as stated.
# fmt: off
_ROWS = (
    _row("status", "1", "status of the displacement problem of the point",
         lambda points: points.status, "int8", {str(status): int(status) for status in Status}),
    _row("reachable", "1", "whether there is a physical configuration within the leg limits",
         lambda points: points.reachable, "int8", {"no": 0, "yes": 1}),
    _row("branches", "1", "number of real branches, leg limits aside",
         lambda points: np.count_nonzero(~np.isnan(points.branch_readings[..., 0]), axis=-1), "int8"),
    _row("branches_within", "1", "number of real branches within the leg limits",
         lambda points: np.count_nonzero(points.branches_within, axis=-1), "int8"),
    _row("branch", "1", "physical branch within the leg limits",
         _branch, "int8", {"none": -1} | {label: number for number, label in enumerate(BRANCHES)}),
    _row("assembly_modes", "1",
         "number of assembly modes that the leg lengths of the physical configuration allow; 0 where not reachable",
         _assembly_modes, "int16"),
    *(
        _row(f"o_{axis.lower()}", "m", f"{axis} of o in the base frame; {_ABSENT}",
             lambda points, column=column: points.physical.translation[:, column])
        for column, axis in enumerate("XYZ")
    ),
    _row("leg_margin", "m", "how far the worst leg is inside its limits, negative outside; "
         "NaN where no physical configuration exists, leg limits aside", _leg_margin),
    _row("conditioning", "1", f"inverse condition number of the Jacobian {_HOMOGENEOUS}; {_ABSENT}", _conditioning),
    _row("isotropy", "1", f"geometric over arithmetic mean of the eigenvalues of G G^T {_HOMOGENEOUS}; {_ABSENT}",
         _isotropy),
    _row("forward_distance", "1", f"least singular value of J_b and J_c: distance to a forward singularity; {_ABSENT}",
         lambda points: points.spread(points.sigma[:, :2].min(axis=-1))),
    _row("inverse_distance", "1", f"least singular value of K: distance to an inverse singularity; {_ABSENT}",
         lambda points: points.spread(points.sigma[:, 2])),
    _row("det_lower", "1", f"determinant of J_b, lower stage, forward, over d^3; {_ABSENT}",
         lambda points: points.spread(points.determinants[:, 0])),
    _row("det_upper", "1", f"determinant of J_c, upper stage, forward, over d^3; {_ABSENT}",
         lambda points: points.spread(points.determinants[:, 1])),
    _row("det_structure", "1", f"determinant of K, inverse, over d^3; {_ABSENT}",
         lambda points: points.spread(points.determinants[:, 2])),
    _row("payload", "N", f"largest force at o held in every direction {_BY_LEGS}; {_ABSENT}", _payload),
    _row("payload_down", "N", f"largest force at o held along -Z {_BY_LEGS}; {_ABSENT}", _payload_down),
    _row("least_stiffness", "N m-1", f"least translational stiffness at o, for a stiffness of each leg; {_ABSENT}",
         lambda points, *, leg_stiffness=1.0: _least_stiffness(points, slice(0, 3), leg_stiffness)),
    _row("least_rotational_stiffness", "N m rad-1",
         f"least rotational stiffness, for a stiffness of each leg; {_ABSENT}",
         lambda points, *, leg_stiffness=1.0: _least_stiffness(points, slice(3, 6), leg_stiffness)),
)
# fmt: on

METRICS: Mapping[str, Metric] = MappingProxyType({row.name: row for row in _ROWS[1:]})
"""The metrics of the package by name; with other parameters, ``METRICS["payload"](push=900.0)``."""
STATUS = _ROWS[0]
"""In every store, where it distinguishes "not computed" from "no value here"."""
