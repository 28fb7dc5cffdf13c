"""The six legs of a machine: their names, kinds and limits, their axes, pivots, balls and offsets."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, GeometryError, UnreachableError, raised_as
from spm_pin.formulas import circles, leg_constants, leg_planes, planar_legs
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.operations import bind, on_arrays, rows_of
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
from spm_pin.mechanism.leg_kinds import RPS, LegKind

LEGS = ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3")
"""Names and order of the legs: the lower stage's three, then the upper stage's."""

ORDERED = "minimum < maximum for every leg"

# Unit vectors towards leg 1, 2, 3, and the revolute axes R_1i of Eq. (4a), in {B}; in {m} they read the same.
RADIAL, AXES = np.array(leg_constants.RADIAL), np.array(leg_constants.AXES)

_triangle_axes, _squared_sides = on_arrays(triangle_axes), on_arrays(circles.squared_sides)
_admitted_readings = on_arrays(leg_constants.admitted_readings)
_limit_rounding = on_arrays(leg_constants.limit_rounding)
_upper_ball_weights = on_arrays(leg_planes.upper_ball_weights)
_plane_axes = bind(planar_legs.plane_axes, sqrt=math.sqrt)
_UNIT = 1e-6
"""Largest error of the length of an axis that is taken for rounding."""
_STEP = 1e-100
"""Imaginary step of a derivative."""
_FLAT = 1e-6
"""Smallest height of the triangle of three balls, in units of its longest side."""


@dataclass(frozen=True, init=False, repr=False)
class LegLimits:
    """Smallest and largest reading of each leg.

    Parameters
    ----------
    minimum, maximum : float or sequence of six floats
        In the order of `LEGS`: in metres, of RRS legs in radians. They may be infinite.

    Notes
    -----
    A reading beyond a limit by rounding is within it, everywhere in this package and in what it exports: by at most
    1e-8 of the larger of the leg's finite limits.
    """

    minimum: tuple[float, ...]
    maximum: tuple[float, ...]

    def __init__(self, minimum: float | Sequence[float], maximum: float | Sequence[float]) -> None:
        object.__setattr__(self, "minimum", _six(minimum, "minimum"))
        object.__setattr__(self, "maximum", _six(maximum, "maximum"))
        for leg, low, high in zip(LEGS, self.minimum, self.maximum, strict=True):
            if not low < high:
                cause = "Minimum and maximum exchanged?" if low > high else ""
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
        """Ends (2, 6) of the readings that count as within the limits: these and what rounding adds."""
        return frozen(np.array(_admitted_readings(np.array(self.minimum), np.array(self.maximum))))

    @property
    def rounding(self) -> FloatArray:
        """By how much readings (6,) may be beyond the limits and count as within them."""
        return np.asarray(_limit_rounding(np.array(self.minimum), np.array(self.maximum)))

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
    """Kinds, axes, pivots, balls and encoder offsets of the six legs, in the order of `LEGS`; read-only.

    Leg i moves in the plane through its pivot that is normal to its axis, the direction of its revolute joints, and
    holds the centre of a ball of the middle platform there. Its reading is that of its kind, plus the offset: of an RPS
    leg |ball - pivot| + offset.

    Parameters
    ----------
    axes : array_like, shape (6, 3)
        Unit vectors along the revolute axes, of the lower legs in {B}, of the upper legs in {m}.
    pivots : array_like, shape (6, 3)
        Points of these axes where the legs' lines start [m], in the same frames.
    balls : array_like, shape (6, 3)
        Centres of the balls [m] in {n}. Those of a lower and of an upper leg need not coincide.
    offsets : array_like, shape (6,)
        What each reading exceeds that of its leg's own dimensions by [m], or [rad] of RRS legs.
    kinds : pair of LegKind
        What the lower and the upper legs are, with the numbers fixed in them: `RPS`, `PRS` or `RRS`.

    A `GeometryError` is raised for a number beyond 1e9 m, an axis that is no unit vector, and balls of the lower or of
    the upper legs that are on one line.
    """

    axes: FloatArray
    pivots: FloatArray
    balls: FloatArray
    offsets: FloatArray
    kinds: tuple[LegKind, LegKind] = (RPS(), RPS())
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
        if not (isinstance(self.kinds, tuple) and [isinstance(x, LegKind) for x in self.kinds] == [True, True]):
            raise ArgumentError("kinds", "a pair of kinds of legs, such as (RPS(), RPS())", type_and_value(self.kinds))
        backward = (axes * np.tile(AXES, (2, 1))).sum(axis=-1) <= 0.0
        if backward.any() and not self.are_rps:
            leg, expected = (
                int(backward.argmax()),
                "axes along the drawn ones, from which x and z of a leg's plane follow",
            )
            raise ArgumentError("axes", expected, f"the opposite direction of {LEGS[leg]}", "Change its sign")
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

    @property
    def are_rps(self) -> bool:
        """Whether all legs are RPS: their circles have the pivots for centres, and readings are lengths."""
        return all(isinstance(kind, RPS) for kind in self.kinds)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the readings, "m" or "rad", in the order of `LEGS`."""
        return tuple(kind.unit for kind in self.kinds for _ in range(3))

    @functools.cached_property
    def planes(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors x, radially outwards, and z, towards the middle platform, of the legs' planes, (6, 3) each.

        As the axes they are in {B} of lower and in {m} of upper legs.
        """
        outward, forward = zip(
            *(
                _plane_axes(tuple(axis), leg_constants.TANGENT_SIGNS[leg % 3], 1.0 - 2.0 * (leg // 3))
                for leg, axis in enumerate(self.axes.tolist())
            ),
            strict=True,
        )
        return frozen(np.array(outward)), frozen(np.array(forward))

    def readings(self, places: FloatArray) -> FloatArray:
        """Return what the encoders show (..., 6) of balls at x and z (..., 6, 2) [m]; NaN out of a leg's reach."""
        return self._of_stages("readings", places) + self.offsets

    def slopes(self, places: FloatArray, readings: FloatArray) -> FloatArray:
        """Return κ (..., 6), the speed of each ball away from its circle's centre per unit rate of the reading."""
        return self._of_stages("slopes", places, readings - self.offsets)

    def centre_rates(self, readings: FloatArray) -> FloatArray:
        """Return the derivatives of the circles' centres by readings (..., 6) in the legs' planes, (..., 6, 2)."""
        stages = self._by_stage("circles", readings - self.offsets + 1j * _STEP)
        return np.concatenate([centres.imag / _STEP for centres, _ in stages], axis=-2)

    @functools.cached_property
    def slope_signs(self) -> FloatArray:
        """Signs of κ in the working modes of the legs, (6,)."""
        return frozen(np.concatenate([-np.broadcast_to(getattr(kind, "sign", -1.0), 3) for kind in self.kinds]))

    @property
    def largest_slopes(self) -> FloatArray:
        """The largest κ of each leg, (6,): 1, of RRS legs the crank's length [m]."""
        return np.concatenate([np.broadcast_to(getattr(kind, "crank", 1.0), 3) for kind in self.kinds])

    def circles(self, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centres (..., 6, 3), in {B} or {m}, and radii (..., 6) [m] of the circles that readings leave."""
        if self.are_rps:
            radii = readings - self.offsets
            return np.broadcast_to(self.pivots, (*radii.shape, 3)), radii
        (lower, below), (upper, above) = self._by_stage("circles", readings - self.offsets)
        x, z = np.moveaxis(np.concatenate([lower, upper], axis=-2)[..., None], -2, 0)
        outward, forward = self.planes
        return self.pivots + x * outward + z * forward, np.concatenate([below, above], axis=-1)

    def _by_stage(self, name: str, *arguments: Any) -> list[Any]:
        """Return what a method of both kinds makes of arrays whose axis of length six counts the legs."""
        stages = slice(0, 3), slice(3, 6)
        return [
            getattr(kind, name)(*(x[..., legs, :] if x.shape[-1] == 2 else x[..., legs] for x in arguments))
            for kind, legs in zip(self.kinds, stages, strict=True)
        ]

    def _of_stages(self, name: str, *arguments: FloatArray) -> FloatArray:
        return np.concatenate(self._by_stage(name, *arguments), axis=-1)

    @functools.cached_property
    def sides(self) -> FloatArray:
        """Distances 12, 23, 31 of the lower legs' balls [m], shape (3,)."""
        return frozen(triangle_sides(self.balls[:3]))

    @functools.cached_property
    def _key(self) -> tuple[object, ...]:
        # -0.0 and 0.0 are equal.
        return *((array + 0.0).tobytes() for array in self.arrays), *self.kinds

    @functools.cached_property
    def upper_ball_weights(self) -> FloatArray:
        """Weights of `formulas.leg_planes.upper_balls`, as rows (3, 3)."""
        return frozen(np.array(_upper_ball_weights(rows_of(self.balls[:3]), rows_of(self.balls[3:]))))

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Legs) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def __reduce__(self) -> tuple[Any, ...]:
        return Legs, (*self.arrays, self.kinds)


@functools.lru_cache(maxsize=64)
def drawn_legs(
    base_radius: float, platform_radius: float, middle_side: float, kinds: tuple[LegKind, LegKind] = (RPS(), RPS())
) -> Legs:
    """Return the legs of the drawing with the dimensions E, C and d [m], of these kinds, equal in a stage."""
    corners = middle_side / math.sqrt(3.0) * RADIAL
    pivots = np.concatenate([base_radius * RADIAL, platform_radius * RADIAL])
    nominal = kinds[0].nominal, kinds[1].nominal
    legs = Legs(np.tile(AXES, (2, 1)), pivots, np.concatenate([corners, corners]), np.zeros(6), nominal)
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
