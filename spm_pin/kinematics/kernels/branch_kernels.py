"""Inverse displacement of a batch of poses: all branches with their leg lengths, one branch, or the complex roots.

A tile of poses goes through loops without branches: its axes, the quadratics of its families, their roots, then branch
by branch the joints and leg lengths, which are moved to the results while the next branch is computed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.branch_tiles import (
    COSINE,
    NI,
    PHYSICAL,
    REAL,
    SINE,
    STRAIGHT,
    UU,
    UV,
    VV,
    ByteArray,
    N,
    allocate,
    allocate_aspects,
    allocate_joints,
    allocate_lengths,
    allocate_records,
    allocate_roots,
    joints_of_root,
    load_poses,
    put_aspect,
    put_branch,
    put_roots,
    put_status,
    set_up_families,
    solve_families,
)
from spm_pin.kinematics.kernels.compilation import TILE, kernel, readonly_array
from spm_pin.kinematics.kernels.quadratics import COS_30, ROOT_SIGN, root_of, where
from spm_pin.kinematics.kernels.tile_results import store_joints, store_lengths, store_pose, store_poses
from spm_pin.kinematics.kernels.vectors import cross, dot
from spm_pin.mechanism.arguments import FloatArray

_POSES = f"{readonly_array(3)}, {readonly_array(2)}"


@kernel(f"b1({_POSES}, f8)")
def are_rigid(rotation: FloatArray, position: FloatArray, exact: float) -> bool:
    """Check that N poses are finite, that no entry of RᵀR - I exceeds `exact`, and that no R is a reflection."""
    good = True
    for n in range(len(position)):
        a, b, c = rotation[n, 0], rotation[n, 1], rotation[n, 2]
        x, y, z = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
        size = max(abs(dot(x, x) - 1.0), abs(dot(y, y) - 1.0), abs(dot(z, z) - 1.0))
        skew = max(abs(dot(x, y)), abs(dot(x, z)), abs(dot(y, z)))
        # A maximum may lose NaN; the determinant does not.
        good &= (size <= exact) & (skew <= exact) & (dot(x, cross(y, z)) > 0.0)
        good &= abs(position[n, 0]) + abs(position[n, 1]) + abs(position[n, 2]) < np.inf
    return good


@kernel(
    f"void({_POSES}, f8, f8, f8, f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], u1[:,::1], i1[::1], "
    "u1[::1])"
)
def all_branches(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    rotation_copy: FloatArray,
    position_copy: FloatArray,
    joints: FloatArray,
    lengths: FloatArray,
    discriminants: FloatArray,
    choice: ByteArray,
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
    rotation_copy, position_copy : ndarray, shapes (N, 3, 3) and (N, 3), written
        The poses.
    joints, lengths, discriminants : ndarray, shapes (N, 8, 3, 3), (N, 8, 6) and (N, 4), written
        b_i [m], leg lengths [m], discriminants over r².
    choice : ndarray, shape (N, 3), written
        Whether TT+ is physical, whether TT- is, and whether TT- is tilted less.
    status, flagged : ndarray, shape (N,), written
        0 or 1, the first two of `Status`, continuous families not counted; and bit k for a continuous family k,
        `VERTICAL`.
    """
    tiles, roots, joint_tile, length_tile = allocate(), allocate_roots(), allocate_joints(), allocate_lengths()
    aspects, records, poses = allocate_aspects(), allocate_records(), tiles[0]
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        solve_families(rotation, position, start, width, r, platform_radius, tiles, roots)
        for branch in range(8):
            put_branch(branch, tiles, roots, base_radius, joint_tile, length_tile)
            store_joints(width, start, branch, joint_tile, joints)
            store_lengths(width, start, branch, length_tile, lengths)
        for branch in range(2):
            put_aspect(branch, poses, base_radius, platform_radius, joint_tile, aspects)
        store_poses(width, start, poses, records, rotation_copy, position_copy, discriminants)
        put_status(tiles, start, width, status, flagged)
        for k in range(width):
            choice[start + k, 0] = np.uint8(aspects[0, PHYSICAL, k])
            choice[start + k, 1] = np.uint8(aspects[1, PHYSICAL, k])
            choice[start + k, 2] = 1 if aspects[1, STRAIGHT, k] > aspects[0, STRAIGHT, k] else 0


@kernel(f"void({_POSES}, f8, f8, f8, {readonly_array(2)}, f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1])")
def physical_branches(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    limits: FloatArray,
    rotation_copy: FloatArray,
    position_copy: FloatArray,
    joints: FloatArray,
    lengths: FloatArray,
) -> None:
    """Solve N poses for the physical branch, which is TT+ or TT-.

    Arguments as for `all_branches`, and the least and largest leg lengths (2, 6) [m], which decide between two; then
    the smaller tilt does. Poses, joints (N, 3, 3) and lengths (N, 6) are NaN where there is no such branch.
    """
    tiles, roots, joint_tile, length_tile = allocate(), allocate_roots(), allocate_joints(), allocate_lengths()
    aspects, poses = allocate_aspects(), tiles[0]
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        load_poses(rotation, position, start, width, poses)
        set_up_families(tiles, r, platform_radius, True)
        put_roots(0, tiles, r, roots)
        put_branch(0, tiles, roots, base_radius, joint_tile, length_tile)
        put_branch(1, tiles, roots, base_radius, joint_tile, length_tile)
        for branch in range(2):
            put_aspect(branch, poses, base_radius, platform_radius, joint_tile, aspects)
            for k in range(TILE):
                inside = True
                for i in range(6):
                    length = length_tile[6 * branch + i, k]
                    inside = inside & (length >= limits[0, i]) & (length <= limits[1, i])
                aspects[branch, PHYSICAL, k] *= where(inside, 2.0, 1.0)
        for k in range(width):
            plus, minus = aspects[0, PHYSICAL, k], aspects[1, PHYSICAL, k]
            straighter = aspects[1, STRAIGHT, k] > aspects[0, STRAIGHT, k]
            side = 1 if (minus > plus) | ((minus == plus) & straighter) else 0
            factor = 1.0 if plus + minus > 0.0 else np.nan
            store_pose(poses, k, factor, rotation_copy[start + k], position_copy[start + k])
            for i in range(3):
                for j in range(3):
                    joints[start + k, i, j] = factor * joint_tile[9 * side + 3 * i + j, k]
            for i in range(6):
                lengths[start + k, i] = factor * length_tile[6 * side + i, k]


@kernel(f"void({_POSES}, f8, f8, f8, f8[:,:,::1], i1[::1], u1[::1])")
def branch_lengths(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    lengths: FloatArray,
    status: npt.NDArray[np.int8],
    flagged: ByteArray,
) -> None:
    """Solve N poses for the leg lengths alone; arguments as for `all_branches`."""
    tiles, roots, joint_tile, length_tile = allocate(), allocate_roots(), allocate_joints(), allocate_lengths()
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        solve_families(rotation, position, start, width, r, platform_radius, tiles, roots)
        for branch in range(8):
            put_branch(branch, tiles, roots, base_radius, joint_tile, length_tile)
            store_lengths(width, start, branch, length_tile, lengths)
        put_status(tiles, start, width, status, flagged)


@kernel(f"void({_POSES}, f8, c16[:,:,:,::1])")
def complex_branches(rotation: FloatArray, position: FloatArray, r: float, joints: npt.NDArray[np.complex128]) -> None:
    """Solve N poses for all roots (N, 8, 3, 3), real or complex; arguments as for `all_branches`."""
    tiles = allocate()
    forms = tiles[2]
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        load_poses(rotation, position, start, width, tiles[0])
        set_up_families(tiles, r, 0.0, False)
        for k in range(width):
            for branch in range(8):
                uu, uv, vv = forms[branch // 2, UU, k], forms[branch // 2, UV, k], forms[branch // 2, VV, k]
                root = ROOT_SIGN[branch] * np.sqrt(complex(forms[branch // 2, REAL, k], 0.0))
                u, v, _ = root_of(uu, uv, vv, root)
                size = np.sqrt(u * u + v * v)
                # Not a division, which raises an error where the root is at infinity.
                scale = size.conjugate() * (1.0 / (size.real * size.real + size.imag * size.imag))
                (p1, p2, p3), (z1, z2, z3) = joints_of_root(branch, k, u * scale, v * scale, r, tiles)
                b = joints[start + k, branch]
                b[0, 0], b[0, 1], b[0, 2] = COS_30 * p1, -0.5 * p1, z1
                b[1, 0], b[1, 1], b[1, 2] = 0.0 * p2, p2, z2
                b[2, 0], b[2, 1], b[2, 2] = -COS_30 * p3, -0.5 * p3, z3


@kernel(f"void({_POSES}, f8, f8[:,::1], f8[:,:,::1])")
def family_forms(
    rotation: FloatArray, position: FloatArray, r: float, shared: FloatArray, quadratics: FloatArray
) -> None:
    """Write c, s and the common normal (N, 4), and the families' forms uu, uv, vv less h (N, 4, 3)."""
    tiles = allocate()
    shared_tile, forms = tiles[1], tiles[2]
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        load_poses(rotation, position, start, width, tiles[0])
        set_up_families(tiles, r, 0.0, False)
        for k in range(width):
            shared[start + k, 0], shared[start + k, 1] = shared_tile[COSINE, k], shared_tile[SINE, k]
            shared[start + k, 2], shared[start + k, 3] = shared_tile[N, k], shared_tile[NI, k]
            for family in range(4):
                for i in range(3):
                    quadratics[start + k, family, i] = forms[family, i, k]
