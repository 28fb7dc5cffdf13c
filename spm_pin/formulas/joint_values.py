"""Values of the revolute, prismatic and ball joints of a state, of any machine: `docs/mechanism.md`.

Angles are returned as multiples of their sine and cosine, for the runner's own arc tangent.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.operations import sqrt, where
from spm_pin.formulas.vectors import Rows, Vector, combined, cross, direction, dot, minus, times, weighted

Angle = tuple[float, float]
"""Multiples of the sine and the cosine of an angle, by one positive factor."""


class LegFrame(NamedTuple):
    """Constants of a leg: its frame at the pivot, x along the revolute axis, and its home."""

    axes: Rows  # of the frame, in {B} or {m}
    pivot: Vector  # in those axes
    corner: Rows  # the axes of the frame at the ball, in those of the lower balls' triangle
    lean_cos: float  # of the direction from pivot to ball at home, about x from z
    lean_sin: float
    home_length: float


class LegValues(NamedTuple):
    """Joint values of a leg, from its ball seen from the platform that the leg stands on."""

    hip: Angle
    slide: float
    length: float
    plane_distance: float


def leg_values(ball: Vector, leg: LegFrame) -> LegValues:
    """Return the hip's angle and the slide of a leg."""
    along, across, up = minus(times(leg.axes, ball), leg.pivot)
    # Turned back by the lean at home, the direction's angle is the hip's.
    cosine = leg.lean_cos * up - leg.lean_sin * across
    sine = -leg.lean_sin * up - leg.lean_cos * across
    length = sqrt(cosine * cosine + sine * sine)
    return LegValues((sine, cosine), length - leg.home_length, length, along)


def triangle_axes(b: Rows) -> Rows:
    """Return the axes of a triangle b_1, b_2, b_3: x along b_3 b_1, y towards b_2, z normal."""
    x = direction(minus(b[0], b[2]))
    y = minus(minus(b[1], b[0]), minus(b[2], b[1]))
    y = direction(combined(y, -dot(x, y), x))
    return x, y, cross(x, y)


def ball_angles(values: LegValues, leg: LegFrame, axes: Rows, sign: float) -> tuple[Angle, Angle, Angle]:
    """Return the angles about x, y, z of the rotation Rx Ry Rz from the rod to the middle platform, times `sign`.

    `axes` are those of the lower balls' triangle, seen from the platform that the leg stands on. For an upper leg the
    rotation goes from the platform to the rod: its transpose has the angles negated, and `sign` is -1.
    """
    # The axes of the frame at the ball in the leg's frame, then turned back by the hip about x.
    x, y, z = _seen(leg, axes, leg.corner[0]), _seen(leg, axes, leg.corner[1]), _seen(leg, axes, leg.corner[2])
    s, c = _unit(values.hip, values.length)
    y_z, z_z = c * z[1] + s * z[2], c * z[2] - s * z[1]
    level = sqrt(y_z * y_z + z_z * z_z)
    sine, cosine = _unit((-y_z, z_z), level)
    # The last from what the first leaves over, hence exact where the first is not determined.
    last_sine = cosine * (c * x[1] + s * x[2]) + sine * (c * x[2] - s * x[1])
    last_cosine = cosine * (c * y[1] + s * y[2]) + sine * (c * y[2] - s * y[1])
    return (sign * sine, cosine), (sign * z[0], level), (sign * last_sine, last_cosine)


def _seen(leg: LegFrame, axes: Rows, corner: Vector) -> Vector:
    return times(leg.axes, weighted(corner, axes))


def _unit(angle: Angle, length: float) -> Angle:
    """Return sine and cosine over their length, (0, 1) where that is zero."""
    none = length == 0.0
    safe = where(none, 1.0, length)
    return angle[0] / safe, where(none, 1.0, angle[1] / safe)
