"""Six general legs between two plates and a middle triangle: their balls, vectors and closure, of any machine.

Axes and pivots of lower legs are in {B}, of upper legs in {m}. A leg's line starts at its pivot, is perpendicular to
its axis, and ends at the centre of a ball of the middle platform.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.kinematics.formulas.operations import sqrt
from spm_pin.kinematics.formulas.stages import is_home_aspect
from spm_pin.kinematics.formulas.vectors import Rows, Vector, combined, cross, dot, minus, times
from spm_pin.kinematics.formulas.wrenches import normals, pairs


class StageLegs(NamedTuple):
    """Revolute axes and pivots of the three legs of a stage, in one frame."""

    axes: Rows
    pivots: Rows


def turned(rotation: Rows, rows: Rows) -> Rows:
    """Return R v of three vectors v."""
    return times(rotation, rows[0]), times(rotation, rows[1]), times(rotation, rows[2])


def carried(legs: StageLegs, rotation: Rows, position: Vector) -> StageLegs:
    """Return the legs of a stage in {B}, given in {m}."""
    pivots = turned(rotation, legs.pivots)
    first, second = combined(pivots[0], 1.0, position), combined(pivots[1], 1.0, position)
    return StageLegs(turned(rotation, legs.axes), (first, second, combined(pivots[2], 1.0, position)))


def upper_balls(b: Rows, weights: Rows) -> Rows:
    """Return the upper legs' balls from the lower ones' b_i, by `upper_ball_weights`.

    Each is its own corner's b_i plus multiples of b_2 - b_1, b_3 - b_1 and their cross product; with weights of zero,
    those of the drawn machine, it is b_i exactly.
    """
    p, q = minus(b[1], b[0]), minus(b[2], b[0])
    n = cross(p, q)
    return _beside(b[0], weights[0], p, q, n), _beside(b[1], weights[1], p, q, n), _beside(b[2], weights[2], p, q, n)


def _beside(corner: Vector, weights: Vector, p: Vector, q: Vector, n: Vector) -> Vector:
    return combined(combined(combined(corner, weights[0], p), weights[1], q), weights[2], n)


def leg_vectors(balls: Rows, pivots: Rows) -> Rows:
    """Return the vectors from pivot to ball of a stage."""
    return minus(balls[0], pivots[0]), minus(balls[1], pivots[1]), minus(balls[2], pivots[2])


def leg_lengths(balls: Rows, pivots: Rows) -> Vector:
    """Return the true lengths of the legs of a stage."""
    first, second, third = leg_vectors(balls, pivots)
    return sqrt(dot(first, first)), sqrt(dot(second, second)), sqrt(dot(third, third))


def plane_distances(balls: Rows, legs: StageLegs) -> Vector:
    """Return the distances of the balls of a stage from the planes of their legs."""
    first, second, third = leg_vectors(balls, legs.pivots)
    return dot(first, legs.axes[0]), dot(second, legs.axes[1]), dot(third, legs.axes[2])


def side_errors(balls: Rows, sides: Vector) -> Vector:
    """Return (s² - d²) / 2d for the sides 12, 23, 31 of a triangle, smooth everywhere."""
    return (
        _side_error(minus(balls[0], balls[1]), sides[0]),
        _side_error(minus(balls[1], balls[2]), sides[1]),
        _side_error(minus(balls[2], balls[0]), sides[2]),
    )


def _side_error(side: Vector, d: float) -> float:
    return (dot(side, side) - d * d) / (2.0 * d)


def is_in_home_aspect(balls: Rows, legs: StageLegs, up: float) -> bool:
    """Return whether a stage is in the aspect of its home; `up` is 1 for the lower stage and -1 for the upper one.

    The axis of leg 1 has the opposite sense of the others about the platform's normal.
    """
    vectors = leg_vectors(balls, legs.pivots)
    c12, c23, c31, c21, c32, c13 = pairs(balls, normals(vectors, legs.axes))
    return is_home_aspect((-up * c12, up * c23, up * c31, up * c21, up * c32, -up * c13))
