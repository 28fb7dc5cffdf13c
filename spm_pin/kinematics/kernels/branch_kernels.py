"""Inverse displacement of a batch of poses: all branches with their leg lengths, one branch, or the complex roots.

A tile is an array (`_ROWS`, `TILE`): its last axis counts poses side by side, its rows are the quantities of a pose.
"""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.branches import (
    Family,
    PoseFrame,
    discriminant,
    families,
    is_continuous,
    is_other_preferred,
    is_tilted,
    leg_lengths,
    middle_joints,
    platform_corners,
    pose_frame,
    root,
    rounding_bound,
    stands_at_home,
)
from spm_pin.formulas.stages import cartesian
from spm_pin.formulas.vectors import Rows, Vector, cross, dot, transposed
from spm_pin.kinematics.kernels.compilation import (
    OK,
    TILE,
    UNREACHABLE,
    ComplexArray,
    jit,
    jit_inline,
    kernel,
    matrix,
    put_rows,
    readonly_array,
    rows_at,
    vector,
    vector_at,
)
from spm_pin.kinematics.kernels.quadric_newton import squared
from spm_pin.support.arguments import FloatArray

VERTICAL = 16
"""Flag of a pose, besides bit k for a continuous family k: the two Z axes are parallel, without a common normal."""

# Rows of a tile: R, o, the discriminants over r²; b_i and leg lengths, branch by branch; 1 if a branch is real; flags;
# by how much each discriminant exceeds its rounding; of TT+ and TT-, 1 if physical, 2 if within the leg limits too, and
# the sum of its radii.
_POSITION, _DISCRIMINANTS, _JOINTS, _LENGTHS = 9, 12, 16, 88
_REAL, _FLAGS, _CERTAIN, _RANK, _TILTS, _ROWS = 136, 137, 138, 142, 144, 146
_POSES = f"{readonly_array(3)}, {readonly_array(2)}"


@kernel(f"b1({_POSES}, f8, f8)")
def are_valid(rotation, position, exact, farthest):
    """Check N poses: entries of RᵀR - I up to `exact`, det R > 0, |x| + |y| + |z| up to `farthest`."""
    good = True
    for n in range(len(position)):
        x, y, z = transposed(rows_at(rotation[n], 0))
        size = max(abs(dot(x, x) - 1.0), abs(dot(y, y) - 1.0), abs(dot(z, z) - 1.0))
        skew = max(abs(dot(x, y)), abs(dot(x, z)), abs(dot(y, z)))
        # A maximum may lose NaN; the determinant does not.
        good &= (size <= exact) & (skew <= exact) & (dot(x, cross(y, z)) > 0.0)
        good &= abs(position[n, 0]) + abs(position[n, 1]) + abs(position[n, 2]) <= farthest
    return good


@jit_inline
def _load(rotation: FloatArray, position: FloatArray, start: int, width: int, tile: FloatArray) -> None:
    """Put poses into a tile; the places beyond `width` keep what they hold."""
    for k in range(width):
        for i in range(3):
            for j in range(3):
                tile[3 * i + j, k] = rotation[start + k, i, j]
            tile[_POSITION + i, k] = position[start + k, i]


@jit_inline
def _radicand(family: Family, frame: PoseFrame) -> float:
    """Return the discriminant of a family, NaN where it has no isolated branches."""
    regular = not (frame.is_vertical | is_continuous(family, frame.noise))
    return discriminant(family) if regular else np.nan


@jit_inline
def _put_branch(
    tile: FloatArray,
    k: int,
    branch: int,
    radicand: float,
    family: Family,
    frame: PoseFrame,
    corners: Rows,
    sizes: Vector,
) -> None:
    """Write the b_i and the leg lengths of a branch of the pose in place k."""
    u, v, square = root(family, 1.0 if branch % 2 == 0 else -1.0, np.sqrt(radicand))
    radii, heights = middle_joints(u, v, sizes[0] / square, family, frame, vector(tile, _POSITION, k))
    b, lengths = cartesian(radii, heights), leg_lengths(radii, heights, corners, sizes[1])
    for i in range(3):
        for j in range(3):
            tile[_JOINTS + 9 * branch + 3 * i + j, k] = b[i][j]
    for i in range(6):
        tile[_LENGTHS + 6 * branch + i, k] = lengths[i]


@jit_inline
def _put_homes(tile: FloatArray, sizes: Vector) -> None:
    """Write whether TT+ and TT- are physical, leg limits aside, and the sums of their radii."""
    for branch in range(2):
        row = _JOINTS + 9 * branch
        for k in range(TILE):
            rotation, position = matrix(tile, 0, k), vector(tile, _POSITION, k)
            (_, y1, z1), (_, y2, z2), (_, y3, z3) = matrix(tile, row, k)
            radii = -2.0 * y1, y2, -2.0 * y3
            home, tilts = stands_at_home(radii, (z1, z2, z3), rotation, position, sizes[1], sizes[2])
            tile[_RANK + branch, k], tile[_TILTS + branch, k] = (1.0 if home else 0.0), tilts


@jit_inline
def _put_family(
    tile: FloatArray, k: int, number: int, family: Family, frame: PoseFrame, corners: Rows, sizes: Vector
) -> None:
    """Write both branches of a family, its discriminant and flag, and count it if it is real."""
    radicand, unit = _radicand(family, frame), 1.0 / (sizes[0] * sizes[0])
    is_free = is_continuous(family, frame.noise) & (not frame.is_vertical)
    value = np.nan if frame.is_vertical else discriminant(family) * unit
    tile[_DISCRIMINANTS + number, k] = value
    is_known = abs(value) > rounding_bound(vector(tile, _POSITION, k), sizes[0])
    tile[_CERTAIN + number, k] = 1.0 if is_known & is_tilted(matrix(tile, 0, k)) & (not is_free) else 0.0
    tile[_REAL, k] += 1.0 if radicand >= 0.0 else 0.0
    tile[_FLAGS, k] += 1.0 * 2**number if is_free else 0.0
    _put_branch(tile, k, 2 * number, radicand, family, frame, corners, sizes)
    _put_branch(tile, k, 2 * number + 1, radicand, family, frame, corners, sizes)


@kernel(
    f"void({_POSES}, f8, f8, f8, f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,::1], b1[:,::1], b1[:,::1], "
    "i1[::1], u1[::1])"
)
def all_branches(
    rotation,
    position,
    r,
    base_radius,
    platform_radius,
    rotation_copy,
    position_copy,
    joints,
    lengths,
    discriminants,
    certain,
    at_home,
    status,
    flagged,
):
    """Solve N poses R (N, 3, 3), o (N, 3) [m], with circumradii of the middle, base and terminal platforms [m].

    Written are the poses; b_i (N, 8, 3, 3) and leg lengths (N, 8, 6) [m]; discriminants over r² (N, 4), and which of
    their signs are `certain`; which branches are physical, leg limits aside, as `at_home` (N, 8); `Status` (N,),
    continuous families not counted; as `flagged` (N,) bit k for a continuous family k, and `VERTICAL`. Without memory
    for the poses only lengths, status and flags are written.
    """
    count, tile, sizes = len(position), np.ones((_ROWS, TILE)), (r, base_radius, platform_radius)
    rotations, joint_rows = rotation_copy.reshape(len(rotation_copy), 9), joints.reshape(len(joints), 72)
    length_rows = lengths.reshape(count, 48)
    for start in range(0, count, TILE):
        width = min(TILE, count - start)
        _load(rotation, position, start, width, tile)
        for k in range(TILE):
            turn, o = matrix(tile, 0, k), vector(tile, _POSITION, k)
            frame, corners = pose_frame(turn, o, r), platform_corners(turn, o, platform_radius)
            tt, tf, ft, ff = families(frame, r)
            tile[_REAL, k], tile[_FLAGS, k] = 0.0, (1.0 * VERTICAL if frame.is_vertical else 0.0)
            _put_family(tile, k, 0, tt, frame, corners, sizes)
            _put_family(tile, k, 1, tf, frame, corners, sizes)
            _put_family(tile, k, 2, ft, frame, corners, sizes)
            _put_family(tile, k, 3, ff, frame, corners, sizes)
        if len(rotations) > 0:
            _put_homes(tile, sizes)
        # Pose by pose, by loops of constant length: in another order it takes twice the time.
        for k in range(width):
            status[start + k] = OK if tile[_REAL, k] > 0.0 else UNREACHABLE
            flagged[start + k] = np.uint8(tile[_FLAGS, k])
            for i in range(48):
                length_rows[start + k, i] = tile[_LENGTHS + i, k]
            if len(rotations) == 0:
                continue
            for i in range(9):
                rotations[start + k, i] = tile[i, k]
            for i in range(3):
                position_copy[start + k, i] = tile[_POSITION + i, k]
            for i in range(72):
                joint_rows[start + k, i] = tile[_JOINTS + i, k]
            for i in range(4):
                discriminants[start + k, i] = tile[_DISCRIMINANTS + i, k]
                certain[start + k, i] = tile[_CERTAIN + i, k] > 0.0
            for i in range(8):
                at_home[start + k, i] = i < 2 and tile[_RANK + i % 2, k] > 0.0


@kernel(f"void({_POSES}, f8, f8, f8, {readonly_array(2)}, f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1])")
def physical_branch(
    rotation, position, r, base_radius, platform_radius, limits, rotation_copy, position_copy, joints, lengths
):
    """Solve N poses for the physical branch, which is TT+ or TT-.

    Arguments as for `all_branches`, and the least and largest leg lengths (2, 6) [m], which decide between two; then
    the smaller tilt does. Poses, joints (N, 3, 3) and lengths (N, 6) are NaN where there is no such branch.
    """
    tile, sizes = np.ones((_ROWS, TILE)), (r, base_radius, platform_radius)
    for start in range(0, len(position), TILE):
        width = min(TILE, len(position) - start)
        _load(rotation, position, start, width, tile)
        for k in range(TILE):
            turn, o = matrix(tile, 0, k), vector(tile, _POSITION, k)
            frame, corners = pose_frame(turn, o, r), platform_corners(turn, o, platform_radius)
            family = families(frame, r)[0]
            radicand = _radicand(family, frame)
            _put_branch(tile, k, 0, radicand, family, frame, corners, sizes)
            _put_branch(tile, k, 1, radicand, family, frame, corners, sizes)
        _put_homes(tile, sizes)
        for k in range(width):
            for branch in range(2):
                inside = True
                for i in range(6):
                    length = tile[_LENGTHS + 6 * branch + i, k]
                    inside = inside & (length >= limits[0, i]) & (length <= limits[1, i])
                tile[_RANK + branch, k] *= 2.0 if inside else 1.0
            plus, minus = tile[_RANK, k], tile[_RANK + 1, k]
            side = 1 if is_other_preferred(plus, tile[_TILTS, k], minus, tile[_TILTS + 1, k]) else 0
            factor = 1.0 if plus + minus > 0.0 else np.nan
            for i in range(3):
                for j in range(3):
                    rotation_copy[start + k, i, j] = factor * tile[3 * i + j, k]
                    joints[start + k, i, j] = factor * tile[_JOINTS + 9 * side + 3 * i + j, k]
                position_copy[start + k, i] = factor * tile[_POSITION + i, k]
            for i in range(6):
                lengths[start + k, i] = factor * tile[_LENGTHS + 6 * side + i, k]


@jit
def put_complex_branches(rotation: Rows, position: Vector, r: float, joints: ComplexArray) -> bool:
    """Write the b_i of all roots (8, 3, 3), real or complex; return whether no family is continuous."""
    frame = pose_frame(rotation, position, r)
    every, is_regular = families(frame, r), True
    for branch in range(8):
        family = every[branch // 2]
        radicand = _radicand(family, frame)
        is_regular = is_regular and radicand == radicand
        signed = (family.plus if branch % 2 == 0 else -family.plus) * np.sqrt(complex(radicand, 0.0))
        # Both pairs solve the form; the longer one is free of cancellation.
        u, v, other = signed - family.uv, complex(family.uu, 0.0), -signed - family.uv
        if squared(u) + squared(v) < squared(other) + family.vv * family.vv:
            u, v = complex(family.vv, 0.0), other
        size = u * u + v * v
        # Not a division, which raises an error where the root is at infinity.
        scale = r * size.conjugate() * (1.0 / squared(size))
        radii, heights = middle_joints(u, v, scale, family, frame, position)
        put_rows(cartesian(radii, heights), joints[branch])
    return is_regular


@kernel(f"void({_POSES}, f8, c16[:,:,:,::1])")
def complex_branches(rotation, position, r, joints):
    """Solve N poses for all roots (N, 8, 3, 3), real or complex; arguments as for `all_branches`."""
    for n in range(len(position)):
        put_complex_branches(rows_at(rotation[n], 0), vector_at(position[n], 0), r, joints[n])
