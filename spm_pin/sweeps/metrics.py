"""Metrics: functions that compute one number per point of a sweep, each with its unit, meaning and parameters.

Those of this package are the rows of a table at the end. Those of a state describe the physical configuration
within the leg limits, and are NaN if it is missing. Those of the Jacobian make it homogeneous: with a characteristic
length L the twist is (v, Lω). By default L is the platform's radius C: then Lω is the speed that a rotation about o
gives to the joints c_i.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import forward_displacement, singular_values
from spm_pin.machine import BRANCHES, Configuration, Status
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, choice, real_number
from spm_pin.sweeps.points import Points

DTYPES = ("float64", "float32", "float16", "int64", "int32", "int16", "int8")
"""Types in which a metric can be stored."""
_ATTRIBUTES = {"long_name", "units", "not_computed", "flag_values", "flag_meanings", "coordinates"}


@dataclass(frozen=True)
class Metric:
    """A number for every point of a sweep. Usually made by the decorator `metric`.

    Parameters
    ----------
    name : str
        Name of the variable in the results: letters, digits and underscores.
    unit : str
        Unit in the notation of udunits, or "1".
    description : str
        Description of the metric, and where it is NaN, in one line.
    function : callable
        Function of `Points`, and of the parameters by keyword; returns an array of shape (N,). It is sent to worker
        processes.
    dtype : str
        Type in the store: a float such as "float64", or a signed integer.
    flags : dict of str to int
        Meanings of integers, if the values are codes.
    parameters : dict
        Values of the function's keyword-only arguments, as JSON holds them; their defaults if not given.
    version : str or int, optional
        What you change whenever the values of the function change. A sweep continues a store only if its metrics have
        the versions of those stored; without a version a metric of your own continues none.
    """

    name: str
    unit: str
    description: str
    function: Callable[..., npt.ArrayLike] = field(repr=False)
    dtype: str = "float64"
    flags: dict[str, int] = field(default_factory=dict, repr=False)
    parameters: dict[str, Any] = field(default_factory=dict)
    version: str | int | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("name", "unit", "description"):
            check_instance(getattr(self, name), str, name)
        if not (self.name.isidentifier() and self.name.isascii()) or self.name.startswith("__"):
            raise ArgumentError("name", "letters, digits and underscores", repr(self.name))
        try:
            arguments = inspect.signature(self.function).parameters.values()
        except (TypeError, ValueError) as error:
            raise ArgumentError("function", "a function of Points", type(self.function).__name__) from error
        choice(self.dtype, "dtype", DTYPES)
        if type(self.version) not in (int, str, type(None)):
            raise ArgumentError("version", "a text or an integer", repr(self.version))
        flags = check_instance(self.flags, dict, "flags")
        fits = self.is_integer and all(
            isinstance(text, str) and len(text.split()) == 1 and type(value) is int for text, value in flags.items()
        )
        if flags and not fits:
            raise ArgumentError("flags", "texts without blanks, each with an integer; none for floats", repr(flags))
        defaults = {argument.name: argument.default for argument in arguments if argument.kind is argument.KEYWORD_ONLY}
        parameters = defaults | check_instance(self.parameters, dict, "parameters")
        for name, value in parameters.items():
            if value is inspect.Parameter.empty:
                raise ArgumentError(name, "a default for every parameter of a metric", "none")
        try:
            # A copy, of plain types, that no caller changes afterwards.
            copy = json.loads(json.dumps(parameters, allow_nan=False))
        except (TypeError, ValueError, RecursionError):
            copy = {}
        if copy.keys() != parameters.keys() or _ATTRIBUTES & copy.keys():
            expected = f"names other than {', '.join(sorted(_ATTRIBUTES))}, with values that JSON can hold"
            raise ArgumentError("parameters", expected, repr(parameters))
        object.__setattr__(self, "parameters", copy)

    def __hash__(self) -> int:
        return hash((self.name, self.unit, self.dtype, self.version))

    def __reduce__(self) -> tuple[Callable[..., Metric], tuple[Any, ...]]:
        if self.is_of_package:
            # Functions of the package's table have no name by which pickle finds them.
            return _package_metric, (self.name, self.parameters)
        return Metric, tuple(getattr(self, field.name) for field in dataclasses.fields(self))

    def __call__(self, **parameters: Any) -> Metric:
        """Return the metric with other parameters, which are positive numbers for the metrics of this package.

        Examples
        --------
        >>> import spm_pin as spm
        >>> spm.sweeps.METRICS["payload"](push=900.0, pull=400.0).parameters
        {'push': 900.0, 'pull': 400.0}
        """
        for name, value in parameters.items():
            if name not in self.parameters:
                raise ArgumentError(name, f"a parameter among {', '.join(self.parameters) or 'none'}", self.name)
            if self.is_of_package and value is not None:
                parameters[name] = real_number(value, name, "a positive number", above=0.0)
        return dataclasses.replace(self, parameters={**self.parameters, **parameters})

    @property
    def is_of_package(self) -> bool:
        """True for the metrics of `METRICS`, with any parameters; False for a copy that is changed otherwise."""
        known = METRICS.get(self.name)
        return known is not None and dataclasses.replace(self, parameters=known.parameters) == known

    @property
    def is_integer(self) -> bool:
        """True if values are stored as whole numbers."""
        return self.dtype.startswith("int")

    @property
    def not_computed(self) -> float | int:
        """The value in the results where nothing has been computed: NaN, or the least integer."""
        return int(np.iinfo(self.dtype).min) if self.is_integer else math.nan

    def evaluate(self, points: Points) -> npt.NDArray[Any]:
        """Return the metric at `points` in its own type, shape (N,), after a check of what the function returns."""
        try:
            values = np.asanyarray(self.function(points, **self.parameters))
        except Exception as error:
            error.add_note(f"while evaluating the metric {self.name!r}")
            raise
        expected = f"an array of shape ({len(points)},), of values that {self.dtype} can hold"
        fits = values.shape == (len(points),) and values.dtype.kind in ("biu" if self.is_integer else "biuf")
        if not fits or np.ma.is_masked(values):
            received = "masked values" if fits else f"{values.dtype} of shape {values.shape}"
            raise ArgumentError(f"metric {self.name}", expected, received)
        with np.errstate(over="ignore"):
            stored = np.asarray(values).astype(self.dtype)
        if self.is_integer:
            is_lost = (stored != values) | (stored == self.not_computed)
        else:
            is_lost = np.isinf(stored) & np.isfinite(values)
        if is_lost.any():
            raise ArgumentError(f"metric {self.name}", expected, f"{values[is_lost][0]:g}", "Store it as another type")
        return stored

    def definition(self) -> dict[str, Any]:
        """Return the identity of the metric as JSON: metrics that differ here do not share a store."""
        names = ("name", "unit", "dtype", "parameters", "version", "is_of_package")
        return {name: getattr(self, name) for name in names}

    @staticmethod
    def from_definition(content: dict[str, Any]) -> Metric:
        """Make a metric from its `definition`; the function of one that is not of the package is `unavailable`."""
        others = dict(content)
        if others.pop("is_of_package"):
            return _package_metric(content["name"], content["parameters"])
        return Metric(description="", function=unavailable, **others)

    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the variable in a store: description, unit, flags, parameters."""
        attributes: dict[str, Any] = {"long_name": self.description, "units": self.unit}
        if self.is_integer:
            attributes["not_computed"] = self.not_computed
        if self.flags:
            flags = {"not_computed": self.not_computed, **self.flags}
            attributes |= {"flag_values": list(flags.values()), "flag_meanings": " ".join(flags)}
        return attributes | {name: value for name, value in self.parameters.items() if value is not None}


def metric(
    unit: str,
    description: str,
    *,
    dtype: str = "float64",
    flags: dict[str, int] | None = None,
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
    {'length': 1.3}
    """

    def decorate(function: Callable[..., npt.ArrayLike]) -> Metric:
        name = getattr(function, "__name__", "metric")
        made = Metric(name, unit, description, function, dtype, flags or {}, version=version)
        # So that pickle finds the function below the name that the metric takes.
        function.__qualname__ += ".function"
        return made

    return decorate


def unavailable(points: Points, **parameters: Any) -> npt.ArrayLike:
    """Refuse to compute a metric of which only the definition is known."""
    cause = "A metric of your own has to be given again, to `run_sweep`, with all the rest"
    raise ArgumentError(
        "metrics", f"metrics among {', '.join(METRICS)}", "a metric whose function is not defined", cause
    )


def resolve_metrics(metrics: str | Metric | Iterable[str | Metric]) -> tuple[Metric, ...]:
    """Return metrics, each given by its name or as a `Metric`."""
    is_list = isinstance(metrics, Iterable) and not isinstance(metrics, str | Metric)
    given: list[Any] = list(metrics) if is_list else [metrics]  # type: ignore[arg-type]
    chosen: tuple[Any, ...] = tuple(METRICS.get(each) if isinstance(each, str) else each for each in given)
    if not all(isinstance(each, Metric) for each in chosen):
        raise ArgumentError("metrics", f"a Metric, or names among {', '.join(METRICS)}", repr(metrics))
    names = [each.name for each in chosen]
    if not names or len(set(names)) < len(names):
        raise ArgumentError("metrics", "one or more metrics of different names", ", ".join(names) or "none")
    return chosen


def prepare_metrics(metrics: Iterable[Metric], points: Points) -> None:
    """Evaluate the package's metrics once, so that other processes find kernels compiled; raises what they raise."""
    for metric in metrics:
        if metric.is_of_package:
            metric.evaluate(points)


def condition(
    metric: str | Metric, *, least: float | None = None, most: float | None = None
) -> Callable[[Configuration], BoolArray]:
    """Return a condition on states, for volumes: a metric is between `least` and `most`.

    Parameters
    ----------
    metric : str or Metric
        A metric, by its name or with parameters; it is evaluated at the states, without leg limits.
    least, most : float, optional
        Bounds in the unit of the metric, at least one; NaN is not within them.

    Returns
    -------
    callable
        Takes states (...) and returns booleans (...); it can be sent to other processes.

    Examples
    --------
    >>> import spm_pin as spm
    >>> good = spm.sweeps.condition("conditioning", least=1 / 60)
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [[1.11, 1.49, 1.43, 1.15, 1.44, 1.2], [1.3] * 6])
    >>> good(state).tolist()
    [True, False]
    """
    chosen, *others = resolve_metrics(metric)
    if others:
        raise ArgumentError("metric", "one metric", f"{1 + len(others)} metrics")
    if least is None and most is None:
        raise ArgumentError("least, most", "at least one of the two", "none")
    low = -np.inf if least is None else real_number(least, "least", f"a bound in {chosen.unit}")
    high = np.inf if most is None else real_number(most, "most", f"a bound in {chosen.unit}")
    if not low <= high:
        raise ArgumentError("least, most", "least not above most", f"{low:g} and {high:g}")
    return partial(_is_within, chosen, low, high)


def _is_within(metric: Metric, least: float, most: float, states: Configuration) -> BoolArray:
    # Solving the readings anew may find another state: a PRS stage can have two in its home assembly region.
    flat = states.transformed(lambda array, inner: array.reshape(-1, *array.shape[array.ndim - inner :]))
    values = metric.evaluate(Points.of_states(flat))
    return np.asarray((values >= least) & (values <= most)).reshape(states.shape)


def _package_metric(name: str, parameters: Mapping[str, Any]) -> Metric:
    return METRICS[name](**parameters)


# The functions of the metrics that take more than a line.

_MODES_AT_A_TIME = 64
"""Problems of forward displacement solved together: each takes 43 kB."""


def _check_manipulator(points: Points, metric: str) -> None:
    if points.machine.is_stage:
        raise ArgumentError("metrics", "metrics that a stage has", metric, "It is defined for manipulators only")


def _branch(points: Points) -> npt.ArrayLike:
    _check_manipulator(points, "branch")
    # A state that was computed from leg lengths is one of the branches up to rounding.
    branches, physical = points.solutions.configurations, points.physical
    gaps = np.abs(branches.compared_points - physical.compared_points[:, None]).max(axis=(-1, -2))
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    return np.where(np.isfinite(gaps.min(axis=-1)), gaps.argmin(axis=-1), -1)


def _assembly_modes(points: Points) -> npt.ArrayLike:
    readings = points.reached.readings
    batches = range(0, max(1, len(readings)), _MODES_AT_A_TIME)
    counts = [forward_displacement(points.machine, readings[k : k + _MODES_AT_A_TIME]).count for k in batches]
    return points.spread(np.concatenate(counts), absent=0.0).astype(np.int16)


def _leg_margin(points: Points) -> npt.ArrayLike:
    """Return the margin of the worst leg, in the physical branch of a pose with the largest margin."""
    limits = points.machine.limits
    if limits is None:
        raise ArgumentError("machine", "a machine with leg limits, for the margin", "a machine without limits")
    scale = points.machine.legs.largest_slopes
    if points.space == "legs":
        return np.where(points.assembled.exists, limits.margin(points.coordinates, scale), np.nan)
    margins = limits.margin(points.solutions.readings, scale)
    largest = np.where(points.solutions.is_physical, margins, -np.inf).max(axis=-1)
    return np.where(np.isinf(largest), np.nan, largest)


def _conditioning(points: Points, *, length: float | None = None) -> npt.ArrayLike:
    """Return the local conditioning index of C. Gosselin, J. Angeles, Journal of Mechanical Design 113 (1991)."""
    values = points.singular_values(length)
    return points.spread(np.nan_to_num(values[:, -1] / values[:, 0]))


def _isotropy(points: Points, *, length: float | None = None) -> npt.ArrayLike:
    """Return the measure of isotropy of J.-O. Kim, P. K. Khosla, "Dexterity measures...", IROS 1991."""
    values = points.singular_values(length)
    squares = (values / values[:, :1]) ** 2
    return points.spread(np.nan_to_num(squares.prod(axis=-1) ** (1.0 / values.shape[-1]) / squares.mean(axis=-1)))


def _tilt(normals: FloatArray) -> npt.ArrayLike:
    return np.arctan2(np.hypot(normals[..., 0], normals[..., 1]), normals[..., 2])


def _determinant(points: Points, column: int) -> npt.ArrayLike:
    if column > 0:
        _check_manipulator(points, ("det_lower", "det_upper", "det_structure")[column])
    return points.spread(points.determinants[:, column])


def _payload(points: Points, *, push: float = 1.0, pull: float | None = None) -> npt.ArrayLike:
    """Return the force held at o whatever its direction, without a moment, for efforts of at most push and pull."""
    # f = -Gᵀ w: a unit force u takes -G_v[:, i] · u of leg i, at most |G_v[:, i]| in either sense.
    largest = np.linalg.norm(points.platform_jacobians[:, :3], axis=-2).max(axis=-1)
    return points.spread(np.nan_to_num(min(push, push if pull is None else pull) / largest))


def _payload_down(points: Points, *, push: float = 1.0, pull: float | None = None) -> npt.ArrayLike:
    """Return the force along -Z of {B} that the machine holds at o, without a moment: a weight."""
    forces = points.platform_jacobians[:, 2]
    share = np.maximum(forces / push, -forces / (push if pull is None else pull)).max(axis=-1)
    return points.spread(np.nan_to_num(1.0 / share))


def _least_stiffness(points: Points, rows: slice, leg_stiffness: float) -> npt.ArrayLike:
    """Return the least stiffness against a force or a moment, `rows` of G, that leaves the other motion free."""
    # A force f moves o by G_v G_vᵀ f / leg_stiffness, G_v the upper three rows of G; everything but the legs is rigid.
    largest = singular_values(points.platform_jacobians[:, rows])[:, 0]
    return points.spread(np.nan_to_num(leg_stiffness / largest**2))


_ABSENT = "NaN where not reachable"
_HOMOGENEOUS = "of (v, L omega), L = length or the platform radius"
_BY_LEGS = "with efforts of the actuators of at most push and pull, forces or torques"


# To add a metric, add a row: name, unit, description, function of the points; for whole numbers also their type, and
# what they stand for. Keyword-only arguments of the function are the metric's parameters: positive numbers, by default
# as stated.
# fmt: off
_ROWS = (
    Metric("status", "1", "status of the displacement problem of the point",
           lambda points: points.status, "int8", {str(status): int(status) for status in Status}),
    Metric("reachable", "1", "whether there is a physical configuration within the leg limits",
           lambda points: points.reachable, "int8", {"no": 0, "yes": 1}),
    Metric("branches", "1", "number of real branches, leg limits aside",
           lambda points: np.count_nonzero(~np.isnan(points.branch_readings[..., 0]), axis=-1), "int8"),
    Metric("branches_within", "1", "number of real branches within the leg limits",
           lambda points: np.count_nonzero(points.branches_within, axis=-1), "int8"),
    Metric("branch", "1", "physical branch within the leg limits",
           _branch, "int8", {"none": -1} | {label: number for number, label in enumerate(BRANCHES)}),
    Metric("assembly_modes", "1",
           "number of assembly modes that the readings of the physical configuration allow; 0 where not reachable",
           _assembly_modes, "int16"),
    *(
        Metric(f"o_{axis.lower()}", "m", f"{axis} of o in the base frame; {_ABSENT}",
               lambda points, column=column: points.physical.translation[:, column])
        for column, axis in enumerate("XYZ")
    ),
    Metric("platform_tilt", "rad", f"angle between Z of the base and the platform's normal; {_ABSENT}",
           lambda points: _tilt(points.physical.rotation[..., 2])),
    Metric("leg_margin", "m", "how far the worst leg is inside its limits, for RRS legs at the knee, negative outside; "
           "NaN where no physical configuration exists, leg limits aside", _leg_margin),
    Metric("conditioning", "1", f"inverse condition number of the Jacobian {_HOMOGENEOUS}; {_ABSENT}", _conditioning),
    Metric("isotropy", "1", f"geometric over arithmetic mean of the eigenvalues of G G^T {_HOMOGENEOUS}; {_ABSENT}",
           _isotropy),
    Metric("forward_distance", "1", f"least singular value of J_b, J_c: distance to a forward singularity; {_ABSENT}",
           lambda points: points.spread(points.sigma[:, :-1].min(axis=-1))),
    Metric("inverse_distance", "1", f"least singular value of K: distance to an inverse singularity; {_ABSENT}",
           lambda points: points.spread(points.sigma[:, -1])),
    Metric("det_lower", "1", f"determinant of J_b, lower stage, forward, over d^3; {_ABSENT}",
           lambda points: _determinant(points, 0)),
    Metric("det_upper", "1", f"determinant of J_c, upper stage, forward, over d^3; {_ABSENT}",
           lambda points: _determinant(points, 1)),
    Metric("det_structure", "1", f"determinant of K, inverse, over d^3; {_ABSENT}",
           lambda points: _determinant(points, 2)),
    Metric("payload", "N", f"largest force at o held in every direction {_BY_LEGS}; {_ABSENT}", _payload),
    Metric("payload_down", "N", f"largest force at o held along -Z {_BY_LEGS}; {_ABSENT}", _payload_down),
    Metric("least_stiffness", "N m-1",
           f"least translational stiffness at o, for a stiffness of each actuator; {_ABSENT}",
           lambda points, *, leg_stiffness=1.0: _least_stiffness(points, slice(0, 3), leg_stiffness)),
    Metric("least_rotational_stiffness", "N m rad-1",
           f"least rotational stiffness, for a stiffness of each actuator; {_ABSENT}",
           lambda points, *, leg_stiffness=1.0: _least_stiffness(points, slice(3, 6), leg_stiffness)),
)
# fmt: on

METRICS: Mapping[str, Metric] = MappingProxyType({row.name: row for row in _ROWS[1:]})
"""The metrics of the package by name; with other parameters, ``METRICS["payload"](push=900.0)``."""
STATUS = _ROWS[0]
"""Stored in every sweep, where it distinguishes "not computed" from "no value here"."""
