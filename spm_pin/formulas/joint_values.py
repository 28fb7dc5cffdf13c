"""Values of the revolute, prismatic and ball joints of a state, for any machine: `docs/mechanism.md`.

The value of a leg's actuated joint is its reading minus that in the home, the value of its passive joint the angle
about the revolute axis from the home. `kind` has the leg's formulas from `spm_pin.formulas.planar_legs`, bound to the
same scalar type. Angles are returned as multiples of sine and cosine, for the caller's own arc tangent.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from spm_pin.formulas.leg_constants import AXES, INFINITY, TANGENT_SIGNS, UP, leg_axes
from spm_pin.formulas.operations import both, sqrt, where
from spm_pin.formulas.planar_legs import Circle, Numbers
from spm_pin.formulas.stage_numbers import StageNumbers
from spm_pin.formulas.vectors import Rows, Vector, combined, cross, direction, dot, minus, times, weighted

Angle = tuple[float, float]
"""Sine and cosine of an angle, times one positive factor."""
InPlane = tuple[float, float]
"""x and z of a vector in a leg's plane, radially outwards and towards the middle platform."""


class LegHome(NamedTuple):
    """A leg in the home, with both platforms level on one axis."""

    reading: float  # without the encoder's offset
    x: float  # of the ball, from the pivot
    z: float


class LegFrame(NamedTuple):
    """Constants of a leg: its frame at the pivot, x along the revolute axis, and its home."""

    axes: Rows  # of the frame, in {B} or {m}
    pivot: Vector  # in those axes
    corner: Rows  # axes of the frame at the ball, in those of the lower balls' triangle
    outward: float  # signs of x and z of the leg's plane along y and z of the frame, +1 or -1
    up: float
    rod: InPlane  # direction from the circle's centre to the ball at home
    passive: InPlane  # the same in the frame of the body with the passive joint
    home_reading: float
    middle: float  # see `planar_legs.crank_middle`
    numbers: Numbers  # constants of the leg, see `planar_legs`


class LegValues(NamedTuple):
    """Joint values of a leg, from its ball in the frame of the leg's plate."""

    passive: Angle
    actuated: float
    rod: Angle  # rotation of the rod, or an RPS leg, about the revolute axis
    length: float  # of the rod, the factor of its angle
    plane_distance: float


def leg_home(
    x: float, height: float, limits: tuple[float, float], slope_sign: float, numbers: Numbers, kind: Any
) -> LegHome:
    """Return a leg in the home, with its ball at x: at the middle of its limits, if the ball is then above the plate.

    Otherwise, and without limits, it is at the reading of its kind's `home`. `slope_sign` is that of κ in the leg's
    working mode, and `height` the home height of a stage without limits, the sum of the radii of its two triangles.
    """
    low, high = limits
    middle = 0.5 * (low + high)
    stands = both(both(low < high, ball_height(x, middle, slope_sign, numbers, kind) > 0.0), middle < INFINITY)
    reading = where(stands, middle, kind.home(x, height, low, numbers))
    return LegHome(reading, x, ball_height(x, reading, slope_sign, numbers, kind))


def ball_height(x: float, reading: float, slope_sign: float, numbers: Numbers, kind: Any) -> float:
    """Return z of a ball at x on the circle of a reading: the upper position, or the lower one if it has the mode."""
    circle: Circle = kind.circle(reading, numbers)
    aside = x - circle.x
    rise = sqrt((circle.radius - aside) * (circle.radius + aside))
    above = slope_sign * kind.slope(x, circle.z + rise, reading, numbers) > 0.0
    return circle.z + where(above, rise, -rise)


def leg_frame(
    placement: tuple[Vector, Vector],
    drawn_axis: Vector,
    own_axes: Rows,
    signs: tuple[float, float],
    at_home: LegHome,
    middle: float,
    numbers: tuple[Numbers, Numbers],
    kind: Any,
) -> LegFrame:
    """Return the constants of a leg with this axis and pivot.

    `own_axes` are the axes of the lower balls' triangle in {n}; `signs` are the leg's of `leg_constants.TANGENT_SIGNS`,
    and +1 for a lower leg or -1 for an upper; `numbers` are those of the nominal machine and the leg's own.
    """
    (axis, pivot), (tangent_sign, up), (drawn_numbers, own_numbers) = placement, signs, numbers
    rows = leg_axes(axis)
    corner = times(own_axes, drawn_axis), times(own_axes, cross(UP, drawn_axis)), times(own_axes, UP)
    circle = kind.circle(at_home.reading, drawn_numbers)
    rod = (at_home.x - circle.x) / circle.radius, (at_home.z - circle.z) / circle.radius
    passive = kind.passive(*rod, at_home.reading)
    pivot, reading = times(rows, pivot), at_home.reading
    return LegFrame(rows, pivot, corner, -tangent_sign, up, rod, passive, reading, middle, own_numbers)


def stage_frames(
    stage: StageNumbers,
    own_axes: Rows,
    radii: tuple[float, float],
    limits: tuple[float, float],
    drawn: tuple[Numbers, Numbers, Numbers],
    up: float,
    kind: Any,
) -> tuple[LegFrame, LegFrame, LegFrame]:
    """Return the constants of a stage's legs.

    `radii` are those of the platform of the legs and of the balls, and `limits` those that the legs share; `drawn` are
    the numbers of the drawing, in the legs' own working modes.
    """
    radius, r = radii
    home = leg_home(r - radius, r + radius, limits, kind.largest_slope(drawn[0]), drawn[0], kind)
    return (
        _frame_at(home, 0, stage, own_axes, drawn, up, kind),
        _frame_at(home, 1, stage, own_axes, drawn, up, kind),
        _frame_at(home, 2, stage, own_axes, drawn, up, kind),
    )


def _frame_at(
    home: LegHome, leg: int, stage: StageNumbers, own_axes: Rows, drawn: Any, up: float, kind: Any
) -> LegFrame:
    """Return the constants of a leg; in the other working mode the ball is in the same place at another reading."""
    has_mode = kind.largest_slope(drawn[leg]) * kind.largest_slope(drawn[0]) > 0.0
    middle, placement = stage.middles[leg], (stage.axes[leg], stage.pivots[leg])
    at_home = LegHome(where(has_mode, home.reading, kind.reading(home.x, home.z, middle, drawn[leg])), home.x, home.z)
    signs, numbers = (TANGENT_SIGNS[leg], up), (drawn[leg], stage.numbers[leg])
    return leg_frame(placement, AXES[leg], own_axes, signs, at_home, middle, numbers, kind)


def leg_values(ball: Vector, leg: LegFrame, kind: Any) -> LegValues:
    """Return the values of a leg's passive and actuated joint from its ball, in {B} or {m}."""
    along, across, level = minus(times(leg.axes, ball), leg.pivot)
    x, z = leg.outward * across, leg.up * level
    reading = kind.reading(x, z, leg.middle, leg.numbers)
    circle = kind.circle(reading, leg.numbers)
    rod = x - circle.x, z - circle.z
    sense = leg.outward * leg.up
    passive = _turn(leg.passive, kind.passive(*rod, reading), sense)
    return LegValues(passive, reading - leg.home_reading, _turn(leg.rod, rod, sense), circle.radius, along)


def _turn(begin: InPlane, end: InPlane, sense: float) -> Angle:
    """Return the angle about the leg's axis from a direction at home to another, from x towards z if `sense` is +1."""
    return sense * (begin[0] * end[1] - begin[1] * end[0]), begin[1] * end[1] + begin[0] * end[0]


def triangle_axes(b: Rows) -> Rows:
    """Return the axes of a triangle b_1, b_2, b_3: x along b_3 b_1, y towards b_2, z normal."""
    x = direction(minus(b[0], b[2]))
    y = minus(minus(b[1], b[0]), minus(b[2], b[1]))
    y = direction(combined(y, -dot(x, y), x))
    return x, y, cross(x, y)


def ball_angles(values: LegValues, leg: LegFrame, axes: Rows, sign: float) -> tuple[Angle, Angle, Angle]:
    """Return the angles about x, y, z of the rotation Rx Ry Rz from the rod to the middle platform, times `sign`.

    `axes` are those of the lower balls' triangle, in the frame of the leg's plate. For an upper leg the
    rotation goes from the platform to the rod: its transpose has the angles negated, and `sign` is -1.
    """
    # The axes of the frame at the ball in the leg's frame, then turned back about x like the rod.
    x, y, z = _seen(leg, axes, leg.corner[0]), _seen(leg, axes, leg.corner[1]), _seen(leg, axes, leg.corner[2])
    s, c = _unit(values.rod, values.length)
    y_z, z_z = c * z[1] + s * z[2], c * z[2] - s * z[1]
    level = sqrt(y_z * y_z + z_z * z_z)
    sine, cosine = _unit((-y_z, z_z), level)
    # The last angle is computed from the rest of the first, hence exact where the first is not determined.
    last_sine = cosine * (c * x[1] + s * x[2]) + sine * (c * x[2] - s * x[1])
    last_cosine = cosine * (c * y[1] + s * y[2]) + sine * (c * y[2] - s * y[1])
    return (sign * sine, cosine), (sign * z[0], level), (sign * last_sine, last_cosine)


def _seen(leg: LegFrame, axes: Rows, corner: Vector) -> Vector:
    return times(leg.axes, weighted(corner, axes))


def _unit(angle: Angle, length: float) -> Angle:
    """Return sine and cosine divided by their length, (0, 1) if that is zero."""
    none = length == 0.0
    safe = where(none, 1.0, length)
    return angle[0] / safe, where(none, 1.0, angle[1] / safe)
