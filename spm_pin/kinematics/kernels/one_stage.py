"""The inverse of a stage, pose and readings from the normal and the height, and working modes of its legs."""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.circles import is_home_state
from spm_pin.formulas.planar_legs import (
    PRS_LEGS,
    RPS_LEGS,
    from_middle,
    prs_circle,
    prs_reading,
    prs_slope,
    rrs_crank,
    rrs_slope,
)
from spm_pin.formulas.stage_poses import platform_balls, pose_in_mode, shortest_turn, stage_constants, torsion_equation
from spm_pin.formulas.vectors import combinations, differences, direction, dots, multiples
from spm_pin.kinematics.kernels.compilation import (
    TILE,
    jit,
    kernel,
    matrix,
    readonly_array,
    rows_at,
    vector,
    vector_at,
)
from spm_pin.support.arguments import FloatArray

_NORMAL, _HEIGHT, _ROTATION, _POSITION, _X, _Z = 0, 3, 4, 13, 16, 19
_READING, _COSINE, _ROD_X, _ROD_Z, _HOME, _ROWS = 22, 25, 28, 31, 34, 35
"""Rows of a tile: what is given, the pose, balls in their legs' planes, readings, rods, and whether it is physical."""


@jit
def _put_readings(tile: FloatArray, kind: int, numbers: FloatArray, middles: FloatArray) -> None:
    """Write the readings of the legs (for RRS legs sines and cosines from the middles), and x and z of their rods."""
    for leg in range(3):
        x, z, reading, cosine = _X + leg, _Z + leg, _READING + leg, _COSINE + leg
        along, up = _ROD_X + leg, _ROD_Z + leg
        if kind == RPS_LEGS:
            for k in range(TILE):
                tile[along, k], tile[up, k] = tile[x, k], tile[z, k]
                tile[reading, k] = np.sqrt(tile[x, k] * tile[x, k] + tile[z, k] * tile[z, k])
        elif kind == PRS_LEGS:
            fixed = vector_at(numbers[leg], 0)
            for k in range(TILE):
                tile[reading, k] = prs_reading(tile[x, k], tile[z, k], middles[leg], fixed)
                circle = prs_circle(tile[reading, k], fixed)
                tile[along, k], tile[up, k] = tile[x, k] - circle.x, tile[z, k] - circle.z
        else:
            fixed = vector_at(numbers[leg], 0)
            for k in range(TILE):
                c, s = rrs_crank(tile[x, k], tile[z, k], fixed)
                scale = fixed[0] / (tile[x, k] * tile[x, k] + tile[z, k] * tile[z, k])
                tile[along, k], tile[up, k] = tile[x, k] - scale * c, tile[z, k] - scale * s
                tile[cosine, k], tile[reading, k] = from_middle(c, s, middles[leg])


@kernel(
    f"void({readonly_array(2)}, {readonly_array(1)}, {readonly_array(3)}, {readonly_array(3)}, i8, "
    f"{readonly_array(2)}, {readonly_array(1)}, f8, f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], u1[:,::1])"
)
def poses_of_stages(
    normals, heights, legs, planes, kind, numbers, middles, up, rotation, position, readings, cosines, is_physical
):
    """Compute the poses of a stage's platform for N normals (N, 3) and heights (N,) [m], in modes T and F.

    `legs` (3, 3, 3) are axes, pivots and balls [m], `planes` (2, 3, 3) the directions of x and z of the legs' planes,
    `numbers` (3, n) the constants of the legs, and `middles` (3,) those of `planar_legs.crank_middle`. The results, for
    m modes, 1 or 2, are R (N, m, 3, 3) and t (N, m, 3) [m], NaN where there is none; readings without offsets
    (N, m, 3), NaN out of a leg's reach; and which are physical (N, m). For RRS legs the readings, less `middles`, are
    given by multiples of their sines and, if `cosines` is not empty, of the cosines.
    """
    axes, pivots = rows_at(legs[0], 0), rows_at(legs[1], 0)
    stage = stage_constants(axes, pivots, rows_at(legs[2], 0))
    outward, forward = rows_at(planes[0], 0), rows_at(planes[1], 0)
    tile, modes = np.empty((_ROWS, TILE)), rotation.shape[1]
    for start in range(0, len(heights), TILE):
        size = min(TILE, len(heights) - start)
        for k in range(TILE):
            n = start + min(k, size - 1)
            tile[_HEIGHT, k] = heights[n]
            for j in range(3):
                tile[_NORMAL + j, k] = normals[n, j]
        for mode in range(modes):
            sign = 1.0 - 2.0 * mode
            for k in range(TILE):
                turn, height = shortest_turn(direction(vector(tile, _NORMAL, k))), tile[_HEIGHT, k]
                r, t = pose_in_mode(sign, turn, height, torsion_equation(turn, height, stage), stage)
                arms = differences(platform_balls(r, t, stage.balls), pivots)
                tile[_X, k], tile[_X + 1, k], tile[_X + 2, k] = dots(outward, arms)
                tile[_Z, k], tile[_Z + 1, k], tile[_Z + 2, k] = dots(forward, arms)
                (
                    (tile[_ROTATION, k], tile[_ROTATION + 1, k], tile[_ROTATION + 2, k]),
                    (tile[_ROTATION + 3, k], tile[_ROTATION + 4, k], tile[_ROTATION + 5, k]),
                    (tile[_ROTATION + 6, k], tile[_ROTATION + 7, k], tile[_ROTATION + 8, k]),
                ) = r
                tile[_POSITION, k], tile[_POSITION + 1, k], tile[_POSITION + 2, k] = t
            _put_readings(tile, kind, numbers, middles)
            for k in range(TILE):
                rods = multiples(vector(tile, _ROD_X, k), outward)
                rods = combinations(rods, vector(tile, _ROD_Z, k), forward)
                b = platform_balls(matrix(tile, _ROTATION, k), vector(tile, _POSITION, k), stage.balls)
                tile[_HOME, k] = 1.0 if is_home_state(b, differences(b, rods), axes, up) else 0.0
            for k in range(size):
                n = start + k
                is_physical[n, mode] = sign > 0.0 and tile[_HOME, k] > 0.0
                for j in range(3):
                    position[n, mode, j], readings[n, mode, j] = tile[_POSITION + j, k], tile[_READING + j, k]
                    for i in range(3):
                        rotation[n, mode, i, j] = tile[_ROTATION + 3 * i + j, k]
                if len(cosines):
                    for j in range(3):
                        cosines[n, mode, j] = tile[_COSINE + j, k]


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(3)}, i8, "
    f"{readonly_array(2)}, b1[::1])"
)
def working_modes(joints, readings, pivots, planes, kind, numbers, is_own):
    """Write of which of N states, with balls (N, 3, 3) [m] and readings without offsets (N, 3), all legs are in theirs.

    The legs are as for `poses_of_stages`, PRS or RRS; `pivots` (3, 3) [m]. Where a ball is NaN they are not.
    """
    p, outward, forward = rows_at(pivots, 0), rows_at(planes[0], 0), rows_at(planes[1], 0)
    for n in range(len(joints)):
        arms = differences(rows_at(joints[n], 0), p)
        x, z, is_own[n] = dots(outward, arms), dots(forward, arms), True
        for leg in range(3):
            fixed = vector_at(numbers[leg], 0)
            if kind == PRS_LEGS:
                slope = prs_slope(x[leg], z[leg], readings[n, leg], fixed)
            else:
                slope = rrs_slope(x[leg], z[leg], readings[n, leg], fixed)
            # The sign of κ is opposite to that of the root in the reading.
            is_own[n] = is_own[n] and fixed[2] * slope < 0.0
