"""Inverse displacement of an imperfect machine for a batch of poses: all branches, under the ideal machine's labels.

All eight roots are solved for, see `quadric_elimination`. Each real branch of the ideal machine is then followed while
the errors grow from zero to those of the machine, and gives its label to the root where it ends. Where it meets another
branch it ends on the way; the roots left over take the labels left over, marked as not carried.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import jit, kernel, readonly_array
from spm_pin.closed_form.kernels.quadric_elimination import eight_roots
from spm_pin.closed_form.kernels.three_quadrics import (
    image,
    newton_step,
    polished,
    projective_distance,
    put_quadrics,
    put_quaternion,
)
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["SHORTEST_AT_FIRST", "as_built_branches", "followed", "put_planes"]

ComplexArray = npt.NDArray[np.complex128]

OK, UNREACHABLE, DEGENERATE, UNSOLVED = 0, 1, 2, 3
_SHORTEST = 1e-7
"""A step of the errors shorter than this part of them stands before two branches that meet."""
SHORTEST_AT_FIRST = 0.02
"""The same while it is not known yet whether any real root will be left for such a branch."""
_FIRST_STEP = 0.1
_CONTRACTION = 0.1
"""Newton's method has to begin with a step of at most the one, and its second be at most this part of the first.

It then converges to the root next to it, and no other is near.
"""
_SAME = 1e-6


@jit
def put_planes(
    rotation: FloatArray,
    position: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    part: float,
    normals: FloatArray,
    heights: FloatArray,
    balls: FloatArray,
) -> None:
    """Write the planes in {B} and the balls in {n} of a machine that has this part of the errors.

    `nominal` and `built` (3, 6, 3) are axes, pivots and balls.
    """
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


@jit
def _is_real(x: ComplexArray) -> bool:
    """Return whether a root that `eight_roots` found is real."""
    return bool(x[0].imag == 0.0 and x[1].imag == 0.0 and x[2].imag == 0.0 and x[3].imag == 0.0)


@jit
def followed(
    rotation: FloatArray,
    position: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    last: FloatArray,
    x: FloatArray,
    trial: FloatArray,
    forms: FloatArray,
    normals: FloatArray,
    heights: FloatArray,
    balls: FloatArray,
    own: FloatArray,
    work: FloatArray,
    shortest: float,
) -> bool:
    """Follow the root x of the ideal machine to the machine as built, with the quadrics `last`; False where it ends."""
    done, step = 0.0, 1.0
    while done < 1.0:
        target = min(done + step, 1.0)
        if target < 1.0:
            put_planes(rotation, position, nominal, built, target, normals, heights, balls)
            put_quadrics(normals, heights, balls, own, forms)
        there = last if target == 1.0 else forms
        for i in range(4):
            trial[i] = x[i]
        first = newton_step(there, trial, work)
        second = newton_step(there, trial, work)
        if first <= _FIRST_STEP and second <= max(_CONTRACTION * first, 1e-13) and polished(there, trial, work, 8):
            for i in range(4):
                x[i] = trial[i]
            done = target
            step *= 2.0
        else:
            step *= 0.5
            if step < shortest:
                return False
    return True


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, Array(c16, 4, 'A', True), "
    f"{readonly_array(3)}, {readonly_array(3)}, f8, f8[:,:,:,::1], f8[:,:,::1], u1[:,::1], i1[::1], c16[:,:,:,::1])"
)
def as_built_branches(
    rotation: FloatArray,
    position: FloatArray,
    ideal: FloatArray,
    ideal_complex: ComplexArray,
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
    ideal, ideal_complex : ndarray, shape (N, 8, 3, 3)
        b_i of the ideal machine [m]: of its real branches, NaN where one is not, and of all.
    nominal, built : ndarray, shape (3, 6, 3)
        Axes, pivots and balls of the ideal machine and of the one as built, in units of `unit`.
    unit : float
        The middle platform's radius [m].
    joints, lengths : ndarray, shapes (N, 8, 3, 3) and (N, 8, 6), written
        Centres of the lower legs' balls and lengths of the legs without offsets [m], NaN where a branch is not real.
    carried : ndarray, shape (N, 8), written
        1 where the branch of the ideal machine was followed to the root under its label, 0 where it ended on the way or
        where a real root has a label left over; 2 where neither the ideal machine nor this one has the branch.
    status : ndarray, shape (N,), written
        `Status` of each pose.
    complex_joints : ndarray, shape (N, 8, 3, 3), written; or of no length
        Centres of the lower legs' balls of all roots.
    """
    forms, last, own = np.empty((3, 4, 4)), np.empty((3, 4, 4)), np.empty((6, 9))
    # Those of the machine as built, and those on the way.
    normals, heights, balls, own_way = np.empty((6, 3)), np.empty(6), np.empty((6, 3)), np.empty((6, 9))
    last_normals, last_heights, last_balls = np.empty((6, 3)), np.empty(6), np.empty((6, 3))
    place, x, trial, work = np.empty(3), np.empty(4), np.empty(4), np.empty((4, 5))
    roots, found = np.empty((8, 4), np.complex128), np.empty((8, 6, 3), np.complex128)
    label_of, root_of, complex_x = np.empty(8, np.int64), np.empty(8, np.int64), np.empty(4, np.complex128)
    for n in range(len(position)):
        for i in range(3):
            place[i] = position[n, i] / unit
        joints[n], lengths[n], carried[n] = np.nan, np.nan, 2
        if len(complex_joints):
            complex_joints[n] = np.nan
        put_planes(rotation[n], place, nominal, built, 1.0, last_normals, last_heights, last_balls)
        spans = put_quadrics(last_normals, last_heights, last_balls, own, last)
        count = eight_roots(last, roots) if spans else 0
        if count < 8:
            status[n] = UNSOLVED if spans else DEGENERATE
            continue
        for k in range(8):
            image(roots[k], last_heights, last_normals, last_balls, own, found[k])
            label_of[k], root_of[k] = -1, -1
        real_roots, claimed = 0, 0
        for k in range(8):
            real_roots += 1 if _is_real(roots[k]) else 0
        for attempt in range(2):
            # A branch that has not arrived can only arrive at a root that is real and no other's.
            if attempt == 1 and claimed >= real_roots:
                break
            for label in range(8):
                if np.isnan(ideal[n, label, 0, 0]) or carried[n, label] == 1:
                    continue
                carried[n, label] = 0
                put_quaternion(ideal[n, label], x)
                shortest = SHORTEST_AT_FIRST if attempt == 0 else _SHORTEST
                if followed(
                    rotation[n],
                    place,
                    nominal,
                    built,
                    last,
                    x,
                    trial,
                    forms,
                    normals,
                    heights,
                    balls,
                    own_way,
                    work,
                    shortest,
                ):
                    for i in range(4):
                        complex_x[i] = complex(x[i], 0.0)
                    for k in range(8):
                        if projective_distance(complex_x, roots[k]) < _SAME and label_of[k] != -2:
                            # Two that arrive at one root: neither label is certain.
                            if label_of[k] >= 0:
                                carried[n, label_of[k]] = 0
                                root_of[label_of[k]] = -1
                                label_of[k] = -2
                                claimed -= 1
                            else:
                                label_of[k], root_of[label] = label, k
                                carried[n, label] = 1
                                claimed += 1
                            break
        for k in range(8):
            label_of[k] = max(label_of[k], -1)
        _assign_rest(ideal_complex[n], found, unit, label_of, root_of)
        status[n] = UNREACHABLE
        for label in range(8):
            k = root_of[label]
            if len(complex_joints):
                for i in range(3):
                    for j in range(3):
                        complex_joints[n, label, i, j] = found[k, i, j] * unit
            if _is_real(roots[k]):
                status[n] = OK
                carried[n, label] = carried[n, label] % 2
                for i in range(3):
                    for j in range(3):
                        joints[n, label, i, j] = found[k, i, j].real * unit
                for i in range(6):
                    square = 0.0
                    for j in range(3):
                        pivot = built[1, i, j]
                        if i >= 3:
                            pivot = place[j]
                            for m in range(3):
                                pivot += rotation[n, j, m] * built[1, i, m]
                        square += (found[k, i, j].real - pivot) ** 2
                    lengths[n, label, i] = math.sqrt(square) * unit


@jit
def _assign_rest(
    ideal: ComplexArray,
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
                                distance = max(distance, abs(found[k, i, j] - ideal[label, i, j] / unit))
                        if best_label < 0 or distance < nearest:
                            nearest, best_label, best_root = distance, label, k
        if best_label < 0:
            return
        label_of[best_root], root_of[best_label] = best_label, best_root
