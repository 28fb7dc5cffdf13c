"""Inverse displacement of a calibrated machine for a batch of poses: all branches, labelled, or the physical one.

The six leg planes of a pose are three quadrics, all eight common points of which are found, see `quadric_roots`. Each
real branch of the nominal machine is followed while the errors grow from zero to those of the machine, and gives its
label to the root where it ends. Where it meets another branch it ends on the way; the roots left over take the labels
left over, marked as not carried.

Which state is physical does not depend on labels. Usually Newton's method leads from TT+ and TT- of the nominal
machine to the only two roots that can be physical; if it does not, all eight roots are checked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.formulas.ball_motions import points_from_platform
from spm_pin.formulas.branches import (
    discriminant,
    families,
    is_continuous,
    is_other_preferred,
    middle_joints,
    pose_frame,
    quaternion,
    root,
    tilt_cosine_sum,
)
from spm_pin.formulas.circles import is_home_state
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.leg_planes import StagePlanes, quadric
from spm_pin.formulas.stages import cartesian
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    differences,
    dot,
    dots,
    minus,
    multiples,
    rotation_of,
    shifted,
    times,
    turned,
)
from spm_pin.kinematics.kernels.branch_kernels import put_complex_branches
from spm_pin.kinematics.kernels.compilation import (
    DEGENERATE,
    OK,
    UNREACHABLE,
    UNSOLVED,
    ComplexArray,
    jit,
    jit_inline,
    kernel,
    put_rows,
    readonly_array,
    rows_at,
    vector_at,
)
from spm_pin.kinematics.kernels.quadric_newton import (
    CONVERGED,
    FAILED,
    PENDING,
    POINTS,
    ROWS,
    STATE,
    is_real,
    is_same_point,
    point,
    polish,
    put_real_part,
    real_part,
)
from spm_pin.kinematics.kernels.quadric_roots import allocate_elimination, eight_roots
from spm_pin.support.arguments import FloatArray

Planes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Normals (6, 3) and heights (6,) of planes in {B}, the balls (6, 3) in {n} that lie in them, and the factors (6, 9) of
the normals N = Qᵀ R: R in factors[:3, :3], and Q, whose last three rows are the null space, in factors[:, 3:]."""

_SHORTEST_STEPS = 1.0, 0.02, 1e-7
"""Shortest steps, as shares of the errors, in which branches are followed: one that needs shorter steps meets another.
The shorter ones are tried only while a real root without a label is left."""
_ERROR_SHARE = 8 * POINTS  # where the row begins that has the share of the errors to which each root was followed
_LEVELS = 25  # times that the way may be halved: enough for the shortest step
_SAME_ROOT = 1e-6  # projective distance up to which a branch that was followed has arrived at a root
_FLAT = 1e-13
_LARGE = 5e-3  # error of a direction, or of a length over r, beyond which any root may be the physical one
_LEVEL = 0.25
"""Largest error of a leg's plane, in units of r, over the sine of the platform's tilt, at which roots of other families
stay far from physical: towards a level pose the equations shrink with the tilt, and the errors do not."""
_DISPUTED = -2  # label of a root at which two branches seem to have arrived


class PoseScratch(NamedTuple):
    """Arrays that poses are solved in, one after another."""

    planes: Planes  # of the calibrated machine
    planes_between: Planes  # of a machine with a share of the errors
    targets: FloatArray  # shares of the errors, the first of which is 1
    forms: FloatArray  # the quadrics there (_LEVELS, 3, 10)
    trial: FloatArray  # roots moved on trial, as in `polish`


@jit_inline
def _allocate_pose_scratch() -> PoseScratch:
    planes = np.empty((6, 3)), np.empty(6), np.empty((6, 3)), np.empty((6, 9))
    between = np.empty((6, 3)), np.empty(6), np.empty((6, 3)), np.empty((6, 9))
    return PoseScratch(planes, between, np.ones(_LEVELS), np.empty((_LEVELS, 3, 10)), np.empty(ROWS * POINTS))


@jit_inline
def _between(machines: FloatArray, row: int, i: int, share: float) -> Vector:
    """Return a vector of leg i of a machine with a share of the errors; `machines` is (2, 3, 6, 3)."""
    drawn = vector_at(machines[0, row, i], 0)
    return combined(drawn, share, minus(vector_at(machines[1, row, i], 0), drawn))


@jit
def _put_planes(rotation: Rows, position: Vector, machines: FloatArray, share: float, planes: Planes) -> None:
    """Write the planes in {B} and the balls in {n} of a machine with a share of the errors."""
    normals, heights, balls, _ = planes
    for i in range(6):
        axis, pivot = _between(machines, 0, i, share), _between(machines, 1, i, share)
        height = dot(axis, pivot)
        if i >= 3:
            axis = times(rotation, axis)
            height += dot(axis, position)
        heights[i] = height
        normals[i, 0], normals[i, 1], normals[i, 2] = axis
        balls[i, 0], balls[i, 1], balls[i, 2] = _between(machines, 2, i, share)


@jit
def _put_quadrics(planes: Planes, forms: FloatArray) -> bool:
    """Write the three quadrics of six planes (3, 10), of norm 1 as matrices, and the planes' factors.

    Returned is whether the normals span space; if not, the rotation does not determine t.
    """
    normals, heights, balls, factors = planes
    # Householder reflections of (normals | identity), the identity's last three rows being the null space.
    for i in range(6):
        for j in range(3):
            factors[i, j] = normals[i, j]
        for j in range(6):
            factors[i, 3 + j] = 1.0 if i == j else 0.0
    spans = True
    for j in range(3):
        square = 0.0
        for i in range(j, 6):
            square += factors[i, j] * factors[i, j]
        size = math.sqrt(square)
        if not size > _FLAT:
            spans = False
            continue
        size = -size if factors[j, j] > 0.0 else size
        pivot = factors[j, j] - size
        factor = -1.0 / (size * pivot)
        column = (pivot, factors[1, j], factors[2, j], factors[3, j], factors[4, j], factors[5, j])
        for k in range(j, 9):
            total = pivot * factors[j, k]
            for i in range(j + 1, 6):
                total += column[i] * factors[i, k]
            total *= factor
            factors[j, k] -= total * pivot
            for i in range(j + 1, 6):
                factors[i, k] -= total * column[i]
    lower = StagePlanes(rows_at(normals, 0), vector_at(heights, 0), rows_at(balls, 0))
    upper = StagePlanes(rows_at(normals, 3), vector_at(heights, 3), rows_at(balls, 3))
    for k in range(3):
        form = quadric(vector_at(factors[3 + k], 3), vector_at(factors[3 + k], 6), lower, upper)
        square = 0.0
        for i in range(4):
            square += form[i] * form[i]
        for i in range(4, 10):
            square += 2.0 * form[i] * form[i]
        scale = 1.0 / math.sqrt(square) if square > 0.0 else 0.0
        for i in range(10):
            forms[k, i] = scale * form[i]
    return spans


@jit
def _image(x, planes):
    """Return the lower and the upper legs' balls in {B} of a root x, a quaternion, real or complex.

    The planes are as `_put_quadrics` left them: their factors give t.
    """
    normals, heights, balls, factors = planes
    rotation = rotation_of(x[0], x[1], x[2], x[3])
    s0 = s1 = s2 = 0.0 * rotation[0][0]
    for i in range(6):
        gap = heights[i] - dot(vector_at(normals[i], 0), times(rotation, vector_at(balls[i], 0)))
        s0 += factors[0, 3 + i] * gap
        s1 += factors[1, 3 + i] * gap
        s2 += factors[2, 3 + i] * gap
    # Numba and NumPy round quotients of complex numbers differently, products alike.
    t2 = s2 * (1.0 / factors[2, 2])
    t1 = (s1 - factors[1, 2] * t2) * (1.0 / factors[1, 1])
    t0 = (s0 - factors[0, 1] * t1 - factors[0, 2] * t2) * (1.0 / factors[0, 0])
    t = t0, t1, t2
    return shifted(turned(rotation, rows_at(balls, 0)), t), shifted(turned(rotation, rows_at(balls, 3)), t)


@jit_inline
def _read_pose(rotation: FloatArray, position: FloatArray, n: int, unit: float) -> tuple[Rows, Vector]:
    return rows_at(rotation[n], 0), (position[n, 0] / unit, position[n, 1] / unit, position[n, 2] / unit)


@jit_inline
def _put_pose(
    rotation: FloatArray, position: FloatArray, n: int, rotation_copy: FloatArray, position_copy: FloatArray
) -> None:
    """Copy pose n, element by element: Numba takes three seconds to compile the assignment of an array."""
    put_rows(rows_at(rotation[n], 0), rotation_copy[n])
    for i in range(3):
        position_copy[n, i] = position[n, i]


@jit_inline
def _put_start(roots: FloatArray, k: int, b: Rows) -> None:
    """Write a real branch of the nominal machine, its lower balls, as root k."""
    # The axes are the rows of the transposed rotation.
    x0, x1, x2, x3 = quaternion(triangle_axes(b))
    put_real_part(roots, k, (-x1, -x2, -x3, x0))


@jit
def _follow(
    rotation: Rows, position: Vector, machines: FloatArray, shortest: float, roots: FloatArray, scratch: PoseScratch
) -> None:
    """Follow real roots while the errors grow from zero to those of the machine.

    The row `_ERROR_SHARE` of the roots has the shares of the errors that they were led to: zero in the beginning, and
    one in the end if a root has arrived. A root that needs a step shorter than `shortest` is left behind.
    """
    trial, targets = scratch.trial, scratch.targets
    level, share = 0, 0.0
    # Before a target that some root cannot be led to in one step the half of the way there is put.
    while level >= 0:
        waiting = False
        for k in range(POINTS):
            is_tried = roots[_ERROR_SHARE + k] == share
            waiting = waiting or is_tried
            trial[STATE + k] = PENDING if is_tried else FAILED
            put_real_part(trial, k, real_part(roots, k))
        if waiting:
            polish(scratch.forms[level], trial, False, True, 10)
            waiting = False
            for k in range(POINTS):
                if trial[STATE + k] == CONVERGED:
                    roots[_ERROR_SHARE + k] = targets[level]
                    put_real_part(roots, k, real_part(trial, k))
                elif roots[_ERROR_SHARE + k] == share:
                    waiting = True
        half = 0.5 * (targets[level] - share)
        if waiting and half >= shortest:
            level += 1
            targets[level] = share + half
            _put_planes(rotation, position, machines, targets[level], scratch.planes_between)
            _put_quadrics(scratch.planes_between, scratch.forms[level])
        else:
            share = targets[level]
            level -= 1


@jit_inline
def _put_lengths(b: Rows, c: Rows, machine: FloatArray, unit: float, lengths: FloatArray) -> None:
    """Write the distances of lower balls in {B}, and upper ones in {m}, from their pivots."""
    lower, upper = differences(b, rows_at(machine[1], 0)), differences(c, rows_at(machine[1], 3))
    below, above = dots(lower, lower), dots(upper, upper)
    for i in range(3):
        lengths[i], lengths[3 + i] = math.sqrt(below[i]) * unit, math.sqrt(above[i]) * unit


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, f8, f8[:,:,::1], f8[:,::1], f8[:,:,:,::1], "
    "f8[:,:,::1], c16[:,:,:,::1], u1[:,::1], i1[::1])"
)
def calibrated_branches(
    rotation,
    position,
    machines,
    unit,
    rotation_copy,
    position_copy,
    joints,
    lengths,
    complex_joints,
    is_carried,
    status,
):
    """Solve N poses R (N, 3, 3), o (N, 3) [m] for all branches.

    `machines` (2, 3, 6, 3) are axes, pivots and balls of the nominal and of the calibrated machine, in units of `unit`,
    the middle platform's radius [m]. Written are the poses; b_i (N, 8, 3, 3) and leg lengths without offsets (N, 8, 6)
    [m], NaN where a branch is not real; the b_i of all roots (N, 8, 3, 3) if that array has a length; as `is_carried`
    (N, 8) 1 if the branch of the nominal machine was tracked to the root with its label, 0 if it ended on the way
    or a real root has a remaining label, 2 if neither machine has the branch; and `Status` (N,).
    """
    scratch, elimination = _allocate_pose_scratch(), allocate_elimination()
    roots, followed = np.empty(8 * POINTS), np.empty(9 * POINTS)
    drawn, joints_of_roots = np.empty((8, 3, 3), np.complex128), np.empty((8, 3, 3), np.complex128)
    label_of, root_of, units = np.empty(8, np.int64), np.empty(8, np.int64), (unit, unit, unit)
    for n in range(len(position)):
        turn, place = _read_pose(rotation, position, n, unit)
        _put_pose(rotation, position, n, rotation_copy, position_copy)
        joints[n], lengths[n], is_carried[n] = np.nan, np.nan, 2
        if len(complex_joints):
            complex_joints[n] = np.nan
        _put_planes(turn, place, machines, 1.0, scratch.planes)
        spans = _put_quadrics(scratch.planes, scratch.forms[0])
        if not spans or eight_roots(scratch.forms[0], elimination, roots) < 8:
            status[n] = UNSOLVED if spans else DEGENERATE
            continue
        left = 0
        is_regular = put_complex_branches(turn, place, 1.0, drawn)
        for k in range(8):
            label_of[k], root_of[k] = -1, -1
            left += 1 if is_real(roots, k) else 0
            # What the branches left of a degenerate pose would meet is a continuous family.
            if is_regular and not drawn[k].imag.any():
                is_carried[n, k] = 0
        for shortest in _SHORTEST_STEPS:
            # A branch that has not arrived can only arrive at a root that is real and no other's.
            if left == 0 and shortest < 1.0:
                break
            for k in range(8):
                followed[_ERROR_SHARE + k] = 1.0
                if is_carried[n, k] == 0:
                    followed[_ERROR_SHARE + k] = 0.0
                    _put_start(followed, k, rows_at(drawn[k].real, 0))
            _follow(turn, place, machines, shortest, followed, scratch)
            left -= _claim(roots, followed, is_carried[n], label_of, root_of)
        if left > 0 or len(complex_joints):
            for k in range(8):
                label_of[k] = max(label_of[k], -1)
                balls, _ = _image(point(roots, k), scratch.planes)
                put_rows(balls, joints_of_roots[k])
            _assign_left_over(drawn, joints_of_roots, label_of, root_of)
        status[n] = UNREACHABLE
        for label in range(8):
            k = root_of[label]
            if len(complex_joints):
                put_rows(multiples(units, rows_at(joints_of_roots[k], 0)), complex_joints[n, label])
            if k >= 0 and is_real(roots, k):
                status[n] = OK
                is_carried[n, label] = is_carried[n, label] % 2
                b, c = _image(real_part(roots, k), scratch.planes)
                put_rows(multiples(units, b), joints[n, label])
                _put_lengths(b, points_from_platform(c, turn, place), machines[1], unit, lengths[n, label])


@jit
def _claim(
    roots: FloatArray,
    followed: FloatArray,
    is_carried: npt.NDArray[np.uint8],
    label_of: npt.NDArray[np.int64],
    root_of: npt.NDArray[np.int64],
) -> int:
    """Give labels to the real roots at which branches arrived; return how many more roots have one."""
    claimed = 0
    for label in range(8):
        if is_carried[label] != 0 or followed[_ERROR_SHARE + label] != 1.0:
            continue
        x = real_part(followed, label)
        for k in range(8):
            if is_real(roots, k) and is_same_point(x, real_part(roots, k), _SAME_ROOT):
                # Two that arrive at one root: neither label is certain.
                if label_of[k] >= 0:
                    is_carried[label_of[k]], root_of[label_of[k]], label_of[k] = 0, -1, _DISPUTED
                    claimed -= 1
                elif label_of[k] != _DISPUTED:
                    is_carried[label], root_of[label], label_of[k] = 1, k, label
                    claimed += 1
                break
    return claimed


@jit
def _assign_left_over(
    drawn: ComplexArray, joints_of_roots: ComplexArray, label_of: npt.NDArray[np.int64], root_of: npt.NDArray[np.int64]
) -> None:
    """Give the labels left over to the roots left over, the pairs nearest in their ball centres first."""
    while True:
        nearest, best_label, best_root = np.inf, -1, -1
        for label in range(8):
            for k in range(8):
                if root_of[label] < 0 and label_of[k] < 0:
                    distance = 0.0
                    for i in range(3):
                        for j in range(3):
                            gap = joints_of_roots[k, i, j] - drawn[label, i, j]
                            distance = max(distance, gap.real * gap.real + gap.imag * gap.imag)
                    if best_label < 0 or distance < nearest:
                        nearest, best_label, best_root = distance, label, k
        if best_label < 0:
            return
        label_of[best_root], root_of[best_label] = best_label, best_root


@jit
def _put_nearest(rotation: Rows, position: Vector, scratch: PoseScratch, nearest: FloatArray) -> bool:
    """Write the roots to which Newton's method leads at once from the nominal TT+ and TT-; return whether it does."""
    frame = pose_frame(rotation, position, 1.0)
    tt, tf, ft, ff = families(frame, 1.0)
    radicand, noise = discriminant(tt), frame.noise
    if not radicand >= 0.0 or frame.is_vertical:
        return False
    # What the branches left of a degenerate pose would meet is a continuous family.
    if is_continuous(tt, noise) or is_continuous(tf, noise) or is_continuous(ft, noise) or is_continuous(ff, noise):
        return False
    for k in range(POINTS):
        nearest[STATE + k] = PENDING if k < 2 else FAILED
    for k in range(2):
        u, v, square = root(tt, 1.0 - 2.0 * k, math.sqrt(radicand))
        radii, heights = middle_joints(u, v, 1.0 / square, tt, frame, position)
        _put_start(nearest, k, cartesian(radii, heights))
    polish(scratch.forms[0], nearest, False, True, 10)
    arrived = nearest[STATE] == CONVERGED and nearest[STATE + 1] == CONVERGED
    return arrived and not is_same_point(real_part(nearest, 0), real_part(nearest, 1), _SAME_ROOT)


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, f8, {readonly_array(2)}, f8[:,:,::1], "
    "f8[:,::1], f8[:,:,::1], f8[:,::1])"
)
def calibrated_physical_branch(
    rotation, position, machines, unit, limits, rotation_copy, position_copy, joints, lengths
):
    """Solve N poses for the physical branch.

    Poses and machines as for `calibrated_branches`, limits and results as for `physical_branch` of nominal machines;
    the lengths are those without offsets.
    """
    scratch, elimination, own = _allocate_pose_scratch(), allocate_elimination(), np.empty(6)
    all_roots, nearest = np.empty(8 * POINTS), np.zeros(ROWS * POINTS)
    axes, upper_axes = rows_at(machines[1, 0], 0), rows_at(machines[1, 0], 3)
    pivots, upper_pivots = rows_at(machines[1, 1], 0), rows_at(machines[1, 1], 3)
    error = np.abs(machines[1] - machines[0]).max()
    for n in range(len(position)):
        rotation_copy[n], position_copy[n], joints[n], lengths[n] = np.nan, np.nan, np.nan, np.nan
        turn, place = _read_pose(rotation, position, n, unit)
        _put_planes(turn, place, machines, 1.0, scratch.planes)
        if not _put_quadrics(scratch.planes, scratch.forms[0]):
            continue
        distance = abs(place[0]) + abs(place[1]) + abs(place[2])
        # Towards a level pose the equations shrink with the tilt, and the errors do not: see `_LEVEL`.
        few = error <= _LARGE and error * (1.0 + distance) <= _LEVEL * abs(complex(turn[0][2], turn[1][2]))
        few = few and _put_nearest(turn, place, scratch, nearest)
        best_rank, best_tilts = 0.0, -np.inf
        while best_rank == 0.0:
            roots, count = (nearest, 2) if few else (all_roots, 8)
            if not few and eight_roots(scratch.forms[0], elimination, roots) < 8:
                break
            for k in range(count):
                if not is_real(roots, k):
                    continue
                b, c = _image(real_part(roots, k), scratch.planes)
                c = points_from_platform(c, turn, place)
                if not (is_home_state(b, pivots, axes, 1.0) and is_home_state(c, upper_pivots, upper_axes, -1.0)):
                    continue
                _put_lengths(b, c, machines[1], unit, own)
                rank, tilts = 2.0, tilt_cosine_sum(b, turn)
                for i in range(6):
                    rank = rank if limits[0, i] <= own[i] <= limits[1, i] else 1.0
                if is_other_preferred(best_rank, best_tilts, rank, tilts):
                    best_rank, best_tilts = rank, tilts
                    put_rows(multiples((unit, unit, unit), b), joints[n])
                    for i in range(6):
                        lengths[n, i] = own[i]
            if not few:
                break
            few = False
        if best_rank > 0.0:
            _put_pose(rotation, position, n, rotation_copy, position_copy)
