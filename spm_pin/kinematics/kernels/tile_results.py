"""Tiles of branches copied to results: joints, leg lengths and poses, whole blocks of places at a time."""

from __future__ import annotations

from spm_pin.kinematics.kernels.branch_tiles import DISCRIMINANT
from spm_pin.kinematics.kernels.compilation import TILE, jit_inline
from spm_pin.kinematics.kernels.tile_memory import LANES, fetch_line, in_blocks, move_block, move_numbers
from spm_pin.mechanism.arguments import FloatArray

_LARGE = 4000
"""Poses whose results, some megabytes, exceed the second-level cache: their lines are prefetched."""
_AHEAD = 64
"""Poses between those whose lines are prefetched and those that are written: more than memory takes to answer."""


@jit_inline
def _fetch_ahead(start: int, branch: int, lines: int, out: FloatArray) -> None:
    # An eighth of the lines of a later tile; a pose has `lines` of them.
    if len(out) >= _LARGE:
        share = lines * TILE // 8
        first = lines * (start + _AHEAD) + share * branch
        for line in range(first, first + share):
            fetch_line(out, line)


@jit_inline
def store_pose(poses: FloatArray, k: int, factor: float, rotation: FloatArray, position: FloatArray) -> None:
    """Write the pose in place k of a tile, times a factor of 1, or of NaN where there is no solution."""
    for i in range(3):
        for j in range(3):
            rotation[i, j] = factor * poses[3 * i + j, k]
        position[i] = factor * poses[9 + i, k]


@jit_inline
def _move_joints(start: int, branch: int, tile: FloatArray, joints: FloatArray) -> None:
    # Nine rows a branch: this block of eight is now complete.
    for lane in range(0, TILE, LANES):
        move_block(tile, 8 * branch, lane, joints, start + lane)
        if branch == 7:
            move_block(tile, 64, lane, joints, start + lane)
    _fetch_ahead(start, branch, 9, joints)


@in_blocks(_move_joints)
def store_joints(width: int, start: int, branch: int, tile: FloatArray, joints: FloatArray) -> None:
    """Copy the b_i of a branch to results (N, 8, 3, 3); the branches have to be stored one after the other."""
    for k in range(width):
        for i in range(3):
            for j in range(3):
                joints[start + k, branch, i, j] = tile[9 * branch + 3 * i + j, k]


@jit_inline
def _move_lengths(start: int, branch: int, tile: FloatArray, lengths: FloatArray) -> None:
    # Six rows a branch: three branches of four complete a block.
    if branch % 4 != 0:
        for lane in range(0, TILE, LANES):
            move_block(tile, 8 * (branch - 1 - branch // 4), lane, lengths, start + lane)
    _fetch_ahead(start, branch, 6, lengths)


@in_blocks(_move_lengths)
def store_lengths(width: int, start: int, branch: int, tile: FloatArray, lengths: FloatArray) -> None:
    """Copy the leg lengths of a branch to results (N, 8, 6); the branches have to be stored one after the other."""
    for k in range(width):
        for i in range(6):
            lengths[start + k, branch, i] = tile[6 * branch + i, k]


@jit_inline
def _move_poses(
    start: int,
    poses: FloatArray,
    records: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    discriminants: FloatArray,
) -> None:
    for lane in range(0, TILE, LANES):
        move_block(poses, 0, lane, records, lane)
        move_block(poses, 8, lane, records, lane)
    for k in range(TILE):
        move_numbers(records, k, 0, 9, rotation, start + k)
        move_numbers(records, k, 9, 3, position, start + k)
        move_numbers(records, k, 12, 4, discriminants, start + k)


@in_blocks(_move_poses)
def store_poses(
    width: int,
    start: int,
    poses: FloatArray,
    records: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    discriminants: FloatArray,
) -> None:
    """Copy R, o and the discriminants to results (N, 3, 3), (N, 3) and (N, 4), by way of `records` (TILE, 16)."""
    for k in range(width):
        for i in range(16):
            records[k, i] = poses[i, k]
        for i in range(3):
            for j in range(3):
                rotation[start + k, i, j] = records[k, 3 * i + j]
            position[start + k, i] = records[k, 9 + i]
        for i in range(4):
            discriminants[start + k, i] = records[k, DISCRIMINANT + i]
