"""The pose of a stage's platform from its normal and the height of its centre: `docs/theory/stages.md`.

The rotation is T R_z(ψ), where T turns z to the normal about a level axis and ψ is the torsion. The planes of the legs,
a_i·(R p_i + t) = a_i·(pivot i), are linear in x and y of t and in cos ψ and sin ψ. A sum of them with weights under
which x and y drop out is one equation in ψ, with two solutions: for a nominal stage one has no torsion, mode T, and the
other a half turn, mode F.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.operations import INFINITY, both, sqrt, where
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    direction,
    dot,
    dots,
    largest,
    magnitude,
    minus,
    scaled,
    shifted,
    transposed,
    turned,
)

LEAST_RISE = 1e-6
"""Smallest 1 + z of a normal that has a pose: within 1.4 mrad of -z the legs hardly determine the torsion."""


class StageConstants(NamedTuple):
    """The planes of a stage's legs, the balls in the platform's frame, and the solution of the planes for x and y."""

    axes: Rows
    heights: Vector  # a_i·(pivot i)
    balls: Rows
    weights: Vector  # for which x and y drop out
    along_x: Vector
    along_y: Vector


class Torsion(NamedTuple):
    """The equation cosine cos ψ + sine sin ψ = constant, and the planes' own coefficients."""

    cosine: float
    sine: float
    constant: float
    cosines: Vector
    sines: Vector
    constants: Vector


def stage_constants(axes: Rows, pivots: Rows, balls: Rows) -> StageConstants:
    """Return the constants of a stage."""
    u, v, _ = transposed(axes)
    weights = cross(u, v)
    scale = 1.0 / dot(weights, weights)
    along_x, along_y = scaled(scale, cross(v, weights)), scaled(scale, cross(weights, u))
    return StageConstants(axes, dots(axes, pivots), balls, weights, along_x, along_y)


def unit_normal(normal: Vector, least_rise: float) -> tuple[Vector, bool]:
    """Return the unit vector along a normal of any length, and whether it has a pose; otherwise z.

    Zero, NaN, infinity and directions whose 1 + z is at most `least_rise` have none.
    """
    x, y, z = normal
    is_finite = both(both(magnitude(x) < INFINITY, magnitude(y) < INFINITY), magnitude(z) < INFINITY)
    size = largest(normal)
    is_normal = both(is_finite, size > 0.0)
    # Divided by the largest component first: squares of very short and very long vectors are not representable.
    size = where(is_normal, size, 1.0)
    x, y, z = x / size, y / size, z / size
    x, y, z = direction((where(is_normal, x, 0.0), where(is_normal, y, 0.0), where(is_normal, z, 1.0)))
    exists = both(is_normal, z > least_rise - 1.0)
    return (where(exists, x, 0.0), where(exists, y, 0.0), where(exists, z, 1.0)), exists


def shortest_turn(normal: Vector) -> Rows:
    """Return the rotation T about a level axis that turns z to a unit vector, NaN for -z."""
    x, y, z = normal
    # 1 / (1 + z) is (1 - z) / (x² + y²), which keeps its digits near -z.
    is_below = z < 0.0
    scale = where(is_below, 1.0 - z, 1.0) / where(is_below, x * x + y * y, 1.0 + z)
    return (1.0 - scale * x * x, -scale * x * y, x), (-scale * x * y, 1.0 - scale * y * y, y), (-x, -y, z)


def torsion_equation(turn: Rows, height: float, stage: StageConstants) -> Torsion:
    """Return the equation of the torsion for given T and height of the platform's centre."""
    (px, py, pz), (x, y, z) = transposed(stage.balls), transposed(turned(transposed(turn), stage.axes))
    cosines = x[0] * px[0] + y[0] * py[0], x[1] * px[1] + y[1] * py[1], x[2] * px[2] + y[2] * py[2]
    sines = y[0] * px[0] - x[0] * py[0], y[1] * px[1] - x[1] * py[1], y[2] * px[2] - x[2] * py[2]
    axes = stage.axes
    lift = axes[0][2] * height, axes[1][2] * height, axes[2][2] * height
    constants = minus(minus(stage.heights, (z[0] * pz[0], z[1] * pz[1], z[2] * pz[2])), lift)
    w = stage.weights
    return Torsion(dot(w, cosines), dot(w, sines), dot(w, constants), cosines, sines, constants)


def discriminant(equation: Torsion) -> float:
    """Return a number that is negative if no pose has the normal, and zero where both modes meet."""
    return equation.cosine * equation.cosine + equation.sine * equation.sine - equation.constant * equation.constant


def pose_in_mode(
    sign: float, turn: Rows, height: float, equation: Torsion, stage: StageConstants
) -> tuple[Rows, Vector]:
    """Return rotation and position of mode T, sign +1, or F, -1; NaN if missing."""
    a, b, constant = equation.cosine, equation.sine, equation.constant
    root, scale = sign * sqrt(discriminant(equation)), 1.0 / (a * a + b * b)
    c, s = scale * (a * constant + b * root), scale * (b * constant - a * root)
    rest = combined(combined(equation.constants, -c, equation.cosines), -s, equation.sines)
    position = dot(stage.along_x, rest), dot(stage.along_y, rest), height
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn
    rotation = (
        (c * xx + s * xy, c * xy - s * xx, xz),
        (c * yx + s * yy, c * yy - s * yx, yz),
        (c * zx + s * zy, c * zy - s * zx, zz),
    )
    return rotation, position


def platform_balls(rotation: Rows, position: Vector, balls: Rows) -> Rows:
    """Return the balls in {B}."""
    return shifted(turned(rotation, balls), position)


def pose_of_tilt(
    normal: Vector, least_rise: float, height: float, stage: StageConstants
) -> tuple[Rows, Vector, Rows, bool]:
    """Return rotation, position and balls in {B} of mode T for a normal of any length, and whether they exist.

    `least_rise` is that of `unit_normal`.
    """
    unit, is_normal = unit_normal(normal, least_rise)
    turn = shortest_turn(unit)
    equation = torsion_equation(turn, height, stage)
    rotation, position = pose_in_mode(1.0, turn, height, equation, stage)
    exists = both(is_normal, discriminant(equation) >= 0.0)
    return rotation, position, platform_balls(rotation, position, stage.balls), exists


def parasitic_rates(axes: Rows, b: Rows, o: Vector, motion: Vector) -> tuple[Vector, Vector]:
    """Return the platform's twist (v, ω) at o from `motion`, its v_z, ω_x, ω_y; the legs' planes give v_x, v_y, ω_z.

    These are NaN or infinite at a constraint singularity, where both modes meet.
    """
    rate, wx, wy = motion
    arms = minus(b[0], o), minus(b[1], o), minus(b[2], o)
    u, v, vertical = transposed(axes)
    first, second, third = transposed((cross(arms[0], axes[0]), cross(arms[1], axes[1]), cross(arms[2], axes[2])))
    rest = combined(combined(scaled(-rate, vertical), -wx, first), -wy, second)
    normal = cross(u, v)
    scale = 1.0 / dot(normal, third)
    vx, vy = scale * dot(cross(v, third), rest), scale * dot(cross(third, u), rest)
    return (vx, vy, rate), (wx, wy, scale * dot(normal, rest))
