"""The branches of a tile of poses: their families' quadratics, the ball joints, the leg lengths, the physical branch.

A tile is an array whose last axis counts `TILE` poses side by side, and whose rows are the quantities of a pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import TILE, jit_inline
from spm_pin.closed_form.kernels.quadratics import (
    COS_30,
    FAMILY_GROUP,
    FAMILY_LOWER,
    FAMILY_TURNS,
    ROOT_SIGN,
    ROUNDING,
    axes,
    branch_weights,
    middle_joints,
    quadratic_form,
    quaternion,
    root_of,
    times,
    where,
)
from spm_pin.closed_form.kernels.stage_equations import in_home_aspect
from spm_pin.closed_form.kernels.vectors import Vector, dot
from spm_pin.mechanism.arguments import FloatArray

__all__ = [
    "COSINE",
    "DISCRIMINANT",
    "LEGS",
    "NI",
    "PHYSICAL",
    "REAL",
    "SINE",
    "STRAIGHT",
    "UU",
    "UV",
    "VERTICAL",
    "VV",
    "ByteArray",
    "N",
    "Tiles",
    "allocate",
    "joints_of_root",
    "load_poses",
    "put_aspect",
    "put_branch",
    "put_lengths",
    "put_status",
    "real_joints",
    "set_up_families",
    "store_branch",
    "store_pose",
]

VERTICAL = 16
"""Flag of a pose, besides bit k for a continuous family k: the two Z axes are parallel, without a common normal."""

# Rows of a tile: common to all families; of a group of families, after its branch weights; of a family; of a branch.
SINE, COSINE, N, NI, _M, _MI, _HALF_COSECANT = range(7)
_AXIS, _AXIS_I = 6, 7
UU, UV, VV, REAL, DISCRIMINANT = range(5)
LEGS, PHYSICAL, STRAIGHT = 9, 15, 16

ByteArray = npt.NDArray[np.uint8]
"""An array of bytes: flags that compiled loops write."""
Tiles = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Poses (12, TILE), what all families share (7, TILE), groups (2, 8, TILE), families (4, 5, TILE), flags (TILE,)."""


@jit_inline
def allocate() -> Tiles:
    """Allocate the tiles that a kernel works in."""
    poses, common, groups = np.ones((12, TILE)), np.empty((7, TILE)), np.empty((2, 8, TILE))
    return poses, common, groups, np.empty((4, 5, TILE)), np.empty(TILE)


@jit_inline
def load_poses(rotation: FloatArray, position: FloatArray, start: int, width: int, poses: FloatArray) -> None:
    """Fill the tile of poses, rotations before positions; the places beyond `width` keep what they hold."""
    for k in range(width):
        for i in range(3):
            for j in range(3):
                poses[3 * i + j, k] = rotation[start + k, i, j]
            poses[9 + i, k] = position[start + k, i]


@jit_inline
def store_pose(poses: FloatArray, k: int, factor: float, rotation: FloatArray, position: FloatArray) -> None:
    """Write the pose in place k of a tile, times a factor of 1, or of NaN where there is no solution."""
    for i in range(3):
        for j in range(3):
            rotation[i, j] = factor * poses[3 * i + j, k]
        position[i] = factor * poses[9 + i, k]


@jit_inline
def _vanishes(uu: float, uv: float, vv: float, noise: float) -> bool:
    return (abs(uu) <= noise) & (abs(uv) <= noise) & (abs(vv) <= noise)


@jit_inline
def set_up_families(tiles: Tiles, r: float, only_tt: bool) -> None:
    """Compute the quadratics of a tile of poses, of all families or of TT alone."""
    poses, common, groups, forms, flags = tiles
    for k in range(TILE):
        r00, r01, r02, r10, r11, r12 = poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]
        r20, r21, r22, x, y = poses[6, k], poses[7, k], poses[8, k], poses[9, k], poses[10, k]
        x0, x1, x2, x3 = quaternion(r00, r01, r02, r10, r11, r12, r20, r21, r22)
        cosine, sine, s, si, w, wi, n, ni, m, mi = axes(x0, x1, x2, x3)
        half_cosecant = 0.5 / (cosine * sine)
        common[SINE, k], common[COSINE, k], common[_HALF_COSECANT, k] = sine, cosine, half_cosecant
        common[N, k], common[NI, k], common[_M, k], common[_MI, k] = n, ni, m, mi
        h = n * x + ni * y
        ww, wwi = times(w, wi, w, wi)
        cubed, cubed_i = times(ww, wwi, w, wi)
        # The brackets i s r [W³ ± conj(W)³] of families whose e are equal; in mixed ones they change places.
        sum_, sum_i = -2.0 * r * cubed * si, 2.0 * r * cubed * s
        difference, difference_i = 2.0 * r * cubed_i * s, 2.0 * r * cubed_i * si
        vertical = cosine * sine <= ROUNDING
        # No larger power of the position, which may be any number.
        noise = where(vertical, -1.0, ROUNDING * (r + (abs(x) + abs(y)) * (2.0 * half_cosecant)))
        flags[k] = where(vertical, VERTICAL, 0.0)

        # Per family the sign of the quaternion is the one with κ >= 0: κ does not change sign on any path along which
        # the family stays real, so labels do not either.
        lift = where(x0 < 0.0, -1.0, 1.0)
        weights = branch_weights(abs(x0), lift * x3, sine)
        for i in range(6):
            groups[0, i, k] = weights[i]
        groups[0, _AXIS, k], groups[0, _AXIS_I, k] = lift * w, lift * wi
        uu, uv, vv = quadratic_form(
            sum_, sum_i, difference, difference_i, weights[0], weights[1], weights[2], weights[3]
        )
        _put_family(forms, flags, 0, k, uu - h, uv, vv - h, noise)
        if only_tt:
            continue
        _put_family(forms, flags, 3, k, -uu - h, -uv, -vv - h, noise)

        lift = where(x3 < 0.0, -1.0, 1.0)
        weights = branch_weights(abs(x3), -lift * x0, sine)
        for i in range(6):
            groups[1, i, k] = weights[i]
        groups[1, _AXIS, k], groups[1, _AXIS_I, k] = lift * w, lift * wi
        uu, uv, vv = quadratic_form(
            difference, difference_i, sum_, sum_i, weights[0], weights[1], weights[2], weights[3]
        )
        _put_family(forms, flags, 1, k, uu - h, uv, vv - h, noise)
        _put_family(forms, flags, 2, k, -uu - h, -uv, -vv - h, noise)


@jit_inline
def _put_family(
    forms: FloatArray, flags: FloatArray, family: int, k: int, uu: float, uv: float, vv: float, noise: float
) -> None:
    continuous = _vanishes(uu, uv, vv, noise)
    discriminant = uv * uv - uu * vv
    forms[family, UU, k], forms[family, UV, k], forms[family, VV, k] = uu, uv, vv
    forms[family, DISCRIMINANT, k] = discriminant
    forms[family, REAL, k] = where(continuous | (noise < 0.0), np.nan, discriminant)
    flags[k] += where(continuous, 1.0 * 2**family, 0.0)


@jit_inline
def joints_of_root(branch: int, k: int, u: Any, v: Any, tiles: Tiles, r: float) -> tuple[Vector, Vector]:
    """Return ρ_1, ρ_2, ρ_3 and z_1, z_2, z_3 of one branch of the pose in place k of a tile, given its root."""
    poses, common, groups, _, _ = tiles
    family = branch // 2
    group, turns = FAMILY_GROUP[family], FAMILY_TURNS[family]
    f, fi, g, gi = groups[group, 0, k], groups[group, 1, k], groups[group, 2, k], groups[group, 3, k]
    weights = f, fi, g, gi, groups[group, 4, k], groups[group, 5, k]
    axis, axis_i = groups[group, _AXIS, k], groups[group, _AXIS_I, k]
    lower_axis = times(axis, axis_i, turns[0], turns[1])
    upper_axis = times(axis, -axis_i, turns[2], turns[3])
    position = poses[9, k], poses[10, k], poses[11, k]
    normals = common[N, k], common[NI, k], common[_M, k], common[_MI, k]
    half_angle = common[COSINE, k], common[SINE, k], common[_HALF_COSECANT, k]
    return middle_joints(u, v, weights, lower_axis, upper_axis, position, normals, half_angle, FAMILY_LOWER[family], r)


@jit_inline
def real_joints(branch: int, k: int, tiles: Tiles, r: float) -> tuple[Vector, Vector]:
    """Return ρ_1, ρ_2, ρ_3 and z_1, z_2, z_3 of one branch of the pose in place k of a tile, NaN if it is complex."""
    forms, family = tiles[3], branch // 2
    root = ROOT_SIGN[branch] * np.sqrt(forms[family, REAL, k])
    u, v = root_of(forms[family, UU, k], forms[family, UV, k], forms[family, VV, k], root)
    scale = 1.0 / np.sqrt(u * u + v * v)
    return joints_of_root(branch, k, u * scale, v * scale, tiles, r)


@jit_inline
def _length(x: float, y: float, z: float) -> float:
    return float(np.sqrt(x * x + y * y + z * z))


@jit_inline
def put_lengths(
    radii: Vector, heights: Vector, poses: FloatArray, k: int, e: float, c: float, out: FloatArray, first: int
) -> None:
    """Write the six leg lengths into rows of a tile; e and c are the radii of base and platform."""
    x, y, z = poses[9, k], poses[10, k], poses[11, k]
    cx, cy = COS_30 * c, -0.5 * c
    r00, r01, r10, r11, r20, r21 = poses[0, k], poses[1, k], poses[3, k], poses[4, k], poses[6, k], poses[7, k]
    side_x, side_y, side_z = cx * r00, cx * r10, cx * r20
    back_x, back_y, back_z = x + cy * r01, y + cy * r11, z + cy * r21
    p1, p2, p3 = radii
    z1, z2, z3 = heights
    out[first, k], out[first + 1, k], out[first + 2, k] = (
        _length(p1 - e, 0.0, z1),
        _length(p2 - e, 0.0, z2),
        _length(p3 - e, 0.0, z3),
    )
    out[first + 3, k], out[first + 4, k], out[first + 5, k] = (
        _length(back_x + side_x - COS_30 * p1, back_y + side_y + 0.5 * p1, back_z + side_z - z1),
        _length(x + c * r01, y + c * r11 - p2, z + c * r21 - z2),
        _length(back_x - side_x + COS_30 * p3, back_y - side_y + 0.5 * p3, back_z - side_z - z3),
    )


@jit_inline
def put_branch(branch: int, tiles: Tiles, r: float, e: float, c: float, out: FloatArray) -> None:
    """Write the b_i and leg lengths of one branch of a tile of poses into the first 15 rows of `out` (17, TILE)."""
    for k in range(TILE):
        radii, heights = real_joints(branch, k, tiles, r)
        p1, p2, p3 = radii
        out[0, k], out[1, k], out[2, k] = COS_30 * p1, -0.5 * p1, heights[0]
        out[3, k], out[4, k], out[5, k] = 0.0 * p2, p2, heights[1]
        out[6, k], out[7, k], out[8, k] = -COS_30 * p3, -0.5 * p3, heights[2]
        put_lengths(radii, heights, tiles[0], k, e, c, out, LEGS)


@jit_inline
def put_aspect(poses: FloatArray, e: float, c: float, out: FloatArray) -> None:
    """Write whether a real machine can be in a branch TT, leg limits aside, and the sum of its radii in both stages.

    Both stages stand upright and are in their home's aspect. The sum is larger where their tilts are smaller.
    """
    for k in range(TILE):
        radii, heights = (-2.0 * out[1, k], out[4, k], -2.0 * out[7, k]), (out[2, k], out[5, k], out[8, k])
        x, y, z = poses[9, k], poses[10, k], poses[11, k]
        columns = (
            (poses[0, k], poses[3, k], poses[6, k]),
            (poses[1, k], poses[4, k], poses[7, k]),
            (poses[2, k], poses[5, k], poses[8, k]),
        )
        first, second = (out[0, k] - x, out[1, k] - y, out[2, k] - z), (out[3, k] - x, out[4, k] - y, out[5, k] - z)
        third = out[6, k] - x, out[7, k] - y, out[8, k] - z
        upper = (
            COS_30 * dot(first, columns[0]) - 0.5 * dot(first, columns[1]),
            dot(second, columns[1]),
            -COS_30 * dot(third, columns[0]) - 0.5 * dot(third, columns[1]),
        )
        below = -dot(first, columns[2]), -dot(second, columns[2]), -dot(third, columns[2])
        lower_sum, upper_sum = radii[0] + radii[1] + radii[2], upper[0] + upper[1] + upper[2]
        upright = (lower_sum > 0.0) & (upper_sum > 0.0)
        upright = upright & (heights[0] + heights[1] + heights[2] > 0.0) & (below[0] + below[1] + below[2] > 0.0)
        home = upright & in_home_aspect(radii, heights, e) & in_home_aspect(upper, below, c)
        out[PHYSICAL, k], out[STRAIGHT, k] = where(home, 1.0, 0.0), lower_sum + upper_sum


@jit_inline
def put_status(tiles: Tiles, start: int, width: int, status: npt.NDArray[np.int8], flagged: ByteArray) -> None:
    """Write whether each pose of a tile has a real branch, and its flags."""
    forms, flags = tiles[3], tiles[4]
    for k in range(width):
        real = (forms[0, REAL, k] >= 0.0) | (forms[1, REAL, k] >= 0.0)
        real = real | (forms[2, REAL, k] >= 0.0) | (forms[3, REAL, k] >= 0.0)
        status[start + k] = 0 if real else 1
        flagged[start + k] = np.uint8(flags[k])


@jit_inline
def store_branch(out: FloatArray, k: int, joints: FloatArray, lengths: FloatArray) -> None:
    """Copy the b_i and leg lengths in place k of a tile to a branch's (3, 3) and (6,)."""
    for i in range(3):
        joints[i, 0], joints[i, 1], joints[i, 2] = out[3 * i, k], out[3 * i + 1, k], out[3 * i + 2, k]
    for i in range(6):
        lengths[i] = out[LEGS + i, k]
