"""Vectors of three numbers."""

from __future__ import annotations

from spm_pin.formulas.operations import sqrt, where

Vector = tuple[float, float, float]
Rows = tuple[Vector, Vector, Vector]
"""A matrix by its rows, or three vectors, one for each leg of a stage."""


def dot(a: Vector, b: Vector) -> float:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def differences(a: Rows, b: Rows) -> Rows:
    """Return a_i - b_i."""
    return minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2])


def crosses(a: Rows, b: Rows) -> Rows:
    """Return a_i × b_i."""
    return cross(a[0], b[0]), cross(a[1], b[1]), cross(a[2], b[2])


def dots(a: Rows, b: Rows) -> Vector:
    """Return a_i·b_i."""
    return dot(a[0], b[0]), dot(a[1], b[1]), dot(a[2], b[2])


def multiples(x: Vector, a: Rows) -> Rows:
    """Return x_i a_i."""
    return scaled(x[0], a[0]), scaled(x[1], a[1]), scaled(x[2], a[2])


def combinations(a: Rows, x: Vector, b: Rows) -> Rows:
    """Return a_i + x_i b_i."""
    return combined(a[0], x[0], b[0]), combined(a[1], x[1], b[1]), combined(a[2], x[2], b[2])


def shifted(a: Rows, b: Vector) -> Rows:
    """Return a_i + b."""
    return combinations(a, (1.0, 1.0, 1.0), (b, b, b))


def turned(rotation: Rows, a: Rows) -> Rows:
    """Return R a_i."""
    return times(rotation, a[0]), times(rotation, a[1]), times(rotation, a[2])


def scaled(factor: float, a: Vector) -> Vector:
    """Return factor · a."""
    return factor * a[0], factor * a[1], factor * a[2]


def combined(a: Vector, x: float, b: Vector) -> Vector:
    """Return a + x b."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


def direction(a: Vector) -> Vector:
    """Return the unit vector along a, NaN if a is zero."""
    return scaled(1.0 / sqrt(dot(a, a)), a)


def directions(a: Rows) -> Rows:
    """Return the unit vectors along three vectors."""
    return direction(a[0]), direction(a[1]), direction(a[2])


def directions_and_lengths(a: Rows) -> tuple[Rows, Vector]:
    """Return the unit vectors along three vectors, and the lengths of these."""
    x, y, z = dots(a, a)
    x, y, z = sqrt(x), sqrt(y), sqrt(z)
    return multiples((1.0 / x, 1.0 / y, 1.0 / z), a), (x, y, z)


def weighted(weights: Vector, rows: Rows) -> Vector:
    """Return the weighted sum of three vectors: the transpose of a matrix times a vector."""
    return combined(combined(scaled(weights[0], rows[0]), weights[1], rows[1]), weights[2], rows[2])


def times(rows: Rows, a: Vector) -> Vector:
    """Return the product of a matrix and a vector."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def transposed(rows: Rows) -> Rows:
    """Return the transpose of a matrix, or the columns of it."""
    a, b, c = rows
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


def matrix_product(a: Rows, b: Rows) -> Rows:
    """Return the product of two matrices."""
    return weighted(a[0], b), weighted(a[1], b), weighted(a[2], b)


def rotation_of(x: float, y: float, z: float, w: float) -> Rows:
    """Return the rotation matrix of a quaternion of any length, scalar last."""
    scale = 1.0 / (x * x + y * y + z * z + w * w)
    return (
        scaled(scale, (x * x - y * y - z * z + w * w, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w))),
        scaled(scale, (2.0 * (x * y + z * w), y * y - x * x - z * z + w * w, 2.0 * (y * z - x * w))),
        scaled(scale, (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), z * z - x * x - y * y + w * w)),
    )


def magnitude(x: float) -> float:
    """Return |x|."""
    return where(x < 0.0, -x, x)


def larger(x: float, y: float) -> float:
    """Return the larger of two numbers."""
    return where(x < y, y, x)


def largest(a: Vector) -> float:
    """Return the largest magnitude of three numbers."""
    return larger(larger(magnitude(a[0]), magnitude(a[1])), magnitude(a[2]))


def least(a: Vector) -> float:
    """Return the least of three numbers."""
    return -larger(larger(-a[0], -a[1]), -a[2])
