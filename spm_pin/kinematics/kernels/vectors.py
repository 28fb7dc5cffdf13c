"""Vectors of three numbers, and elimination of Gauss and Jordan."""

from __future__ import annotations

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.mechanism.arguments import FloatArray

Vector = tuple[float, float, float]
"""A vector as three scalars, which compiled code keeps in registers."""


@jit_inline
def dot(a: Vector, b: Vector) -> float:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit_inline
def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit_inline
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit_inline
def scaled(factor: float, a: Vector) -> Vector:
    """Return factor · a."""
    return factor * a[0], factor * a[1], factor * a[2]


@jit_inline
def combined(a: Vector, x: float, b: Vector) -> Vector:
    """Return a + x b."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


@jit
def reduce_rows(rows: FloatArray) -> float:
    """Make the left square of a matrix the identity by Gauss–Jordan elimination, and return the smallest pivot.

    The rows are not finite where that is zero.
    """
    height, width = rows.shape
    least = np.inf
    for j in range(height):
        pivot = j
        for i in range(j + 1, height):
            if abs(rows[i, j]) > abs(rows[pivot, j]):
                pivot = i
        least = min(least, abs(rows[pivot, j]))
        for k in range(width):
            rows[j, k], rows[pivot, k] = rows[pivot, k], rows[j, k]
        scale = 1.0 / rows[j, j]
        for k in range(width):
            rows[j, k] *= scale
        for i in range(height):
            factor = rows[i, j]
            if i != j:
                for k in range(width):
                    rows[i, k] -= factor * rows[j, k]
    return least
