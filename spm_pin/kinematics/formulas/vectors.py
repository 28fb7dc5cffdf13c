"""Vectors of three numbers."""

from __future__ import annotations

from spm_pin.kinematics.formulas.operations import sqrt, where

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


def scaled(factor: float, a: Vector) -> Vector:
    """Return factor · a."""
    return factor * a[0], factor * a[1], factor * a[2]


def combined(a: Vector, x: float, b: Vector) -> Vector:
    """Return a + x b."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


def direction(a: Vector) -> Vector:
    """Return a over its length, not a number where that is zero."""
    return scaled(1.0 / sqrt(dot(a, a)), a)


def weighted(weights: Vector, rows: Rows) -> Vector:
    """Return the sum of three vectors with these weights: the transpose of a matrix times a vector."""
    return combined(combined(scaled(weights[0], rows[0]), weights[1], rows[1]), weights[2], rows[2])


def times(rows: Rows, a: Vector) -> Vector:
    """Return a matrix times a vector."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def magnitude(x: float) -> float:
    """Return |x|."""
    return where(x < 0.0, -x, x)


def larger(x: float, y: float) -> float:
    """Return the larger of two numbers."""
    return where(x < y, y, x)


def largest(a: Vector) -> float:
    """Return the largest magnitude of three numbers."""
    return larger(larger(magnitude(a[0]), magnitude(a[1])), magnitude(a[2]))
