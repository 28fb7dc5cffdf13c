"""Domains of a sweep: a lattice or a random sample of poses, or of leg lengths, described by a few numbers.

A domain does not hold its points. Those of a chunk are computed from the chunk's index when they are needed, so a
billion points need no more memory than ten.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS
from spm_pin.mechanism.arguments import FloatArray, choice, real_array, whole_number

__all__ = ["AXES", "Axis", "Domain", "Drawing", "Range", "Sampling", "Space", "chunk_region", "make_domain"]

Range = float | Sequence[float]
"""One value, (start, stop, count) of a grid, or (start, stop) of a sample [m or rad]."""
Space = Literal["pose", "legs"]
"""The coordinates of a domain: poses of the platform, or six leg lengths."""
Sampling = Literal["sobol", "uniform"]
"""The distribution of sampled points: a scrambled Sobol sequence, or independent uniform ones."""

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
        Number of equally spaced values, both ends included; 1 where the coordinate is fixed, 0 where it is drawn.
    """

    name: str
    start: float
    stop: float
    count: int

    @property
    def fixed(self) -> bool:
        """True if the coordinate has one value only."""
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
class Drawing:
    """Method and parameters by which the points of a sample are drawn.

    Attributes
    ----------
    count : int
        Number of points.
    method : {"sobol", "uniform"}
        Scrambled Sobol sequences, one per chunk, or independent numbers.
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

    count: int
    method: Sampling
    seed: int

    def __post_init__(self) -> None:
        for argument, least, most in (("count", 1, 2**53), ("seed", 0, 2**128)):
            value = whole_number(getattr(self, argument), argument, least=least, most=most)
            object.__setattr__(self, argument, value)
        choice(self.method, "method", ("sobol", "uniform"))

    def draw(self, dimensions: int, index: tuple[int, ...], count: int) -> FloatArray:
        """Return the `count` points of the chunk at `index` in the unit cube, shape (count, dimensions)."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=index))
        if self.method == "uniform":
            return rng.random((count, dimensions))
        # Imported here: it takes a fifth of a second, and most sweeps do not need it.
        from scipy.stats import qmc

        return np.asarray(qmc.Sobol(dimensions, rng=rng).random_base2((count - 1).bit_length())[:count])


@dataclass(frozen=True)
class Domain:
    """The points of a sweep. Made by `pose_grid`, `leg_grid`, `pose_sample` and `leg_sample`.

    Attributes
    ----------
    space : {"pose", "legs"}
        Whether a point is a pose or a set of leg lengths.
    axes : tuple of six Axis
        x, y, z, alpha, beta, lambda_, or the legs.
    drawing : Drawing, optional
        How points are drawn from the box of the axes; a lattice, all combinations of their values, if not given.
    """

    space: Space
    axes: tuple[Axis, ...]
    drawing: Drawing | None = None

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions of the results: those of the axes that are not fixed, or "sample"."""
        return ("sample",) if self.drawing else tuple(axis.name for axis in self.axes if not axis.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of those dimensions."""
        return (self.drawing.count,) if self.drawing else tuple(axis.count for axis in self.axes if not axis.fixed)

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points: the last dimensions whole, as far as they fit."""
        chunk, room = [], whole_number(limit, "chunk", "a positive number of points", least=1)
        if self.drawing:
            return (min(room, self.drawing.count),)
        for length in reversed(self.shape):
            # Parts of nearly equal length: a short last chunk would be stored at the size of a whole one.
            parts = -(-length // max(1, min(length, room)))
            chunk.append(-(-length // parts))
            room //= chunk[-1]
        return tuple(reversed(chunk))

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
        region = chunk_region(self.shape, index, chunk)
        if self.drawing:
            count = region[0].stop - region[0].start
            free = [k for k, axis in enumerate(self.axes) if not axis.fixed]
            start, stop = np.array([(axis.start, axis.stop) for axis in self.axes]).T
            points = np.tile(start, (count, 1))
            points[:, free] += self.drawing.draw(len(free), index, count) * (stop - start)[free]
            return points
        parts = iter(region)
        values = [axis.values if axis.fixed else axis.values[next(parts)] for axis in self.axes]
        points = np.empty((*map(len, values), 6))
        for k, mesh in enumerate(np.meshgrid(*values, indexing="ij", copy=False)):
            points[..., k] = mesh
        return points.reshape(-1, 6)

    def definition(self) -> dict[str, Any]:
        """Return the numbers that describe the domain, as JSON."""
        axes = {axis.name: [axis.start, axis.stop, axis.count] for axis in self.axes}
        return {"space": self.space, "axes": axes, "drawing": self.drawing and asdict(self.drawing)}

    @staticmethod
    def from_definition(content: Mapping[str, Any]) -> Domain:
        """Make a domain from its `definition`, checked as by the functions that make domains."""
        ranges = {
            name: start if count == 1 else (start, stop, count) if count else (start, stop)
            for name, (start, stop, count) in content["axes"].items()
        }
        return make_domain(content["space"], ranges, content["drawing"] and Drawing(**content["drawing"]))


def make_domain(space: Space, ranges: Mapping[str, Range], drawing: Drawing | None = None) -> Domain:
    """Make a domain of the ranges of the six coordinates, by name.

    Raises
    ------
    ArgumentError
        If a range is reversed, empty, not finite, or of fewer than two values, or if nothing varies.
    """
    if tuple(ranges) != AXES[space]:
        raise ArgumentError("ranges", f"the coordinates {', '.join(AXES[space])}", ", ".join(ranges))
    axes = tuple(_axis(name, interval, drawing is not None) for name, interval in ranges.items())
    if all(axis.fixed for axis in axes):
        raise ArgumentError("ranges", "at least one coordinate that varies", "six fixed ones")
    return Domain(space, axes, drawing)


def chunk_region(shape: tuple[int, ...], index: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the slices of the chunk at `index` in an array of `shape`."""
    return tuple(slice(i * n, min((i + 1) * n, total)) for i, n, total in zip(index, chunk, shape, strict=True))


def _axis(name: str, interval: Range, drawn: bool) -> Axis:
    """Read one value, (start, stop, count), or (start, stop) where the coordinate is drawn."""
    unit = "radians" if name in _ANGLES else "metres"
    expected = f"one value or {'(start, stop)' if drawn else '(start, stop, count)'}, in {unit}"
    values = real_array(interval, name, (), expected)
    if values.shape not in ((), (2 if drawn else 3,)):
        raise ArgumentError(name, expected, f"shape {values.shape}")
    start, stop = (float(end) for end in (np.broadcast_to(values, (2,)) if values.ndim == 0 else values[:2]))
    if name in _ANGLES and max(abs(start), abs(stop)) > 2.0 * math.pi:
        raise ArgumentError(name, "angles within ±2π radians", interval, "Degrees instead of radians?")
    if name in LEGS and start <= 0.0:
        raise ArgumentError(name, "positive lengths in metres", interval)
    if values.ndim == 0:
        return Axis(name, start, stop, 1)
    if not start < stop:
        cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
        raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
    count = 0.0 if drawn else float(values[2])
    if not drawn and (not 2 <= count <= _MOST_VALUES or count != int(count)):
        cause = "Give a fixed coordinate as one number." if count == 1 else ""
        raise ArgumentError(name, f"an integer count of at least 2, at most {_MOST_VALUES}", f"{count:g}", cause)
    return Axis(name, start, stop, int(count))
