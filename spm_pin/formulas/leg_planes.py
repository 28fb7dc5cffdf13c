"""Six general legs between two plates and a middle triangle, of any machine: `docs/theory/as_built.md`.

Axes and pivots of lower legs are in {B}, of upper legs in {m}. A leg's line starts at its pivot, is perpendicular to
its axis, and ends at the centre of a ball of the middle platform.

The six leg planes n_i · (R p_i + t) = h_i of a pose are linear in t. The left null space of the 6 x 3 matrix of the n_i
leaves three equations in R alone, quadratic forms xᵀ Q x of the quaternion x, scalar last.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    dot,
    matrix_product,
    minus,
    scaled,
    times,
    transposed,
)

Form = tuple[float, float, float, float, float, float, float, float, float, float]
"""xx, yy, zz, ww, xy, xz, yz, xw, yw, zw of a symmetric matrix."""


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


def upper_ball_weights(lower: Rows, upper: Rows) -> Rows:
    """Return the weights of `upper_balls` from the balls in {n}: exactly zero where they coincide."""
    first, second = minus(lower[1], lower[0]), minus(lower[2], lower[0])
    normal = cross(first, second)
    scale = 1.0 / dot(normal, normal)
    dual = scaled(scale, cross(second, normal)), scaled(scale, cross(normal, first)), scaled(scale, normal)
    x, y, z = minus(upper[0], lower[0]), minus(upper[1], lower[1]), minus(upper[2], lower[2])
    return times(dual, x), times(dual, y), times(dual, z)


class StagePlanes(NamedTuple):
    """Planes of the three legs of a stage."""

    normals: Rows  # in {B}
    heights: Vector
    balls: Rows  # points of the middle platform that lie in them, in its frame


def quadric(lower_weights: Vector, upper_weights: Vector, lower: StagePlanes, upper: StagePlanes) -> Form:
    """Return the form of the planes' equations with weights under which t drops out."""
    below, above = _moments(lower_weights, lower), _moments(upper_weights, upper)
    m00, m01, m02 = combined(below[0], 1.0, above[0])
    m10, m11, m12 = combined(below[1], 1.0, above[1])
    m20, m21, m22 = combined(below[2], 1.0, above[2])
    c = dot(lower_weights, lower.heights) + dot(upper_weights, upper.heights)
    squares = m00 - m11 - m22 - c, m11 - m00 - m22 - c, m22 - m00 - m11 - c, m00 + m11 + m22 - c
    return *squares, m01 + m10, m02 + m20, m12 + m21, m21 - m12, m02 - m20, m10 - m01


def _moments(weights: Vector, planes: StagePlanes) -> Rows:
    """Return the sum of the products n_i p_iᵀ with these weights."""
    n = planes.normals
    weighted_normals = scaled(weights[0], n[0]), scaled(weights[1], n[1]), scaled(weights[2], n[2])
    return matrix_product(transposed(weighted_normals), planes.balls)
