"""All eight common points of three quadrics in the projective space of quaternions.

Newton's method begins where the elimination of two unknowns leads. Eight distinct answers are all there are. Where both
members of a close pair led to one answer, the other is looked for in the direction in which the quadrics hardly change.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.quadric_elimination import ATTEMPTS, Elimination, put_starts
from spm_pin.kinematics.kernels.quadric_newton import (
    CONVERGED,
    FAILED,
    PENDING,
    POINTS,
    STATE,
    imaginary_part,
    point,
    polish,
    product,
    put_imaginary_part,
    put_real_part,
    real_part,
    solve_bordered,
    squared,
    symmetric,
    symmetric_product,
)
from spm_pin.mechanism.arguments import FloatArray

SAME_ROOT = 1e-6
"""Projective distance up to which a branch that was followed has arrived at a root."""
_SEPARATE = 1e-8
"""Projective distance above which two roots differ: rounding moves both members of a pair by less than their distance
as long as that is above the square root of the precision."""


@jit_inline
def is_real(points, k):  # type: ignore[no-untyped-def]
    """Return whether point k is a real vector."""
    return product(imaginary_part(points, k), imaginary_part(points, k)) == 0.0


@jit_inline
def is_same_point(x, y, tolerance):  # type: ignore[no-untyped-def]
    """Return whether the sine of the angle between the lines through two unit vectors is at most `tolerance` << 1."""
    p = x[0] * np.conj(y[0]) + x[1] * np.conj(y[1]) + x[2] * np.conj(y[2]) + x[3] * np.conj(y[3])
    if squared(p) < 0.999:
        return False
    square = squared(x[0] - p * y[0]) + squared(x[1] - p * y[1])
    square += squared(x[2] - p * y[2]) + squared(x[3] - p * y[3])
    return square <= tolerance * tolerance


@jit
def _put_partner(forms: FloatArray, found: FloatArray, points: FloatArray, k: int) -> None:
    """Write the start for a root close to root k: along the direction in which the quadrics hardly change."""
    x = point(found, k)
    p, q, r = symmetric(forms, 0), symmetric(forms, 1), symmetric(forms, 2)
    a, b, c = symmetric_product(p, x), symmetric_product(q, x), symmetric_product(r, x)
    half = complex(0.5, 0.0)
    y = half, half, half, half
    for _ in range(2):
        y = _unit(solve_bordered(a, b, c, x, y[0], y[1], y[2]))
    above, below = 0.0 * half, 0.0
    for halved, form in ((a, p), (b, q), (c, r)):
        linear, square = 2.0 * product(halved, y), product(symmetric_product(form, y), y)
        above += np.conj(square) * linear
        below += abs(square) ** 2
    step = -above * (1.0 / below) if below > 0.0 else 0.0 * half
    y = _unit((x[0] + step * y[0], x[1] + step * y[1], x[2] + step * y[2], x[3] + step * y[3]))
    put_real_part(points, k, (y[0].real, y[1].real, y[2].real, y[3].real))
    put_imaginary_part(points, k, (y[0].imag, y[1].imag, y[2].imag, y[3].imag))
    points[STATE + k] = PENDING


@jit_inline
def _unit(y):  # type: ignore[no-untyped-def]
    scale = 1.0 / math.sqrt(abs(y[0]) ** 2 + abs(y[1]) ** 2 + abs(y[2]) ** 2 + abs(y[3]) ** 2)
    return y[0] * scale, y[1] * scale, y[2] * scale, y[3] * scale


@jit
def _made_real(points: FloatArray, k: int) -> bool:
    """Return whether point k is its own conjugate, and write it as a real vector then."""
    largest, most = 0, 0.0
    for i in range(4):
        re, im = points[i * POINTS + k], points[(4 + i) * POINTS + k]
        if re * re + im * im > most:
            largest, most = i, re * re + im * im
    c, s = points[largest * POINTS + k], -points[(4 + largest) * POINTS + k]
    x, y = real_part(points, k), imaginary_part(points, k)
    im = x[0] * s + y[0] * c, x[1] * s + y[1] * c, x[2] * s + y[2] * c, x[3] * s + y[3] * c
    if not 4.0 * product(im, im) < most * _SEPARATE * _SEPARATE:
        return False
    re = x[0] * c - y[0] * s, x[1] * c - y[1] * s, x[2] * c - y[2] * s, x[3] * c - y[3] * s
    scale = 1.0 / math.sqrt(most)
    put_real_part(points, k, (re[0] * scale, re[1] * scale, re[2] * scale, re[3] * scale))
    put_imaginary_part(points, k, (0.0, 0.0, 0.0, 0.0))
    return True


@jit
def _add(found: FloatArray, count: int, points: FloatArray, k: int, sign: float) -> int:
    """Append point k, its imaginary part times a sign, if it is none of the roots found; return their number."""
    y = imaginary_part(points, k)
    put_real_part(found, count, real_part(points, k))
    put_imaginary_part(found, count, (sign * y[0], sign * y[1], sign * y[2], sign * y[3]))
    for j in range(count):
        if is_same_point(point(found, count), point(found, j), _SEPARATE):
            return count
    return count + 1


@jit
def _collect(forms: FloatArray, points: FloatArray, found: FloatArray, count: int) -> int:
    """Improve the points, append them and their conjugates to the roots found as far as they are new."""
    polish(forms, points, True, False, 30)
    for k in range(POINTS):
        if points[STATE + k] == CONVERGED and _made_real(points, k):
            points[STATE + k] = PENDING
    polish(forms, points, False, False, 10)
    for k in range(POINTS):
        if count < 8 and points[STATE + k] == CONVERGED:
            before, count = count, _add(found, count, points, k, 1.0)
            if before < count < 8 and not is_real(points, k):
                count = _add(found, count, points, k, -1.0)
    return count


@jit
def eight_roots(forms: FloatArray, work: Elimination, found: FloatArray) -> int:
    """Write the common points of three quadrics (3, 4, 4) as the first rows of `found`, and return how many they are.

    Eight is all; real ones have imaginary parts of exactly zero. Fewer are found where some are not isolated.
    """
    points, count = work[4], 0
    for attempt in range(ATTEMPTS):
        if count == 8 or not put_starts(forms, attempt, work):
            continue
        count = _collect(forms, points, found, count)
        if count == 8:
            continue
        # Pairs so close that Newton's method ended twice in one of them.
        for k in range(POINTS):
            points[STATE + k] = FAILED
            if k < count:
                _put_partner(forms, found, points, k)
        count = _collect(forms, points, found, count)
    return count
