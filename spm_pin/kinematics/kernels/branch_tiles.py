"""The branches of a tile of poses: their families' quadratics, the ball joints, the leg lengths, the physical branch.

A tile is an array whose last axis counts `TILE` poses side by side, and whose rows are the quantities of a pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import TILE, jit_inline
from spm_pin.kinematics.kernels.quadratics import (
    COS_30,
    FAMILY_LOWER,
    ROOT_SIGN,
    ROUNDING,
    axes,
    branch_weights,
    complex_product,
    middle_joints,
    quadratic_form,
    quaternion,
    root_of,
    root_weights,
    where,
)
from spm_pin.kinematics.kernels.stage_equations import in_home_aspect
from spm_pin.kinematics.kernels.tile_memory import in_caller, on_stack
from spm_pin.kinematics.kernels.vectors import Vector, dot, minus
from spm_pin.mechanism.arguments import FloatArray

VERTICAL = 16
"""Flag of a pose, besides bit k for a continuous family k: the two Z axes are parallel, without a common normal."""

# Rows of tiles: of a pose, after R and o, the first discriminant; common to all families; of a family; of a branch TT.
DISCRIMINANT = 12
SINE, COSINE, N, NI, _M, _MI, _COS_TILT, _HALF_COSECANT = range(8)
_X0, _X3, _S, _SI, _W, _WI, _H, _NOISE, _PLATFORM = range(8, 17)
UU, UV, VV, REAL, _WEIGHTS = range(5)
PHYSICAL, STRAIGHT = range(2)

ByteArray = npt.NDArray[np.uint8]
"""An array of bytes: flags that compiled loops write."""
Tiles = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Poses and discriminants over r² (16, TILE), what families share (25, TILE), families (4, 14, TILE), flags (TILE,)."""


@on_stack
def _poses() -> FloatArray:
    return np.empty((16, TILE))


@on_stack
def _shared() -> FloatArray:
    return np.empty((25, TILE))


@on_stack
def _families() -> FloatArray:
    return np.empty((4, 14, TILE))


@on_stack
def _flags() -> FloatArray:
    return np.empty(TILE)


@in_caller
def allocate() -> Tiles:
    """Allocate the tiles that a kernel works in."""
    poses, shared, families, flags = _poses(), _shared(), _families(), _flags()
    poses[:] = 1.0
    return poses, shared, families, flags


@on_stack
def allocate_roots() -> FloatArray:
    """Allocate u, v and r / (u² + v²) of all branches (8, 3, TILE)."""
    return np.empty((8, 3, TILE))


@on_stack
def allocate_joints() -> FloatArray:
    """Allocate the b_i of all branches (72, TILE)."""
    return np.empty((72, TILE))


@on_stack
def allocate_records() -> FloatArray:
    """Allocate a tile of poses and discriminants, pose by pose (TILE, 16)."""
    return np.empty((TILE, 16))


@on_stack
def allocate_lengths() -> FloatArray:
    """Allocate the leg lengths of all branches (48, TILE)."""
    return np.empty((48, TILE))


@on_stack
def allocate_aspects() -> FloatArray:
    """Allocate, for TT+ and TT-, whether it is physical and how straight it stands (2, 2, TILE)."""
    return np.empty((2, 2, TILE))


@jit_inline
def load_poses(rotation: FloatArray, position: FloatArray, start: int, width: int, poses: FloatArray) -> None:
    """Fill the tile of poses, rotations before positions; the places beyond `width` keep what they hold."""
    for k in range(width):
        for i in range(3):
            for j in range(3):
                poses[3 * i + j, k] = rotation[start + k, i, j]
            poses[9 + i, k] = position[start + k, i]


@jit_inline
def _vanishes(uu: float, uv: float, vv: float, noise: float) -> bool:
    return (abs(uu) <= noise) & (abs(uv) <= noise) & (abs(vv) <= noise)


@jit_inline
def set_up_families(tiles: Tiles, r: float, c: float, only_tt: bool) -> None:
    """Compute the quadratics of a tile of poses, of all families or of TT alone."""
    _put_axes(tiles, r, c)
    # Per family the sign of the quaternion is the one with κ >= 0: κ does not change sign on any path along which the
    # family stays real, so labels do not either.
    _, shared, families, _ = tiles
    unit = 1.0 / (r * r)
    for k in range(TILE):
        x0, x3, sine = shared[_X0, k], shared[_X3, k], shared[SINE, k]
        sum_, sum_i, difference, difference_i = _brackets(shared, k, r)
        lift, h, noise = where(x0 < 0.0, -1.0, 1.0), shared[_H, k], shared[_NOISE, k]
        a, ai = lift * shared[_W, k], lift * shared[_WI, k]
        weights = branch_weights(abs(x0), lift * x3, sine)
        uu, uv, vv = quadratic_form(
            sum_, sum_i, difference, difference_i, weights[0], weights[1], weights[2], weights[3]
        )
        _put_family(tiles, 0, k, uu - h, uv, vv - h, noise, unit)
        _put_weights(families, 0, k, weights, (a, ai), (a, -ai), sine)
        if not only_tt:
            _put_family(tiles, 3, k, -uu - h, -uv, -vv - h, noise, unit)
            _put_weights(families, 3, k, weights, (ai, -a), (ai, a), sine)
    if only_tt:
        return
    for k in range(TILE):
        x0, x3, sine = shared[_X0, k], shared[_X3, k], shared[SINE, k]
        sum_, sum_i, difference, difference_i = _brackets(shared, k, r)
        lift, h, noise = where(x3 < 0.0, -1.0, 1.0), shared[_H, k], shared[_NOISE, k]
        a, ai = lift * shared[_W, k], lift * shared[_WI, k]
        weights = branch_weights(abs(x3), -lift * x0, sine)
        uu, uv, vv = quadratic_form(
            difference, difference_i, sum_, sum_i, weights[0], weights[1], weights[2], weights[3]
        )
        _put_family(tiles, 1, k, uu - h, uv, vv - h, noise, unit)
        _put_weights(families, 1, k, weights, (-ai, a), (-a, ai), sine)
        _put_family(tiles, 2, k, -uu - h, -uv, -vv - h, noise, unit)
        _put_weights(families, 2, k, weights, (a, ai), (ai, a), sine)


@jit_inline
def _put_axes(tiles: Tiles, r: float, c: float) -> None:
    """Write the quaternion, both stages' tilt axes and their common normal, and flag poses that have none."""
    poses, shared, _, flags = tiles
    cx, cy = COS_30 * c, -0.5 * c
    for k in range(TILE):
        r00, r01, r02, r10, r11, r12 = poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]
        r20, r21, r22, x, y = poses[6, k], poses[7, k], poses[8, k], poses[9, k], poses[10, k]
        x0, x1, x2, x3 = quaternion(r00, r01, r02, r10, r11, r12, r20, r21, r22)
        cosine, sine, s, si, w, wi, n, ni, m, mi, cosecant = axes(x0, x1, x2, x3)
        half_cosecant = 0.5 * cosecant
        shared[_X0, k], shared[_X3, k], shared[SINE, k], shared[COSINE, k] = x0, x3, sine, cosine
        shared[_S, k], shared[_SI, k], shared[_W, k], shared[_WI, k] = s, si, w, wi
        shared[_COS_TILT, k], shared[_HALF_COSECANT, k] = cosine * cosine - sine * sine, half_cosecant
        shared[N, k], shared[NI, k], shared[_M, k], shared[_MI, k] = n, ni, m, mi
        shared[_H, k] = n * x + ni * y
        vertical = cosine * sine <= ROUNDING
        # No larger power of the position, which may be any number.
        shared[_NOISE, k] = where(vertical, -1.0, ROUNDING * (r + (abs(x) + abs(y)) * (2.0 * half_cosecant)))
        flags[k] = where(vertical, VERTICAL, 0.0)
        for i in range(3):
            o, first, second = poses[9 + i, k], poses[3 * i, k], poses[3 * i + 1, k]
            back, side = o + cy * second, cx * first
            shared[_PLATFORM + i, k], shared[_PLATFORM + 6 + i, k] = back + side, back - side
            shared[_PLATFORM + 3 + i, k] = o + c * second


@jit_inline
def _brackets(shared: FloatArray, k: int, r: float) -> tuple[float, float, float, float]:
    """Return i s r [W³ ± conj(W)³], the brackets of families whose e are equal; in mixed ones they change places."""
    s, si, w, wi = shared[_S, k], shared[_SI, k], shared[_W, k], shared[_WI, k]
    ww, wwi = complex_product(w, wi, w, wi)
    cubed, cubed_i = complex_product(ww, wwi, w, wi)
    return -2.0 * r * cubed * si, 2.0 * r * cubed * s, 2.0 * r * cubed_i * s, 2.0 * r * cubed_i * si


@jit_inline
def _put_family(tiles: Tiles, family: int, k: int, uu: float, uv: float, vv: float, noise: float, unit: float) -> None:
    poses, _, families, flags = tiles
    continuous = _vanishes(uu, uv, vv, noise)
    discriminant = uv * uv - uu * vv
    families[family, UU, k], families[family, UV, k], families[family, VV, k] = uu, uv, vv
    poses[DISCRIMINANT + family, k] = discriminant * unit
    families[family, REAL, k] = where(continuous | (noise < 0.0), np.nan, discriminant)
    flags[k] += where(continuous, 1.0 * 2**family, 0.0)


@jit_inline
def _put_weights(
    families: FloatArray,
    family: int,
    k: int,
    weights: tuple[float, float, float, float, float, float],
    lower_axis: tuple[float, float],
    upper_axis: tuple[float, float],
    sine: float,
) -> None:
    found = root_weights(weights, lower_axis, upper_axis, sine)
    for i in range(10):
        families[family, _WEIGHTS + i, k] = found[i]


@jit_inline
def put_roots(family: int, tiles: Tiles, r: float, roots: FloatArray) -> None:
    """Write u, v and r / (u² + v²) of both branches of a family of a tile of poses, NaN where they are complex."""
    families = tiles[2]
    for k in range(TILE):
        uu, uv, vv = families[family, UU, k], families[family, UV, k], families[family, VV, k]
        root = ROOT_SIGN[2 * family] * np.sqrt(families[family, REAL, k])
        u, v, square = root_of(uu, uv, vv, root)
        roots[2 * family, 0, k], roots[2 * family, 1, k], roots[2 * family, 2, k] = u, v, r / square
        u, v, square = root_of(uu, uv, vv, -root)
        roots[2 * family + 1, 0, k], roots[2 * family + 1, 1, k], roots[2 * family + 1, 2, k] = u, v, r / square


@jit_inline
def solve_families(
    rotation: FloatArray,
    position: FloatArray,
    start: int,
    width: int,
    r: float,
    c: float,
    tiles: Tiles,
    roots: FloatArray,
) -> None:
    """Load a tile of poses, and write the quadratics of all families and their roots."""
    load_poses(rotation, position, start, width, tiles[0])
    set_up_families(tiles, r, c, False)
    for family in range(4):
        put_roots(family, tiles, r, roots)


@jit_inline
def joints_of_root(branch: int, k: int, u: Any, v: Any, size: Any, tiles: Tiles) -> tuple[Vector, Vector]:
    """Return ρ_1, ρ_2, ρ_3 and z_1, z_2, z_3 of one branch of the pose in place k of a tile.

    u, v is a root of its form, of any length, and `size` r / (u² + v²).
    """
    poses, shared, families, _ = tiles
    family = branch // 2
    weights = (
        families[family, _WEIGHTS, k],
        families[family, _WEIGHTS + 1, k],
        families[family, _WEIGHTS + 2, k],
        families[family, _WEIGHTS + 3, k],
        families[family, _WEIGHTS + 4, k],
        families[family, _WEIGHTS + 5, k],
        families[family, _WEIGHTS + 6, k],
        families[family, _WEIGHTS + 7, k],
        families[family, _WEIGHTS + 8, k],
        families[family, _WEIGHTS + 9, k],
    )
    position = poses[9, k], poses[10, k], poses[11, k]
    normals = shared[N, k], shared[NI, k], shared[_M, k], shared[_MI, k]
    tilt = shared[_COS_TILT, k], shared[_HALF_COSECANT, k]
    return middle_joints(u, v, size, weights, position, normals, tilt, FAMILY_LOWER[family])


@jit_inline
def _length(x: float, y: float, z: float) -> float:
    return float(np.sqrt(x * x + y * y + z * z))


@jit_inline
def _put_lengths(
    radii: Vector, heights: Vector, shared: FloatArray, k: int, e: float, lengths: FloatArray, first: int
) -> None:
    """Write the six leg lengths into rows of a tile; e is the radius of the base."""
    (p1, p2, p3), (z1, z2, z3) = radii, heights
    lengths[first, k] = _length(p1 - e, 0.0, z1)
    lengths[first + 1, k] = _length(p2 - e, 0.0, z2)
    lengths[first + 2, k] = _length(p3 - e, 0.0, z3)
    c = shared[_PLATFORM, k], shared[_PLATFORM + 1, k], shared[_PLATFORM + 2, k]
    lengths[first + 3, k] = _length(c[0] - COS_30 * p1, c[1] + 0.5 * p1, c[2] - z1)
    c = shared[_PLATFORM + 3, k], shared[_PLATFORM + 4, k], shared[_PLATFORM + 5, k]
    lengths[first + 4, k] = _length(c[0], c[1] - p2, c[2] - z2)
    c = shared[_PLATFORM + 6, k], shared[_PLATFORM + 7, k], shared[_PLATFORM + 8, k]
    lengths[first + 5, k] = _length(c[0] + COS_30 * p3, c[1] + 0.5 * p3, c[2] - z3)


@jit_inline
def put_branch(branch: int, tiles: Tiles, roots: FloatArray, e: float, joints: FloatArray, lengths: FloatArray) -> None:
    """Write the b_i and leg lengths of one branch of a tile of poses into rows of `joints` and `lengths`."""
    first = 9 * branch
    for k in range(TILE):
        radii, heights = joints_of_root(branch, k, roots[branch, 0, k], roots[branch, 1, k], roots[branch, 2, k], tiles)
        p1, p2, p3 = radii
        joints[first, k], joints[first + 1, k], joints[first + 2, k] = COS_30 * p1, -0.5 * p1, heights[0]
        joints[first + 3, k], joints[first + 4, k], joints[first + 5, k] = 0.0 * p2, p2, heights[1]
        joints[first + 6, k], joints[first + 7, k], joints[first + 8, k] = -COS_30 * p3, -0.5 * p3, heights[2]
        _put_lengths(radii, heights, tiles[1], k, e, lengths, 6 * branch)


@jit_inline
def put_aspect(branch: int, poses: FloatArray, e: float, c: float, joints: FloatArray, aspects: FloatArray) -> None:
    """Write whether a branch TT is physical, leg limits aside, and the sum of its radii in both stages.

    Both stages stand upright and are in their home's aspect. The sum is larger where their tilts are smaller.
    """
    at = 9 * branch
    for k in range(TILE):
        first = joints[at, k], joints[at + 1, k], joints[at + 2, k]
        second = joints[at + 3, k], joints[at + 4, k], joints[at + 5, k]
        third = joints[at + 6, k], joints[at + 7, k], joints[at + 8, k]
        radii, heights = (-2.0 * first[1], second[1], -2.0 * third[1]), (first[2], second[2], third[2])
        o = poses[9, k], poses[10, k], poses[11, k]
        columns = (
            (poses[0, k], poses[3, k], poses[6, k]),
            (poses[1, k], poses[4, k], poses[7, k]),
            (poses[2, k], poses[5, k], poses[8, k]),
        )
        first, second, third = minus(first, o), minus(second, o), minus(third, o)
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
        aspects[branch, PHYSICAL, k], aspects[branch, STRAIGHT, k] = where(home, 1.0, 0.0), lower_sum + upper_sum


@jit_inline
def put_status(tiles: Tiles, start: int, width: int, status: npt.NDArray[np.int8], flagged: ByteArray) -> None:
    """Write whether each pose of a tile has a real branch, and its flags."""
    families, flags = tiles[2], tiles[3]
    for k in range(width):
        real = (families[0, REAL, k] >= 0.0) | (families[1, REAL, k] >= 0.0)
        real = real | (families[2, REAL, k] >= 0.0) | (families[3, REAL, k] >= 0.0)
        status[start + k] = 0 if real else 1
        flagged[start + k] = np.uint8(flags[k])
