"""Three quadrics in the projective space of quaternions: made of six leg planes, and Newton's method on them.

The six leg planes n_i · (R p_i + t) = h_i are linear in t. The left null space of the 6 x 3 matrix of the n_i leaves
three equations in R alone, quadratic forms x^T Q_k x of the quaternion x, scalar last. Lengths are in units of the
middle platform's radius.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import jit
from spm_pin.mechanism.arguments import FloatArray

__all__ = [
    "SEPARATE",
    "image",
    "is_real",
    "newton_step",
    "polished",
    "projective_distance",
    "put_quadrics",
    "put_quaternion",
    "solve_4x4",
]

ComplexArray = npt.NDArray[np.complex128]

SEPARATE = 1e-8
"""Projective distance above which two roots differ: rounding moves both members of a pair by less than their distance
as long as that is above the square root of the precision."""
_FLAT = 1e-13


@jit
def put_quadrics(
    normals: FloatArray, heights: FloatArray, balls: FloatArray, own: FloatArray, forms: FloatArray
) -> bool:
    """Write the three quadrics of six planes.

    Parameters
    ----------
    normals, heights, balls : ndarray, shapes (6, 3), (6,) and (6, 3)
        The planes in {B}, and the points in {n} that lie in them.
    own : ndarray, shape (6, 9), written
        The factors of the normals N = Qᵀ R: R in own[:3, :3], and Q, whose last three rows are the null space, in
        own[:, 3:].
    forms : ndarray, shape (3, 4, 4), written
        Symmetric matrices of norm 1.

    Returns
    -------
    bool
        Whether the normals span space; if not, t is not determined by the rotation.
    """
    # Householder reflections of (normals | identity), the identity's last three rows being the null space.
    for i in range(6):
        for j in range(3):
            own[i, j] = normals[i, j]
        for j in range(6):
            own[i, 3 + j] = 1.0 if i == j else 0.0
    spans = True
    for j in range(3):
        square = 0.0
        for i in range(j, 6):
            square += own[i, j] * own[i, j]
        size = math.sqrt(square)
        if not size > _FLAT:
            spans = False
            continue
        size = -size if own[j, j] > 0.0 else size
        pivot = own[j, j] - size
        factor = -1.0 / (size * pivot)
        column = (pivot, own[1, j], own[2, j], own[3, j], own[4, j], own[5, j])
        for k in range(j, 9):
            total = pivot * own[j, k]
            for i in range(j + 1, 6):
                total += column[i] * own[i, k]
            total *= factor
            own[j, k] -= total * pivot
            for i in range(j + 1, 6):
                own[i, k] -= total * column[i]
    for k in range(3):
        c = 0.0
        m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0
        for i in range(6):
            weight = own[3 + k, 3 + i]
            c += weight * heights[i]
            a0, a1, a2 = weight * normals[i, 0], weight * normals[i, 1], weight * normals[i, 2]
            p0, p1, p2 = balls[i, 0], balls[i, 1], balls[i, 2]
            m00 += a0 * p0
            m01 += a0 * p1
            m02 += a0 * p2
            m10 += a1 * p0
            m11 += a1 * p1
            m12 += a1 * p2
            m20 += a2 * p0
            m21 += a2 * p1
            m22 += a2 * p2
        form = forms[k]
        form[0, 0], form[1, 1] = m00 - m11 - m22 - c, m11 - m00 - m22 - c
        form[2, 2], form[3, 3] = m22 - m00 - m11 - c, m00 + m11 + m22 - c
        form[0, 1], form[0, 2], form[1, 2] = m01 + m10, m02 + m20, m12 + m21
        form[0, 3], form[1, 3], form[2, 3] = m21 - m12, m02 - m20, m10 - m01
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
def image(x, heights, normals, balls, own, joints):  # type: ignore[no-untyped-def]
    """Write the six ball centres (6, 3) in {B} of a root x (4,), real or complex; `own` as `put_quadrics` left it."""
    a, b, c, d = x[0], x[1], x[2], x[3]
    scale = 1.0 / (a * a + b * b + c * c + d * d)
    r00, r11 = (a * a - b * b - c * c + d * d) * scale, (b * b - a * a - c * c + d * d) * scale
    r22 = (c * c - a * a - b * b + d * d) * scale
    r01, r10 = 2.0 * (a * b - c * d) * scale, 2.0 * (a * b + c * d) * scale
    r02, r20 = 2.0 * (a * c + b * d) * scale, 2.0 * (a * c - b * d) * scale
    r12, r21 = 2.0 * (b * c - a * d) * scale, 2.0 * (b * c + a * d) * scale
    s0 = s1 = s2 = 0.0 * scale
    for i in range(6):
        p0, p1, p2 = balls[i, 0], balls[i, 1], balls[i, 2]
        y0, y1, y2 = r00 * p0 + r01 * p1 + r02 * p2, r10 * p0 + r11 * p1 + r12 * p2, r20 * p0 + r21 * p1 + r22 * p2
        joints[i, 0], joints[i, 1], joints[i, 2] = y0, y1, y2
        gap = heights[i] - (normals[i, 0] * y0 + normals[i, 1] * y1 + normals[i, 2] * y2)
        s0 += own[0, 3 + i] * gap
        s1 += own[1, 3 + i] * gap
        s2 += own[2, 3 + i] * gap
    t2 = s2 / own[2, 2]
    t1 = (s1 - own[1, 2] * t2) / own[1, 1]
    t0 = (s0 - own[0, 1] * t1 - own[0, 2] * t2) / own[0, 0]
    for i in range(6):
        joints[i, 0] += t0
        joints[i, 1] += t1
        joints[i, 2] += t2


@jit
def newton_step(forms, x, work):  # type: ignore[no-untyped-def]
    """Improve a unit vector x (4,), real or complex, by a step of Newton's method across x; return the step's size.

    `work` (4, 5) is of the kind of x. Not a number where the derivative is singular.
    """
    for k in range(3):
        value = 0.0 * x[0]
        for i in range(4):
            total = 0.0 * x[0]
            for j in range(4):
                total += forms[k, i, j] * x[j]
            work[k, i] = 2.0 * total
            value += total * x[i]
        work[k, 4] = value
    for i in range(4):
        work[3, i] = np.conj(x[i])
    work[3, 4] = 0.0
    solve_4x4(work)
    square = 0.0
    norm = 0.0
    for i in range(4):
        square += abs(work[i, 4]) ** 2
        x[i] -= work[i, 4]
        norm += abs(x[i]) ** 2
    for i in range(4):
        x[i] *= 1.0 / math.sqrt(norm)
    return math.sqrt(square)


@jit
def solve_4x4(work):  # type: ignore[no-untyped-def]
    """Solve the 4 x 4 system in `work` (4, 5); the solution is written into its last column."""
    for j in range(4):
        pivot, largest = j, abs(work[j, j])
        for i in range(j + 1, 4):
            if abs(work[i, j]) > largest:
                pivot, largest = i, abs(work[i, j])
        if pivot != j:
            for k in range(j, 5):
                work[j, k], work[pivot, k] = work[pivot, k], work[j, k]
        if not largest > 0.0:
            work[3, 4] = np.nan
            return
        scale = 1.0 / work[j, j]
        for i in range(j + 1, 4):
            factor = work[i, j] * scale
            for k in range(j + 1, 5):
                work[i, k] -= factor * work[j, k]
    for j in range(3, -1, -1):
        total = work[j, 4]
        for k in range(j + 1, 4):
            total -= work[j, k] * work[k, 4]
        work[j, 4] = total / work[j, j]


@jit
def polished(forms, x, work, most):  # type: ignore[no-untyped-def]
    """Improve x by Newton's method until nothing changes any more; return whether it converged."""
    last = 1.0
    for _ in range(most):
        size = newton_step(forms, x, work)
        if not size < 4.0:
            return False
        if size < 1e-15 or (size < 1e-10 and size > 0.5 * last):
            return True
        last = size
    return last < 1e-9


@jit
def projective_distance(x, y):  # type: ignore[no-untyped-def]
    """Return the sine of the angle between the lines through two unit vectors."""
    product = 0.0 * x[0] * y[0]
    for i in range(4):
        product += np.conj(y[i]) * x[i]
    square = 0.0
    for i in range(4):
        square += abs(x[i] - product * y[i]) ** 2
    return math.sqrt(square)


@jit
def is_real(x: ComplexArray) -> bool:
    """Return whether x is the same point as its conjugate, and write it as a real vector then."""
    largest = 0
    for i in range(1, 4):
        if abs(x[i]) > abs(x[largest]):
            largest = i
    phase = np.conj(x[largest]) / abs(x[largest])
    square = 0.0
    for i in range(4):
        square += (x[i] * phase).imag ** 2
    if not 4.0 * square < SEPARATE * SEPARATE:
        return False
    for i in range(4):
        x[i] = complex((x[i] * phase).real, 0.0)
    return True
