"""Domains of a sweep: lattices and random samples of poses or of leg lengths.

A domain does not hold its points: those of a chunk are computed from the chunk's index when they are needed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS
from spm_pin.mechanism.arguments import FloatArray, real_array, whole_number

AxisRange = float | Sequence[float]
"""One value, (start, stop, count) of a grid, or (start, stop) of a sample [m or rad]."""
Space = Literal["pose", "legs"]
"""The coordinates of a domain: poses of the platform, or six leg lengths."""

_LENGTHS = {k.lower(): f"{k} of o in {{B}}" for k in "XYZ"} | {leg: f"length of leg {leg}" for leg in LEGS}
_ANGLES = {name: f"X-Y-X Euler angle {sign}" for name, sign in (("alpha", "α"), ("beta", "β"), ("lambda_", "λ"))}
AXES: Mapping[str, tuple[str, ...]] = {"pose": ("x", "y", "z", *_ANGLES), "legs": LEGS}
"""Names of the six coordinates of each space."""
_MOST_VALUES = 10**8
"""Values along one axis; they are held in memory."""


@dataclass(frozen=True)
class Axis:
    """One coordinate of a domain and its values."""

    name: str
    """Name of the coordinate, one of `AXES`."""
    start: float
    """First value [m or rad]."""
    stop: float
    """Last value [m or rad]."""
    count: int
    """Number of equally spaced values, both ends included; 1 where the coordinate is fixed, 0 where it is sampled."""

    @staticmethod
    def from_range(name: str, value: AxisRange, sampled: bool) -> Axis:
        """Read one value, (start, stop, count), or (start, stop) where the coordinate is sampled."""
        unit = "radians" if name in _ANGLES else "metres"
        expected = f"one value or {'(start, stop)' if sampled else '(start, stop, count)'}, in {unit}"
        numbers = real_array(value, name, (), expected)
        if numbers.shape not in ((), (2 if sampled else 3,)):
            raise ArgumentError(name, expected, f"shape {numbers.shape}")
        start, stop = map(float, numbers[:2] if numbers.ndim else (numbers, numbers))
        if name in _ANGLES and max(abs(start), abs(stop)) > 2.0 * math.pi:
            raise ArgumentError(name, "angles within ±2π radians", value, "Degrees instead of radians?")
        if name in LEGS and start <= 0.0:
            raise ArgumentError(name, "positive lengths in metres", value)
        if numbers.ndim == 0:
            return Axis(name, start, stop, 1)
        if not start < stop:
            cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
            raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
        count = 0 if sampled else int(numbers[2])
        if not sampled and (not 2 <= count <= _MOST_VALUES or count != numbers[2]):
            expected = f"an integer count of at least 2, at most {_MOST_VALUES}"
            raise ArgumentError(name, expected, f"{numbers[2]:g}", "Give a fixed coordinate as one number.")
        return Axis(name, start, stop, count)

    @property
    def is_fixed(self) -> bool:
        """True if the coordinate has one value only."""
        return self.count == 1

    @property
    def values(self) -> FloatArray:
        """All values, shape (count,)."""
        return np.linspace(self.start, self.stop, self.count)

    @property
    def unit(self) -> str:
        """Unit, "rad" or "m"."""
        return "rad" if self.name in _ANGLES else "m"

    @property
    def description(self) -> str:
        """One line that says what the coordinate is."""
        return (_LENGTHS | _ANGLES)[self.name]


@dataclass(frozen=True)
class Sample:
    """Points drawn at random, each chunk by a Sobol sequence that is scrambled by the seed and the chunk's index.

    Means over chunks of equal length are independent and unbiased: their scatter estimates the error of their mean; see
    A. B. Owen, "Randomly permuted (t, m, s)-nets and (t, s)-sequences", Monte Carlo and Quasi-Monte Carlo Methods in
    Scientific Computing, Springer, 1995.
    """

    count: int
    """Number of points."""
    seed: int
    """Seed of the random numbers, from 0 to 2¹²⁸."""

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
    """The points of a sweep. Made by `pose_grid`, `leg_grid`, `pose_sample` and `leg_sample`."""

    space: Space
    """Kind of the coordinates: the platform's pose, or the leg lengths."""
    axes: tuple[Axis, ...]
    """The six coordinates, in the order of `AXES`."""
    sample: Sample | None = None
    """How points are drawn from the box of the axes; a lattice, all combinations of their values, if not given."""

    @staticmethod
    def from_ranges(space: Space, ranges: Sequence[AxisRange], sample: Sample | None = None) -> Domain:
        """Make a domain of the ranges of the six coordinates."""
        named = zip(AXES[space], ranges, strict=True)
        axes = tuple(Axis.from_range(name, values, sample is not None) for name, values in named)
        if all(axis.is_fixed for axis in axes):
            raise ArgumentError("ranges", "at least one coordinate that varies", "six fixed ones")
        return Domain(space, axes, sample)

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
        """Return the coordinates of the chunk at `index` [m, rad], shape (N, 6), the last dimension fastest."""
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
        return np.stack(np.meshgrid(*values, indexing="ij", copy=False), axis=-1).reshape(-1, 6)

    def definition(self) -> dict[str, Any]:
        """Return the numbers that describe the domain, as JSON."""
        axes = [asdict(axis) for axis in self.axes]
        return {"space": self.space, "axes": axes, "sample": self.sample and asdict(self.sample)}

    @staticmethod
    def from_definition(content: Mapping[str, Any]) -> Domain:
        """Make a domain from its `definition`."""
        axes = tuple(Axis(**axis) for axis in content["axes"])
        return Domain(content["space"], axes, content["sample"] and Sample(**content["sample"]))


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
    return Domain.from_ranges("pose", [x, y, z, *_three(xyx, "xyx")])


def leg_grid(lower: AxisRange | Sequence[AxisRange], upper: AxisRange | Sequence[AxisRange]) -> Domain:
    """Describe a lattice of leg lengths.

    Parameters
    ----------
    lower, upper : float, (start, stop, count), or three of these
        Lengths of the lower legs r_b1, r_b2, r_b3 and of the upper legs r_c1, r_c2, r_c3 [m]: the same for the three,
        or one after another in a list. A tuple of three numbers is a range.
    """
    return Domain.from_ranges("legs", _leg_ranges(lower, upper))


def pose_sample(
    count: int, x: AxisRange, y: AxisRange, z: AxisRange, *, xyx: Sequence[AxisRange], seed: int = 0
) -> Domain:
    """Describe poses drawn from a box of positions and X-Y-X angles, by scrambled Sobol sequences.

    Parameters
    ----------
    count : int
        Number of poses.
    x, y, z, xyx
        As for `pose_grid`, with ranges (start, stop). The distribution is uniform in these coordinates; one that is
        uniform over rotations has the weight ``|sin β|``.
    seed : int
        Seed of the random generator.
    """
    return Domain.from_ranges("pose", [x, y, z, *_three(xyx, "xyx")], Sample(count, seed))


def leg_sample(
    count: int, lower: AxisRange | Sequence[AxisRange], upper: AxisRange | Sequence[AxisRange], *, seed: int = 0
) -> Domain:
    """Describe leg lengths drawn from a box, by scrambled Sobol sequences.

    Parameters
    ----------
    count : int
        Number of sets of six lengths.
    lower, upper : float, (start, stop), or three of these
        As for `leg_grid`.
    seed : int
        Seed of the random generator.
    """
    return Domain.from_ranges("legs", _leg_ranges(lower, upper), Sample(count, seed))


def _leg_ranges(*stages: AxisRange | Sequence[AxisRange]) -> list[AxisRange]:
    named = zip(("lower", "upper"), stages, strict=True)
    return [leg for name, stage in named for leg in _three(stage if isinstance(stage, list) else [stage] * 3, name)]


def _three(ranges: Any, argument: str) -> Sequence[AxisRange]:
    if not isinstance(ranges, Sequence | np.ndarray) or isinstance(ranges, str) or len(ranges) != 3:
        raise ArgumentError(argument, "three values or ranges", repr(ranges))
    return ranges
