"""The plan of a sweep: its domain, a lattice or a sample of poses, tilts or readings, its metrics, and its chunks.

A domain does not hold its points: those of a chunk are computed from the chunk's index when they are needed.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.machine import LEGS, Manipulator, Stage
from spm_pin.machine.legs import STAGE_LEGS
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.machine.manipulator import machine_from_data
from spm_pin.support.arguments import FloatArray, check_instance, real_array, whole_number
from spm_pin.sweeps.metrics import STATUS, Metric, prepare_metrics, resolve_metrics
from spm_pin.sweeps.points import Points, Space

AxisRange = float | Sequence[float]
"""One value, (start, stop, count) of a grid, or (start, stop) of a sample [m or rad]."""

_ALL_LEGS = (*LEGS, *STAGE_LEGS)
_LENGTHS = {k.lower(): f"{k} of o in {{B}}" for k in "XYZ"} | {leg: f"reading of leg {leg}" for leg in _ALL_LEGS}
_LENGTHS["height"] = "height of the platform's origin above the plane of the pivots"
_XYX = {name: f"X-Y-X Euler angle {sign}" for name, sign in (("alpha", "α"), ("beta", "β"), ("lambda_", "λ"))}
_ANGLES = _XYX | {"tilt": "angle between Z of the base and the platform's normal", "azimuth": "where the normal leans"}
AXES: dict[type[Machine], dict[Space, tuple[str, ...]]] = {
    Manipulator: {"pose": ("x", "y", "z", *_XYX), "legs": LEGS},
    Stage: {"tilt": ("height", "tilt", "azimuth"), "legs": STAGE_LEGS},
}
"""Names of the coordinates of each space of a machine."""
_ARGUMENTS: dict[Space, str] = {"pose": "x, y, z, xyx", "tilt": "height, tilt, azimuth", "legs": "lower, upper"}
_RESERVED = {*_LENGTHS, *_ANGLES, "sample", "status", "sweep"}
"""Names in a store that no metric may have."""
_MOST_VALUES = 10**8
"""Maximum number of values along one axis; they are kept in memory."""
_BLOCK = 8192
"""Points evaluated together: enough for little time outside kernels, few enough to need some megabytes."""
FORMAT = 6
"""Version of the layout of a store."""


@dataclass(frozen=True)
class Axis:
    """One coordinate of a domain, named as in `AXES`, and its values from `start` to `stop` [m or rad].

    Whether a reading is a length or an angle depends on the machine's legs: see `SweepPlan.unit`.
    """

    name: str
    start: float
    stop: float
    count: int
    """Number of equally spaced values, both ends included; 1 where the coordinate is fixed, 0 where it is sampled."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "count", whole_number(self.count, "count", least=0, most=_MOST_VALUES))

    @staticmethod
    def from_range(name: str, value: AxisRange, sampled: bool) -> Axis:
        """Read an `AxisRange`."""
        unit, ends = "radians" if name in _ANGLES else "metres", "start, stop" if sampled else "start, stop, count"
        unit += ", for RRS legs in radians" if name in _ALL_LEGS else ""
        expected = f"one value or ({ends}), in {unit}"
        numbers = real_array(value, name, (), expected)
        if numbers.shape not in ((), (2 if sampled else 3,)):
            raise ArgumentError(name, expected, f"shape {numbers.shape}")
        start, stop = map(float, numbers[:2] if numbers.ndim else (numbers, numbers))
        if name in _ANGLES and max(abs(start), abs(stop)) > 2.0 * math.pi:
            raise ArgumentError(name, "angles within ±2π radians", value, "Degrees instead of radians?")
        if name == "tilt" and not 0.0 <= min(start, stop) <= max(start, stop) < math.pi:
            cause = "To the other side leans what has another azimuth"
            raise ArgumentError(name, "angles from 0 to less than π, in radians", value, cause)
        if numbers.ndim == 0:
            return Axis(name, start, stop, 1)
        if not start < stop:
            cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
            raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
        count = 0.0 if sampled else numbers[2]
        if not sampled and not (2 <= count <= _MOST_VALUES and count == int(count)):
            expected = f"an integer count of at least 2, at most {_MOST_VALUES}"
            raise ArgumentError(name, expected, f"{count:g}", "Give a fixed coordinate as one number.")
        return Axis(name, start, stop, int(count))

    @property
    def is_fixed(self) -> bool:
        """True if there is one value only."""
        return self.count == 1

    @property
    def values(self) -> FloatArray:
        """All values, shape (count,)."""
        return np.linspace(self.start, self.stop, self.count)

    @property
    def description(self) -> str:
        """Description of the coordinate, one line."""
        return (_LENGTHS | _ANGLES)[self.name]


@dataclass(frozen=True)
class Sample:
    """Points drawn at random, each chunk by a Sobol sequence that is scrambled by the seed and the chunk's index.

    Means over chunks of equal length are independent and unbiased: their scatter estimates the error of their mean; see
    A. B. Owen, "Randomly permuted (t, m, s)-nets and (t, s)-sequences", Monte Carlo and Quasi-Monte Carlo Methods in
    Scientific Computing, Springer, 1995.
    """

    count: int
    seed: int
    """Seed, from 0 to 2¹²⁸."""

    def __post_init__(self) -> None:
        for argument, least, most in (("count", 1, 2**53), ("seed", 0, 2**128)):
            value = whole_number(getattr(self, argument), argument, least=least, most=most)
            object.__setattr__(self, argument, value)

    def draw(self, dimensions: int, index: tuple[int, ...], count: int) -> FloatArray:
        """Return the `count` points of the chunk at `index` in the unit cube, shape (count, dimensions)."""
        # Imported here: it takes a fifth of a second, and most sweeps do not need it.
        from scipy.stats import qmc

        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=index))
        return np.asarray(qmc.Sobol(dimensions, rng=rng).random_base2((count - 1).bit_length())[:count])


@dataclass(frozen=True)
class Domain:
    """The points of a sweep. Made by `pose_grid`, `tilt_grid`, `leg_grid`, and the samples of the same names."""

    space: Space
    axes: tuple[Axis, ...]
    """The coordinates, in the order of `AXES`."""
    sample: Sample | None = None
    """Random sample of the box of the axes; all combinations of their values if not given."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the results: those of the axes that are not fixed, or "sample"."""
        return ("sample",) if self.sample else tuple(axis.name for axis in self.axes if not axis.is_fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of those dimensions."""
        return (self.sample.count,) if self.sample else tuple(axis.count for axis in self.axes if not axis.is_fixed)

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points: the last dimensions whole, as far as they fit."""
        room = whole_number(limit, "chunk", "a positive number of points", least=1)
        if self.sample:
            return (min(room, self.sample.count),)
        chunk: list[int] = []
        for length in reversed(self.shape):
            # Parts of nearly equal length: a short last chunk would be stored at the size of a whole one.
            parts = -(-length // max(1, min(length, room)))
            chunk.insert(0, -(-length // parts))
            room //= chunk[0]
        return tuple(chunk)

    def region(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
        """Return the slices of the chunk at `index` in the results; the last ones may be shorter than `chunk`."""
        lengths = zip(index, chunk, self.shape, strict=True)
        return tuple(slice(i * n, min((i + 1) * n, total)) for i, n, total in lengths)

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of the chunk at `index` [m, rad], shape (N, axes), the last dimension fastest."""
        region = self.region(index, chunk)
        if self.sample:
            count = region[0].stop - region[0].start
            free = [k for k, axis in enumerate(self.axes) if not axis.is_fixed]
            start, stop = np.array([(axis.start, axis.stop) for axis in self.axes]).T
            points = np.tile(start, (count, 1))
            points[:, free] += self.sample.draw(len(free), index, count) * (stop - start)[free]
            return points
        parts = iter(region)
        values = [axis.values if axis.is_fixed else axis.values[next(parts)] for axis in self.axes]
        return np.stack(np.meshgrid(*values, indexing="ij", copy=False), axis=-1).reshape(-1, len(values))

    @property
    def ends(self) -> FloatArray:
        """First and last values of the axes, shape (2, axes)."""
        return np.array([[axis.start for axis in self.axes], [axis.stop for axis in self.axes]])


def pose_grid(x: AxisRange, y: AxisRange, z: AxisRange, *, xyx: Sequence[AxisRange]) -> Domain:
    """Describe a lattice of poses.

    Parameters
    ----------
    x, y, z : float or (start, stop, count)
        Position of o in {B} [m]: one value, or equally spaced ones with both ends among them.
    xyx : three of float or (start, stop, count)
        The paper's Euler angles α, β, λ [rad], likewise.

    Examples
    --------
    >>> grid = pose_grid((-0.5, 0.5, 101), (-0.5, 0.5, 101), 2.4, xyx=[0.3, 0.5, -0.3])
    >>> grid.dims, grid.size
    (('x', 'y'), 10201)
    """
    return _domain(Manipulator, "pose", [x, y, z, *_three(xyx, "xyx")])


def tilt_grid(height: AxisRange, tilt: AxisRange, azimuth: AxisRange) -> Domain:
    """Describe a lattice of heights and tilts of a stage.

    Parameters
    ----------
    height : float or (start, stop, count)
        Height of the platform's origin above the pivots [m]: one value, or equally spaced ones including both ends.
    tilt, azimuth : float or (start, stop, count)
        Angle between the platform's normal and z, from 0 to less than π, and where the normal leans [rad], likewise.

    Examples
    --------
    >>> import numpy as np
    >>> tilt_grid((0.08, 0.15, 36), (0.0, 0.5, 26), (-np.pi, np.pi, 73)).size
    68328
    """
    return _domain(Stage, "tilt", [height, tilt, azimuth])


def leg_grid(lower: AxisRange | Sequence[AxisRange], upper: AxisRange | Sequence[AxisRange] | None = None) -> Domain:
    """Describe a lattice of readings, which are lengths for RPS legs.

    Parameters
    ----------
    lower, upper : float, (start, stop, count), or three of these
        Readings of the lower legs r_b1, r_b2, r_b3 and of the upper legs r_c1, r_c2, r_c3 [m] ([rad] for RRS legs): one
        value for all three legs, or a list of three. A tuple of three numbers is a range. For a stage only `lower`, for
        r_1, r_2, r_3.
    """
    return _leg_domain(lower, upper)


def pose_sample(
    count: int, x: AxisRange, y: AxisRange, z: AxisRange, *, xyx: Sequence[AxisRange], seed: int = 0
) -> Domain:
    """Describe poses drawn from a box of positions and X-Y-X angles, by scrambled Sobol sequences.

    Parameters
    ----------
    count, seed : int
        Number of poses, and seed of the random generator.
    x, y, z, xyx
        As for `pose_grid`, with ranges (start, stop). The distribution is uniform in these coordinates; one that is
        uniform over rotations has the weight ``|sin β|``.
    """
    return _domain(Manipulator, "pose", [x, y, z, *_three(xyx, "xyx")], Sample(count, seed))


def tilt_sample(count: int, height: AxisRange, tilt: AxisRange, azimuth: AxisRange, *, seed: int = 0) -> Domain:
    """Describe heights and tilts of a stage drawn from a box, by scrambled Sobol sequences.

    Parameters
    ----------
    count, seed : int
        Number of tilts, and seed of the random generator.
    height, tilt, azimuth
        As for `tilt_grid`, with ranges (start, stop). The distribution is uniform in these coordinates; one that is
        uniform over normals has the weight ``sin(tilt)``.
    """
    return _domain(Stage, "tilt", [height, tilt, azimuth], Sample(count, seed))


def leg_sample(
    count: int,
    lower: AxisRange | Sequence[AxisRange],
    upper: AxisRange | Sequence[AxisRange] | None = None,
    *,
    seed: int = 0,
) -> Domain:
    """Describe readings drawn from a box, by scrambled Sobol sequences.

    Parameters
    ----------
    count, seed : int
        Number of sets of readings, and seed of the random generator.
    lower, upper
        As for `leg_grid`, with ranges (start, stop).
    """
    return _leg_domain(lower, upper, Sample(count, seed))


def _domain(machine: type[Machine], space: Space, ranges: list[AxisRange], sample: Sample | None = None) -> Domain:
    named = zip(AXES[machine][space], ranges, strict=True)
    axes = tuple(Axis.from_range(name, values, sample is not None) for name, values in named)
    if all(axis.is_fixed for axis in axes):
        raise ArgumentError(_ARGUMENTS[space], "at least one coordinate with a range", "fixed coordinates only")
    return Domain(space, axes, sample)


def _leg_domain(lower: Any, upper: Any, sample: Sample | None = None) -> Domain:
    stages = [("lower", lower), ("upper", upper)][: 1 if upper is None else 2]
    ranges = [x for name, stage in stages for x in _three(stage if isinstance(stage, list) else [stage] * 3, name)]
    return _domain(Stage if upper is None else Manipulator, "legs", ranges, sample)


def _three(ranges: Any, argument: str) -> list[AxisRange]:
    if not isinstance(ranges, Sequence | np.ndarray) or isinstance(ranges, str) or len(ranges) != 3:
        raise ArgumentError(argument, "three values or ranges", repr(ranges))
    return list(ranges)


def coordinate_unit(machine: Machine, axis: Axis) -> str:
    """Return the unit of a coordinate of a machine, "m" or "rad"."""
    legs = dict(zip(machine.legs.names, machine.legs.units, strict=True))
    return legs.get(axis.name, "rad" if axis.name in _ANGLES else "m")


@dataclass(frozen=True)
class SweepPlan:
    """Everything that determines the bytes of a store."""

    machine: Manipulator | Stage
    domain: Domain
    metrics: tuple[Metric, ...]
    """Metrics, in the order of their names."""
    chunk: tuple[int, ...]
    """Shape of a chunk along the dimensions of the domain."""
    version: str
    """Version of this package."""

    @classmethod
    def make(
        cls, machine: Manipulator | Stage, domain: Domain, metrics: Iterable[str | Metric], chunk: int
    ) -> SweepPlan:
        """Make a plan of metrics, each given by its name or as a `Metric`, with chunks of at most `chunk` points."""
        check_machine(machine)
        check_instance(domain, Domain, "domain", "Made by pose_grid, leg_grid, pose_sample or leg_sample?")
        spaces, names = AXES[type(machine)], tuple(axis.name for axis in domain.axes)
        if spaces.get(domain.space) != names:
            expected = f"coordinates of a {type(machine).__name__}: {' or '.join(map(', '.join, spaces.values()))}"
            cause = "For a stage use tilt_grid or leg_grid(readings), for a manipulator pose_grid or leg_grid"
            raise ArgumentError("domain", expected, ", ".join(names), cause)
        for axis, least in zip(domain.axes, machine.legs.free_limits.minimum, strict=True):
            if axis.name in _ALL_LEGS and axis.start <= least:
                raise ArgumentError(axis.name, "positive lengths in metres", f"{axis.start:g}")
        # Sorted by name, so that the sweep does not depend on their order.
        ordered = tuple(sorted(resolve_metrics(metrics), key=lambda metric: metric.name))
        reserved = [metric.name for metric in ordered if metric.name in _RESERVED]
        if reserved:
            raise ArgumentError("metrics", "names other than those of the coordinates", ", ".join(reserved))
        return cls(machine, domain, ordered, domain.chunk_shape(chunk), package_version())

    @classmethod
    def from_definition(cls, content: dict[str, Any]) -> SweepPlan:
        """Make a plan from its `text` as JSON; metrics of other packages have names, but no function."""
        machine, domain = machine_from_data(content["geometry"], "geometry"), content["domain"]
        axes, sample = tuple(Axis(**axis) for axis in domain["axes"]), domain["sample"]
        domain = Domain(domain["space"], axes, sample and Sample(**sample))
        metrics = tuple(map(Metric.from_definition, content["metrics"]))
        chunk = domain.chunk_shape(math.prod(content["chunk"]))
        return cls(machine, domain, metrics, chunk, content["spm_pin"])

    @cached_property
    def text(self) -> str:
        """The inputs that determine the results, as the text of a JSON object; made once, and sent to workers."""
        definition = {
            "format": FORMAT,
            "spm_pin": self.version,
            "geometry": self.machine.as_data(),
            "domain": asdict(self.domain),
            "metrics": [metric.definition() for metric in self.metrics],
            "chunk": self.chunk,
        }
        return json.dumps(definition, ensure_ascii=False)  # of numbers limits alone may be infinite

    @property
    def variables(self) -> tuple[Metric, ...]:
        """Variables stored for every point: coordinates of a sample, the status, and the metrics."""
        sampled = [
            Metric(axis.name, self.unit(axis), axis.description, lambda points, k=k: points.coordinates[:, k])
            for k, axis in enumerate(self.domain.axes)
            if axis.count == 0
        ]
        return (*sampled, STATUS, *self.metrics)

    def unit(self, axis: Axis) -> str:
        """Return the unit of a coordinate, "m" or "rad"."""
        return coordinate_unit(self.machine, axis)

    @property
    def chunks(self) -> tuple[int, ...]:
        """Number of chunks along each dimension."""
        return tuple(-(-length // size) for length, size in zip(self.domain.shape, self.chunk, strict=True))

    @property
    def count(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunks)

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        """Iterate over the indices of the chunks, without a list of them."""
        return (tuple(map(int, np.unravel_index(k, self.chunks))) for k in range(self.count))

    def chunk_size(self, index: tuple[int, ...]) -> int:
        """Return the number of points of the chunk at `index`."""
        return math.prod(part.stop - part.start for part in self.domain.region(index, self.chunk))

    def prepare(self) -> None:
        """Evaluate the metrics at the ends of the domain; heights and readings in another unit are refused there."""
        from spm_pin.kinematics.kernels.compilation import expecting

        with expecting(self.domain.size):
            points = Points(self.machine, self.domain.space, self.domain.ends)
            STATUS.evaluate(points)
            prepare_metrics(self.metrics, points)

    def evaluate(self, index: tuple[int, ...]) -> dict[str, npt.NDArray[Any]]:
        """Return the values of all variables on the chunk at `index`, each of the shape of its region."""
        coordinates = self.domain.points(index, self.chunk)
        variables, count = self.variables, len(coordinates)
        values = {metric.name: np.empty(count, dtype=metric.dtype) for metric in variables}
        for first in range(0, count, _BLOCK):
            block = slice(first, first + _BLOCK)
            points = Points(self.machine, self.domain.space, coordinates[block])
            for metric in variables:
                values[metric.name][block] = metric.evaluate(points)
        shape = tuple(part.stop - part.start for part in self.domain.region(index, self.chunk))
        return {name: array.reshape(shape) for name, array in values.items()}


def package_version() -> str:
    """Return the version of this package."""
    # By name: the root imports every layer, and no layer imports the root.
    return str(import_module("spm_pin").__version__)


def definition_differences(stored: Any, requested: Any, where: str = "", *, of: str = "sweep") -> list[str]:
    """Return the differences between two definitions, as JSON, a line for each."""
    if stored == requested:
        return []
    both: tuple[Any, ...] = stored, requested
    if all(isinstance(side, dict) for side in both):
        pairs = [(f"{where}.{key}".lstrip("."), stored.get(key), requested.get(key)) for key in {**stored, **requested}]
    elif all(isinstance(side, list) for side in both) and len(stored) == len(requested):
        pairs = [(f"{where}[{k}]", *pair) for k, pair in enumerate(zip(stored, requested, strict=True))]
    else:
        if where == "metrics":
            both = tuple([metric["name"] for metric in side] for side in both)
        old, new = (textwrap.shorten(json.dumps(side, ensure_ascii=False), 120, placeholder=" …") for side in both)
        return [f"{where} is {old} in the store and {new} in this {of}"]
    return [line for name, old, new in pairs for line in definition_differences(old, new, name, of=of)]
