"""The planes of the six legs, and balls that do not coincide, for any machine: `docs/theory/calibrated.md`.

A leg moves in the plane through its pivot that is normal to its revolute axis; a ball of the middle platform stays
in this plane. Axes and pivots of lower legs are in {B}, of upper legs in {m}.

For a given pose all six planes are known in {B}, and R, t of the middle platform are unknown. With the ball p_i in the
platform's frame, the six equations n_i · (R p_i + t) = h_i are linear in t. The left null space of the 6 x 3 matrix of
the n_i leaves three equations in R alone, quadratic forms xᵀ Q x of its quaternion x, scalar last.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    cross,
    differences,
    dot,
    matrix_product,
    minus,
    multiples,
    scaled,
    shifted,
    transposed,
    turned,
)

Form = tuple[float, float, float, float, float, float, float, float, float, float]
"""A quadratic form xᵀ Q x of a quaternion: the entries xx, yy, zz, ww, xy, xz, yz, xw, yw, zw of Q."""


class StageLegs(NamedTuple):
    """Revolute axes and pivots of the three legs of a stage, in one frame."""

    axes: Rows
    pivots: Rows


def carried(legs: StageLegs, rotation: Rows, position: Vector) -> StageLegs:
    """Return in {B} the legs of a stage that are given in {m}, the frame with the pose R, o."""
    return StageLegs(turned(rotation, legs.axes), shifted(turned(rotation, legs.pivots), position))


def upper_balls(b: Rows, weights: Rows) -> Rows:
    """Return the balls c_i of the upper legs from those of the lower ones, b_i, by `upper_ball_weights`.

    c_i - b_i is a sum of multiples of b_2 - b_1, b_3 - b_1 and their cross product; with weights of zero, those of the
    nominal machine, c_i is b_i exactly.
    """
    p, q = minus(b[1], b[0]), minus(b[2], b[0])
    along_p, along_q, along_n = transposed(weights)
    n = cross(p, q)
    beside = combinations(combinations(b, along_p, (p, p, p)), along_q, (q, q, q))
    return combinations(beside, along_n, (n, n, n))


def upper_ball_weights(lower: Rows, upper: Rows) -> Rows:
    """Return the weights of `upper_balls` from the balls in {n}, the platform's frame: zero if balls coincide."""
    first, second = minus(lower[1], lower[0]), minus(lower[2], lower[0])
    normal = cross(first, second)
    scale = 1.0 / dot(normal, normal)
    dual = scaled(scale, cross(second, normal)), scaled(scale, cross(normal, first)), scaled(scale, normal)
    return turned(dual, differences(upper, lower))


class StagePlanes(NamedTuple):
    """Planes of the three legs of a stage."""

    normals: Rows  # in {B}
    heights: Vector
    balls: Rows  # in these planes, in the middle platform's frame


def quadric(lower_weights: Vector, upper_weights: Vector, lower: StagePlanes, upper: StagePlanes) -> Form:
    """Return the form of the weighted sum of n_i · R p_i - h_i, with weights for which t drops out."""
    below, above = _moments(lower_weights, lower), _moments(upper_weights, upper)
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = combinations(below, (1.0, 1.0, 1.0), above)
    c = dot(lower_weights, lower.heights) + dot(upper_weights, upper.heights)
    squares = m00 - m11 - m22 - c, m11 - m00 - m22 - c, m22 - m00 - m11 - c, m00 + m11 + m22 - c
    return *squares, m01 + m10, m02 + m20, m12 + m21, m21 - m12, m02 - m20, m10 - m01


def _moments(weights: Vector, planes: StagePlanes) -> Rows:
    """Return the sum of the products n_i p_iᵀ with these weights."""
    return matrix_product(transposed(multiples(weights, planes.normals)), planes.balls)
