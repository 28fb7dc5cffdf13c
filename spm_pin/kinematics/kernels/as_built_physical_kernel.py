"""The physical branch of an imperfect machine: Newton's method from that of the nominal machine, on three quadrics.

For errors well below `_DOUBT`. A pose at which a branch in question cannot be followed is left to the complete
solution.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.as_built_kernels import (
    PART,
    allocate_path,
    begin,
    follow,
    put_planes,
)
from spm_pin.kinematics.kernels.compilation import jit, kernel, readonly_array
from spm_pin.kinematics.kernels.quadric_newton import part, point
from spm_pin.kinematics.kernels.quadric_roots import is_same_point
from spm_pin.kinematics.kernels.three_quadrics import allocate_planes, image, put_quadrics, put_quaternion
from spm_pin.mechanism.arguments import FloatArray

_COS_30 = math.sqrt(0.75)

_FIRST = 0.02
_MOVED = 1e9
_DOUBT = 0.05
"""A branch of the nominal machine whose margin is below the negative of this is not physical in this machine either."""


@jit
def _across(balls: FloatArray, i: int, j: int, axis: FloatArray, leg: FloatArray) -> float:
    """Return (b_i - b_j) · (axis x leg)."""
    g0, g1, g2 = balls[i, 0] - balls[j, 0], balls[i, 1] - balls[j, 1], balls[i, 2] - balls[j, 2]
    w0, w1 = axis[1] * leg[2] - axis[2] * leg[1], axis[2] * leg[0] - axis[0] * leg[2]
    return float(g0 * w0 + g1 * w1 + g2 * (axis[0] * leg[1] - axis[1] * leg[0]))


@jit
def _margin(
    balls: FloatArray,
    rotation: FloatArray,
    place: FloatArray,
    axes: FloatArray,
    pivots: FloatArray,
    lengths: FloatArray,
    legs: FloatArray,
) -> tuple[float, float]:
    """Return a number that is positive where a state is physical, see `physical`, and its tilt_cosine_sum.

    `balls` (6, 3), `axes` (6, 3), the upper ones along y of a leg's own azimuth as the lower ones, and `pivots` (6, 3)
    are in {B}, in units of r; `lengths` (6,) and the unit vectors along the `legs` (6, 3) are written.
    """
    for i in range(6):
        sign = 1.0 if i < 3 else -1.0
        square = 0.0
        for j in range(3):
            legs[i, j] = sign * (balls[i, j] - pivots[i, j])
            square += legs[i, j] * legs[i, j]
        lengths[i] = math.sqrt(square)
        for j in range(3):
            legs[i, j] /= lengths[i]
    b = balls
    c0, c1 = (b[0, 0] + b[1, 0] + b[2, 0]) / 3.0, (b[0, 1] + b[1, 1] + b[2, 1]) / 3.0
    c2 = (b[0, 2] + b[1, 2] + b[2, 2]) / 3.0
    r = rotation
    height = r[0, 2] * (place[0] - c0) + r[1, 2] * (place[1] - c1) + r[2, 2] * (place[2] - c2)
    margin = min(c2, height)
    lower = _COS_30 * (b[0, 0] - b[2, 0]) - 0.5 * (b[0, 1] + b[2, 1]) + b[1, 1]
    upper = 0.0
    for j in range(3):
        upper += r[j, 0] * _COS_30 * (b[0, j] - b[2, j]) + r[j, 1] * (b[1, j] - 0.5 * (b[0, j] + b[2, j]))
    margin = min(margin, lower / 3.0, upper / 3.0)
    for stage in range(2):
        s = 3 * stage
        least, second = np.inf, np.inf
        total = 0.0
        for turn in range(2):
            product = 1.0
            for i in range(3):
                # (0, 1), (1, 2), (2, 0), then (1, 0), (2, 1), (0, 2)
                first, other = (i, (i + 1) % 3) if turn == 0 else ((i + 1) % 3, i)
                value = _across(balls[s : s + 3], first, other, axes[s + first], legs[s + first])
                product *= value
                if value < least:
                    least, second = value, least
                elif value < second:
                    second = value
            total += product
        margin = min(margin, second, total)
    u0, u1, u2 = b[0, 0] - b[2, 0], b[0, 1] - b[2, 1], b[0, 2] - b[2, 2]
    v0, v1 = 2.0 * b[1, 0] - b[0, 0] - b[2, 0], 2.0 * b[1, 1] - b[0, 1] - b[2, 1]
    v2 = 2.0 * b[1, 2] - b[0, 2] - b[2, 2]
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    along = n2 + n0 * r[0, 2] + n1 * r[1, 2] + n2 * r[2, 2]
    return margin, along / math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@jit
def _put_frame(
    machine: FloatArray,
    signs: FloatArray,
    rotation: FloatArray,
    place: FloatArray,
    axes: FloatArray,
    pivots: FloatArray,
) -> None:
    """Write the axes of a machine (3, 6, 3), with these signs, and its pivots in {B}."""
    for i in range(6):
        for j in range(3):
            if i < 3:
                axes[i, j], pivots[i, j] = signs[i] * machine[0, i, j], machine[1, i, j]
            else:
                axis, pivot = 0.0, place[j]
                for m in range(3):
                    axis += rotation[j, m] * machine[0, i, m]
                    pivot += rotation[j, m] * machine[1, i, m]
                axes[i, j], pivots[i, j] = signs[i] * axis, pivot


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(4)}, {readonly_array(3)}, {readonly_array(3)}, "
    f"{readonly_array(1)}, {readonly_array(2)}, f8, f8[:,:,::1], f8[:,::1], b1[::1])"
)
def certain_physical_branches(
    rotation: FloatArray,
    position: FloatArray,
    nominal_joints: FloatArray,
    nominal: FloatArray,
    built: FloatArray,
    signs: FloatArray,
    limits: FloatArray,
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
    signs : ndarray, shape (6,)
        Signs that make the axes tangents of their platforms.
    limits : ndarray, shape (2, 6)
        Least and largest lengths of the legs [m], without offsets.
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
    place, x, found, reach = np.empty(3), np.empty(4), np.empty((2, 6, 3)), np.empty((2, 6))
    possible = np.empty(2, np.bool_)
    for n in range(len(position)):
        joints[n], lengths[n], certain[n] = np.nan, np.nan, False
        if np.isnan(nominal_joints[n, 0, 0, 0]) or np.isnan(nominal_joints[n, 1, 0, 0]):
            continue
        for j in range(3):
            place[j] = position[n, j] / unit
        put_planes(rotation[n], place, nominal, built, 1.0, planes)
        if not put_quadrics(planes, forms[0]):
            continue
        _put_frame(nominal, signs, rotation[n], place, axes, pivots)
        for side in range(2):
            for i in range(3):
                for j in range(3):
                    found[side, i, j] = found[side, 3 + i, j] = nominal_joints[n, side, i, j] / unit
            margin, _ = _margin(found[side], rotation[n], place, axes, pivots, reach[side], legs)
            possible[side] = True
            if possible[side]:
                put_quaternion(nominal_joints[n, side], x)
                begin(path, side, x)
        follow(rotation[n], place, nominal, built, path, _FIRST)
        best, best_score, best_straight, sure = -1, 0, 0.0, True
        _put_frame(built, signs, rotation[n], place, axes, pivots)
        if is_same_point(point(roots, 0), point(roots, 1), 1e-6):
            sure = False
        for side in range(2):
            if not possible[side]:
                continue
            if roots[PART + side] != 1.0:
                sure = False
                break
            image(part(roots, 0, side), planes, found[side])
            for i in range(3):
                for j in range(3):
                    if abs(found[side, i, j] - nominal_joints[n, side, i, j] / unit) > _MOVED:
                        sure = False
            margin, straight = _margin(found[side], rotation[n], place, axes, pivots, reach[side], legs)
            if margin <= 0.0:
                continue
            inside = True
            for i in range(6):
                length = reach[side, i] * unit
                inside = inside and limits[0, i] <= length <= limits[1, i]
            score = 2 if inside else 1
            if score > best_score or (score == best_score and straight > best_straight):
                best, best_score, best_straight = side, score, straight
        if not sure or best < 0:
            continue
        certain[n] = True
        for i in range(3):
            for j in range(3):
                joints[n, i, j] = found[best, i, j] * unit
        for i in range(6):
            lengths[n, i] = reach[best, i] * unit
