"""Inverse displacement of an imperfect machine for a batch of poses: all branches, under the nominal machine's labels.

All eight roots are solved for, see `quadric_roots`. Each real branch of the nominal machine is then followed while
the errors grow from zero to those of the machine, and gives its label to the root where it ends. Where it meets another
branch it ends on the way; the roots left over take the labels left over, marked as not carried.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.quadric_elimination import allocate_elimination
from spm_pin.kinematics.kernels.quadric_newton import (
    CONVERGED,
    FAILED,
    PENDING,
    POINTS,
    ROWS,
    STATE,
    point,
    polish,
    put_real_part,
    real_part,
)
from spm_pin.kinematics.kernels.quadric_roots import SAME_ROOT, eight_roots, is_real, is_same_point
from spm_pin.kinematics.kernels.three_quadrics import Planes, allocate_planes, image, put_quadrics, put_quaternion
from spm_pin.mechanism.arguments import FloatArray

ComplexArray = npt.NDArray[np.complex128]
HomotopyScratch = tuple[FloatArray, FloatArray, FloatArray, FloatArray, Planes]
"""Roots that are followed side by side, flat as in `polish`, and how they are moved on trial; targets, as parts of the
errors, and the quadrics there, `forms`, the first of the machine as built; planes on the way."""

OK, UNREACHABLE, DEGENERATE, UNSOLVED = 0, 1, 2, 3
_SHORTEST = 1e-7
"""A step of the errors shorter than this part of them stands before two branches that meet."""
SHORTEST_AT_FIRST = 0.02
"""The same while it is not known yet whether any real root will be left for such a branch."""
_LEVELS = 25
"""Halvings of the way, no fewer than lead to the shortest step."""
_DISPUTED = -2
"""Label of a root at which two branches seem to have arrived."""
FRACTION_ROW = 8 * POINTS
"""Where the row of the shares of the errors begins at which the roots are."""


@jit
def put_planes(
    rotation: FloatArray,
    position: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    part: float,
    planes: Planes,
) -> None:
    """Write the planes in {B} and the balls in {n} of a machine with a share of the errors.

    `nominal` and `built` (3, 6, 3) are axes, pivots and balls.
    """
    normals, heights, balls, _ = planes
    for i in range(6):
        for j in range(3):
            balls[i, j] = nominal[2, i, j] + part * (built[2, i, j] - nominal[2, i, j])
        a0 = nominal[0, i, 0] + part * (built[0, i, 0] - nominal[0, i, 0])
        a1 = nominal[0, i, 1] + part * (built[0, i, 1] - nominal[0, i, 1])
        a2 = nominal[0, i, 2] + part * (built[0, i, 2] - nominal[0, i, 2])
        p0 = nominal[1, i, 0] + part * (built[1, i, 0] - nominal[1, i, 0])
        p1 = nominal[1, i, 1] + part * (built[1, i, 1] - nominal[1, i, 1])
        p2 = nominal[1, i, 2] + part * (built[1, i, 2] - nominal[1, i, 2])
        height = a0 * p0 + a1 * p1 + a2 * p2
        if i < 3:
            normals[i, 0], normals[i, 1], normals[i, 2] = a0, a1, a2
        else:
            for j in range(3):
                normals[i, j] = rotation[j, 0] * a0 + rotation[j, 1] * a1 + rotation[j, 2] * a2
                height += normals[i, j] * position[j]
        heights[i] = height


@jit_inline
def allocate_path() -> HomotopyScratch:
    """Allocate the arrays that `follow` works in, with no root in them."""
    roots = np.zeros((FRACTION_ROW // POINTS + 1) * POINTS)
    roots[FRACTION_ROW:] = 1.0
    return roots, np.empty(ROWS * POINTS), np.empty(_LEVELS), np.empty((_LEVELS, 3, 4, 4)), allocate_planes()


@jit
def begin(path: HomotopyScratch, k: int, x: FloatArray) -> None:
    """Set the unit vector x (4,) as the start from which root k is followed."""
    roots = path[0]
    put_real_part(roots, k, (x[0], x[1], x[2], x[3]))
    roots[FRACTION_ROW + k] = 0.0


@jit
def follow(
    rotation: FloatArray,
    place: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    path: HomotopyScratch,
    shortest: float,
) -> None:
    """Follow real roots while the errors grow from zero to those of the machine.

    Parameters
    ----------
    rotation, place : ndarray, shapes (3, 3) and (3,)
        The pose, its position in units of the middle platform's radius.
    nominal, built : ndarray, shape (3, 6, 3)
        Axes, pivots and balls of the nominal machine and of the one as built.
    path : HomotopyScratch, changed
        The first of `forms` are the quadrics of the machine as built. Roots that `begin` put into `roots` are followed;
        those that arrived have parts of 1 in the end.
    shortest : float
        Shortest step, as a part of the errors.
    """
    roots, trial, targets, forms, planes = path
    level, done = 0, 0.0
    targets[0] = 1.0
    # Upon a target that some root cannot be led to in one step the half of the way there is put.
    while level >= 0:
        waiting = False
        for k in range(POINTS):
            tried = roots[FRACTION_ROW + k] == done
            waiting |= tried
            trial[STATE + k] = PENDING if tried else FAILED
            put_real_part(trial, k, real_part(roots, k))
        if waiting:
            polish(forms[level], trial, False, True, 10)
            waiting = False
            for k in range(POINTS):
                if trial[STATE + k] == CONVERGED:
                    roots[FRACTION_ROW + k] = targets[level]
                    put_real_part(roots, k, real_part(trial, k))
                elif roots[FRACTION_ROW + k] == done:
                    waiting = True
        if waiting and 0.5 * (targets[level] - done) >= shortest:
            level += 1
            targets[level] = 0.5 * (done + targets[level - 1])
            put_planes(rotation, place, nominal, built, targets[level], planes)
            put_quadrics(planes, forms[level])
        else:
            done = targets[level]
            level -= 1


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, Array(c16, 4, 'A', True), "
    f"{readonly_array(3)}, {readonly_array(3)}, f8, f8[:,:,:,::1], f8[:,:,::1], u1[:,::1], i1[::1], c16[:,:,:,::1])"
)
def as_built_branches(
    rotation: FloatArray,
    position: FloatArray,
    nominal_joints: FloatArray,
    nominal_complex_joints: ComplexArray,
    nominal: FloatArray,
    built: FloatArray,
    unit: float,
    joints: FloatArray,
    lengths: FloatArray,
    carried: npt.NDArray[np.uint8],
    status: npt.NDArray[np.int8],
    complex_joints: ComplexArray,
) -> None:
    """Solve N poses.

    Parameters
    ----------
    rotation, position : ndarray, shapes (N, 3, 3) and (N, 3)
        R and o [m].
    nominal_joints, nominal_complex_joints : ndarray, shape (N, 8, 3, 3)
        b_i of the nominal machine [m]: of its real branches, NaN where one is not, and of all.
    nominal, built : ndarray, shape (3, 6, 3)
        Axes, pivots and balls of the nominal machine and of the one as built, in units of `unit`.
    unit : float
        The middle platform's radius [m].
    joints, lengths : ndarray, shapes (N, 8, 3, 3) and (N, 8, 6), written
        Centres of the lower legs' balls and lengths of the legs without offsets [m], NaN where a branch is not real.
    carried : ndarray, shape (N, 8), written
        1 where the branch of the nominal machine was followed to the root under its label, 0 where it ended on the way
        or where a real root has a label left over; 2 where neither the nominal machine nor this one has the branch.
    status : ndarray, shape (N,), written
        `Status` of each pose.
    complex_joints : ndarray, shape (N, 8, 3, 3), written; or of no length
        Centres of the lower legs' balls of all roots.
    """
    path, planes, elimination = allocate_path(), allocate_planes(), allocate_elimination()
    reached, forms = path[0], path[3]
    roots, found, own = np.empty(8 * POINTS), np.empty((8, 6, 3), np.complex128), np.empty((6, 3))
    label_of, root_of = np.empty(8, np.int64), np.empty(8, np.int64)
    place, start = np.empty(3), np.empty((8, 4))
    for n in range(len(position)):
        for i in range(3):
            place[i] = position[n, i] / unit
        joints[n], lengths[n], carried[n] = np.nan, np.nan, 2
        if len(complex_joints):
            complex_joints[n] = np.nan
        put_planes(rotation[n], place, nominal, built, 1.0, planes)
        spans = put_quadrics(planes, forms[0])
        count = eight_roots(forms[0], elimination, roots) if spans else 0
        if count < 8:
            status[n] = UNSOLVED if spans else DEGENERATE
            continue
        left = 0
        for k in range(8):
            label_of[k], root_of[k] = -1, -1
            left += 1 if is_real(roots, k) else 0
            if not np.isnan(nominal_joints[n, k, 0, 0]):
                carried[n, k] = 0
                put_quaternion(nominal_joints[n, k], start[k])
        for shortest in (1.0, SHORTEST_AT_FIRST, _SHORTEST):
            # A branch that has not arrived can only arrive at a root that is real and no other's.
            if left == 0 and shortest < 1.0:
                break
            for k in range(8):
                if carried[n, k] == 0:
                    begin(path, k, start[k])
            follow(rotation[n], place, nominal, built, path, shortest)
            left -= _claim(roots, reached, carried[n], label_of, root_of)
        if left > 0 or len(complex_joints):
            for k in range(8):
                label_of[k] = max(label_of[k], -1)
                image(point(roots, k), planes, found[k])
            _assign_left_over(nominal_complex_joints[n], found, unit, label_of, root_of)
        status[n] = UNREACHABLE
        for label in range(8):
            k = root_of[label]
            if len(complex_joints):
                for i in range(3):
                    for j in range(3):
                        complex_joints[n, label, i, j] = found[k, i, j] * unit
            if k >= 0 and is_real(roots, k):
                status[n] = OK
                carried[n, label] = carried[n, label] % 2
                image(real_part(roots, k), planes, own)
                for i in range(6):
                    square = 0.0
                    for j in range(3):
                        pivot = built[1, i, j]
                        if i >= 3:
                            pivot = place[j]
                            for m in range(3):
                                pivot += rotation[n, j, m] * built[1, i, m]
                        else:
                            joints[n, label, i, j] = own[i, j] * unit
                        square += (own[i, j] - pivot) ** 2
                    lengths[n, label, i] = math.sqrt(square) * unit


@jit
def _claim(
    roots: FloatArray,
    reached: FloatArray,
    carried: npt.NDArray[np.uint8],
    label_of: npt.NDArray[np.int64],
    root_of: npt.NDArray[np.int64],
) -> int:
    """Give labels to the real roots at which branches arrived; return how many more roots have one."""
    claimed = 0
    for label in range(8):
        if carried[label] != 0 or reached[FRACTION_ROW + label] != 1.0:
            continue
        x = point(reached, label)
        for k in range(8):
            if is_real(roots, k) and is_same_point(x, point(roots, k), SAME_ROOT):
                # Two that arrive at one root: neither label is certain.
                if label_of[k] >= 0:
                    carried[label_of[k]], root_of[label_of[k]], label_of[k] = 0, -1, _DISPUTED
                    claimed -= 1
                elif label_of[k] != _DISPUTED:
                    carried[label], root_of[label], label_of[k] = 1, k, label
                    claimed += 1
                break
    return claimed


@jit
def _assign_left_over(
    nominal_joints: ComplexArray,
    found: ComplexArray,
    unit: float,
    label_of: npt.NDArray[np.int64],
    root_of: npt.NDArray[np.int64],
) -> None:
    """Give the labels left over to the roots left over, the pairs nearest in their ball centres first."""
    while True:
        nearest, best_label, best_root = np.inf, -1, -1
        for label in range(8):
            if root_of[label] < 0:
                for k in range(8):
                    if label_of[k] < 0:
                        distance = 0.0
                        for i in range(3):
                            for j in range(3):
                                gap = found[k, i, j] - nominal_joints[label, i, j] / unit
                                distance = max(distance, gap.real * gap.real + gap.imag * gap.imag)
                        if best_label < 0 or distance < nearest:
                            nearest, best_label, best_root = distance, label, k
        if best_label < 0:
            return
        label_of[best_root], root_of[best_label] = best_label, best_root
