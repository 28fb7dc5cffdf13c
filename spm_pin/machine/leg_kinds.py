"""The kinds of planar legs, RPS, PRS and RRS, with the fixed dimensions of the three legs of a stage.

The actuated joint, underlined in the literature, is the P of RPS and of PRS and the first R of RRS. With a locked
actuator the ball of each kind moves on a circle: `spm_pin.formulas.planar_legs`.
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
"""One number for all three legs, or one for each."""

FORMULAS = "reading", "reach", "room", "circle", "slope", "largest_slope", "home", "passive"
"""Names of the formulas that every kind has."""
_STEP = 1e-100
"""Imaginary step of a derivative."""


@dataclass(frozen=True)
class LegKind:
    """Base class of planar legs of a stage; see `RPS`, `PRS` and `RRS`."""

    name: ClassVar[str]
    unit: ClassVar[str]
    """Unit of the readings, "m" or "rad"."""
    meaning: ClassVar[str]
    """Meaning of a reading without its offset, in words."""
    effort_unit: ClassVar[str]
    """Unit of the actuator effort, "N" or "N m"."""
    joints: ClassVar[tuple[str, str]]
    """Names of the two joints from the plate to the ball: "hip", "slide" or "knee"."""
    actuated: ClassVar[str]
    """Name of the actuated one."""
    body: ClassVar[str]
    """Name of the body between them."""
    least_reading: ClassVar[float] = -math.inf
    """Lower bound of the reading, without its offset."""
    identified: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers that a design chooses and a calibration identifies: all but the working mode."""
    turned: ClassVar[tuple[float, ...]]
    """Changes of the offset, and of each `identified` number, that correspond to a unit rotation of the leg's links."""
    number: ClassVar[int]
    """Number of the kind in `spm_pin.formulas.planar_legs`, for kernels."""
    formulas: ClassVar[SimpleNamespace]
    """Formulas of the kind in `spm_pin.formulas.planar_legs`, see `FORMULAS`, for each backend to bind."""
    on_arrays: ClassVar[SimpleNamespace]
    """The same as functions of NumPy arrays."""

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        for field in fields(self):
            legs = _three(getattr(self, field.name), field.name, _READERS[field.name])
            # Store a scalar if all three legs are equal.
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
        """Name of the joint without actuator, which is revolute."""
        return self.joints[self.joints[0] == self.actuated]

    @property
    def links(self) -> FloatArray:
        """Sum of the fixed lengths of each leg [m], (3,)."""
        lengths = [getattr(self, field.name) for field in fields(self) if _READERS[field.name] is dimension]
        return np.asarray(sum((np.broadcast_to(length, 3) for length in lengths), np.zeros(3)))

    @functools.cached_property
    def numbers(self) -> FloatArray:
        """The fixed numbers as arguments of the formulas, (3, n)."""
        rows = [np.broadcast_to(getattr(self, field.name), 3) for field in fields(self)]
        return frozen(np.array(rows, dtype=np.float64).reshape(len(rows), 3).T)

    @property
    def has_equal_legs(self) -> bool:
        """Whether the three legs have equal numbers."""
        return not any(isinstance(getattr(self, field.name), tuple) for field in fields(self))

    @property
    def nominal(self) -> LegKind:
        """The legs with the mean of each number in all three."""
        if self.has_equal_legs:
            return self
        return self.with_numbers(np.tile(self.numbers[:, : len(self.identified)].mean(axis=0), (3, 1)))

    @property
    def up(self) -> float:
        """+1 if the platform is above the centres of the balls' circles at home, -1 if it hangs below them."""
        return float(self.up_of(on_arrays, self.numbers.tolist()))

    @classmethod
    def up_of(cls, bind: Callable[[Any], Any], numbers: Sequence[Any]) -> Any:
        """Return `up` for three legs with these numbers, by formulas bound by a function such as `on_arrays`."""
        return 1.0

    def as_data(self) -> dict[str, Any]:
        """Return the data of these legs for a file."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {"kind": self.name} | {name: list(x) if isinstance(x, tuple) else x for name, x in values.items()}

    def with_numbers(self, identified: FloatArray) -> LegKind:
        """Return legs with other `identified` numbers (3, n)."""
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

        The derivatives are with respect to the reading, then each of the `identified` numbers.
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
        """Return the distance of balls at x and z (..., 3, 2) from the leg's own singularities [m], (..., 3).

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
    """Cylinders: a revolute joint, an actuated prismatic one, and a ball. A reading is a length [m]."""

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
    """A carriage on a rail, or a nut on a screw, and a rod: an actuated slide, a revolute joint and a ball.

    A reading is the position of the carriage along the rail [m], from the pivot.

    Parameters
    ----------
    rod : float, or three
        Distance from the revolute joint to the ball [m].
    direction : float, or three
        Direction of the slide in the leg's plane [rad]: 0 is radially outwards, π/2 towards the middle platform.
    sign : int, or three
        Working mode: -1 if the carriage is behind the ball, seen along the slide, +1 if it is ahead. With +1 and slides
        that rise by more than 0.05 rad the platform hangs below the carriages at home, otherwise it is above them.
    """

    rod: Number
    direction: Number = math.pi / 2.0
    sign: int | Sequence[int] = -1

    number = planar_legs.PRS_LEGS
    unit = "m"
    meaning = "the position of the carriage along its slide, from the pivot"
    effort_unit = "N"
    joints = ("slide", "knee")
    actuated = "slide"
    body = "carriage"
    identified = ("rod", "direction")
    turned = (0.0, 0.0, 1.0)

    @classmethod
    def up_of(cls, bind: Callable[[Any], Any], numbers: Sequence[Any]) -> Any:
        """Return `up` for three legs: -1 if the carriages are ahead of the balls on slides that rise."""
        return bind(planar_legs.prs_up)(*numbers)


@dataclass(frozen=True)
class RRS(LegKind):
    """A servo's crank and a rod: an actuated revolute joint, a second one and a ball.

    A reading is the angle of the crank in the leg's plane [rad]: 0 radially outwards, π/2 towards the middle platform.
    Among the angles that differ by full turns it is the one nearest to the middle of the machine's limits of this leg,
    which may be anywhere and up to a turn apart; without two limits the one from -π/2 to 3π/2, offset aside.

    Parameters
    ----------
    crank, rod : float, or three
        Distances from the servo's axis to the knee, and from there to the ball [m].
    sign : int, or three
        Working mode: -1 if the knee is on the outer side of the line from the servo's axis to the ball, +1 if
        it is on the inner side.
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
    expected = "an angle in radians, at most one turn"
    return real_number(value, argument, expected, least=-MOST_TURNED, most=MOST_TURNED, cause="Is it in degrees?")


_READERS: dict[str, Callable[[Any, str], float]] = {
    "rod": dimension,
    "crank": dimension,
    "direction": _direction,
    "sign": _sign,
}
_SIZES, _TURNS = (SMALLEST, LARGEST), (-MOST_TURNED, MOST_TURNED)
BOUNDS = {"rod": _SIZES, "crank": _SIZES, "direction": _TURNS, "sign": (-1.0, 1.0)}
"""Ranges of the fixed numbers; a sign is one of its bounds."""
KINDS: dict[str, type[LegKind]] = {kind.__name__: kind for kind in (RPS, PRS, RRS)}
"""The kinds of legs, by name."""


def drawn_numbers(numbers: Sequence[Any], identified: int) -> Any:
    """Return the numbers of three nominal legs, with the means of the first ones, which a calibration identifies."""
    means = tuple((numbers[0][k] + numbers[1][k] + numbers[2][k]) / 3.0 for k in range(identified))
    return tuple((*means, *x[identified:]) for x in numbers)


def _three(value: Any, argument: str, read: Callable[[Any, str], float]) -> tuple[float, ...]:
    """Read one number for all three legs, or one for each."""
    array = as_array(value)
    if array is None or array.shape not in ((), (3,)):
        raise GeometryError(argument, "a number, or one for each of the three legs", type_and_value(value))
    return tuple(read(x, argument) for x in (np.broadcast_to(array, 3)).tolist())
