"""The kinds of planar legs, RPS, PRS and RRS, with the numbers that are fixed in the three legs of a stage.

The actuated joint, underlined in the literature, is the P of RPS and of PRS and the first R of RRS. All three hold a
ball on a circle when the actuator is locked: `spm_pin.formulas.planar_legs`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from spm_pin.errors import GeometryError, raised_as
from spm_pin.formulas import planar_legs
from spm_pin.formulas.operations import on_arrays
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.support.arguments import (
    LARGEST,
    SMALLEST,
    FloatArray,
    as_array,
    dimension,
    frozen,
    real_number,
    type_and_value,
)

Number = float | Sequence[float]
"""One number of all three legs, or one for each."""

FORMULAS = "reading", "reach", "room", "circle", "slope", "largest_slope", "home", "passive"
"""What every kind has a formula for."""
_STEP = 1e-100
"""Imaginary step of a derivative."""


@dataclass(frozen=True)
class LegKind:
    """What planar legs of a stage have in common; see `RPS`, `PRS` and `RRS`."""

    name: ClassVar[str]
    unit: ClassVar[str]
    """Of readings: "m" or "rad"."""
    meaning: ClassVar[str]
    """What a reading is, offset aside."""
    effort_unit: ClassVar[str]
    """Of what the actuator exerts: "N" or "N m"."""
    joints: ClassVar[tuple[str, str]]
    """Names of the two joints from the plate to the ball: "hip", "slide" or "knee"."""
    actuated: ClassVar[str]
    """Which of them the actuator moves."""
    body: ClassVar[str]
    """Name of the body between them."""
    least_reading: ClassVar[float] = -math.inf
    """Beyond which every reading is, offset aside."""
    identified: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers that a maker chooses and a calibration identifies: all but the working mode."""
    turned: ClassVar[tuple[float, ...]]
    """Changes of the offset, and of each of the `identified` numbers, that amount to a unit turn of the leg's links."""
    number: ClassVar[int]
    """The kind's number of `spm_pin.formulas.planar_legs`, for kernels."""
    formulas: ClassVar[SimpleNamespace]
    """The kind's formulas of `spm_pin.formulas.planar_legs`, see `FORMULAS`, for runners to bind."""
    on_arrays: ClassVar[SimpleNamespace]
    """The same as functions of NumPy's arrays."""

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        for field in fields(self):
            legs = _three(getattr(self, field.name), f"{field.name} of {self.name}", _READERS[field.name])
            # One number where the legs are equal, as it was drawn.
            object.__setattr__(self, field.name, legs[0] if len(set(legs)) == 1 else legs)

    def __init_subclass__(cls) -> None:
        cls.name = cls.__name__
        cls.formulas = SimpleNamespace(**{x: getattr(planar_legs, f"{cls.__name__.lower()}_{x}") for x in FORMULAS})
        cls.on_arrays = cls.bound(on_arrays)

    @classmethod
    def bound(cls, bind: Callable[[Any], Any]) -> SimpleNamespace:
        """Return the kind's formulas, each bound by a function such as `on_arrays`."""
        return SimpleNamespace(**{name: bind(formula) for name, formula in vars(cls.formulas).items()})

    @property
    def passive(self) -> str:
        """Name of the joint that the actuator does not move, which is revolute."""
        return self.joints[self.joints[0] == self.actuated]

    @property
    def links(self) -> FloatArray:
        """Sum of the lengths that are fixed in each leg [m], (3,)."""
        lengths = [getattr(self, field.name) for field in fields(self) if _READERS[field.name] is dimension]
        return np.asarray(sum((np.broadcast_to(length, 3) for length in lengths), np.zeros(3)))

    @functools.cached_property
    def numbers(self) -> FloatArray:
        """The fixed numbers as the formulas take them, (3, n)."""
        rows = [np.broadcast_to(getattr(self, field.name), 3) for field in fields(self)]
        return frozen(np.array(rows, dtype=np.float64).reshape(len(rows), 3).T)

    @property
    def is_drawn(self) -> bool:
        """Whether the three legs have equal numbers."""
        return not any(isinstance(getattr(self, field.name), tuple) for field in fields(self))

    @property
    def nominal(self) -> LegKind:
        """The legs with the mean of each number in all three."""
        if self.is_drawn:
            return self
        return self.with_numbers(np.tile(self.numbers[:, : len(self.identified)].mean(axis=0), (3, 1)))

    @property
    def up(self) -> float:
        """+1 if the platform is above the centres of the balls' circles at home, -1 if it hangs below them."""
        return float(self.up_of(on_arrays, self.numbers.tolist()))

    @classmethod
    def up_of(cls, bind: Callable[[Any], Any], numbers: Sequence[Any]) -> Any:
        """Return `up` of three legs with these numbers, by formulas bound by a function such as `on_arrays`."""
        return 1.0

    def as_data(self) -> dict[str, Any]:
        """Return what a file says of these legs."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {"kind": self.name} | {name: list(x) if isinstance(x, tuple) else x for name, x in values.items()}

    def with_numbers(self, identified: FloatArray) -> LegKind:
        """Return legs with other identified numbers (3, n)."""
        return replace(self, **dict(zip(self.identified, map(tuple, identified.T.tolist()), strict=True)))

    @property
    def turned_over(self) -> LegKind:
        """The legs in the order 3, 2, 1."""
        return replace(self, **{name: x[::-1] for name, x in vars(self).items() if isinstance(x, tuple)})

    def readings(self, places: FloatArray, middles: FloatArray) -> FloatArray:
        """Return the readings (..., 3) of balls at x and z (..., 3, 2), offsets aside; NaN out of a leg's reach.

        Angles are those nearest to `middles` (3,), see `planar_legs.crank_middle`.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(self.on_arrays.reading(places[..., 0], places[..., 1], middles, tuple(self.numbers.T)))

    def circles(self, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centres (..., 3, 2), x and z, and the radii (..., 3) of the balls' circles."""
        x, z, radius = self.on_arrays.circle(readings, tuple(self.numbers.T))
        zero = np.zeros_like(readings)
        return np.stack([x + zero, z + zero], axis=-1), radius + zero

    def circle_derivatives(self, readings: FloatArray) -> FloatArray:
        """Return the derivatives of x, z and radius of the balls' circles, (..., 3, 3, 1 + n).

        By the reading, then by each of the `identified` numbers.
        """
        given = np.broadcast_to(self.numbers, (*readings.shape, self.numbers.shape[1]))
        given = np.concatenate([readings[..., None], given], axis=-1)
        columns = []
        for step in 1j * _STEP * np.eye(given.shape[-1])[: 1 + len(self.identified)]:
            reading, *numbers = np.moveaxis(given + step, -1, 0)
            circle = np.broadcast_arrays(*self.on_arrays.circle(reading, tuple(numbers)))
            columns.append(np.stack(circle, axis=-1).imag / _STEP)
        return np.stack(columns, axis=-1)

    def rooms(self, places: FloatArray) -> FloatArray:
        """Return how far balls at x and z (..., 3, 2) are from where the legs are singular [m], (..., 3).

        Negative out of a leg's reach.
        """
        return np.asarray(self.on_arrays.room(places[..., 0], places[..., 1], tuple(self.numbers.T)).distance)

    def slopes(self, places: FloatArray, readings: FloatArray) -> FloatArray:
        """Return κ (..., 3) of balls at x and z (..., 3, 2) with these readings."""
        numbers = tuple(self.numbers.T)
        return np.asarray(self.on_arrays.slope(places[..., 0], places[..., 1], readings, numbers) + 0.0 * readings)

    @property
    def largest_slopes(self) -> FloatArray:
        """The κ of each leg that is largest in magnitude, with the sign of its working mode, (3,)."""
        return np.broadcast_to(self.on_arrays.largest_slope(tuple(self.numbers.T)), 3)


@dataclass(frozen=True)
class RPS(LegKind):
    """Legs of a revolute joint, an actuated prismatic one, and a ball: cylinders. A reading is a length [m]."""

    number = planar_legs.RPS_LEGS
    unit = "m"
    meaning = "the distance from pivot to ball"
    effort_unit = "N"
    joints = ("hip", "slide")
    actuated = "slide"
    body = "cylinder"
    least_reading = 0.0
    turned = (0.0,)


@dataclass(frozen=True)
class PRS(LegKind):
    """Legs of an actuated slide, a revolute joint and a ball: a carriage on a rail, or a nut on a screw, and a rod.

    A reading is the place of the carriage along the rail [m], from the pivot.

    Parameters
    ----------
    rod : float, or three
        From the revolute joint to the ball [m].
    direction : float, or three
        Of the slide in the leg's plane: an angle [rad] from radially outwards, 0, to the middle platform, π/2.
    sign : int, or three
        The working mode: -1 where the carriage is behind the ball, seen along the slide, +1 where it is ahead.
    """

    rod: Number
    direction: Number = math.pi / 2.0
    sign: int | Sequence[int] = -1

    number = planar_legs.PRS_LEGS
    unit = "m"
    meaning = "the place of the carriage along its slide, from the pivot"
    effort_unit = "N"
    joints = ("slide", "knee")
    actuated = "slide"
    body = "carriage"
    identified = ("rod", "direction")
    turned = (0.0, 0.0, 1.0)

    @classmethod
    def up_of(cls, bind: Callable[[Any], Any], numbers: Sequence[Any]) -> Any:
        """Return `up` of three legs: -1 if the carriages are ahead of the balls on slides that rise."""
        return bind(planar_legs.prs_up)(*numbers)


@dataclass(frozen=True)
class RRS(LegKind):
    """Legs of an actuated revolute joint, a second one and a ball: a servo's crank and a rod.

    A reading is the angle of the crank in the leg's plane [rad]: 0 radially outwards, π/2 towards the middle platform.
    Of the angles that differ by turns it is the one nearest to the middle of the machine's limits of this leg, which
    may be anywhere and up to a turn apart; without two limits the one from -π/2 to 3π/2, offset aside.

    Parameters
    ----------
    crank, rod : float, or three
        From the servo's axis to the knee, and from there to the ball [m].
    sign : int, or three
        The working mode: -1 where the knee is on the outer side of the line from the servo's axis to the ball, +1 where
        it is on the inner.
    """

    crank: Number
    rod: Number
    sign: int | Sequence[int] = -1

    number = planar_legs.RRS_LEGS
    unit = "rad"
    meaning = "the angle of the crank, 0 radially outwards and pi/2 towards the middle platform"
    effort_unit = "N m"
    joints = ("hip", "knee")
    actuated = "hip"
    body = "crank"
    identified = ("crank", "rod")
    turned = (-1.0, 0.0, 0.0)


def _sign(value: Any, argument: str) -> float:
    expected = "+1 or -1, the working mode"
    number = real_number(value, argument, expected)
    if number not in (1.0, -1.0):
        raise GeometryError(argument, expected, f"{number:g}")
    return int(number)


def _direction(value: Any, argument: str) -> float:
    expected = "an angle in radians, of at most one turn"
    return real_number(value, argument, expected, least=-MOST_TURNED, most=MOST_TURNED, cause="Given in degrees?")


_READERS: dict[str, Callable[[Any, str], float]] = {
    "rod": dimension,
    "crank": dimension,
    "direction": _direction,
    "sign": _sign,
}
_SIZES, _TURNS = (SMALLEST, LARGEST), (-MOST_TURNED, MOST_TURNED)
BOUNDS = {"rod": _SIZES, "crank": _SIZES, "direction": _TURNS, "sign": (-1.0, 1.0)}
"""Between which the numbers fixed in a leg are; a sign is one of its bounds."""
KINDS: dict[str, type[LegKind]] = {kind.__name__: kind for kind in (RPS, PRS, RRS)}
"""The kinds of legs by their names."""


def drawn_numbers(numbers: Sequence[Any], identified: int) -> Any:
    """Return the numbers of three legs as drawn, with the means of the first ones, which a calibration identifies."""
    means = tuple((numbers[0][k] + numbers[1][k] + numbers[2][k]) / 3.0 for k in range(identified))
    return tuple((*means, *x[identified:]) for x in numbers)


def _three(value: Any, argument: str, read: Callable[[Any, str], float]) -> tuple[float, ...]:
    """Read one number for all three legs, or one for each."""
    array = as_array(value)
    if array is None or array.shape not in ((), (3,)):
        raise GeometryError(argument, "a number, or one for each of the three legs", type_and_value(value))
    return tuple(read(x, argument) for x in (np.broadcast_to(array, 3)).tolist())
