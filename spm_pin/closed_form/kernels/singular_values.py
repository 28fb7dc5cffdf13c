"""Singular values and vectors of a tile of small matrices, by plane rotations of their rows.

A tile of matrices is an array (rows, columns, TILE). Householder's reflections make a square matrix triangular, which
halves the number of rotations; then pairs of rows are rotated until all are orthogonal (Jacobi's method from one side):
each row then is a singular value times its right singular vector. Small singular values are as accurate as rounding of
the matrix allows. Further columns beside the first six are carried along by all operations on rows.

What is done to a matrix does not depend on the others in its tile: one that is finished is not rotated any more.
"""

from __future__ import annotations

import numpy as np

from spm_pin.closed_form.kernels.compilation import TILE, jit, jit_inline, kernel, readonly_array
from spm_pin.closed_form.kernels.stage_equations import EPS
from spm_pin.mechanism.arguments import FloatArray

__all__ = [
    "WIDTH",
    "null_vector",
    "orthogonalize",
    "put_norms",
    "put_smallest_last",
    "singular_values",
    "triangularize",
]

WIDTH = 6
"""Columns of the matrices; narrower ones are filled up with zeros."""
_ORTHOGONAL = 16.0 * EPS * EPS
"""Square of the cosine of the angle between two rows that need no rotation."""
_LAST_SWEEP = 1e-18
"""Square of the largest cosine met in a sweep that leaves only rounding: a sweep leaves about the square of it."""
_MOST_SWEEPS = 30
_COSINE, _SINE, _ACTIVE, _MORE = range(4)


@jit
def triangularize(rows: FloatArray, work: FloatArray) -> None:
    """Make matrices (6, 6, TILE), or wider ones, upper triangular by reflections; `work` is (2, TILE)."""
    _clear_column(rows, 0, work)
    _clear_column(rows, 1, work)
    _clear_column(rows, 2, work)
    _clear_column(rows, 3, work)
    _clear_column(rows, 4, work)


@jit_inline
def _clear_column(rows: FloatArray, j: int, work: FloatArray) -> None:
    """Reflect the rows from j on, so that column j is zero below."""
    for k in range(TILE):
        square = 0.0
        for i in range(j, WIDTH):
            square += rows[i, j, k] * rows[i, j, k]
        size, lead = np.sqrt(square), rows[j, j, k]
        product = size * (size + abs(lead))
        work[0, k], work[1, k] = (1.0 / product if product > 0.0 else 0.0), (size if lead < 0.0 else -size)
        rows[j, j, k] = lead - work[1, k]
    for c in range(j + 1, rows.shape[1]):
        for k in range(TILE):
            total = 0.0
            for i in range(j, WIDTH):
                total += rows[i, j, k] * rows[i, c, k]
            total *= work[0, k]
            for i in range(j, WIDTH):
                rows[i, c, k] -= total * rows[i, j, k]
    for k in range(TILE):
        rows[j, j, k] = work[1, k]
        for i in range(j + 1, WIDTH):
            rows[i, j, k] = 0.0


@jit
def orthogonalize(rows: FloatArray, first: int, last: int, work: FloatArray) -> None:
    """Rotate the rows from `first` to before `last` until they are orthogonal; `work` is (4, TILE)."""
    for k in range(TILE):
        work[_ACTIVE, k] = 1.0
    for _ in range(_MOST_SWEEPS):
        for k in range(TILE):
            work[_MORE, k] = 0.0
        for i in range(first, last - 1):
            for j in range(i + 1, last):
                _rotate(rows, i, j, work)
        unfinished = False
        for k in range(TILE):
            work[_ACTIVE, k] = work[_MORE, k]
            unfinished = unfinished | (work[_MORE, k] > 0.0)
        if not unfinished:
            break


@jit_inline
def _rotate(rows: FloatArray, i: int, j: int, work: FloatArray) -> None:
    """Make two rows orthogonal."""
    some = False
    for k in range(TILE):
        a, b, g = 0.0, 0.0, 0.0
        for c in range(WIDTH):
            x, y = rows[i, c, k], rows[j, c, k]
            a, b, g = a + x * x, b + y * y, g + x * y
        need = (g * g > _ORTHOGONAL * (a * b)) & (work[_ACTIVE, k] > 0.0)
        work[_MORE, k] += 1.0 if need & (g * g > _LAST_SWEEP * (a * b)) else 0.0
        d = b - a
        g2 = -2.0 * g if d < 0.0 else 2.0 * g
        adjacent = abs(d) + np.sqrt(d * d + g2 * g2)
        scale = 1.0 / np.sqrt(adjacent * adjacent + g2 * g2)
        work[_COSINE, k], work[_SINE, k] = (adjacent * scale if need else 1.0), (g2 * scale if need else 0.0)
        some = some | need
    if some:
        for c in range(rows.shape[1]):
            for k in range(TILE):
                x, y = rows[i, c, k], rows[j, c, k]
                rows[i, c, k] = work[_COSINE, k] * x - work[_SINE, k] * y
                rows[j, c, k] = work[_SINE, k] * x + work[_COSINE, k] * y


@jit_inline
def put_norms(rows: FloatArray, count: int, norms: FloatArray) -> None:
    """Write the lengths (count, TILE) of the rows, the singular values if these are orthogonal."""
    for i in range(count):
        for k in range(TILE):
            square = 0.0
            for c in range(WIDTH):
                square += rows[i, c, k] * rows[i, c, k]
            norms[i, k] = np.sqrt(square)


@jit
def put_smallest_last(rows: FloatArray, norms: FloatArray) -> None:
    """Exchange the shortest row with the last of all."""
    last = rows.shape[0] - 1
    for i in range(last):
        for c in range(rows.shape[1]):
            for k in range(TILE):
                x, y, exchange = rows[i, c, k], rows[last, c, k], norms[i, k] < norms[last, k]
                rows[i, c, k], rows[last, c, k] = (y if exchange else x), (x if exchange else y)
        for k in range(TILE):
            x, y, exchange = norms[i, k], norms[last, k], norms[i, k] < norms[last, k]
            norms[i, k], norms[last, k] = (y if exchange else x), (x if exchange else y)


@jit
def null_vector(rows: FloatArray, vector: FloatArray, work: FloatArray) -> None:
    """Write the unit vector (6, TILE) orthogonal to the first five rows, which are overwritten; `work` is (5, TILE).

    The last right singular vector, where the last singular value is zero, too.
    """
    _make_normal(rows, 0, work)
    _make_normal(rows, 1, work)
    _make_normal(rows, 2, work)
    _make_normal(rows, 3, work)
    _make_normal(rows, 4, work)
    for k in range(TILE):
        for c in range(WIDTH - 1):
            vector[c, k] = 0.0
        vector[WIDTH - 1, k] = 1.0
    _reflect(rows[4], vector, 4, work[4])
    _reflect(rows[3], vector, 3, work[3])
    _reflect(rows[2], vector, 2, work[2])
    _reflect(rows[1], vector, 1, work[1])
    _reflect(rows[0], vector, 0, work[0])


@jit_inline
def _make_normal(rows: FloatArray, j: int, work: FloatArray) -> None:
    """Turn row j into the normal of the reflection that takes it to an axis, and reflect the rows after it."""
    for k in range(TILE):
        square = 0.0
        for c in range(j, WIDTH):
            square += rows[j, c, k] * rows[j, c, k]
        size, lead = np.sqrt(square), rows[j, j, k]
        product = size * (size + abs(lead))
        rows[j, j, k] = lead - size if lead < 0.0 else lead + size
        work[j, k] = 1.0 / product if product > 0.0 else 0.0
    for i in range(j + 1, WIDTH - 1):
        _reflect(rows[j], rows[i], j, work[j])


@jit_inline
def _reflect(normal: FloatArray, vector: FloatArray, first: int, scale: FloatArray) -> None:
    """Reflect vectors (6, TILE) along normals that begin at place `first`."""
    for k in range(TILE):
        total = 0.0
        for c in range(first, WIDTH):
            total += normal[c, k] * vector[c, k]
        total *= scale[k]
        for c in range(first, WIDTH):
            vector[c, k] -= total * normal[c, k]


@kernel(f"void({readonly_array(3)}, f8[:,::1])")
def singular_values(matrices: FloatArray, values: FloatArray) -> None:
    """Write the singular values (N, rows), from large to small, of N matrices with at most six columns and rows."""
    _, count, columns = matrices.shape
    rows, norms, work = np.ones((WIDTH, WIDTH, TILE)), np.empty((WIDTH, TILE)), np.empty((4, TILE))
    for start in range(0, len(matrices), TILE):
        width = min(TILE, len(matrices) - start)
        rows[:, :, :] = 0.0
        for k in range(width):
            for i in range(count):
                for j in range(columns):
                    rows[i, j, k] = matrices[start + k, i, j]
        if count == WIDTH:
            triangularize(rows, work)
        orthogonalize(rows, 0, count, work)
        put_norms(rows, count, norms)
        for k in range(width):
            for i in range(count):
                at = i
                while at > 0 and values[start + k, at - 1] < norms[i, k]:
                    values[start + k, at] = values[start + k, at - 1]
                    at -= 1
                values[start + k, at] = norms[i, k]
