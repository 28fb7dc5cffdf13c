"""What a sweep runs over: a lattice or a random sample of poses, or of leg lengths, told in a few numbers.

Nothing here holds the points themselves. A chunk of them is made from its index when it is needed, so a billion
points weigh no more than ten.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["ANGLES", "POSITION", "Axis", "Domain", "Grid", "Method", "Sample", "Space", "region"]

POSITION = ("x", "y", "z")
ANGLES = ("alpha", "beta", "lambda_")

Space = Literal["pose", "legs"]
Method = Literal["sobol", "uniform"]

_LONG_NAMES = {
    "x": "X of o in {B}",
    "y": "Y of o in {B}",
    "z": "Z of o in {B}",
    "alpha": "X-Y-X Euler angle α",
    "beta": "X-Y-X Euler angle β",
    "lambda_": "X-Y-X Euler angle λ",
    **{leg: f"length of leg {leg}" for leg in LEGS},
}


@dataclass(frozen=True)
class Axis:
    """One coordinate and the values it takes.

    Attributes
    ----------
    name : str
        x, y, z, alpha, beta, lambda_, or a leg.
    start, stop : float
        First and last value [m or rad]; equal where the coordinate is fixed.
    count : int
        How many equally spaced values, both ends among them; 1 where the coordinate is fixed, 0 in a sample.
    """

    name: str
    start: float
    stop: float
    count: int

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
        """Unit and description, as CF names them."""
        return {"units": "rad" if self.name in ANGLES else "m", "long_name": _LONG_NAMES[self.name]}


class Domain(Protocol):
    """A `Grid` or a `Sample`."""

    @property
    def space(self) -> Space:
        """Whether points are poses or leg lengths."""
        ...

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The six coordinates."""
        ...

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the axes that results have."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of those axes."""
        ...

    @property
    def size(self) -> int:
        """Number of points."""
        ...

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points."""
        ...

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates (N, 6) of the chunk at `index` when chunks have the shape `chunk`."""
        ...

    def definition(self) -> dict[str, Any]:
        """Return what `Grid.from_definition` or `Sample.from_definition` makes it from, as JSON."""
        ...


@dataclass(frozen=True)
class Grid:
    """A lattice: every combination of the values of six axes. Made by `pose_grid` and `leg_grid`.

    Attributes
    ----------
    space : {"pose", "legs"}
        Whether a point is a pose or a set of leg lengths.
    axes : tuple of six Axis
        x, y, z, alpha, beta, lambda_, or the legs.
    """

    space: Space
    axes: tuple[Axis, ...]

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the axes that are not fixed; results have one dimension for each."""
        return tuple(axis.name for axis in self.axes if not axis.fixed)

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of values along `dims`."""
        return tuple(axis.count for axis in self.axes if not axis.fixed)

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points: the last axes whole, as far as they fit."""
        chunk, room = [], _chunk_limit(limit)
        for length in reversed(self.shape):
            # Parts of nearly equal length, so that the last is no splinter that is stored at full size.
            parts = -(-length // max(1, min(length, room)))
            chunk.append(-(-length // parts))
            room //= chunk[-1]
        return tuple(reversed(chunk))

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of one chunk, the last axis fastest.

        Parameters
        ----------
        index : tuple of int
            Which chunk, along `dims`.
        chunk : tuple of int
            Shape of the chunks; the last ones along an axis may be shorter.

        Returns
        -------
        ndarray, shape (N, 6)
            Coordinates in the order of `axes` [m, rad].
        """
        parts = iter(region(self.shape, index, chunk))
        values = [axis.values if axis.fixed else axis.values[next(parts)] for axis in self.axes]
        return np.stack([mesh.ravel() for mesh in np.meshgrid(*values, indexing="ij")], axis=-1)

    def definition(self) -> dict[str, Any]:
        """Return the numbers it is made from, as JSON."""
        return {
            "kind": "grid",
            "space": self.space,
            "axes": {axis.name: [axis.start, axis.stop, axis.count] for axis in self.axes},
        }

    @classmethod
    def from_definition(cls, content: Mapping[str, Any]) -> Grid:
        """Make it again from its `definition`."""
        return cls(content["space"], tuple(Axis(name, *axis) for name, axis in content["axes"].items()))


@dataclass(frozen=True)
class Sample:
    """Points drawn from a box, along one dimension, `sample`. Made by `pose_sample` and `leg_sample`.

    Attributes
    ----------
    space : {"pose", "legs"}
        Whether a point is a pose or a set of leg lengths.
    axes : tuple of six Axis
        The ranges; `count` is 0 where the coordinate varies.
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
    and their scatter is an honest measure of the error of their mean [1]_. A chunk of a power of two is balanced best.

    .. [1] A. B. Owen, "Randomly permuted (t, m, s)-nets and (t, s)-sequences", Monte Carlo and Quasi-Monte Carlo
       Methods in Scientific Computing, Springer, 1995.
    """

    space: Space
    axes: tuple[Axis, ...]
    count: int
    method: Method
    seed: int

    @property
    def dims(self) -> tuple[str, ...]:
        """The one dimension of the results."""
        return ("sample",)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points, in a tuple."""
        return (self.count,)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.count

    def chunk_shape(self, limit: int) -> tuple[int, ...]:
        """Return the shape of chunks of at most `limit` points."""
        return (min(_chunk_limit(limit), self.count),)

    def points(self, index: tuple[int, ...], chunk: tuple[int, ...]) -> FloatArray:
        """Return the coordinates of one chunk, shape (N, 6); see `Grid.points`."""
        (part,) = region(self.shape, index, chunk)
        count = part.stop - part.start
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=index))
        free = [k for k, axis in enumerate(self.axes) if not axis.fixed]
        if self.method == "sobol":
            # Imported here: a fifth of a second that most sweeps have no use for.
            from scipy.stats import qmc

            unit = qmc.Sobol(len(free), rng=rng).random_base2((count - 1).bit_length())[:count]
        else:
            unit = rng.random((count, len(free)))
        start, stop = (np.array([getattr(axis, end) for axis in self.axes]) for end in ("start", "stop"))
        points = np.tile(start, (count, 1))
        points[:, free] += unit * (stop - start)[free]
        return points

    def definition(self) -> dict[str, Any]:
        """Return the numbers it is made from, as JSON."""
        return {
            "kind": "sample",
            "space": self.space,
            "axes": {axis.name: [axis.start, axis.stop, axis.count] for axis in self.axes},
            "count": self.count,
            "method": self.method,
            "seed": self.seed,
        }

    @classmethod
    def from_definition(cls, content: Mapping[str, Any]) -> Sample:
        """Make it again from its `definition`."""
        axes = tuple(Axis(name, *axis) for name, axis in content["axes"].items())
        return cls(content["space"], axes, content["count"], content["method"], content["seed"])


def region(shape: tuple[int, ...], index: tuple[int, ...], chunk: tuple[int, ...]) -> tuple[slice, ...]:
    """Return where in an array of `shape` the chunk at `index` is."""
    return tuple(slice(i * n, min((i + 1) * n, total)) for i, n, total in zip(index, chunk, shape, strict=True))


def _chunk_limit(limit: int) -> int:
    if isinstance(limit, bool) or not isinstance(limit, int | np.integer) or limit < 1:
        raise ArgumentError("chunk", "a positive number of points", limit)
    return int(limit)
