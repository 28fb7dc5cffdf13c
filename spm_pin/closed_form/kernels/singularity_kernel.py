"""Determinants, singular values and singular vectors of J_b, J_c and K of a batch of states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import TILE, jit, jit_inline, kernel, readonly_array
from spm_pin.closed_form.kernels.singular_values import (
    WIDTH,
    null_vector,
    orthogonalize,
    put_norms,
    put_smallest_last,
    triangularize,
)
from spm_pin.closed_form.kernels.vectors import Vector, combined, cross, dot, minus, scaled
from spm_pin.closed_form.kernels.wrench_vectors import (
    BASE_AXES,
    Three,
    is_short,
    joints_of,
    load,
    lower_legs,
    mean,
    normals,
    plane_determinant,
    platform_axes,
    position_of,
    upper_legs,
)
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["describe_singularities"]

ByteArray = npt.NDArray[np.uint8]
_STATES = f"{readonly_array(4)}, {readonly_array(4)}, {readonly_array(3)}"
# Blocks of three rows of a tile: the forces of the lower and of the upper legs, and their revolute axes.
_LOWER, _UPPER, _LOWER_AXES, _UPPER_AXES = range(4)
# The blocks of J_b, J_c and K.
_FIRST, _SECOND = (_LOWER, _UPPER, _LOWER_AXES), (_LOWER_AXES, _UPPER_AXES, _UPPER_AXES)


@jit_inline
def _put_row(blocks: FloatArray, block: int, i: int, k: int, force: Vector, arm: Vector) -> None:
    moment = cross(arm, force)
    for c in range(3):
        blocks[block, i, c, k], blocks[block, i, 3 + c, k] = force[c], moment[c]


@jit_inline
def _put_six(row: FloatArray, first: Vector, second: Vector) -> None:
    for c in range(3):
        row[c], row[3 + c] = first[c], second[c]


@jit_inline
def _put_block(blocks: FloatArray, block: int, k: int, forces: Three, arms: Three) -> None:
    for i in range(3):
        _put_row(blocks, block, i, k, forces[i], arms[i])


@jit
def _dependent(block: FloatArray, tolerance: float, rows: FloatArray, norms: FloatArray, work: FloatArray) -> None:
    """Write 1 into `work[4]` where three rows (3, 6, TILE) are dependent at a relative tolerance, else 0.

    The determinant of their products decides in most cases: σ_1² σ_2² is at most a quarter of the trace squared.
    """
    doubt = False
    for k in range(TILE):
        a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(WIDTH):
            x, y, z = block[0, j, k], block[1, j, k], block[2, j, k]
            a, b, c, d, e, f = a + x * x, b + y * y, c + z * z, d + x * y, e + x * z, f + y * z
        trace = a + b + c
        determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
        certain = (determinant > 1e-10 * trace * trace * trace) & (
            4.0 * determinant > 2.0 * tolerance * tolerance * trace * trace * trace
        )
        work[4, k] = 0.0
        doubt = doubt | (not certain)
    if doubt:
        for i in range(3):
            for j in range(WIDTH):
                for k in range(TILE):
                    rows[i, j, k], rows[3 + i, j, k] = block[i, j, k], 0.0
        orthogonalize(rows, rows[:0], work)
        put_norms(rows, norms)
        for k in range(TILE):
            least, largest = norms[0, k], norms[0, k]
            for i in range(1, 3):
                least = norms[i, k] if norms[i, k] < least else least
                largest = norms[i, k] if norms[i, k] > largest else largest
            work[4, k] = 1.0 if least <= tolerance * largest else 0.0


@kernel(
    f"void({_STATES}, f8, f8, f8, f8, f8, f8[:,::1], f8[:,::1], f8[:,::1], i1[:,::1], b1[:,::1], f8[:,:,::1], "
    "f8[:,::1])"
)
def describe_singularities(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    base_radius: float,
    platform_radius: float,
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
    """Describe J_b, J_c and K of S states.

    Parameters
    ----------
    joints, rotation, position : ndarray, shapes (outer, inner, 3, 3), (outer, inner, 3, 3), (outer, inner, 3)
        b_i, R, o [m].
    base_radius, platform_radius, side : float
        E, C, d [m].
    tolerance : float
        A singular value counts that is larger than this times the largest.
    couple_only : float
        A wrench is a couple where its force is at most this times its moment over d.
    determinants, largest, smallest, rank : ndarray, shape (S, 3), written
        Determinants [m³], largest and smallest singular values, and the number of those that count.
    flags : ndarray, shape (S, 2), written
        Whether the constraints of a stage are dependent, and whether a leg has no length.
    twists : ndarray, shape (S, 3, 6), written
        Twists (v, ω) at o whose (v, dω) at the middle platform's centre are the right singular vectors of the smallest
        singular values.
    wrench : ndarray, shape (S, 6), written
        Sum of the upper constraints at o, weighted by the left singular vector of K, of |f| = 1, or |m| = 1.
    """
    tile, blocks = np.ones((21, TILE)), np.empty((4, 3, WIDTH, TILE))
    # Beside K, the share of the upper stage in what its rows carry.
    rows, beside = np.ones((WIDTH, WIDTH, TILE)), np.ones((WIDTH, WIDTH, TILE))
    norms, vector, work = np.empty((WIDTH, TILE)), np.empty((WIDTH, TILE)), np.empty((WIDTH, TILE))
    out = np.empty((3, TILE))
    for start in range(0, len(determinants), TILE):
        width = min(TILE, len(determinants) - start)
        load(joints, rotation, position, start, width, tile)
        for k in range(TILE):
            b, axes = joints_of(tile, k), platform_axes(tile, k)
            lower, upper = lower_legs(b, base_radius), upper_legs(b, tile, k, platform_radius)
            p, unit = mean(b), 1.0 / side
            arms = scaled(unit, minus(b[0], p)), scaled(unit, minus(b[1], p)), scaled(unit, minus(b[2], p))
            out[0, k] = -plane_determinant(b, normals(lower, BASE_AXES))
            out[1, k] = -plane_determinant(b, normals(upper, axes))
            out[2, k] = -plane_determinant(b, normals(BASE_AXES, axes))
            work[0, k] = 1.0 if is_short(b, lower) | is_short(b, upper) else 0.0
            _put_block(blocks, _LOWER, k, lower, arms)
            _put_block(blocks, _UPPER, k, upper, arms)
            _put_block(blocks, _LOWER_AXES, k, BASE_AXES, arms)
            _put_block(blocks, _UPPER_AXES, k, axes, arms)
        for k in range(width):
            flags[start + k, 1] = work[0, k] > 0.0
            for i in range(3):
                determinants[start + k, i] = out[i, k]
        for stage in range(2):
            _dependent(blocks[_LOWER_AXES + stage], tolerance, rows, norms, work)
            for k in range(width):
                flags[start + k, 0] = (work[4, k] > 0.0) | ((stage == 1) & flags[start + k, 0])
        for which in range(3):
            for i in range(3):
                for c in range(WIDTH):
                    for k in range(TILE):
                        rows[i, c, k] = blocks[_FIRST[which], i, c, k]
                        rows[3 + i, c, k] = blocks[_SECOND[which], i, c, k]
                        beside[i, c, k], beside[3 + i, c, k] = 0.0, blocks[_UPPER_AXES, i, c, k]
            others = beside[: WIDTH if which == 2 else 0]
            triangularize(rows, others, work)
            orthogonalize(rows, others, work)
            put_norms(rows, norms)
            put_smallest_last(rows, beside, norms)
            null_vector(rows, vector, work)
            for k in range(width):
                most = norms[0, k]
                for i in range(1, WIDTH):
                    most = norms[i, k] if norms[i, k] > most else most
                count = 0
                for i in range(WIDTH):
                    count += 1 if norms[i, k] > tolerance * most else 0
                rank[start + k, which] = count
                largest[start + k, which], smallest[start + k, which] = most, norms[WIDTH - 1, k]
                lever = minus(position_of(tile, k), mean(joints_of(tile, k)))
                angular = scaled(1.0 / side, (vector[3, k], vector[4, k], vector[5, k]))
                linear = combined((vector[0, k], vector[1, k], vector[2, k]), 1.0, cross(angular, lever))
                _put_six(twists[start + k, which], linear, angular)
        for k in range(width):
            lever = minus(position_of(tile, k), mean(joints_of(tile, k)))
            last = beside[WIDTH - 1]
            force = last[0, k], last[1, k], last[2, k]
            moment = scaled(side, (last[3, k], last[4, k], last[5, k]))
            moment = combined(moment, -1.0, cross(lever, force))
            size, couple = np.sqrt(dot(force, force)), np.sqrt(dot(moment, moment))
            scale = 1.0 / (size if size > couple_only * couple / side else couple)
            _put_six(wrench[start + k], scaled(scale, force), scaled(scale, moment))
