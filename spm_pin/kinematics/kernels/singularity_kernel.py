"""Determinants, singular values and singular vectors of J_b, J_c and K of a batch of states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.formulas.vectors import Rows, Vector, combined, cross, dot, minus, scaled
from spm_pin.formulas.wrenches import arms, mean
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel
from spm_pin.kinematics.kernels.jacobian_kernels import (
    INPUTS,
    MACHINE,
    STATES,
    Machine,
    load_states,
    put_determinants,
    read_machine,
    state_forces,
)
from spm_pin.kinematics.kernels.singular_values import (
    LANES,
    WIDTH,
    null_vector,
    orthogonalize,
    put_norms,
    put_smallest_last,
    triangularize,
)
from spm_pin.mechanism.arguments import FloatArray

# Blocks of three rows of a tile: the forces of the lower and of the upper legs, and their revolute axes.
_LOWER, _UPPER, _LOWER_AXES, _UPPER_AXES = range(4)
_LEVER = 6
# The blocks of J_b, J_c and K.
_FIRST, _SECOND = (_LOWER, _UPPER, _LOWER_AXES), (_LOWER_AXES, _UPPER_AXES, _UPPER_AXES)


@jit_inline
def _put_row(blocks: FloatArray, block: int, i: int, k: int, force: Vector, arm: Vector) -> None:
    # The moments about Z before the others: the columns of large numbers come first.
    moment = cross(arm, force)
    for c in range(3):
        blocks[block, i, c, k], blocks[block, i, 3 + (c + 1) % 3, k] = force[c], moment[c]


@jit_inline
def _put_six(row: FloatArray, first: Vector, second: Vector) -> None:
    for c in range(3):
        row[c], row[3 + c] = first[c], second[c]


@jit_inline
def _put_block(blocks: FloatArray, block: int, k: int, forces: Rows, about: Rows) -> None:
    for i in range(3):
        _put_row(blocks, block, i, k, forces[i], about[i])


@jit
def _set_up(
    tile: FloatArray, k: int, legs: Machine, side: float, tolerance: float, blocks: FloatArray, out: FloatArray
) -> None:
    """Write the forces of one state into its blocks, and what follows from them alone into `out`.

    That is the determinants, 1 if a leg is short, and for both stages 1 if the constraints may be dependent; then o
    less the lower balls' centre. Not part of the loop over the states, which would take seconds to compile.
    """
    s = state_forces(tile, k, legs)
    p = mean(s.b)
    lower, upper, lever = arms(s.b, p, side), arms(s.c, p, side), minus(s.o, p)
    put_determinants(s, legs.is_paired, out, 0, k)
    out[3, k] = 1.0 if s.is_short else 0.0
    _put_block(blocks, _LOWER, k, s.lower, lower)
    _put_block(blocks, _UPPER, k, s.upper, upper)
    _put_block(blocks, _LOWER_AXES, k, s.a, lower)
    _put_block(blocks, _UPPER_AXES, k, s.a_m, upper)
    for stage in range(2):
        out[4 + stage, k] = 0.0 if _are_independent(blocks[_LOWER_AXES + stage], k, tolerance) else 1.0
    out[_LEVER, k], out[_LEVER + 1, k], out[_LEVER + 2, k] = lever


@jit_inline
def _lever(out: FloatArray, k: int) -> Vector:
    return out[_LEVER, k], out[_LEVER + 1, k], out[_LEVER + 2, k]


@jit_inline
def _are_independent(block: FloatArray, k: int, tolerance: float) -> bool:
    """Return whether three rows are certainly independent: in most cases the determinant of their products decides.

    σ_1² σ_2² is at most a quarter of the trace squared.
    """
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(WIDTH):
        x, y, z = block[0, j, k], block[1, j, k], block[2, j, k]
        a, b, c, d, e, f = a + x * x, b + y * y, c + z * z, d + x * y, e + x * z, f + y * z
    trace = a + b + c
    determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    bound = max(1e-10, 0.5 * tolerance * tolerance)
    return bool(determinant > bound * trace * trace * trace)


@jit
def _copy(block: FloatArray, rows: FloatArray, factor: float) -> None:
    # Number by number, for an assignment brings all of NumPy's broadcasting along, which takes long to compile.
    count, width, lanes = block.shape
    for i in range(count):
        for c in range(width):
            for k in range(lanes):
                rows[i, c, k] = factor * block[i, c, k]


@jit
def _put_columns(first: FloatArray, second: FloatArray, columns: FloatArray) -> None:
    """Write the columns (6, 6, lanes) of matrices of two blocks of rows."""
    count, width, lanes = first.shape
    for i in range(count):
        for c in range(width):
            for k in range(lanes):
                columns[c, i, k], columns[c, count + i, k] = first[i, c, k], second[i, c, k]


@jit
def _find_dependent(block: FloatArray, tolerance: float, rows: FloatArray, norms: FloatArray, work: FloatArray) -> None:
    """Write 1 into `work[4]` where three rows (3, 6, lanes) are dependent at a relative tolerance, else 0."""
    count, _, lanes = block.shape
    _copy(block, rows[:3], 1.0)
    _copy(block, rows[3:], 0.0)
    orthogonalize(rows, work)
    put_norms(rows, norms)
    for k in range(lanes):
        least, largest = norms[0, k], norms[0, k]
        for i in range(1, count):
            least, largest = min(least, norms[i, k]), max(largest, norms[i, k])
        # Not a number is not dependent.
        work[4, k] = 1.0 if least <= tolerance * largest else 0.0


@jit
def _count(norms: FloatArray, k: int, tolerance: float) -> tuple[float, int]:
    """Return the largest singular value of a matrix, and how many count."""
    most, count = norms[0, k], 0
    for i in range(1, len(norms)):
        most = norms[i, k] if norms[i, k] > most else most
    for i in range(len(norms)):
        count += 1 if norms[i, k] > tolerance * most else 0
    return most, count


@jit
def _store_twist(vector: FloatArray, out: FloatArray, k: int, side: float, twist: FloatArray) -> None:
    """Write the twist (6,) of a right singular vector."""
    angular = scaled(1.0 / side, (vector[4, k], vector[5, k], vector[3, k]))
    linear = combined((vector[0, k], vector[1, k], vector[2, k]), 1.0, cross(angular, _lever(out, k)))
    _put_six(twist, linear, angular)


@jit
def _store_wrench(
    rows: FloatArray,
    weights: FloatArray,
    out: FloatArray,
    k: int,
    side: float,
    couple_only: float,
    wrench: FloatArray,
) -> None:
    """Write the sum of three rows so weighted, as a wrench (6,)."""
    for c in range(WIDTH):
        wrench[c] = weights[0, k] * rows[0, c, k] + weights[1, k] * rows[1, c, k] + weights[2, k] * rows[2, c, k]
    force, moment = (wrench[0], wrench[1], wrench[2]), scaled(side, (wrench[4], wrench[5], wrench[3]))
    moment = combined(moment, -1.0, cross(_lever(out, k), force))
    size, couple = np.sqrt(dot(force, force)), np.sqrt(dot(moment, moment))
    scale = 1.0 / (size if size > couple_only * couple / side else couple)
    _put_six(wrench, scaled(scale, force), scaled(scale, moment))


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
    f"void({STATES}, {MACHINE}, f8, f8, f8, f8[:,::1], f8[:,::1], f8[:,::1], i1[:,::1], b1[:,::1], f8[:,:,::1], "
    "f8[:,::1])"
)
def describe_singularities(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    machine: FloatArray,
    side: float,
    tolerance: float,
    couple_only: float,
    determinants: FloatArray,
    largest: FloatArray,
    smallest: FloatArray,
    rank: npt.NDArray[np.int8],
    flags: npt.NDArray[np.bool_],
    twists: FloatArray,
    wrench: FloatArray,
) -> None:
    """Describe J_b, J_c and K of S states: b_i (outer, inner, 3, 3), R (outer, inner, 3, 3), o (outer, inner, 3) [m].

    Written are, for each of the three matrices, the determinants [m³], the largest and the smallest singular values and
    the number of those that are larger than `tolerance` times the largest, (S, 3); as `flags` (S, 2) whether the
    constraints of a stage are dependent and whether a leg has no length; as `twists` (S, 3, 6) the (v, ω) at o whose
    (v, dω) at the middle platform's centre are the right singular vectors of the smallest singular values; and as
    `wrench` (S, 6) the sum of the upper constraints at o, weighted by the left singular vector of K, of |f| = 1, or of
    |m| = 1 where the force is at most `couple_only` times the moment over d.
    """
    lanes = min(LANES, len(determinants))
    tile, blocks, legs = np.ones((INPUTS, lanes)), np.empty((4, 3, WIDTH, lanes)), read_machine(machine)
    rows, images = np.ones((WIDTH, WIDTH, lanes)), np.zeros((WIDTH, WIDTH, lanes))
    norms, work, out = np.empty((WIDTH, lanes)), np.empty((2 * WIDTH, lanes)), np.empty((9, lanes))
    right, left = np.empty((WIDTH, lanes)), np.empty((WIDTH, lanes))
    for start in range(0, len(determinants), LANES):
        width = min(LANES, len(determinants) - start)
        load_states(joints, rotation, position, start, width, tile)
        doubtful = False
        for k in range(lanes):
            _set_up(tile, k, legs, side, tolerance, blocks, out)
            doubtful = doubtful | (out[4, k] + out[5, k] > 0.0)
        for k in range(width):
            flags[start + k, 0], flags[start + k, 1] = False, out[3, k] > 0.0
            for i in range(3):
                determinants[start + k, i] = out[i, k]
        if doubtful:
            for stage in range(2):
                _find_dependent(blocks[_LOWER_AXES + stage], tolerance, rows, norms, work)
                for k in range(width):
                    flags[start + k, 0] |= (work[4, k] > 0.0) & (out[4 + stage, k] > 0.0)
        for which in range(3):
            first, second = blocks[_FIRST[which]], blocks[_SECOND[which]]
            _put_columns(first, second, images)
            triangularize(images, rows, work)
            orthogonalize(rows, work)
            put_norms(rows, norms)
            put_smallest_last(rows, norms)
            if which == 2:
                # Right singular vectors become left ones, times the squares of their values.
                for i in range(WIDTH - 1):
                    _multiply(first, rows[i], images[i, :3])
                    _multiply(second, rows[i], images[i, 3:])
                null_vector(images, left, work)
            null_vector(rows, right, work)
            for k in range(width):
                largest[start + k, which], rank[start + k, which] = _count(norms, k, tolerance)
                smallest[start + k, which] = norms[WIDTH - 1, k]
                _store_twist(right, out, k, side, twists[start + k, which])
        for k in range(width):
            _store_wrench(blocks[_UPPER_AXES], left[3:], out, k, side, couple_only, wrench[start + k])
