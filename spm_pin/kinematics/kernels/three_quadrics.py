"""Three quadrics in the projective space of quaternions: their forms from six leg planes, ball centres from a root.

The six leg planes n_i · (R p_i + t) = h_i are linear in t. The left null space of the 6 x 3 matrix of the n_i leaves
three equations in R alone, quadratic forms x^T Q_k x of the quaternion x, scalar last. Lengths are in units of the
middle platform's radius.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.kinematics.formulas.quadrics import StagePlanes, quadric, rotation
from spm_pin.kinematics.formulas.vectors import Rows
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.mechanism.arguments import FloatArray

Planes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Normals (6, 3) and heights (6,) of planes in {B}, the balls (6, 3) in {n} that lie in them, and the factors (6, 9) of
the normals N = Qᵀ R: R in factors[:3, :3], and Q, whose last three rows are the null space, in factors[:, 3:]."""
_FLAT = 1e-13


@jit_inline
def rows_at(array: FloatArray, first: int) -> Rows:
    """Return three rows of an array of vectors."""
    x, y, z = array[first], array[first + 1], array[first + 2]
    return (x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2])


@jit_inline
def allocate_planes() -> Planes:
    """Allocate the arrays of six planes."""
    return np.empty((6, 3)), np.empty(6), np.empty((6, 3)), np.empty((6, 9))


@jit
def put_quadrics(planes: Planes, forms: FloatArray) -> bool:
    """Write the three quadrics of six planes.

    Parameters
    ----------
    planes : Planes
        Normals, heights and balls are read, factors written.
    forms : ndarray, shape (3, 4, 4), written
        Symmetric matrices of norm 1.

    Returns
    -------
    bool
        Whether the normals span space; if not, t is not determined by the rotation.
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
    lower = StagePlanes(rows_at(normals, 0), (heights[0], heights[1], heights[2]), rows_at(balls, 0))
    upper = StagePlanes(rows_at(normals, 3), (heights[3], heights[4], heights[5]), rows_at(balls, 3))
    for k in range(3):
        weights, form = factors[3 + k, 3:], forms[k]
        numbers = quadric((weights[0], weights[1], weights[2]), (weights[3], weights[4], weights[5]), lower, upper)
        form[0, 0], form[1, 1], form[2, 2], form[3, 3] = numbers[0], numbers[1], numbers[2], numbers[3]
        form[0, 1], form[0, 2], form[1, 2] = numbers[4], numbers[5], numbers[6]
        form[0, 3], form[1, 3], form[2, 3] = numbers[7], numbers[8], numbers[9]
        square = 0.0
        for i in range(4):
            for j in range(i):
                form[i, j] = form[j, i]
                square += 2.0 * form[i, j] * form[i, j]
            square += form[i, i] * form[i, i]
        scale = 1.0 / math.sqrt(square) if square > 0.0 else 0.0
        for i in range(4):
            for j in range(4):
                form[i, j] *= scale
    return spans


@jit
def put_quaternion(b: FloatArray, x: FloatArray) -> None:
    """Write the quaternion (4,), scalar last, of the middle platform with its joints at the rows of b (3, 3)."""
    u0, u1, u2 = b[0, 0] - b[2, 0], b[0, 1] - b[2, 1], b[0, 2] - b[2, 2]
    size = 1.0 / math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
    u0, u1, u2 = u0 * size, u1 * size, u2 * size
    v0, v1 = 2.0 * b[1, 0] - b[0, 0] - b[2, 0], 2.0 * b[1, 1] - b[0, 1] - b[2, 1]
    v2 = 2.0 * b[1, 2] - b[0, 2] - b[2, 2]
    size = u0 * v0 + u1 * v1 + u2 * v2
    v0, v1, v2 = v0 - size * u0, v1 - size * u1, v2 - size * u2
    size = 1.0 / math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = v0 * size, v1 * size, v2 * size
    w0, w1, w2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    # The column of x xᵀ with the largest diagonal entry keeps the digits.
    xx, yy, zz, ww = u0 - v1 - w2, v1 - u0 - w2, w2 - u0 - v1, u0 + v1 + w2
    if ww >= xx and ww >= yy and ww >= zz:
        x[0], x[1], x[2], x[3] = v2 - w1, w0 - u2, u1 - v0, 1.0 + ww
    elif xx >= yy and xx >= zz:
        x[0], x[1], x[2], x[3] = 1.0 + xx, v0 + u1, w0 + u2, v2 - w1
    elif yy >= zz:
        x[0], x[1], x[2], x[3] = v0 + u1, 1.0 + yy, w1 + v2, w0 - u2
    else:
        x[0], x[1], x[2], x[3] = w0 + u2, w1 + v2, 1.0 + zz, u1 - v0
    size = 1.0 / math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + x[3] * x[3])
    for i in range(4):
        x[i] *= size


@jit
def image(x, planes, joints):  # type: ignore[no-untyped-def]
    """Write the six ball centres (6, 3) in {B} of a root, four numbers, for planes as `put_quadrics` left them."""
    normals, heights, balls, factors = planes
    a, b, c, d = x[0], x[1], x[2], x[3]
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rotation(a, b, c, d)
    s0 = s1 = s2 = 0.0 * r00
    for i in range(6):
        p0, p1, p2 = balls[i, 0], balls[i, 1], balls[i, 2]
        y0, y1, y2 = r00 * p0 + r01 * p1 + r02 * p2, r10 * p0 + r11 * p1 + r12 * p2, r20 * p0 + r21 * p1 + r22 * p2
        joints[i, 0], joints[i, 1], joints[i, 2] = y0, y1, y2
        gap = heights[i] - (normals[i, 0] * y0 + normals[i, 1] * y1 + normals[i, 2] * y2)
        s0 += factors[0, 3 + i] * gap
        s1 += factors[1, 3 + i] * gap
        s2 += factors[2, 3 + i] * gap
    t2 = s2 / factors[2, 2]
    t1 = (s1 - factors[1, 2] * t2) / factors[1, 1]
    t0 = (s0 - factors[0, 1] * t1 - factors[0, 2] * t2) / factors[0, 0]
    for i in range(6):
        joints[i, 0] += t0
        joints[i, 1] += t1
        joints[i, 2] += t2
