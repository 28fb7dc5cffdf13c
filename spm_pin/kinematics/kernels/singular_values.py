"""Singular values and vectors of a tile of small matrices, by plane rotations of their rows.

A tile of matrices is an array (rows, columns, lanes). Householder's reflections make a square matrix triangular, which
halves the number of rotations, the more so if its long columns come first; then pairs of rows are rotated until all are
orthogonal (Jacobi's method from one side): each row then is a singular value times its right singular vector. Small
singular values are as accurate as rounding of the matrix allows.

What is done to a matrix does not depend on the others in its tile: one that is finished is not rotated any more.
"""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.stages import EPS
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array
from spm_pin.mechanism.arguments import FloatArray

LANES = 64
"""Matrices in a tile: more than elsewhere, for the loops are many and short."""
WIDTH = 6
"""Columns of the matrices; narrower ones are filled up with zeros."""
_ORTHOGONAL = 16.0 * EPS * EPS
"""Square of the cosine of the angle between two rows that need no rotation."""
_LAST_SWEEP = 1e-18
"""Square of the largest cosine met in a sweep that leaves only rounding: a sweep leaves about the square of it."""
_MOST_SWEEPS = 30
_COSINE, _SINE, _ACTIVE, _MORE = range(4)


@jit
def _reflect_rows(rows: FloatArray, work: FloatArray) -> None:
    """Make six rows lower triangular by reflections, whose normals are left in the rows from the diagonal on.

    `work` is (12, lanes): the scales of the normals, and from row 6 on the diagonal.
    """
    # Here and below not `WIDTH`: loops that are unrolled, and every one vectorised, take long to compile.
    width, _, lanes = rows.shape
    last = width - 1
    total = work[last]
    for j in range(last):
        for k in range(lanes):
            total[k] = 0.0
        for c in range(j, width):
            for k in range(lanes):
                total[k] += rows[j, c, k] * rows[j, c, k]
        for k in range(lanes):
            size, lead = np.sqrt(total[k]), rows[j, j, k]
            product = size * (size + abs(lead))
            work[width + j, k] = size if lead < 0.0 else -size
            rows[j, j, k] = lead - work[width + j, k]
            work[j, k] = 1.0 / product if product > 0.0 else 0.0
        for i in range(j + 1, width):
            _reflect(rows[j], rows[i], j, work[j], total)
    for k in range(lanes):
        work[width + last, k] = rows[last, last, k]


@jit
def _reflect(normal: FloatArray, vector: FloatArray, first: int, scale: FloatArray, total: FloatArray) -> None:
    """Reflect vectors (6, lanes) along normals that begin at place `first`; `total` is (lanes,), overwritten."""
    width, lanes = vector.shape
    for k in range(lanes):
        total[k] = 0.0
    for c in range(first, width):
        for k in range(lanes):
            total[k] += normal[c, k] * vector[c, k]
    for k in range(lanes):
        total[k] *= scale[k]
    for c in range(first, width):
        for k in range(lanes):
            vector[c, k] -= total[k] * normal[c, k]


@jit
def triangularize(columns: FloatArray, rows: FloatArray, work: FloatArray) -> None:
    """Write upper triangular matrices with the right singular vectors of others, given by their columns; overwrites."""
    _reflect_rows(columns, work)
    width, _, lanes = rows.shape
    for i in range(width):
        for j in range(width):
            for k in range(lanes):
                rows[i, j, k] = columns[j, i, k] if j > i else 0.0
        for k in range(lanes):
            rows[i, i, k] = work[width + i, k]


@jit
def orthogonalize(rows: FloatArray, work: FloatArray) -> None:
    """Rotate six rows until they are orthogonal; `work` has four rows."""
    width, _, lanes = rows.shape
    for k in range(lanes):
        work[_ACTIVE, k] = 1.0
    for _ in range(_MOST_SWEEPS):
        for k in range(lanes):
            work[_MORE, k] = 0.0
        for i in range(width - 1):
            for j in range(i + 1, width):
                if _find_rotation(rows[i], rows[j], work):
                    _rotate(rows[i], rows[j], work)
        unfinished = False
        for k in range(lanes):
            work[_ACTIVE, k] = work[_MORE, k]
            unfinished = unfinished | (work[_MORE, k] > 0.0)
        if not unfinished:
            break


@jit_inline
def _find_rotation(first: FloatArray, second: FloatArray, work: FloatArray) -> bool:
    """Write the cosines and sines that make two rows orthogonal; return whether any matrix needs them."""
    some, lanes = False, first.shape[1]
    for k in range(lanes):
        a, b, g = 0.0, 0.0, 0.0
        for c in range(WIDTH):
            x, y = first[c, k], second[c, k]
            a, b, g = a + x * x, b + y * y, g + x * y
        need = (g * g > _ORTHOGONAL * (a * b)) & (work[_ACTIVE, k] > 0.0)
        work[_MORE, k] += 1.0 if need & (g * g > _LAST_SWEEP * (a * b)) else 0.0
        d = b - a
        g2 = -2.0 * g if d < 0.0 else 2.0 * g
        adjacent = abs(d) + np.sqrt(d * d + g2 * g2)
        scale = 1.0 / np.sqrt(adjacent * adjacent + g2 * g2)
        work[_COSINE, k], work[_SINE, k] = (adjacent * scale if need else 1.0), (g2 * scale if need else 0.0)
        some = some | need
    return some


@jit_inline
def _rotate(first: FloatArray, second: FloatArray, work: FloatArray) -> None:
    width, lanes = first.shape
    for c in range(width):
        for k in range(lanes):
            x, y = first[c, k], second[c, k]
            first[c, k] = work[_COSINE, k] * x - work[_SINE, k] * y
            second[c, k] = work[_SINE, k] * x + work[_COSINE, k] * y


@jit
def put_norms(rows: FloatArray, norms: FloatArray) -> None:
    """Write the lengths (6, lanes) of the rows, the singular values if these are orthogonal."""
    width, _, lanes = rows.shape
    for i in range(width):
        for k in range(lanes):
            norms[i, k] = 0.0
        for c in range(width):
            for k in range(lanes):
                norms[i, k] += rows[i, c, k] * rows[i, c, k]
        for k in range(lanes):
            norms[i, k] = np.sqrt(norms[i, k])


@jit
def put_smallest_last(rows: FloatArray, norms: FloatArray) -> None:
    """Exchange the shortest of six rows with the last."""
    width, _, lanes = rows.shape
    last = width - 1
    for i in range(last):
        for c in range(width):
            for k in range(lanes):
                x, y, exchange = rows[i, c, k], rows[last, c, k], norms[i, k] < norms[last, k]
                rows[i, c, k], rows[last, c, k] = (y if exchange else x), (x if exchange else y)
        for k in range(lanes):
            x, y, exchange = norms[i, k], norms[last, k], norms[i, k] < norms[last, k]
            norms[i, k], norms[last, k] = (y if exchange else x), (x if exchange else y)


@jit
def null_vector(rows: FloatArray, vector: FloatArray, work: FloatArray) -> None:
    """Write the unit vector (6, lanes) orthogonal to the first five rows, which are overwritten; `work` is (12, lanes).

    The last right singular vector, where the last singular value is zero, too.
    """
    _reflect_rows(rows, work)
    width, _, lanes = rows.shape
    last = width - 1
    for c in range(width):
        for k in range(lanes):
            vector[c, k] = 0.0 if c < last else 1.0
    for i in range(last):
        j = last - 1 - i
        _reflect(rows[j], vector, j, work[j], work[last])


@kernel(f"void({readonly_array(3)}, f8[:,::1])")
def singular_values(matrices: FloatArray, values: FloatArray) -> None:
    """Write the singular values (N, rows), from large to small, of N matrices with at most six columns and rows."""
    _, count, columns = matrices.shape
    lanes = min(LANES, len(matrices))
    rows, transposed = np.ones((WIDTH, WIDTH, lanes)), np.ones((WIDTH, WIDTH, lanes))
    norms, work = np.empty((WIDTH, lanes)), np.empty((2 * WIDTH, lanes))
    for start in range(0, len(matrices), LANES):
        width = min(LANES, len(matrices) - start)
        rows[:, :, :] = 0.0
        for k in range(width):
            for i in range(count):
                for j in range(columns):
                    rows[i, j, k] = transposed[j, i, k] = matrices[start + k, i, j]
        if count == WIDTH:
            triangularize(transposed, rows, work)
        orthogonalize(rows, work)
        put_norms(rows, norms)
        for k in range(width):
            for i in range(count):
                rank = i
                while rank > 0 and values[start + k, rank - 1] < norms[i, k]:
                    values[start + k, rank] = values[start + k, rank - 1]
                    rank -= 1
                values[start + k, rank] = norms[i, k]
