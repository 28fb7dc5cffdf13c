"""The three legs of a stage, or the six of a machine: names, kinds and limits, axes, pivots, balls and offsets."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, GeometryError, UnreachableError, raised_as
from spm_pin.formulas import circles, leg_constants, leg_planes, planar_legs
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.operations import on_arrays, rows_of, vector_of
from spm_pin.machine.leg_kinds import RPS, LegKind
from spm_pin.support.arguments import (
    COLUMNS,
    LARGEST,
    SMALLEST,
    STAGE_COLUMNS,
    BoolArray,
    FloatArray,
    as_array,
    frozen,
    generator,
    number_pair,
    real_array,
    real_number,
    type_and_value,
)

LEGS = COLUMNS[6]
"""Names and order of the legs: the lower stage's three, then the upper stage's."""
STAGE_LEGS = STAGE_COLUMNS
"""Names and order of the legs of a stage alone."""

# Unit vectors towards legs 1, 2, 3, and revolute axes R_1i of Eq. (4a), in {B}; their components in {m} are the same.
RADIAL, AXES = np.array(leg_constants.RADIAL), np.array(leg_constants.AXES)
AZIMUTHS = np.arctan2(RADIAL[:, 1], RADIAL[:, 0])
"""Azimuths of the nominal legs 1, 2, 3, from x towards y [rad]: -30, 90 and 210 degrees."""

COMPONENTS = ("direction_1", "direction_2", *(f"{p}_{x}" for p in ("pivot", "ball") for x in "xyz"), "offset")
"""Names of the nine parameters of an RPS leg."""
_MOST_LENGTH, _MOST_ANGLE = 1e7, 0.2
"""Largest standard deviations of random errors, for which normal numbers stay in the accepted ranges."""

_turned_axis = on_arrays(leg_constants.turned_axis)
_triangle_axes, _squared_sides = on_arrays(triangle_axes), on_arrays(circles.squared_sides)
_admitted_readings = on_arrays(leg_constants.admitted_readings)
_limit_rounding = on_arrays(leg_constants.limit_rounding)
_upper_ball_weights = on_arrays(leg_planes.upper_ball_weights)
_plane_axes = on_arrays(planar_legs.plane_axes)
_UNIT = 1e-6
"""Largest difference of an axis's length from 1 that counts as rounding."""
_UNITS = "metres, for RRS legs radians"
_STEP = 1e-100
"""Imaginary step of a derivative."""
_FLAT = 1e-6
"""Smallest height of the triangle of three balls, in units of its longest side."""


@dataclass(frozen=True, init=False, repr=False)
class LegLimits:
    """Minimum and maximum reading of each leg.

    Parameters
    ----------
    minimum, maximum : float or sequence of six or three floats
        One for each leg of a manipulator, in the order of `LEGS`, or of a stage; or one for all legs of a manipulator,
        which a stage takes for its own. In metres, for RRS legs in radians. They may be infinite.

    Notes
    -----
    A reading beyond a limit by rounding, at most 1e-8 of the larger finite limit of the leg, counts as within it, in
    all functions of this package and in exported programs.
    """

    minimum: tuple[float, ...]
    maximum: tuple[float, ...]

    def __init__(self, minimum: float | Sequence[float], maximum: float | Sequence[float]) -> None:
        ends = [_of_legs(minimum, "minimum"), _of_legs(maximum, "maximum")]
        counts = {len(end) for end in ends if end.shape} or {6}
        if len(counts) > 1:
            raise GeometryError("limits", "as many minima as maxima", "three and six")
        (count,) = counts
        for name, end in zip(("minimum", "maximum"), ends, strict=True):
            object.__setattr__(self, name, tuple(np.broadcast_to(end, count).tolist()))
        for leg, low, high in zip(self.legs, self.minimum, self.maximum, strict=True):
            if not low < high:
                cause = "Minimum and maximum exchanged?" if low > high else ""
                received = f"[{low:g}, {high:g}] for {leg}"
                raise GeometryError("limits", "minimum < maximum for every leg", received, cause)

    @classmethod
    @raised_as(GeometryError)
    def stages(cls, lower: Sequence[float], upper: Sequence[float]) -> LegLimits:
        """Make limits from (minimum, maximum) of the lower and of the upper legs [m], for RRS legs [rad]."""
        pairs = [number_pair(lower, "lower", _UNITS)] * 3 + [number_pair(upper, "upper", _UNITS)] * 3
        return LegLimits(*zip(*pairs, strict=True))

    @property
    def legs(self) -> tuple[str, ...]:
        """Names of the legs: `LEGS` or `STAGE_LEGS`."""
        return LEGS if len(self.minimum) == 6 else STAGE_LEGS

    def __repr__(self) -> str:
        pairs = [f"{low:.6g}, {high:.6g}" for low, high in zip(self.minimum, self.maximum, strict=True)]
        if len(set(pairs)) == 1:
            low, high = pairs[0].split(", ")
            return f"LegLimits({low if len(pairs) == 6 else f'[{low}] * 3'}, {high})"
        if len(set(pairs[:3])) == len(set(pairs[3:])) == 1:
            return f"LegLimits.stages(({pairs[0]}), ({pairs[3]}))"
        bounds = (f"[{', '.join(f'{end:.6g}' for end in ends)}]" for ends in (self.minimum, self.maximum))
        return f"LegLimits({', '.join(bounds)})"

    @functools.cached_property
    def ends(self) -> FloatArray:
        """Minima and maxima as rows (2, 6)."""
        return frozen(np.array([self.minimum, self.maximum]))

    @property
    def are_finite(self) -> bool:
        """True if every reading is limited on both sides."""
        return bool(np.isfinite(self.ends).all())

    @functools.cached_property
    def admitted(self) -> FloatArray:
        """Minima and maxima (2, 6) with the tolerance for rounding."""
        return frozen(np.array(_admitted_readings(*self.ends)))

    @property
    def rounding(self) -> FloatArray:
        """Tolerance (6,) for readings beyond the limits, for rounding."""
        return np.asarray(_limit_rounding(*self.ends))

    def contains(self, readings: npt.ArrayLike) -> BoolArray:
        """Return which sets of readings (..., 6) are within all limits, to rounding; False for NaN."""
        lengths, (low, high) = self._read(readings), self.admitted
        return np.asarray(_least(np.minimum(lengths - low, high - lengths)) >= 0.0)

    def excess(self, readings: npt.ArrayLike) -> FloatArray:
        """Return the excess of each of (..., 6) above its limits, negative below them, in its unit; 0 within them."""
        lengths, (low, high) = self._read(readings), self.admitted
        beyond = np.maximum(lengths - self.maximum, 0.0) + np.minimum(lengths - self.minimum, 0.0)
        return np.where((lengths >= low) & (lengths <= high), 0.0, beyond)

    def margin(self, readings: npt.ArrayLike, scale: npt.ArrayLike | None = None) -> FloatArray:
        """Return the least distance of readings (..., legs) from their limits; negative outside, NaN for NaN.

        `scale` (legs,) is the factor for each reading, 1 if not given.
        """
        lengths, (low, high) = self._read(readings), self.admitted
        room = np.minimum(lengths - self.minimum, self.maximum - lengths)
        if scale is not None:
            room = room * real_array(scale, "scale", (len(self.legs),), "a factor for each reading")
        return _least(np.where((lengths >= low) & (lengths <= high), np.maximum(room, 0.0), room))

    def _read(self, readings: npt.ArrayLike) -> FloatArray:
        shape = (len(self.legs),)
        return real_array(readings, "readings", shape, f"readings of the encoders, in {_UNITS}", allow_nan=True)


def check_path_readings(
    limits: LegLimits | None, units: Sequence[str], readings: FloatArray, argument: str, places: FloatArray, what: str
) -> None:
    """Raise `UnreachableError` at the first of `places` (n,) where readings (n, legs) are beyond the limits, if any."""
    if limits is None:
        return
    excess = limits.excess(readings)
    if excess.any():
        k = int(excess.any(axis=-1).argmax())
        leg = int(np.abs(excess[k]).argmax())
        received = f"{limits.legs[leg]} of {readings[k, leg]:.6g} {units[leg]} at {what} {places[k]:.4g}"
        raise UnreachableError(argument, f"readings within the machine's {limits}", received)


def _least(of_legs: FloatArray) -> FloatArray:
    # Leg by leg: NumPy takes several times as long to reduce a short last axis.
    return np.asarray(functools.reduce(np.minimum, np.moveaxis(of_legs, -1, 0)))


def _of_legs(value: float | Sequence[float], argument: str) -> FloatArray:
    expected = f"one reading, or six in the order {', '.join(LEGS)}, or three of a stage, in {_UNITS}"
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise GeometryError(argument, expected, type_and_value(value))
    if array.shape not in ((), (3,), (6,)):
        raise GeometryError(argument, expected, f"shape {array.shape}")
    if np.isnan(array).any():
        raise GeometryError("limits", expected, "NaN", "Use infinity for no maximum, or 0 for no minimum of a length")
    return array.astype(np.float64)


class PlacedLegs(NamedTuple):
    """The legs of one stage, lower or upper, in the frame of their plate."""

    axes: FloatArray
    """Revolute axes of the legs, as rows (3, 3)."""
    balls: FloatArray
    """Centres of the balls in the platform's frame, as rows (3, 3) [m]."""
    up: float
    """-1 if the platform is below the circles' centres at home, in the direction of z; otherwise +1."""
    pivots: FloatArray
    planes: FloatArray
    """Unit vectors x and z of the legs' planes (2, 3, 3)."""
    kind: LegKind
    offsets: FloatArray


@dataclass(frozen=True, repr=False, eq=False)
class Legs:
    """Kinds, axes, pivots, balls and encoder offsets of the legs of a manipulator (six) or a stage (three); read-only.

    They are in the order of `LEGS`. The legs of a `Stage` have one kind, and are those of a lower stage.

    Leg i moves in the plane through its pivot that is normal to its axis, the direction of its revolute joints; the
    centre of a ball of the middle platform stays in this plane. Its reading is that of its kind, plus the offset: for
    an RPS leg |ball - pivot| + offset.

    Parameters
    ----------
    axes : array_like, shape (6, 3)
        Unit vectors along the revolute axes, in {B} for lower legs, in {m} for upper legs. Either sense gives the
        same machine; the one within a quarter turn of the nominal axis is stored.
    pivots : array_like, shape (6, 3)
        Points of these axes where the legs begin [m], in the same frames.
    balls : array_like, shape (6, 3)
        Centres of the balls [m] in {n}. Those of a lower and of an upper leg need not coincide.
    offsets : array_like, shape (6,)
        Encoder offsets: reading minus value computed from the leg's own dimensions [m], for RRS legs [rad].
    kinds : pair of LegKind, or one
        Kinds of the lower and the upper legs with their fixed numbers: `RPS`, `PRS` or `RRS`.

    A `GeometryError` is raised for a number beyond 1e9 m, an axis that is not a unit vector, and three balls of the
    lower or of the upper legs on one line.
    """

    axes: FloatArray
    pivots: FloatArray
    balls: FloatArray
    offsets: FloatArray
    kinds: tuple[LegKind, ...] = (RPS(), RPS())
    is_nominal: bool = field(default=False, init=False)
    """True for legs that a `Manipulator` or a `Stage` has computed from its dimensions."""

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        kinds = self.kinds
        if not (isinstance(kinds, tuple) and len(kinds) in (1, 2) and all(isinstance(x, LegKind) for x in kinds)):
            raise ArgumentError("kinds", "a pair of kinds of legs, such as (RPS(), RPS())", type_and_value(kinds))
        names, count = self.names, len(self.names)
        axes = bounded_array(self.axes, "axes", (count, 3), "unit vectors along the revolute axes")
        sizes = np.sqrt((axes**2).sum(axis=-1))
        wrong = np.abs(sizes - 1.0) > _UNIT
        if wrong.any():
            leg = int(wrong.argmax())
            expected = "unit vectors along the revolute axes"
            raise ArgumentError("axes", expected, f"length {sizes[leg]:g} of {names[leg]}", "Divide it by its length")
        # An exact unit vector keeps its bits, so that a machine is the same after writing and reading.
        exact = np.abs(sizes - 1.0) <= 4.0 * np.finfo(float).eps
        pivots = bounded_array(self.pivots, "pivots", (count, 3), "points of the revolute axes in metres")
        balls = bounded_array(self.balls, "balls", (count, 3), "ball centres in {n} in metres")
        triangles = balls.reshape(-1, 3, 3), pivots.reshape(-1, 3, 3)
        for stage, b, p in zip(("lower", "upper"), *triangles, strict=False):
            longest = triangle_sides(b).max()
            if longest < SMALLEST or np.linalg.norm(np.cross(b[1] - b[0], b[2] - b[0])) < _FLAT * longest**2:
                expected = "three ball centres of each stage that form a triangle"
                raise ArgumentError("balls", expected, f"the balls of the {stage} legs on one line")
            if all(np.cross(x[1] - x[0], x[2] - x[0])[2] < 0.0 for x in (b, p)):
                expected = f"{stage} legs 1, 2, 3 counterclockwise about z, nominally at -30, 90, 210 degrees"
                cause = "List the legs in the opposite order, in axes, pivots, balls, offsets and numbers of the kind"
                raise ArgumentError("balls", expected, "a clockwise order", cause)
            for name, points in (("pivots", p), ("balls", b)):
                if (RADIAL * points).sum() < 0.0:
                    turn = math.degrees(np.arctan2(np.cross(RADIAL, points)[:, 2].sum(), (RADIAL * points).sum()))
                    expected = f"{stage} legs within a quarter turn of the nominal azimuths, -30, 90, 210 degrees"
                    cause = (
                        "Turn axes, pivots and balls about z by one angle, or name the leg nearest to -30 degrees leg 1"
                    )
                    raise ArgumentError(name, expected, f"{name} turned by {turn:.0f} degrees", cause)
        offsets = bounded_array(self.offsets, "offsets", (count,), f"offsets of the readings in {_UNITS}")
        # The sense of a hinge's axis is arbitrary; x and z of a leg's plane are computed with the nominal sense.
        backward = (axes * np.tile(AXES, (len(kinds), 1))).sum(axis=-1) < 0.0
        axes = axes / np.where(backward, -1.0, 1.0)[:, None] / np.where(exact, 1.0, sizes)[:, None]
        arrays = axes, pivots, balls, offsets
        for name, array in zip(("axes", "pivots", "balls", "offsets"), arrays, strict=True):
            object.__setattr__(self, name, frozen(array.copy()))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the legs: `LEGS`, or `STAGE_LEGS` for a stage alone."""
        return LEGS if len(self.kinds) == 2 else STAGE_LEGS

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Axes, pivots, balls and offsets."""
        return self.axes, self.pivots, self.balls, self.offsets

    @functools.cached_property
    def are_rps(self) -> bool:
        """True if all legs are RPS: pivots are the centres of their circles, and readings are lengths."""
        return all(isinstance(kind, RPS) for kind in self.kinds)

    @functools.cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the readings, "m" or "rad", in the order of `LEGS`."""
        return tuple(kind.unit for kind in self.kinds for _ in range(3))

    def unit_text(self, lengths: str = "metres", angles: str = "radians") -> str:
        """Return the unit of the readings for messages: one word if all legs have the same."""
        if "rad" not in self.units:
            return lengths
        return angles if "m" not in self.units else f"{lengths}, for RRS legs {angles}"

    @functools.cached_property
    def least_readings(self) -> FloatArray:
        """Lower bounds of the readings (6,) without offsets: RPS legs have no negative length."""
        return frozen(np.repeat([kind.least_reading for kind in self.kinds], 3))

    @functools.cached_property
    def stages(self) -> tuple[PlacedLegs, ...]:
        """The legs of each stage: of the lower and the upper one, or of the only one."""
        planes, stages = np.stack(self.planes), []
        for k, kind in enumerate(self.kinds):
            own = slice(3 * k, 3 * k + 3)
            arrays = self.axes[own], self.balls[own], (1.0 - 2.0 * k) * kind.up, self.pivots[own], planes[:, own]
            stages.append(PlacedLegs(*arrays, kind, self.offsets[own]))
        return tuple(stages)

    @functools.cached_property
    def stage_ups(self) -> FloatArray:
        """`PlacedLegs.up` of each stage, (2,) or (1,)."""
        return frozen(np.array([stage.up for stage in self.stages]))

    @functools.cached_property
    def ups(self) -> FloatArray:
        """`LegKind.up` for each leg, (6,) or (3,)."""
        return frozen(np.repeat([kind.up for kind in self.kinds], 3))

    @functools.cached_property
    def planes(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors x, radially outwards, and z, towards the balls, of the legs' planes, (6, 3) or (3, 3) each.

        They are in {B} for lower legs and in {m} for upper legs, as the axes are.
        """
        outward, forward = _plane_axes(vector_of(self.axes), *self._signs)
        return frozen(np.stack(outward, axis=-1)), frozen(np.stack(forward, axis=-1))

    @property
    def _signs(self) -> tuple[FloatArray, FloatArray]:
        """Signs of the tangents and of the directions up, of each leg."""
        count = len(self.kinds)
        return np.tile(leg_constants.TANGENT_SIGNS, count), np.repeat([1.0, -1.0][:count], 3)

    @property
    def turned_over(self) -> Legs:
        """The three legs of a stage turned over about its y axis, as upper legs: in the order 3, 2, 1."""
        (kind,), turn = self.kinds, np.array([-1.0, 1.0, -1.0])
        # The axis of leg 2 then points backwards.
        axes = (self.axes * turn * [[1.0], [-1.0], [1.0]])[::-1]
        vectors = axes, (self.pivots * turn)[::-1], (self.balls * turn)[::-1]
        return Legs(*vectors, self.offsets[::-1], (kind.turned_over,))

    def turned_about_z(self, angles: FloatArray) -> Legs:
        """Return the legs turned about z by angles (3,) [rad], each with its axis, pivot and ball."""
        c, s, zero = np.cos(angles), np.sin(angles), np.zeros(3)
        turns = np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], axis=-1).reshape(3, 3, 3)
        axes, pivots, balls = ((turns @ x[..., None])[..., 0] for x in self.arrays[:3])
        return Legs(axes, pivots, balls, self.offsets, self.kinds)

    @property
    def parameters(self) -> FloatArray:
        """Nine numbers for each leg, then the fixed numbers of PRS and RRS legs: see `Manipulator.parameters`."""
        drawn, first, second = axis_directions(len(self.kinds))
        across = np.stack([(self.axes * first).sum(axis=-1), (self.axes * second).sum(axis=-1)], axis=-1)
        sine = np.sqrt((across**2).sum(axis=-1))
        angle = np.arctan2(sine, (self.axes * drawn).sum(axis=-1))
        turn = across * np.divide(angle, sine, out=np.ones(len(sine)), where=sine > 0.0)[:, None]
        numbers = [kind.numbers[:, : len(kind.identified)].ravel() for kind in self.kinds]
        rows = np.concatenate([turn, self.pivots, self.balls, self.offsets[:, None]], axis=-1)
        return np.concatenate([rows.ravel(), *numbers])

    @property
    def axis_derivatives(self) -> FloatArray:
        """Derivatives of the axes by the two coordinates of their direction in `parameters`, (legs, 3, 2)."""
        drawn, first, second = axis_directions(len(self.kinds))
        turn = self.parameters[: 9 * len(drawn)].reshape(-1, 9)[:, None, :2]
        angle = np.sqrt((turn**2).sum(axis=-1, keepdims=True))
        sinc, across = np.sinc(angle / np.pi), np.stack([first, second], axis=-1)
        # (cos a - sin a / a) / a², which is -1/3 at zero.
        small = angle < 1e-3
        curve = np.where(small, -1.0 / 3.0 + angle**2 / 30.0, (np.cos(angle) - sinc) / np.where(small, 1.0, angle) ** 2)
        along = (across * turn).sum(axis=-1, keepdims=True)
        return np.asarray(sinc * (across - turn * drawn[..., None]) + curve * turn * along)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the `parameters`, such as `r_b1.pivot_x`, and for PRS and RRS legs `r_b1.rod`."""
        own = (f"{leg}.{component}" for leg in self.names for component in COMPONENTS)
        stages = zip(self.kinds, (self.names[:3], self.names[3:]), strict=False)
        return *own, *(f"{leg}.{name}" for kind, legs in stages for leg in legs for name in kind.identified)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the `parameters`, "m" or "rad"."""
        offsets = dict(zip((f"{leg}.offset" for leg in self.names), self.units, strict=True))
        return tuple(offsets.get(name, "rad" if ".direction" in name else "m") for name in self.parameter_names)

    @raised_as(GeometryError)
    def from_parameters(self, parameters: npt.ArrayLike) -> Legs:
        """Return legs with these `parameters`, in the same working modes."""
        count, meaning = len(self.parameter_names), "radians and metres, see parameter_names"
        read, first = bounded_array(parameters, "parameters", (count,), meaning), len(COMPONENTS) * len(self.names)
        values, kinds = read[:first].reshape(-1, len(COMPONENTS)), []
        for kind in self.kinds:
            last = first + 3 * len(kind.identified)
            kinds.append(kind.with_numbers(read[first:last].reshape(3, -1)))
            first = last
        angle = np.sqrt((values[:, :2] ** 2).sum(axis=-1))
        if (angle > np.pi / 2.0).any():
            leg = int(angle.argmax())
            expected = "directions of the axes within a quarter turn of the nominal ones, in radians"
            raise GeometryError("parameters", expected, f"{angle[leg]:g} rad at {self.names[leg]}", "Is it in degrees?")
        drawn = tuple(np.tile(AXES, (len(self.kinds), 1)).T)
        axes = np.stack(_turned_axis(drawn, values[:, 0], values[:, 1]), axis=-1)
        return Legs(axes, values[:, 2:5], values[:, 5:8], values[:, 8], tuple(kinds))

    def perturbed(self, rng: Any = None, *, length: float = 1e-4, angle: float = 1e-4) -> Legs:
        """Return legs with independent normal errors added to all `parameters`; see `Manipulator.perturbed`."""
        random = generator(rng)
        expected = f"a standard deviation from 0 to {_MOST_LENGTH:g} m"
        spread = real_number(length, "length", expected, least=0.0, most=_MOST_LENGTH)
        expected = f"a standard deviation from 0 to {_MOST_ANGLE} rad"
        turn = real_number(angle, "angle", expected, least=0.0, most=_MOST_ANGLE, cause="Is it in degrees?")
        scale = np.array([turn if unit == "rad" else spread for unit in self.parameter_units])
        parameters = self.parameters + scale * random.standard_normal(len(scale))
        try:
            return self.from_parameters(parameters)
        except GeometryError as error:
            cause = f"No machine has such legs: {error}"
            raise GeometryError("length", "errors much smaller than the machine", f"{spread:g} m", cause) from error

    def deviations(self, drawn: Legs) -> tuple[FloatArray, ...]:
        """Return the difference of each leg from the nominal one: axis [rad], and pivot, ball and offset [m]."""
        sine = np.sqrt((np.cross(self.axes, drawn.axes) ** 2).sum(axis=-1))
        angles = np.arctan2(sine, (self.axes * drawn.axes).sum(axis=-1))
        _, pivots, balls, offsets = map(np.abs, map(np.subtract, self.arrays, drawn.arrays))
        return angles, pivots.max(axis=-1), balls.max(axis=-1), offsets

    def readings(self, places: FloatArray, middles: FloatArray) -> FloatArray:
        """Return the readings (..., 6) for ball positions (x, z) in the planes of their legs (..., 6, 2) [m].

        NaN if a leg cannot reach the ball. `middles` (6,) are the `Machine.crank_middles`.
        """
        return self._of_stages("readings", places, middles) + self.offsets

    def slopes(self, places: FloatArray, readings: FloatArray) -> FloatArray:
        """Return κ (..., 6), the speed of each ball away from its circle's centre per unit rate of the reading."""
        return self._of_stages("slopes", places, readings - self.offsets)

    def circle_derivatives(self, readings: FloatArray) -> list[FloatArray]:
        """Return the derivatives of x, z and radius of the circles of both stages, (..., 3, 3, 1 + n) each.

        The derivatives are with respect to the readings (..., 6), then each fixed number of the legs.
        """
        return self._by_stage("circle_derivatives", readings - self.offsets)

    def centre_rates(self, readings: FloatArray) -> FloatArray:
        """Return the derivatives of the circles' centres by readings (..., 6) in the legs' planes, (..., 6, 2)."""
        return np.concatenate([x[..., :2, 0] for x in self.circle_derivatives(readings)], axis=-2)

    @functools.cached_property
    def plane_turns(self) -> FloatArray:
        """Derivatives by the axes of each plane's rotation about its axis, from x to z, (legs, 3)."""
        tilted = self.axes[:, None] + 1j * _STEP * np.eye(3)
        tangents, up = self._signs
        outward, _ = _plane_axes(vector_of(tilted), tangents[:, None], up[:, None])
        _, forward = self.planes
        return frozen((np.stack(outward, axis=-1).imag / _STEP * forward[:, None]).sum(axis=-1))

    @functools.cached_property
    def slope_signs(self) -> FloatArray:
        """Signs of κ in the working modes of the legs, (6,)."""
        return frozen(np.sign(np.concatenate([kind.largest_slopes for kind in self.kinds])))

    @property
    def free_limits(self) -> LegLimits:
        """Infinite limits."""
        return LegLimits(self.least_readings.tolist(), math.inf)

    @functools.cached_property
    def largest_slopes(self) -> FloatArray:
        """The largest κ of each leg, (6,): 1, for RRS legs the crank's length [m]."""
        return frozen(np.abs(np.concatenate([kind.largest_slopes for kind in self.kinds])))

    def circles(self, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centres (..., 6, 3), in {B} or {m}, and radii (..., 6) [m] of the circles for these readings."""
        if self.are_rps:
            radii = readings - self.offsets
            return np.broadcast_to(self.pivots, (*radii.shape, 3)), radii
        stages = self._by_stage("circles", readings - self.offsets)
        x, z = np.moveaxis(np.concatenate([centres for centres, _ in stages], axis=-2)[..., None], -2, 0)
        outward, forward = self.planes
        return self.pivots + x * outward + z * forward, np.concatenate([radii for _, radii in stages], axis=-1)

    def _by_stage(self, name: str, *arguments: Any) -> list[Any]:
        """Apply a method of each stage's kind to its part of arrays with an axis of six legs."""
        stages = (slice(0, 3), slice(3, 6))[: len(self.kinds)]
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
def nominal_legs(radii: tuple[tuple[float, float], ...], kinds: tuple[LegKind, ...]) -> Legs:
    """Return the nominal legs, equal within a stage, with pivots and balls at the `radii` of each stage [m]."""
    pivots, balls = (np.concatenate([radius * RADIAL for radius in column]) for column in zip(*radii, strict=True))
    nominal, count = tuple(kind.nominal for kind in kinds), len(kinds)
    legs = Legs(np.tile(AXES, (count, 1)), pivots, balls, np.zeros(3 * count), nominal)
    object.__setattr__(legs, "is_nominal", True)
    return legs


def axis_directions(stages: int = 2) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each leg's nominal axis and the two directions perpendicular to it, radial and along z, (6, 3) each."""
    axes = np.tile(AXES, (stages, 1))
    up = np.broadcast_to([0.0, 0.0, 1.0], axes.shape)
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
    """Read finite numbers of this shape, at most the largest dimension in magnitude."""
    array = real_array(value, argument, shape, meaning)
    if array.shape != shape:
        raise ArgumentError(argument, f"shape {shape}, {meaning}", f"shape {array.shape}")
    if (np.abs(array) > LARGEST).any():
        raise ArgumentError(argument, f"{meaning}, at most {LARGEST:g}", f"{np.abs(array).max():g}", "Another unit?")
    return array
