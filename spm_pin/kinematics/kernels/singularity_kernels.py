"""Determinants, singular values and singular vectors of J_b, J_c and K of a batch of states.

A tile of matrices is an array (rows, columns, lanes): a lane is one matrix. Householder's reflections make a square
matrix triangular, which halves the number of rotations, the more so if its long columns come first; then pairs of rows
are rotated until all are orthogonal (Jacobi's method from one side): each row then is a singular value times its right
singular vector. Small singular values are as accurate as rounding of the matrix allows.

What is done to a matrix does not depend on the others in its tile: one that is finished is not rotated any more.
"""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.stages import EPS
from spm_pin.formulas.vectors import Rows, Vector, combined, cross, dot, minus, scaled
from spm_pin.formulas.wrenches import arms, mean
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array, vector
from spm_pin.kinematics.kernels.jacobian_kernels import (
    INPUTS,
    MACHINE,
    STATES,
    LegNumbers,
    load_states,
    read_machine,
    state_forces,
    three_determinants,
)
from spm_pin.support.arguments import FloatArray

LANES = 64
"""Matrices in a tile: more than elsewhere, for the loops are many and short."""
WIDTH = 6
"""Columns of the matrices; narrower ones are filled up with zeros."""
_ORTHOGONAL = 16.0 * EPS * EPS  # square of the cosine of the angle between two rows that need no rotation
_LAST_SWEEP = 1e-18
"""Square of the largest cosine before a sweep that is the last one: it leaves about the square of the cosine."""
_MOST_SWEEPS = 30
_COSINE, _SINE, _ACTIVE, _MORE = range(4)
# Blocks of three rows of a tile: the forces of the lower and of the upper legs, and their revolute axes.
_LOWER, _UPPER, _LOWER_AXES, _UPPER_AXES = range(4)
# The blocks of J_b, J_c and K.
_FIRST, _SECOND = (_LOWER, _UPPER, _LOWER_AXES), (_LOWER_AXES, _UPPER_AXES, _UPPER_AXES)
_SHORT, _LEVER, _OUT_ROWS = 3, 4, 7
"""Rows of `out` after the three determinants: 1 if a leg has no length, and o less the balls' centre."""


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
def _triangularize(columns: FloatArray, rows: FloatArray, work: FloatArray) -> None:
    """Write triangular matrices with the singular values and right singular vectors of `columns`, which get lost."""
    _reflect_rows(columns, work)
    width, _, lanes = rows.shape
    for i in range(width):
        for j in range(width):
            for k in range(lanes):
                rows[i, j, k] = columns[j, i, k] if j > i else 0.0
        for k in range(lanes):
            rows[i, i, k] = work[width + i, k]


@jit
def _orthogonalize(rows: FloatArray, work: FloatArray) -> None:
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
def _put_norms(rows: FloatArray, norms: FloatArray) -> None:
    """Write the lengths (6, lanes) of the rows, the singular values if these are orthogonal."""
    count, width, lanes = rows.shape
    for i in range(count):
        for k in range(lanes):
            norms[i, k] = 0.0
        for c in range(width):
            for k in range(lanes):
                norms[i, k] += rows[i, c, k] * rows[i, c, k]
        for k in range(lanes):
            norms[i, k] = np.sqrt(norms[i, k])


@jit
def _put_smallest_last(rows: FloatArray, norms: FloatArray) -> None:
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
def _null_vector(rows: FloatArray, vector: FloatArray, work: FloatArray) -> None:
    """Write the unit vector (6, lanes) orthogonal to the first five rows, which are overwritten; `work` is (12, lanes).

    It is the last right singular vector, even where the last singular value is zero.
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


@jit_inline
def _put_block(blocks: FloatArray, block: int, k: int, forces: Rows, about: Rows) -> None:
    for i in range(3):
        moment = cross(about[i], forces[i])
        for c in range(3):
            # The moments about Z before the others, so that columns of large numbers come first.
            blocks[block, i, c, k], blocks[block, i, 3 + (c + 1) % 3, k] = forces[i][c], moment[c]


@jit
def _set_up(tile: FloatArray, k: int, legs: LegNumbers, side: float, blocks: FloatArray, out: FloatArray) -> None:
    """Write the forces of one state into its blocks, and what follows from them alone into `out`.

    Not part of the loop over the states, which would take seconds to compile.
    """
    s = state_forces(tile, k, legs)
    p = mean(s.b)
    lower, upper, lever = arms(s.b, p, side), arms(s.c, p, side), minus(s.o, p)
    _put_block(blocks, _LOWER, k, s.lower, lower)
    _put_block(blocks, _UPPER, k, s.upper, upper)
    _put_block(blocks, _LOWER_AXES, k, s.a, lower)
    _put_block(blocks, _UPPER_AXES, k, s.a_m, upper)
    out[_SHORT, k] = 1.0 if s.is_short else 0.0
    determinants = three_determinants(s, legs.is_paired)
    for i in range(3):
        out[i, k], out[_LEVER + i, k] = determinants[i], lever[i]


@jit
def _put_columns(first: FloatArray, second: FloatArray, columns: FloatArray) -> None:
    """Write the columns (6, 6, lanes) of matrices of two blocks of rows."""
    count, width, lanes = first.shape
    for i in range(count):
        for c in range(width):
            for k in range(lanes):
                columns[c, i, k], columns[c, count + i, k] = first[i, c, k], second[i, c, k]


@jit
def _store_twist(right: FloatArray, out: FloatArray, k: int, side: float, twist: FloatArray) -> None:
    """Write the twist (6,) of a right singular vector."""
    angular = scaled(1.0 / side, (right[4, k], right[5, k], right[3, k]))
    linear = combined(vector(right, 0, k), 1.0, cross(angular, vector(out, _LEVER, k)))
    for c in range(3):
        twist[c], twist[3 + c] = linear[c], angular[c]


@jit
def _store_wrench(
    rows: FloatArray, weights: FloatArray, lever: Vector, k: int, side: float, couple_only: float, wrench: FloatArray
) -> None:
    """Write the sum of three rows so weighted, as a wrench (6,)."""
    for c in range(WIDTH):
        wrench[c] = weights[0, k] * rows[0, c, k] + weights[1, k] * rows[1, c, k] + weights[2, k] * rows[2, c, k]
    force, moment = (wrench[0], wrench[1], wrench[2]), scaled(side, (wrench[4], wrench[5], wrench[3]))
    moment = combined(moment, -1.0, cross(lever, force))
    size, couple = np.sqrt(dot(force, force)), np.sqrt(dot(moment, moment))
    scale = 1.0 / (size if size > couple_only * couple / side else couple)
    for c in range(3):
        wrench[c], wrench[3 + c] = scale * force[c], scale * moment[c]


@jit
def _multiply(matrix: FloatArray, vector: FloatArray, image: FloatArray) -> None:
    """Write the products (3, lanes) of matrices (3, 6, lanes) with vectors (6, lanes)."""
    count, width, lanes = matrix.shape
    for i in range(count):
        for k in range(lanes):
            image[i, k] = 0.0
        for c in range(width):
            for k in range(lanes):
                image[i, k] += matrix[i, c, k] * vector[c, k]


@kernel(
    f"void({STATES}, {MACHINE}, f8, f8, f8, f8[:,::1], f8[:,::1], f8[:,::1], i1[:,::1], b1[::1], f8[:,:,::1], "
    "f8[:,::1])"
)
def describe_singularities(
    joints,
    rotation,
    position,
    centres,
    machine,
    side,
    tolerance,
    couple_only,
    determinants,
    largest,
    smallest,
    rank,
    is_short,
    twists,
    wrench,
):
    """Describe J_b, J_c and K of S states: b_i (outer, inner, 3, 3), R (outer, inner, 3, 3), o (outer, inner, 3) [m].

    `centres` (outer, inner, 6, 3) are those of the balls' circles [m], in {B} of lower legs and in {m} of upper ones.

    Written are, for each of the three matrices, the determinants [m³], the largest and the smallest singular values and
    the number of those that are larger than `tolerance` times the largest, (S, 3); whether a leg has no length (S,); as
    `twists` (S, 3, 6) the (v, ω) at o whose (v, dω) at the middle platform's centre are the right singular vectors of
    the smallest singular values; and as `wrench` (S, 6) the sum of the upper constraints at o, weighted by the left
    singular vector of K, of |f| = 1, or of |m| = 1 where the force is at most `couple_only` times the moment over d.
    """
    lanes = min(LANES, len(determinants))
    tile, blocks, legs = np.ones((INPUTS, lanes)), np.empty((4, 3, WIDTH, lanes)), read_machine(machine)
    rows, images = np.ones((WIDTH, WIDTH, lanes)), np.zeros((WIDTH, WIDTH, lanes))
    norms, work, out = np.empty((WIDTH, lanes)), np.empty((2 * WIDTH, lanes)), np.empty((_OUT_ROWS, lanes))
    right, left = np.empty((WIDTH, lanes)), np.empty((WIDTH, lanes))
    for start in range(0, len(determinants), LANES):
        width = min(LANES, len(determinants) - start)
        load_states(joints, rotation, position, centres, start, width, tile)
        for k in range(lanes):
            _set_up(tile, k, legs, side, blocks, out)
        for which in range(3):
            first, second = blocks[_FIRST[which]], blocks[_SECOND[which]]
            _put_columns(first, second, images)
            _triangularize(images, rows, work)
            _orthogonalize(rows, work)
            _put_norms(rows, norms)
            _put_smallest_last(rows, norms)
            if which == 2:
                # Right singular vectors become left ones, times the squares of their values.
                for i in range(WIDTH - 1):
                    _multiply(first, rows[i], images[i, :3])
                    _multiply(second, rows[i], images[i, 3:])
                _null_vector(images, left, work)
            _null_vector(rows, right, work)
            for k in range(width):
                most = norms[0, k]
                for i in range(1, WIDTH):
                    most = norms[i, k] if norms[i, k] > most else most
                rank[start + k, which] = 0
                for i in range(WIDTH):
                    rank[start + k, which] += 1 if norms[i, k] > tolerance * most else 0
                determinants[start + k, which] = out[which, k]
                largest[start + k, which], smallest[start + k, which] = most, norms[WIDTH - 1, k]
                _store_twist(right, out, k, side, twists[start + k, which])
        for k in range(width):
            is_short[start + k] = out[_SHORT, k] > 0.0
            lever = vector(out, _LEVER, k)
            _store_wrench(blocks[_UPPER_AXES], left[3:], lever, k, side, couple_only, wrench[start + k])


@kernel(f"void({readonly_array(3)}, f8[:,::1])")
def singular_values(matrices, values):
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
            _triangularize(transposed, rows, work)
        _orthogonalize(rows, work)
        _put_norms(rows, norms)
        for k in range(width):
            for i in range(count):
                rank = i
                while rank > 0 and values[start + k, rank - 1] < norms[i, k]:
                    values[start + k, rank] = values[start + k, rank - 1]
                    rank -= 1
                values[start + k, rank] = norms[i, k]
