"""The physical branch of a machine as built: TT+ and TT- of the drawn machine are followed, and one of them is chosen.

Both are followed whatever they are like: near a level pose a branch moves by far more than the errors, so that one far
from physical can become the physical one. A pose is left to the solution for all roots where one of the two cannot be
followed, or both lead to one root, and where some other root may have become physical.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.formulas.stages import is_home_aspect
from spm_pin.kinematics.formulas.wrenches import normals, pairs
from spm_pin.kinematics.kernels.as_built_kernels import (
    FRACTION_ROW,
    SHORTEST_AT_FIRST,
    allocate_path,
    begin,
    follow,
    put_planes,
)
from spm_pin.kinematics.kernels.compilation import jit, kernel, readonly_array
from spm_pin.kinematics.kernels.quadric_newton import point, real_part
from spm_pin.kinematics.kernels.quadric_roots import SAME_ROOT, is_same_point
from spm_pin.kinematics.kernels.three_quadrics import allocate_planes, image, put_quadrics, put_quaternion, rows_at
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import TANGENT_SIGNS

_COS_30 = math.sqrt(0.75)
_LEVEL = 0.25
"""Largest error of a leg's plane, in units of r, over the sine of the platform's tilt, at which roots of other families
stay far from physical: towards a level pose the equations shrink with the tilt, and the errors do not."""


@jit
def _upright(b: FloatArray, rotation: FloatArray, place: FloatArray) -> float:
    """Return the least of both stages' heights and mean radii, positive for a physical state; b (3, 3) or more rows."""
    r = rotation
    c0, c1 = (b[0, 0] + b[1, 0] + b[2, 0]) / 3.0, (b[0, 1] + b[1, 1] + b[2, 1]) / 3.0
    c2 = (b[0, 2] + b[1, 2] + b[2, 2]) / 3.0
    height = r[0, 2] * (place[0] - c0) + r[1, 2] * (place[1] - c1) + r[2, 2] * (place[2] - c2)
    lower = _COS_30 * (b[0, 0] - b[2, 0]) - 0.5 * (b[0, 1] + b[2, 1]) + b[1, 1]
    upper = 0.0
    for j in range(3):
        upper += r[j, 0] * _COS_30 * (b[0, j] - b[2, j]) + r[j, 1] * (b[1, j] - 0.5 * (b[0, j] + b[2, j]))
    return float(min(c2, height, lower / 3.0, upper / 3.0))


@jit
def _is_at_home(b: FloatArray, axes: FloatArray, legs: FloatArray) -> bool:
    """Return whether a stage is in the aspect of its home, see `is_home_aspect`; rows of three legs."""
    return is_home_aspect(pairs(rows_at(b, 0), normals(rows_at(axes, 0), rows_at(legs, 0))))


@jit
def _tilt_cosine_sum(b: FloatArray, rotation: FloatArray) -> float:
    """Return the sum of the cosines of the stages' tilts."""
    u0, u1, u2 = b[0, 0] - b[2, 0], b[0, 1] - b[2, 1], b[0, 2] - b[2, 2]
    v0, v1 = 2.0 * b[1, 0] - b[0, 0] - b[2, 0], 2.0 * b[1, 1] - b[0, 1] - b[2, 1]
    v2 = 2.0 * b[1, 2] - b[0, 2] - b[2, 2]
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    along = n2 + n0 * rotation[0, 2] + n1 * rotation[1, 2] + n2 * rotation[2, 2]
    return float(along / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2))


@jit
def _put_legs(balls: FloatArray, pivots: FloatArray, legs: FloatArray, lengths: FloatArray) -> None:
    """Write the vectors of the legs (6, 3), from pivot to ball or from ball to pivot, and their lengths (6,)."""
    for i in range(6):
        square = 0.0
        for j in range(3):
            legs[i, j] = balls[i, j] - pivots[i, j] if i < 3 else pivots[i, j] - balls[i, j]
            square += legs[i, j] * legs[i, j]
        lengths[i] = math.sqrt(square)


@jit
def _put_frame(
    machine: FloatArray,
    rotation: FloatArray,
    place: FloatArray,
    axes: FloatArray,
    pivots: FloatArray,
) -> None:
    """Write the axes of a machine (3, 6, 3), as tangents of their platforms, and its pivots in {B}."""
    for i in range(6):
        sign = TANGENT_SIGNS[i]
        for j in range(3):
            if i < 3:
                axes[i, j], pivots[i, j] = sign * machine[0, i, j], machine[1, i, j]
            else:
                axis, pivot = 0.0, place[j]
                for m in range(3):
                    axis += rotation[j, m] * machine[0, i, m]
                    pivot += rotation[j, m] * machine[1, i, m]
                axes[i, j], pivots[i, j] = sign * axis, pivot


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, {readonly_array(3)}, {readonly_array(3)}, "
    f"{readonly_array(2)}, f8, f8, f8[:,:,::1], f8[:,::1], b1[::1])"
)
def certain_physical_branches(
    rotation: FloatArray,
    position: FloatArray,
    nominal_joints: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    limits: FloatArray,
    error: float,
    unit: float,
    joints: FloatArray,
    lengths: FloatArray,
    certain: npt.NDArray[np.bool_],
) -> None:
    """Solve N poses.

    Parameters
    ----------
    rotation, position : ndarray, shapes (N, 3, 3) and (N, 3)
        R and o [m].
    nominal_joints : ndarray, shape (N, 8, 3, 3)
        b_i of the nominal machine's branches [m], NaN where one is not real.
    nominal, built : ndarray, shape (3, 6, 3)
        Axes, pivots and balls of the nominal machine and of the one as built, in units of `unit`.
    limits : ndarray, shape (2, 6)
        Least and largest lengths of the legs [m], without offsets.
    error : float
        Largest error of an axis' component, or of a pivot's or ball's coordinate in units of `unit`.
    unit : float
        The middle platform's radius [m].
    joints, lengths : ndarray, shapes (N, 3, 3) and (N, 6), written
        Centres of the lower legs' balls and lengths of the legs without offsets [m].
    certain : ndarray of bool, shape (N,), written
        Whether there is such a branch and no doubt which it is; the results are NaN elsewhere.
    """
    path, planes = allocate_path(), allocate_planes()
    roots, forms = path[0], path[3]
    axes, pivots, legs = np.empty((6, 3)), np.empty((6, 3)), np.empty((6, 3))
    place, x, balls, reach = np.empty(3), np.empty(4), np.empty((2, 6, 3)), np.empty((2, 6))
    for n in range(len(position)):
        joints[n], lengths[n], certain[n] = np.nan, np.nan, False
        if np.isnan(nominal_joints[n, 0, 0, 0]) or np.isnan(nominal_joints[n, 1, 0, 0]):
            continue
        distance = 0.0
        for j in range(3):
            place[j] = position[n, j] / unit
            distance += abs(place[j])
        if not error * (1.0 + distance) <= _LEVEL * math.hypot(rotation[n, 0, 2], rotation[n, 1, 2]):
            continue
        put_planes(rotation[n], place, nominal, built, 1.0, planes)
        if not put_quadrics(planes, forms[0]):
            continue
        for side in range(2):
            put_quaternion(nominal_joints[n, side], x)
            begin(path, side, x)
        follow(rotation[n], place, nominal, built, path, SHORTEST_AT_FIRST)
        if roots[FRACTION_ROW] != 1.0 or roots[FRACTION_ROW + 1] != 1.0:
            continue
        if is_same_point(point(roots, 0), point(roots, 1), SAME_ROOT):
            continue
        best, best_score, best_cosines = -1, 0, 0.0
        _put_frame(built, rotation[n], place, axes, pivots)
        for side in range(2):
            image(real_part(roots, side), planes, balls[side])
            _put_legs(balls[side], pivots, legs, reach[side])
            if not _upright(balls[side], rotation[n], place) > 0.0:
                continue
            if not (
                _is_at_home(balls[side, :3], axes[:3], legs[:3]) and _is_at_home(balls[side, 3:], axes[3:], legs[3:])
            ):
                continue
            inside = True
            for i in range(6):
                length = reach[side, i] * unit
                inside = inside and limits[0, i] <= length <= limits[1, i]
            score = 2 if inside else 1
            cosines = _tilt_cosine_sum(balls[side], rotation[n])
            if score > best_score or (score == best_score and cosines > best_cosines):
                best, best_score, best_cosines = side, score, cosines
        if best < 0:
            continue
        certain[n] = True
        for i in range(3):
            for j in range(3):
                joints[n, i, j] = balls[best, i, j] * unit
        for i in range(6):
            lengths[n, i] = reach[best, i] * unit
