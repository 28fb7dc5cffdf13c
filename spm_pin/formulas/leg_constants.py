"""Constants of the nominal legs, and the formulas of their parameters and limits: `docs/mechanism.md`."""

from __future__ import annotations

from spm_pin.formulas.operations import COS_30, cos, sin, sqrt, where
from spm_pin.formulas.vectors import Rows, Vector, combined, cross, dot, larger, magnitude, scaled

UP = (0.0, 0.0, 1.0)
RADIAL = ((COS_30, -0.5, 0.0), (0.0, 1.0, 0.0), (-COS_30, -0.5, 0.0))
"""Unit vectors from the platform's centre towards the nominal legs 1, 2, 3, in {B} for lower and {m} for upper legs."""
AXES = ((0.5, COS_30, 0.0), (1.0, 0.0, 0.0), (-0.5, COS_30, 0.0))
"""The nominal revolute axes, unit vectors in the same frames."""
TANGENT_SIGNS = (1.0, -1.0, -1.0)
"""Signs that make the nominal axes counterclockwise about z: a rotation about such an axis turns z outwards."""
INFINITY = float("inf")
LIMIT_ROUNDING = 1e-8
"""Tolerance for readings beyond a limit, relative to the leg's larger finite limit. The
reading computed for a state at an end stop differs from the stop by rounding, near a singularity by that much."""


def drawn_triangle(radius: float) -> Rows:
    """Return the three points at a radius along the `RADIAL` directions."""
    return scaled(radius, RADIAL[0]), scaled(radius, RADIAL[1]), scaled(radius, RADIAL[2])


def mean_radius(points: Rows) -> float:
    """Return the mean radius of three points, that of their components along the `RADIAL` directions."""
    return (dot(RADIAL[0], points[0]) + dot(RADIAL[1], points[1]) + dot(RADIAL[2], points[2])) / 3.0


def turned_axis(axis: Vector, first: float, second: float) -> Vector:
    """Return an axis turned by two angles [rad], towards z x axis and towards z; see `Manipulator.parameters`."""
    square = first * first + second * second
    small = square < 1e-8
    angle = sqrt(where(small, 1.0, square))
    cosine = where(small, 1.0 - square / 2.0 + square * square / 24.0, cos(angle))
    sinc = where(small, 1.0 - square / 6.0 + square * square / 120.0, sin(angle) / angle)
    across = combined(scaled(first, cross(UP, axis)), second, UP)
    return combined(scaled(cosine, axis), sinc, across)


def admitted_readings(low: float, high: float) -> tuple[float, float]:
    """Return the limits of a leg with the tolerance for rounding."""
    rounding = limit_rounding(low, high)
    return low - rounding, high + rounding


def limit_rounding(low: float, high: float) -> float:
    """Return the tolerance for readings beyond the limits of a leg."""
    highest, lowest = where(high < INFINITY, magnitude(high), 0.0), where(low > -INFINITY, magnitude(low), 0.0)
    return LIMIT_ROUNDING * larger(highest, lowest)


def leg_axes(axis: Vector) -> Rows:
    """Return the axes of a leg's frame: x along its revolute axis, z as close to Z of {B} or {m} as that allows."""
    z = combined(UP, -axis[2], axis)
    scale = 1.0 / sqrt(dot(z, z))
    # The second axis is z × x, without the rounding error of its third component.
    return axis, scaled(scale, cross(UP, axis)), scaled(scale, z)
