"""The constants of one stage of a machine, and its legs for given readings or balls: `docs/theory/planar_legs.md`.

Lower legs are in {B}, upper ones in {m}: the frame of the plate that carries them. `kind` has the formulas of the legs'
kind from `spm_pin.formulas.planar_legs`, bound to the same scalar type. Readings are without offsets.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from spm_pin.formulas.circles import Circles, squared_sides
from spm_pin.formulas.leg_constants import TANGENT_SIGNS
from spm_pin.formulas.planar_legs import (
    Circle,
    LegPlane,
    Numbers,
    crank_middle,
    place_in_plane,
    plane_axes,
    point_of_plane,
)
from spm_pin.formulas.vectors import Rows, Vector, minus


class StageNumbers(NamedTuple):
    """The constants of a stage."""

    axes: Rows
    pivots: Rows
    balls: Rows  # in the platform's frame
    offsets: Vector
    numbers: tuple[Numbers, Numbers, Numbers]  # that are fixed in the legs
    planes: tuple[LegPlane, LegPlane, LegPlane]
    middles: Vector  # see `planar_legs.crank_middle`
    squares: Vector  # of the distances of the balls 12, 23, 31
    up: float  # +1 if the platform is above the plate at home, in the direction of z, otherwise -1


def stage_numbers(
    vectors: tuple[Rows, Rows, Rows],
    offsets: Vector,
    limits: tuple[Vector, Vector],
    numbers: tuple[Numbers, Numbers, Numbers],
    side: float,
    up: float,
) -> StageNumbers:
    """Return the constants of a stage from its axes, pivots and balls, offsets, limits and numbers of its legs.

    `side` is +1 for a lower stage and -1 for an upper; `up` is +1 if the platform is on this side of the circles'
    centres at home, -1 if on the other.
    """
    (axes, pivots, balls), (low, high) = vectors, limits
    planes = (
        LegPlane(pivots[0], *plane_axes(axes[0], TANGENT_SIGNS[0], side)),
        LegPlane(pivots[1], *plane_axes(axes[1], TANGENT_SIGNS[1], side)),
        LegPlane(pivots[2], *plane_axes(axes[2], TANGENT_SIGNS[2], side)),
    )
    middles = (
        crank_middle(low[0], high[0], offsets[0]),
        crank_middle(low[1], high[1], offsets[1]),
        crank_middle(low[2], high[2], offsets[2]),
    )
    return StageNumbers(axes, pivots, balls, offsets, numbers, planes, middles, squared_sides(balls), side * up)


def circles_of_readings(readings: Vector, stage: StageNumbers, kind: Any) -> Circles:
    """Return the circles of the balls for these readings."""
    first, a = _circle(readings[0], stage.planes[0], stage.numbers[0], kind)
    second, b = _circle(readings[1], stage.planes[1], stage.numbers[1], kind)
    third, c = _circle(readings[2], stage.planes[2], stage.numbers[2], kind)
    return Circles(stage.axes, (first, second, third), (a, b, c), stage.squares)


def _circle(reading: float, plane: LegPlane, numbers: Numbers, kind: Any) -> tuple[Vector, float]:
    circle: Circle = kind.circle(reading, numbers)
    return point_of_plane(circle.x, circle.z, plane), circle.radius


def readings_of_balls(b: Rows, stage: StageNumbers, kind: Any) -> tuple[Vector, Vector]:
    """Return the readings of the legs with these balls, and numbers that are negative for balls out of reach."""
    q1, reach1 = _reading(b[0], stage.planes[0], stage.middles[0], stage.numbers[0], kind)
    q2, reach2 = _reading(b[1], stage.planes[1], stage.middles[1], stage.numbers[1], kind)
    q3, reach3 = _reading(b[2], stage.planes[2], stage.middles[2], stage.numbers[2], kind)
    return (q1, q2, q3), (reach1, reach2, reach3)


def _reading(ball: Vector, plane: LegPlane, middle: float, numbers: Numbers, kind: Any) -> tuple[float, float]:
    x, z = place_in_plane(ball, plane)
    return kind.reading(x, z, middle, numbers), kind.reach(x, z, numbers)


def rods_at(b: Rows, readings: Vector, stage: StageNumbers, kind: Any) -> tuple[Vector, Rows]:
    """Return κ of the legs with these balls and readings, and the vectors from the circles' centres to the balls."""
    slope1, rod1 = _rod(b[0], readings[0], stage.planes[0], stage.numbers[0], kind)
    slope2, rod2 = _rod(b[1], readings[1], stage.planes[1], stage.numbers[1], kind)
    slope3, rod3 = _rod(b[2], readings[2], stage.planes[2], stage.numbers[2], kind)
    return (slope1, slope2, slope3), (rod1, rod2, rod3)


def _rod(ball: Vector, reading: float, plane: LegPlane, numbers: Numbers, kind: Any) -> tuple[float, Vector]:
    centre, _ = _circle(reading, plane, numbers, kind)
    return kind.slope(*place_in_plane(ball, plane), reading, numbers), minus(ball, centre)


def relative_slopes(slopes: Vector, stage: StageNumbers, kind: Any) -> Vector:
    """Return κ of the legs over the largest of their working modes: at most 1, negative in another mode."""
    first, second, third = stage.numbers
    largest = kind.largest_slope(first), kind.largest_slope(second), kind.largest_slope(third)
    return slopes[0] / largest[0], slopes[1] / largest[1], slopes[2] / largest[2]
