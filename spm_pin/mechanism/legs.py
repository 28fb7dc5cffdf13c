"""The six legs of a machine: their names, the limits of their lengths, their axes, pivots, balls and offsets."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, GeometryError, UnreachableError, raised_as
from spm_pin.formulas import ball_motions, leg_constants, leg_planes
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.mechanism.arguments import (
    LARGEST,
    SMALLEST,
    BoolArray,
    FloatArray,
    as_array,
    frozen,
    number_pair,
    real_array,
    type_and_value,
)

LEGS = ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3")
"""Names and order of the legs: the lower stage's three, then the upper stage's."""

ORDERED = "0 <= minimum < maximum for every leg, in metres"

# Unit vectors towards leg 1, 2, 3, and the revolute axes R_1i of Eq. (4a), in {B}; in {m} they read the same.
RADIAL, AXES = np.array(leg_constants.RADIAL), np.array(leg_constants.AXES)

_triangle_axes, _squared_sides = on_arrays(triangle_axes), on_arrays(ball_motions.squared_sides)
_admitted_readings = on_arrays(leg_constants.admitted_readings)
_upper_ball_weights = on_arrays(leg_planes.upper_ball_weights)
_UNIT = 1e-6
"""Largest error of the length of an axis that is taken for rounding."""
_FLAT = 1e-6
"""Smallest height of the triangle of three balls, in units of its longest side."""


@dataclass(frozen=True, init=False, repr=False)
class LegLimits:
    """Shortest and longest length of each leg.

    Parameters
    ----------
    minimum, maximum : float or sequence of six floats
        Lengths in metres, in the order of `LEGS`. `maximum` may be infinite.

    Notes
    -----
    A reading beyond a limit by rounding is within it, everywhere in this package and in what it exports: by at most
    1e-8 of the leg's maximum, or of its minimum if the maximum is infinite.
    """

    minimum: tuple[float, ...]
    maximum: tuple[float, ...]

    def __init__(self, minimum: float | Sequence[float], maximum: float | Sequence[float]) -> None:
        object.__setattr__(self, "minimum", _six(minimum, "minimum"))
        object.__setattr__(self, "maximum", _six(maximum, "maximum"))
        for leg, low, high in zip(LEGS, self.minimum, self.maximum, strict=True):
            if not 0.0 <= low < high:
                cause = "Minimum and maximum exchanged?" if low > high >= 0.0 else ""
                raise GeometryError("limits", ORDERED, f"[{low:g}, {high:g}] for {leg}", cause)

    @classmethod
    @raised_as(GeometryError)
    def stages(cls, lower: Sequence[float], upper: Sequence[float]) -> LegLimits:
        """Make limits from one (minimum, maximum) pair [m] for the lower legs and one for the upper."""
        pairs = [number_pair(lower, "lower", "metres")] * 3 + [number_pair(upper, "upper", "metres")] * 3
        return cls(*zip(*pairs, strict=True))

    def __repr__(self) -> str:
        pairs = [f"{low:.6g}, {high:.6g}" for low, high in zip(self.minimum, self.maximum, strict=True)]
        if len(set(pairs)) == 1:
            return f"LegLimits({pairs[0]})"
        if len(set(pairs[:3])) == len(set(pairs[3:])) == 1:
            return f"LegLimits.stages(({pairs[0]}), ({pairs[3]}))"
        bounds = (f"[{', '.join(f'{end:.6g}' for end in ends)}]" for ends in (self.minimum, self.maximum))
        return f"LegLimits({', '.join(bounds)})"

    @functools.cached_property
    def admitted(self) -> FloatArray:
        """Ends (2, 6) of the readings that count as within the limits [m]: these and what rounding adds."""
        return frozen(np.array(_admitted_readings(np.array(self.minimum), np.array(self.maximum))))

    def contains(self, readings: npt.ArrayLike) -> BoolArray:
        """Return which sets of readings (..., 6) [m] respect all limits, to rounding; NaN does not."""
        lengths, (low, high) = _read(readings), self.admitted
        return np.asarray(_least(np.minimum(lengths - low, high - lengths)) >= 0.0)

    def excess(self, readings: npt.ArrayLike) -> FloatArray:
        """Return by how much each leg of (..., 6) [m] is too long, or too short (negative); 0 within its limits."""
        lengths, (low, high) = _read(readings), self.admitted
        beyond = np.maximum(lengths - self.maximum, 0.0) + np.minimum(lengths - self.minimum, 0.0)
        return np.where((lengths >= low) & (lengths <= high), 0.0, beyond)

    def margin(self, readings: npt.ArrayLike) -> FloatArray:
        """Return the distance [m] of the worst leg of (..., 6) [m] to its limits; negative outside, NaN for NaN."""
        lengths, (low, high) = _read(readings), self.admitted
        room = np.minimum(lengths - self.minimum, self.maximum - lengths)
        return _least(np.where((lengths >= low) & (lengths <= high), np.maximum(room, 0.0), room))


def _read(readings: npt.ArrayLike) -> FloatArray:
    return real_array(readings, "readings", (6,), "what the encoders show, in metres", allow_nan=True)


def check_path_readings(
    limits: LegLimits | None, readings: FloatArray, argument: str, places: FloatArray, what: str
) -> None:
    """Raise `UnreachableError` at the first of `places` (n,) where readings (n, 6) are beyond the limits, if any."""
    excess = np.zeros(readings.shape) if limits is None else limits.excess(readings)
    if excess.any():
        k = int(excess.any(axis=-1).argmax())
        leg = int(np.abs(excess[k]).argmax())
        received = f"{LEGS[leg]} of {readings[k, leg]:.6g} m at {what} {places[k]:.4g}"
        raise UnreachableError(argument, f"leg lengths within the machine's {limits}", received)


def _least(of_legs: FloatArray) -> FloatArray:
    # Leg by leg: NumPy takes several times as long to reduce a short last axis.
    return np.asarray(functools.reduce(np.minimum, np.moveaxis(of_legs, -1, 0)))


def _six(value: float | Sequence[float], argument: str) -> tuple[float, ...]:
    expected = "one length or six in the order " + ", ".join(LEGS) + ", in metres"
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise GeometryError(argument, expected, type_and_value(value))
    if array.shape not in ((), (6,)):
        raise GeometryError(argument, expected, f"shape {array.shape}")
    if np.isnan(array).any():
        raise GeometryError(argument, expected, "NaN", "Use 0 and infinity where there is no limit")
    return tuple(float(x) for x in np.broadcast_to(array, 6))


@dataclass(frozen=True, repr=False, eq=False)
class Legs:
    """Axes, pivots, balls and encoder offsets of the six legs, in the order of `LEGS`; read-only.

    Leg i turns about a revolute axis, along which nothing moves: its line starts at the pivot, is perpendicular to the
    axis, and ends at the centre of a ball of the middle platform. Its reading is |ball - pivot| + offset.

    Parameters
    ----------
    axes : array_like, shape (6, 3)
        Unit vectors along the revolute axes, of the lower legs in {B}, of the upper legs in {m}.
    pivots : array_like, shape (6, 3)
        Points of these axes where the legs' lines start [m], in the same frames.
    balls : array_like, shape (6, 3)
        Centres of the balls [m] in {n}. Those of a lower and of an upper leg need not coincide.
    offsets : array_like, shape (6,)
        What each reading exceeds the length of its leg by [m].

    A `GeometryError` is raised for a number beyond 1e9 m, an axis that is no unit vector, and balls of the lower or of
    the upper legs that are on one line.
    """

    axes: FloatArray
    pivots: FloatArray
    balls: FloatArray
    offsets: FloatArray
    is_drawn: bool = field(default=False, init=False)
    """True for legs that a `Geometry` has drawn from its dimensions."""

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        axes = bounded_array(self.axes, "axes", (6, 3), "unit vectors along the revolute axes")
        sizes = np.sqrt((axes**2).sum(axis=-1))
        wrong = np.abs(sizes - 1.0) > _UNIT
        if wrong.any():
            leg = int(wrong.argmax())
            expected = "unit vectors along the revolute axes"
            raise ArgumentError("axes", expected, f"length {sizes[leg]:g} of {LEGS[leg]}", "Divide it by its length")
        # An exact unit vector keeps its bits, so that writing and reading gives the same machine.
        exact = np.abs(sizes - 1.0) <= 4.0 * np.finfo(float).eps
        pivots = bounded_array(self.pivots, "pivots", (6, 3), "points of the revolute axes in metres")
        balls = bounded_array(self.balls, "balls", (6, 3), "ball centres in {n} in metres")
        for stage, b in (("lower", balls[:3]), ("upper", balls[3:])):
            longest = triangle_sides(b).max()
            if longest < SMALLEST or np.linalg.norm(np.cross(b[1] - b[0], b[2] - b[0])) < _FLAT * longest**2:
                expected = "three ball centres of each stage that form a triangle"
                raise ArgumentError("balls", expected, f"those of the {stage} legs on one line")
        offsets = bounded_array(self.offsets, "offsets", (6,), "offsets of the readings in metres")
        arrays = axes / np.where(exact, 1.0, sizes)[:, None], pivots, balls, offsets
        for name, array in zip(("axes", "pivots", "balls", "offsets"), arrays, strict=True):
            object.__setattr__(self, name, frozen(array.copy()))

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Axes, pivots, balls and offsets."""
        return self.axes, self.pivots, self.balls, self.offsets

    @functools.cached_property
    def sides(self) -> FloatArray:
        """Distances 12, 23, 31 of the lower legs' balls [m], shape (3,)."""
        return frozen(triangle_sides(self.balls[:3]))

    @functools.cached_property
    def _key(self) -> tuple[bytes, ...]:
        # -0.0 and 0.0 are equal.
        return tuple((array + 0.0).tobytes() for array in self.arrays)

    @functools.cached_property
    def upper_ball_weights(self) -> FloatArray:
        """Weights of `formulas.leg_planes.upper_balls`, as rows (3, 3)."""
        return frozen(np.array(_upper_ball_weights(rows_of(self.balls[:3]), rows_of(self.balls[3:]))))

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Legs) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def __reduce__(self) -> tuple[Any, ...]:
        return Legs, self.arrays


@functools.lru_cache(maxsize=64)
def drawn_legs(base_radius: float, platform_radius: float, middle_side: float) -> Legs:
    """Return the legs of the drawing with the dimensions E, C and d [m]."""
    corners = middle_side / math.sqrt(3.0) * RADIAL
    pivots = np.concatenate([base_radius * RADIAL, platform_radius * RADIAL])
    legs = Legs(np.tile(AXES, (2, 1)), pivots, np.concatenate([corners, corners]), np.zeros(6))
    object.__setattr__(legs, "is_drawn", True)
    return legs


def axis_directions() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each leg's drawn axis and the two directions perpendicular to it, radial and along z, (6, 3) each."""
    axes = np.tile(AXES, (2, 1))
    up = np.broadcast_to([0.0, 0.0, 1.0], (6, 3))
    return axes, np.cross(up, axes), up


def triangle_frames(b: FloatArray) -> FloatArray:
    """Return the axes (..., 3, 3) of triangles b_1, b_2, b_3: x along b_3 b_1, y towards b_2, z normal, as columns."""
    with np.errstate(invalid="ignore", divide="ignore"):
        axes = _triangle_axes(rows_of(b))
    return np.stack([np.stack(axis, axis=-1) for axis in axes], axis=-1)


def triangle_sides(b: FloatArray) -> FloatArray:
    """Return the sides b_1 b_2, b_2 b_3 and b_3 b_1 (..., 3) of triangles (..., 3, 3)."""
    return np.asarray(np.sqrt(np.stack(_squared_sides(rows_of(b)), axis=-1)))


def bounded_array(value: npt.ArrayLike, argument: str, shape: tuple[int, ...], meaning: str) -> FloatArray:
    """Read finite numbers of this shape, none above the largest dimension."""
    array = real_array(value, argument, shape, meaning)
    if array.shape != shape:
        raise ArgumentError(argument, f"shape {shape}, {meaning}", f"shape {array.shape}")
    if (np.abs(array) > LARGEST).any():
        raise ArgumentError(argument, f"{meaning}, at most {LARGEST:g}", f"{np.abs(array).max():g}", "Another unit?")
    return array
