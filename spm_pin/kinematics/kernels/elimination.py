"""Elimination of Gauss and Jordan."""

from __future__ import annotations

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit
from spm_pin.mechanism.arguments import FloatArray


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
