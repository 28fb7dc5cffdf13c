"""Inverse displacement of a batch of poses: all branches with their leg lengths, the lengths alone, complex roots.

A tile of poses goes through two loops: what a pose says about its families, then, per branch, its root and its joints.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import TILE, given, inlined, kernel
from spm_pin.closed_form.kernels.quadratics import (
    COS_30,
    FAMILY_GROUP,
    FAMILY_LOWER,
    FAMILY_TURNS,
    ROOT_SIGN,
    ROUNDING,
    axes,
    middle_joints,
    quadratic_form,
    quaternion,
    root_of,
    shares,
    times,
    where,
)
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["QUESTIONABLE", "VERTICAL", "all_branches", "branch_lengths", "complex_branches", "family_forms"]

# What a pose is flagged with, besides bit k where family k is continuous.
VERTICAL = 16
"""The two Z axes are parallel: no common normal, no branch."""
QUESTIONABLE = 32
"""The rotation is not one to the last bits, or something is not finite."""

# Rows of a tile: of what all families share, of a group's (after what `shares` returns), of a family's.
_SINE, _COSINE, _N, _NI, _M, _MI = range(6)
_AXIS, _AXIS_I = 6, 7
_UU, _UV, _VV, _REAL, _DISCRIMINANT = range(5)

ByteArray = npt.NDArray[np.uint8]


@inlined
def _load(rotation: FloatArray, position: FloatArray, start: int, width: int, poses: FloatArray) -> None:
    """Fill the tile `poses` (12, TILE), rotations before positions; the places beyond `width` keep what they hold."""
    for k in range(width):
        for i in range(3):
            for j in range(3):
                poses[3 * i + j, k] = rotation[start + k, i, j]
            poses[9 + i, k] = position[start + k, i]


@inlined
def _is_rotation(
    r00: float,
    r01: float,
    r02: float,
    r10: float,
    r11: float,
    r12: float,
    r20: float,
    r21: float,
    r22: float,
    exact: float,
) -> bool:
    """Tell whether the entries of RᵀR - I are at most `exact` and the determinant is positive; NaN is not."""
    diagonal = max(
        abs(r00 * r00 + r10 * r10 + r20 * r20 - 1.0),
        abs(r01 * r01 + r11 * r11 + r21 * r21 - 1.0),
        abs(r02 * r02 + r12 * r12 + r22 * r22 - 1.0),
    )
    across = max(
        abs(r00 * r01 + r10 * r11 + r20 * r21),
        abs(r00 * r02 + r10 * r12 + r20 * r22),
        abs(r01 * r02 + r11 * r12 + r21 * r22),
    )
    determinant = r00 * (r11 * r22 - r12 * r21) + r01 * (r12 * r20 - r10 * r22) + r02 * (r10 * r21 - r11 * r20)
    # NaN may get lost in a maximum, but not in the determinant.
    return (diagonal <= exact) & (across <= exact) & (determinant > 0.0)


@inlined
def _vanishes(uu: float, uv: float, vv: float, noise: float) -> bool:
    return (abs(uu) <= noise) & (abs(uv) <= noise) & (abs(vv) <= noise)


@inlined
def _families(
    poses: FloatArray,
    r: float,
    exact: float,
    common: FloatArray,
    groups: FloatArray,
    forms: FloatArray,
    flags: FloatArray,
) -> None:
    """Set up the families of a tile of poses: arrays (6, TILE), (2, 8, TILE), (4, 5, TILE) and (TILE,)."""
    for k in range(TILE):
        r00, r01, r02, r10, r11, r12 = poses[0, k], poses[1, k], poses[2, k], poses[3, k], poses[4, k], poses[5, k]
        r20, r21, r22, x, y, z = poses[6, k], poses[7, k], poses[8, k], poses[9, k], poses[10, k], poses[11, k]
        x0, x1, x2, x3 = quaternion(r00, r01, r02, r10, r11, r12, r20, r21, r22)
        cosine, sine, s, si, w, wi, n, ni, m, mi = axes(x0, x1, x2, x3)
        common[_SINE, k], common[_COSINE, k] = sine, cosine
        common[_N, k], common[_NI, k], common[_M, k], common[_MI, k] = n, ni, m, mi
        h = n * x + ni * y
        ww, wwi = times(w, wi, w, wi)
        cubed, cubed_i = times(ww, wwi, w, wi)
        # The brackets i s r [W³ ± conj(W)³] of families whose e are equal; in mixed ones they change places.
        sum_, sum_i = -2.0 * r * cubed * si, 2.0 * r * cubed * s
        difference, difference_i = 2.0 * r * cubed_i * s, 2.0 * r * cubed_i * si
        fine = _is_rotation(r00, r01, r02, r10, r11, r12, r20, r21, r22, exact)
        fine = fine & (abs(x) + abs(y) + abs(z) < np.inf)
        vertical = cosine * sine <= ROUNDING
        # No larger power of the position, which may be any number.
        noise = where(vertical, -1.0, ROUNDING * (r + (abs(x) + abs(y)) / (cosine * sine)))
        flags[k] = where(fine, 0.0, QUESTIONABLE) + where(vertical, VERTICAL, 0.0)

        # Per family the sign of the quaternion is the one with κ >= 0: κ does not change sign on any path along which
        # the family stays real, so labels do not either.
        lift = where(x0 < 0.0, -1.0, 1.0)
        share = shares(abs(x0), lift * x3, sine)
        groups[0, 0, k], groups[0, 1, k], groups[0, 2, k], groups[0, 3, k], groups[0, 4, k], groups[0, 5, k] = share
        groups[0, _AXIS, k], groups[0, _AXIS_I, k] = lift * w, lift * wi
        uu, uv, vv = quadratic_form(sum_, sum_i, difference, difference_i, share[0], share[1], share[2], share[3])
        _put_family(forms, flags, 0, k, uu - h, uv, vv - h, noise)
        _put_family(forms, flags, 3, k, -uu - h, -uv, -vv - h, noise)

        lift = where(x3 < 0.0, -1.0, 1.0)
        share = shares(abs(x3), -lift * x0, sine)
        groups[1, 0, k], groups[1, 1, k], groups[1, 2, k], groups[1, 3, k], groups[1, 4, k], groups[1, 5, k] = share
        groups[1, _AXIS, k], groups[1, _AXIS_I, k] = lift * w, lift * wi
        uu, uv, vv = quadratic_form(difference, difference_i, sum_, sum_i, share[0], share[1], share[2], share[3])
        _put_family(forms, flags, 1, k, uu - h, uv, vv - h, noise)
        _put_family(forms, flags, 2, k, -uu - h, -uv, -vv - h, noise)


@inlined
def _put_family(
    forms: FloatArray, flags: FloatArray, family: int, k: int, uu: float, uv: float, vv: float, noise: float
) -> None:
    continuous = _vanishes(uu, uv, vv, noise)
    discriminant = uv * uv - uu * vv
    forms[family, _UU, k], forms[family, _UV, k], forms[family, _VV, k] = uu, uv, vv
    forms[family, _DISCRIMINANT, k] = discriminant
    forms[family, _REAL, k] = where(continuous | (noise < 0.0), np.nan, discriminant)
    flags[k] += where(continuous, 1.0 * 2**family, 0.0)


@inlined
def _branch(
    branch: int,
    k: int,
    root: complex,
    poses: FloatArray,
    common: FloatArray,
    groups: FloatArray,
    forms: FloatArray,
    r: float,
) -> tuple[float, float, float, float, float, float]:
    """Return ρ_1, ρ_2, ρ_3, z_1, z_2, z_3 of one branch of the pose in place k of a tile."""
    family = branch // 2
    group, turns = FAMILY_GROUP[family], FAMILY_TURNS[family]
    u, v = root_of(forms[family, _UU, k], forms[family, _UV, k], forms[family, _VV, k], ROOT_SIGN[branch] * root)
    f, fi, g, gi = groups[group, 0, k], groups[group, 1, k], groups[group, 2, k], groups[group, 3, k]
    share = f, fi, g, gi, groups[group, 4, k], groups[group, 5, k]
    axis, axis_i = groups[group, _AXIS, k], groups[group, _AXIS_I, k]
    lower_axis = times(axis, axis_i, turns[0], turns[1])
    upper_axis = times(axis, -axis_i, turns[2], turns[3])
    position = poses[9, k], poses[10, k], poses[11, k]
    normals = common[_N, k], common[_NI, k], common[_M, k], common[_MI, k]
    cosine, sine, lower = common[_COSINE, k], common[_SINE, k], FAMILY_LOWER[family]
    return middle_joints(u, v, share, lower_axis, upper_axis, position, normals, cosine, sine, lower, r)


@inlined
def _length(x: float, y: float, z: float) -> float:
    return float(np.sqrt(x * x + y * y + z * z))


@inlined
def _leg_lengths(
    radii: tuple[float, float, float],
    heights: tuple[float, float, float],
    poses: FloatArray,
    k: int,
    e: float,
    c: float,
) -> tuple[float, float, float, float, float, float]:
    """Return the six lengths, e and c being the radii of base and platform."""
    x, y, z = poses[9, k], poses[10, k], poses[11, k]
    cx, cy = COS_30 * c, -0.5 * c
    r00, r01, r10, r11, r20, r21 = poses[0, k], poses[1, k], poses[3, k], poses[4, k], poses[6, k], poses[7, k]
    side_x, side_y, side_z = cx * r00, cx * r10, cx * r20
    back_x, back_y, back_z = x + cy * r01, y + cy * r11, z + cy * r21
    return (
        _length(radii[0] - e, 0.0, heights[0]),
        _length(radii[1] - e, 0.0, heights[1]),
        _length(radii[2] - e, 0.0, heights[2]),
        _length(back_x + side_x - COS_30 * radii[0], back_y + side_y + 0.5 * radii[0], back_z + side_z - heights[0]),
        _length(x + c * r01, y + c * r11 - radii[1], z + c * r21 - heights[1]),
        _length(back_x - side_x + COS_30 * radii[2], back_y - side_y + 0.5 * radii[2], back_z - side_z - heights[2]),
    )


@inlined
def _put_status(
    forms: FloatArray, flags: FloatArray, start: int, width: int, status: npt.NDArray[np.int8], flagged: ByteArray
) -> None:
    for k in range(width):
        real = (forms[0, _REAL, k] >= 0.0) | (forms[1, _REAL, k] >= 0.0)
        real = real | (forms[2, _REAL, k] >= 0.0) | (forms[3, _REAL, k] >= 0.0)
        status[start + k] = 0 if real else 1
        flagged[start + k] = np.uint8(flags[k])


@kernel(f"void({given(3)}, {given(2)}, f8, f8, f8, f8, f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], i1[::1], u1[::1])")
def all_branches(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    exact: float,
    joints: FloatArray,
    lengths: FloatArray,
    discriminants: FloatArray,
    status: npt.NDArray[np.int8],
    flagged: ByteArray,
) -> None:
    """Solve N poses.

    Parameters
    ----------
    rotation, position : ndarray, shapes (N, 3, 3) and (N, 3)
        R and o [m].
    r, base_radius, platform_radius : float
        Circumradii of the middle, base and terminal platforms [m].
    exact : float
        The largest entry of RᵀR - I of a rotation that is not flagged.
    joints, lengths, discriminants : ndarray, shapes (N, 8, 3, 3), (N, 8, 6) and (N, 4), written
        b_i [m], leg lengths [m], discriminants over r².
    status, flagged : ndarray, shape (N,), written
        0 or 1, the first two of `Status`, continuous families not counted; and what is to be looked at, bit k for
        a continuous family k, `VERTICAL`, `QUESTIONABLE`.
    """
    poses, common, groups = np.ones((12, TILE)), np.empty((6, TILE)), np.empty((2, 8, TILE))
    forms, flags, out = np.empty((4, 5, TILE)), np.empty(TILE), np.empty((15, TILE))
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        _load(rotation, position, start, width, poses)
        _families(poses, r, exact, common, groups, forms, flags)
        _put_status(forms, flags, start, width, status, flagged)
        for k in range(width):
            for family in range(4):
                discriminants[start + k, family] = forms[family, _DISCRIMINANT, k] / (r * r)
        for branch in range(8):
            for k in range(TILE):
                root = np.sqrt(forms[branch // 2, _REAL, k])
                p1, p2, p3, z1, z2, z3 = _branch(branch, k, root, poses, common, groups, forms, r)
                out[0, k], out[1, k], out[2, k] = COS_30 * p1, -0.5 * p1, z1
                out[3, k], out[4, k], out[5, k] = 0.0 * p2, p2, z2
                out[6, k], out[7, k], out[8, k] = -COS_30 * p3, -0.5 * p3, z3
                legs = _leg_lengths((p1, p2, p3), (z1, z2, z3), poses, k, base_radius, platform_radius)
                out[9, k], out[10, k], out[11, k], out[12, k], out[13, k], out[14, k] = legs
            for k in range(width):
                b, legs_of = joints[start + k, branch], lengths[start + k, branch]
                b[0, 0], b[0, 1], b[0, 2] = out[0, k], out[1, k], out[2, k]
                b[1, 0], b[1, 1], b[1, 2] = out[3, k], out[4, k], out[5, k]
                b[2, 0], b[2, 1], b[2, 2] = out[6, k], out[7, k], out[8, k]
                legs_of[0], legs_of[1], legs_of[2] = out[9, k], out[10, k], out[11, k]
                legs_of[3], legs_of[4], legs_of[5] = out[12, k], out[13, k], out[14, k]


@kernel(f"void({given(3)}, {given(2)}, f8, f8, f8, f8, f8[:,:,::1], i1[::1], u1[::1])")
def branch_lengths(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    exact: float,
    lengths: FloatArray,
    status: npt.NDArray[np.int8],
    flagged: ByteArray,
) -> None:
    """Solve N poses for the leg lengths alone; arguments as for `all_branches`."""
    poses, common, groups = np.ones((12, TILE)), np.empty((6, TILE)), np.empty((2, 8, TILE))
    forms, flags, out = np.empty((4, 5, TILE)), np.empty(TILE), np.empty((6, TILE))
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        _load(rotation, position, start, width, poses)
        _families(poses, r, exact, common, groups, forms, flags)
        _put_status(forms, flags, start, width, status, flagged)
        for branch in range(8):
            for k in range(TILE):
                root = np.sqrt(forms[branch // 2, _REAL, k])
                p1, p2, p3, z1, z2, z3 = _branch(branch, k, root, poses, common, groups, forms, r)
                legs = _leg_lengths((p1, p2, p3), (z1, z2, z3), poses, k, base_radius, platform_radius)
                out[0, k], out[1, k], out[2, k], out[3, k], out[4, k], out[5, k] = legs
            for k in range(width):
                legs_of = lengths[start + k, branch]
                legs_of[0], legs_of[1], legs_of[2] = out[0, k], out[1, k], out[2, k]
                legs_of[3], legs_of[4], legs_of[5] = out[3, k], out[4, k], out[5, k]


@kernel(f"void({given(3)}, {given(2)}, f8, f8, c16[:,:,:,::1], u1[::1])")
def complex_branches(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    exact: float,
    joints: npt.NDArray[np.complex128],
    flagged: ByteArray,
) -> None:
    """Solve N poses for all roots (N, 8, 3, 3), real or complex; arguments as for `all_branches`."""
    poses, common, groups = np.ones((12, TILE)), np.empty((6, TILE)), np.empty((2, 8, TILE))
    forms, flags = np.empty((4, 5, TILE)), np.empty(TILE)
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        _load(rotation, position, start, width, poses)
        _families(poses, r, exact, common, groups, forms, flags)
        for k in range(width):
            flagged[start + k] = np.uint8(flags[k])
            for branch in range(8):
                root = np.sqrt(complex(forms[branch // 2, _REAL, k], 0.0))
                p1, p2, p3, z1, z2, z3 = _branch(branch, k, root, poses, common, groups, forms, r)
                b = joints[start + k, branch]
                b[0, 0], b[0, 1], b[0, 2] = COS_30 * p1, -0.5 * p1, z1
                b[1, 0], b[1, 1], b[1, 2] = 0.0 * p2, p2, z2
                b[2, 0], b[2, 1], b[2, 2] = -COS_30 * p3, -0.5 * p3, z3


@kernel(f"void({given(3)}, {given(2)}, f8, f8[:,::1], f8[:,:,::1])")
def family_forms(
    rotation: FloatArray, position: FloatArray, r: float, shared: FloatArray, quadratics: FloatArray
) -> None:
    """Write c, s and the common normal (N, 4), and the families' forms uu, uv, vv less h (N, 4, 3)."""
    poses, common, groups = np.ones((12, TILE)), np.empty((6, TILE)), np.empty((2, 8, TILE))
    forms, flags = np.empty((4, 5, TILE)), np.empty(TILE)
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        _load(rotation, position, start, width, poses)
        _families(poses, r, 0.0, common, groups, forms, flags)
        for k in range(width):
            shared[start + k, 0], shared[start + k, 1] = common[_COSINE, k], common[_SINE, k]
            shared[start + k, 2], shared[start + k, 3] = common[_N, k], common[_NI, k]
            for family in range(4):
                for i in range(3):
                    quadratics[start + k, family, i] = forms[family, i, k]
