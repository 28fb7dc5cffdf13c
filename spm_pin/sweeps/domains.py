"""Domains of a sweep: a lattice or a random sample of poses, or of leg lengths, described by a few numbers.

A domain does not hold its points. Those of a chunk are computed from the chunk's index when they are needed, so a
billion points need no more memory than ten.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS
from spm_pin.mechanism.arguments import FloatArray, real_array

__all__ = ["AXES", "Axis", "Domain", "Grid", "Range", "Sample", "Sampling", "Space", "chunk_region", "is_integer"]

Range = float | Sequence[float]
Space = Literal["pose", "legs"]
Sampling = Literal["sobol", "uniform"]

_ANGLES = ("alpha", "beta", "lambda_")
AXES: Mapping[str, tuple[str, ...]] = {"pose": ("x", "y", "z", *_ANGLES), "legs": LEGS}
"""Names of the six coordinates of each space."""

_LONG_NAMES = {
    **{name: f"{name.upper()} of o in {{B}}" for name in "xyz"},
    **{name: f"X-Y-X Euler angle {sign}" for name, sign in zip(_ANGLES, "αβλ", strict=True)},
    **{leg: f"length of leg {leg}" for leg in LEGS},
}
_MOST_VALUES = 10**8
"""Values along one axis; they are held in memory."""


@dataclass(frozen=True)
class Axis:
    """One coordinate and its values.

    Attributes
    ----------
    name : str
        x, y, z, alpha, beta, lambda_, or a leg.
    start, stop : float
        First and last value [m or rad]; equal where the coordinate is fixed.
    count : int
        Number of equally spaced values, both ends included; 1 where the coordinate is fixed, 0 in a sample.
    """

    name: str
    start: float
    stop: float
    count: int

    @classmethod
    def from_range(cls, name: str, given: Range, *, sampled: bool) -> Axis:
        """Read one value, (start, stop, count), or (start, stop) where the axis is `sampled`.

        Raises
        ------
        ArgumentError
            If the range is reversed, empty, not finite, or of fewer than two values.
        """
        unit = "radians" if name in _ANGLES else "metres"
        parts = "(start, stop)" if sampled else "(start, stop, count)"
        expected = f"one value or {parts}, in {unit}"
        values = real_array(given, name, (), expected)
        if values.shape not in ((), (2 if sampled else 3,)):
            raise ArgumentError(name, expected, f"shape {values.shape}")
        start, stop = (float(end) for end in (np.broadcast_to(values, (2,)) if values.ndim == 0 else values[:2]))
        if name in _ANGLES and max(abs(start), abs(stop)) > 2.0 * math.pi:
            raise ArgumentError(name, "angles within ±2π radians", given, "Degrees instead of radians?")
        if name in LEGS and start <= 0.0:
            raise ArgumentError(name, "positive lengths in metres", given)
        if values.ndim == 0:
            return cls(name, start, stop, 1)
        if not start < stop:
            cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
            raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
        if sampled:
            return cls(name, start, stop, 0)
        count = float(values[2])
        if not 2 <= count <= _MOST_VALUES or count != int(count):
            cause = "Give a fixed coordinate as one number." if count == 1 else ""
            raise ArgumentError(name, f"an integer count of at least 2, at most {_MOST_VALUES}", f"{count:g}", cause)
        return cls(name, start, stop, int(count))

    @property
    def fixed(self) -> bool:
        """Whether the coordinate has one value only."""
        return self.count == 1

    @property
    def values(self) -> FloatArray:
        """All values, shape (count,)."""
        return np.linspace(self.start, self.stop, self.count)

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and description, named as in the CF conventions."""
        return {"units": "rad" if self.name in _ANGLES else "m", "long_name": _LONG_NAMES[self.name]}


@dataclass(frozen=True)
class Domain(ABC):
    """The points of a sweep: a `Grid` or a `Sample`.

    Attributes
    ----------
    space : {"pose", "legs"}
        Whether a point is a pose or a set of leg lengths.
    axes : tuple of six Axis
        x, y, z, alpha, beta, lambda_, or the legs.
    """

    kind: ClassVar[str]
    space: Space
    axes: tuple[Axis, ...]

    @property
    @abstractmethod
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the results."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Lengths of those dimensions."""

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    @abstractmethod
    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points."""

    @abstractmethod
    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of one chunk, the last dimension fastest.

        Parameters
        ----------
        index : tuple of int
            Index of the chunk along `dims`.
        chunk : tuple of int
            Shape of the chunks; the last ones along a dimension may be shorter.

        Returns
        -------
        ndarray, shape (N, 6)
            Coordinates in the order of `axes` [m, rad].
        """

    def definition(self) -> dict[str, Any]:
        """Return the numbers that describe the domain, as JSON."""
        axes = {axis.name: [axis.start, axis.stop, axis.count] for axis in self.axes}
        return {"kind": self.kind, "space": self.space, "axes": axes}

    @staticmethod
    def from_definition(content: Mapping[str, Any]) -> Domain:
        """Make a domain from its `definition`; raises as the constructors do, or KeyError or TypeError."""
        ranges = {
            name: start if count == 1 else (start, stop, count) if count else (start, stop)
            for name, (start, stop, count) in content["axes"].items()
        }
        if content["kind"] == Sample.kind:
            return Sample.from_ranges(content["space"], ranges, content["count"], content["method"], content["seed"])
        return Grid.from_ranges(content["space"], ranges)


@dataclass(frozen=True)
class Grid(Domain):
    """A lattice: all combinations of the values of six axes. Made by `pose_grid` and `leg_grid`."""

    kind: ClassVar[str] = "grid"

    @classmethod
    def from_ranges(cls, space: Space, ranges: Mapping[str, Range]) -> Grid:
        """Check the six ranges, by name of the coordinate; raises `ArgumentError`."""
        return cls(space, _axes(space, ranges, sampled=False))

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the axes that are not fixed; results have one dimension for each."""
        return tuple(axis.name for axis in self.axes if not axis.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of values along `dims`."""
        return tuple(axis.count for axis in self.axes if not axis.fixed)

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points: the last axes whole, as far as they fit."""
        chunk, room = [], _chunk_limit(limit)
        for length in reversed(self.shape):
            # Parts of nearly equal length: a short last chunk would be stored at the size of a whole one.
            parts = -(-length // max(1, min(length, room)))
            chunk.append(-(-length // parts))
            room //= chunk[-1]
        return tuple(reversed(chunk))

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of one chunk; see `Domain.points`."""
        parts = iter(chunk_region(self.shape, index, chunk))
        values = [axis.values if axis.fixed else axis.values[next(parts)] for axis in self.axes]
        points = np.empty((*map(len, values), 6))
        for k, mesh in enumerate(np.meshgrid(*values, indexing="ij", copy=False)):
            points[..., k] = mesh
        return points.reshape(-1, 6)


@dataclass(frozen=True)
class Sample(Domain):
    """Points drawn from a box, along one dimension, `sample`. Made by `pose_sample` and `leg_sample`.

    Attributes
    ----------
    count : int
        Number of points.
    method : {"sobol", "uniform"}
        How they are drawn.
    seed : int
        Seed of the drawing.

    Notes
    -----
    Each chunk is drawn on its own, from the seed and its index: with "uniform" independently, with "sobol" as a Sobol
    sequence with its own random scrambling. The means over chunks of equal length are then independent and unbiased,
    and their scatter estimates the error of their mean [1]_. A chunk of a power of two is balanced best.

    .. [1] A. B. Owen, "Randomly permuted (t, m, s)-nets and (t, s)-sequences", Monte Carlo and Quasi-Monte Carlo
       Methods in Scientific Computing, Springer, 1995.
    """

    kind: ClassVar[str] = "sample"
    count: int
    method: Sampling
    seed: int

    @classmethod
    def from_ranges(cls, space: Space, ranges: Mapping[str, Range], count: int, method: Sampling, seed: int) -> Sample:
        """Check the six ranges, by name of the coordinate, and the rest; raises `ArgumentError`."""
        axes = _axes(space, ranges, sampled=True)
        for argument, value, least, most in (("count", count, 1, 2**53), ("seed", seed, 0, 2**128)):
            if not is_integer(value) or not least <= value <= most:
                raise ArgumentError(argument, f"an integer from {least} to {most}", repr(value))
        if not isinstance(method, str) or method not in ("sobol", "uniform"):
            raise ArgumentError("method", "'sobol' or 'uniform'", repr(method))
        return cls(space, axes, int(count), method, int(seed))

    @property
    def dims(self) -> tuple[str, ...]:
        """The one dimension of the results."""
        return ("sample",)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points, in a tuple."""
        return (self.count,)

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points."""
        return (min(_chunk_limit(limit), self.count),)

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of one chunk, shape (N, 6); see `Domain.points`."""
        (part,) = chunk_region(self.shape, index, chunk)
        count = part.stop - part.start
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=index))
        free = [k for k, axis in enumerate(self.axes) if not axis.fixed]
        if self.method == "sobol":
            # Imported here: it takes a fifth of a second, and most sweeps do not need it.
            from scipy.stats import qmc

            unit = qmc.Sobol(len(free), rng=rng).random_base2((count - 1).bit_length())[:count]
        else:
            unit = rng.random((count, len(free)))
        start, stop = (np.array([getattr(axis, end) for axis in self.axes]) for end in ("start", "stop"))
        points = np.tile(start, (count, 1))
        points[:, free] += unit * (stop - start)[free]
        return points

    def definition(self) -> dict[str, Any]:
        """Return the numbers that describe the sample, as JSON."""
        return {**super().definition(), "count": self.count, "method": self.method, "seed": self.seed}


def chunk_region(shape: tuple[int, ...], index: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the slices of the chunk at `index` in an array of `shape`."""
    return tuple(slice(i * n, min((i + 1) * n, total)) for i, n, total in zip(index, chunk, shape, strict=True))


def is_integer(value: object) -> bool:
    """Return whether a value is an integer, and no bool."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _axes(space: Space, ranges: Mapping[str, Range], *, sampled: bool) -> tuple[Axis, ...]:
    if tuple(ranges) != AXES[space]:
        raise ArgumentError("ranges", f"the coordinates {', '.join(AXES[space])}", ", ".join(ranges))
    axes = tuple(Axis.from_range(name, given, sampled=sampled) for name, given in ranges.items())
    if all(axis.fixed for axis in axes):
        raise ArgumentError("ranges", "at least one coordinate that varies", "six fixed ones")
    return axes


def _chunk_limit(limit: int) -> int:
    if not is_integer(limit) or limit < 1:
        raise ArgumentError("chunk", "a positive number of points", repr(limit))
    return int(limit)
