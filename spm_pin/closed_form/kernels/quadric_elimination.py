"""All eight common points of three quadrics in the projective space of quaternions.

Two unknowns are eliminated as in Kukelova, Heller, Fitzgibbon, "Efficient intersection of three quadrics and
applications in computer vision", CVPR 2016: the squares and the product of two coordinates are expressed by the rest,
which makes three identities linear in both; their determinant is of degree eight in the third coordinate. Its roots are
only where Newton's method on the quadrics begins, which loses none of the digits.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.kernels.compilation import jit
from spm_pin.closed_form.kernels.three_quadrics import (
    SEPARATE,
    is_real,
    polished,
    projective_distance,
    solve_4x4,
)
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["eight_roots"]

ComplexArray = npt.NDArray[np.complex128]

_ATTEMPTS = 4
_LONGEST = 60
"""Iterations for the polynomial; 8 to 12 are usual."""


def _coordinates() -> FloatArray:
    """Return orthogonal matrices, one for each attempt: products of a left and a right unit quaternion."""
    pairs = (
        ((3.0, 1.0, -2.0, 5.0), (2.0, -3.0, 1.0, 4.0)),
        ((1.0, 4.0, 2.0, -3.0), (5.0, 2.0, 3.0, 1.0)),
        ((-2.0, 3.0, 6.0, 1.0), (1.0, 5.0, -2.0, 2.0)),
        ((7.0, -2.0, 3.0, 4.0), (-3.0, 1.0, 4.0, 6.0)),
    )
    found = np.empty((_ATTEMPTS, 4, 4))
    for k, ((a, b, c, d), (e, f, g, h)) in enumerate(pairs):
        left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
        right = np.array([[e, -f, -g, -h], [f, e, h, -g], [g, -h, e, f], [h, g, -f, e]])
        product = left @ right
        found[k] = product / math.sqrt((product[0] ** 2).sum())
    return found


_COORDINATES = _coordinates()
_NINTH = np.exp(2j * np.pi * np.arange(9) / 9.0)


@jit
def _identities(rest, z):  # type: ignore[no-untyped-def]
    """Return the 3 x 3 matrix at z, by rows, that takes (x, y, 1) to the three identities.

    `rest` (3, 7) has x², y², x y as (d z + e) x + (f z + g) y + h z² + i z + j.
    """
    a1, a2 = rest[0, 0] * z + rest[0, 1], rest[0, 2] * z + rest[0, 3]
    a3 = (rest[0, 4] * z + rest[0, 5]) * z + rest[0, 6]
    b1, b2 = rest[1, 0] * z + rest[1, 1], rest[1, 2] * z + rest[1, 3]
    b3 = (rest[1, 4] * z + rest[1, 5]) * z + rest[1, 6]
    c1, c2 = rest[2, 0] * z + rest[2, 1], rest[2, 2] * z + rest[2, 3]
    c3 = (rest[2, 4] * z + rest[2, 5]) * z + rest[2, 6]
    # x (x y) = y x², y (x y) = x y², (x y)² = x² y², their squares and products replaced.
    first = c1 * c2 + c3 - a2 * b1, c1 * a2 + (c2 - a1) * c2 - a2 * b2 - a3, c1 * a3 + (c2 - a1) * c3 - a2 * b3
    second = (c1 - b2) * c1 + c2 * b1 - b1 * a1 - b3, c1 * c2 + c3 - b1 * a2, (c1 - b2) * c3 + c2 * b3 - b1 * a3
    xx, xy, yy = c1 * c1 - a1 * b1, 2.0 * c1 * c2 - a1 * b2 - a2 * b1, c2 * c2 - a2 * b2
    third = (
        xx * a1 + xy * c1 + yy * b1 + 2.0 * c1 * c3 - a1 * b3 - a3 * b1,
        xx * a2 + xy * c2 + yy * b2 + 2.0 * c2 * c3 - a2 * b3 - a3 * b2,
        xx * a3 + xy * c3 + yy * b3 + c3 * c3 - a3 * b3,
    )
    return first, second, third


@jit
def _across(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def _size(a):  # type: ignore[no-untyped-def]
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@jit
def _eliminate(forms: FloatArray, turn: FloatArray, turned: FloatArray, block: FloatArray, rest: FloatArray) -> bool:
    """Write `rest` of `_identities` in the coordinates y = turn · x with y_3 = 1."""
    for k in range(3):
        for i in range(4):
            for j in range(4):
                total = 0.0
                for m in range(4):
                    inner = 0.0
                    for n in range(4):
                        inner += forms[k, m, n] * turn[j, n]
                    total += turn[i, m] * inner
                turned[i, j] = total
        block[k, 0], block[k, 1], block[k, 2] = turned[0, 0], turned[1, 1], 2.0 * turned[0, 1]
        block[k, 3], block[k, 4] = -2.0 * turned[0, 2], -2.0 * turned[0, 3]
        block[k, 5], block[k, 6] = -2.0 * turned[1, 2], -2.0 * turned[1, 3]
        block[k, 7], block[k, 8], block[k, 9] = -turned[2, 2], -2.0 * turned[2, 3], -turned[3, 3]
    for j in range(3):
        pivot = j
        for i in range(j + 1, 3):
            if abs(block[i, j]) > abs(block[pivot, j]):
                pivot = i
        if not abs(block[pivot, j]) > 1e-12:
            return False
        for k in range(10):
            block[j, k], block[pivot, k] = block[pivot, k], block[j, k]
        scale = 1.0 / block[j, j]
        for k in range(10):
            block[j, k] *= scale
        for i in range(3):
            factor = block[i, j]
            if i != j:
                for k in range(10):
                    block[i, k] -= factor * block[j, k]
    for i in range(3):
        for k in range(7):
            rest[i, k] = block[i, 3 + k]
    return True


@jit
def _determinant(rest, z):  # type: ignore[no-untyped-def]
    first, second, third = _identities(rest, z)
    normal = _across(first, second)
    return normal[0] * third[0] + normal[1] * third[1] + normal[2] * third[2]


@jit
def _polynomial(rest: FloatArray, polynomial: FloatArray) -> None:
    """Write the determinant's nine coefficients, from its values at the ninth roots of unity."""
    value = _determinant(rest, complex(1.0, 0.0)).real
    for j in range(9):
        polynomial[j] = value / 9.0
    for m in range(1, 5):
        number = _determinant(rest, _NINTH[m]) * (2.0 / 9.0)
        for j in range(9):
            turn = _NINTH[(j * m) % 9]
            polynomial[j] += number.real * turn.real + number.imag * turn.imag


@jit
def _roots(polynomial: FloatArray, roots: ComplexArray) -> bool:
    """Write the eight roots by the method of Ehrlich and Aberth; return whether the degree is eight."""
    largest = 0.0
    for j in range(9):
        largest = max(largest, abs(polynomial[j]))
    if not abs(polynomial[8]) > 1e-14 * largest:
        return False
    radius = min(max(abs(polynomial[0] / polynomial[8]) ** 0.125, 1e-2), 1e2)
    for k in range(8):
        angle = 0.7853981633974483 * k + 0.4
        roots[k] = complex(radius * math.cos(angle), radius * math.sin(angle))
    for _ in range(_LONGEST):
        moved = 0.0
        for k in range(8):
            z = roots[k]
            value, slope = complex(polynomial[8], 0.0), complex(0.0, 0.0)
            for j in range(7, -1, -1):
                slope = slope * z + value
                value = value * z + polynomial[j]
            if value == 0.0:
                continue
            total = complex(0.0, 0.0)
            for j in range(8):
                if j != k:
                    gap = z - roots[j]
                    total += np.conj(gap) * (1.0 / (gap.real * gap.real + gap.imag * gap.imag + 1e-300))
            bottom = slope - value * total
            size = bottom.real * bottom.real + bottom.imag * bottom.imag
            if size > 0.0:
                change = value * np.conj(bottom) * (1.0 / size)
                roots[k] = z - change
                moved = max(moved, abs(change) / (1.0 + abs(z)))
        if moved < 1e-7:
            break
    return True


@jit
def _start(rest: FloatArray, z: complex, turn: FloatArray, x: ComplexArray) -> None:
    """Write the unit vector that belongs to a root of the determinant."""
    first, second, third = _identities(rest, z)
    best = _across(first, second)
    other = _across(first, third)
    # Compared at the scale of the rows, whose degrees in z differ.
    if _size(other) * _size(second) > _size(best) * _size(third):
        best = other
    other = _across(second, third)
    if _size(other) * _size(first) > _size(best) * _size(third):
        best = other
    size = abs(best[0]) ** 2 + abs(best[1]) ** 2 + abs(best[2]) ** 2 * (1.0 + abs(z) ** 2)
    scale = 1.0 / math.sqrt(size) if size > 0.0 else 0.0
    y0, y1, y2, y3 = best[0] * scale, best[1] * scale, z * best[2] * scale, best[2] * scale
    for i in range(4):
        x[i] = turn[0, i] * y0 + turn[1, i] * y1 + turn[2, i] * y2 + turn[3, i] * y3


@jit
def _partner(forms: FloatArray, x: ComplexArray, work: ComplexArray, other: ComplexArray) -> None:
    """Write the start for a root close to the root x: along the direction in which the quadrics hardly change."""
    for i in range(4):
        other[i] = complex(0.5, 0.0)
    for _ in range(2):
        for k in range(3):
            for i in range(4):
                total = complex(0.0, 0.0)
                for j in range(4):
                    total += forms[k, i, j] * x[j]
                work[k, i] = 2.0 * total
        for i in range(4):
            work[3, i], work[i, 4] = np.conj(x[i]), other[i]
        work[3, 4] = 0.0
        solve_4x4(work)
        norm = 0.0
        for i in range(4):
            norm += abs(work[i, 4]) ** 2
        for i in range(4):
            other[i] = work[i, 4] * (1.0 / math.sqrt(norm))
    above, below = complex(0.0, 0.0), 0.0
    for k in range(3):
        linear, square = complex(0.0, 0.0), complex(0.0, 0.0)
        for i in range(4):
            for j in range(4):
                linear += 2.0 * forms[k, i, j] * x[i] * other[j]
                square += forms[k, i, j] * other[i] * other[j]
        above += np.conj(square) * linear
        below += abs(square) ** 2
    step = -above * (1.0 / below) if below > 0.0 else complex(0.0, 0.0)
    norm = 0.0
    for i in range(4):
        other[i] = x[i] + step * other[i]
        norm += abs(other[i]) ** 2
    for i in range(4):
        other[i] *= 1.0 / math.sqrt(norm)


@jit
def _add(found: ComplexArray, count: int, x: ComplexArray) -> int:
    """Append x to the roots found if it is none of them; return their number."""
    for j in range(count):
        if not projective_distance(x, found[j]) > SEPARATE:
            return count
    for i in range(4):
        found[count, i] = x[i]
    return count + 1


@jit
def _take(
    forms: FloatArray,
    x: ComplexArray,
    work: ComplexArray,
    real: FloatArray,
    real_work: FloatArray,
    found: ComplexArray,
    count: int,
) -> int:
    """Improve x, append it and its conjugate to the roots found as far as they are new; return their number."""
    if not polished(forms, x, work, 30):
        return count
    if is_real(x):
        for i in range(4):
            real[i] = x[i].real
        if polished(forms, real, real_work, 10):
            for i in range(4):
                x[i] = complex(real[i], 0.0)
        return _add(found, count, x)
    count = _add(found, count, x)
    if count < 8:
        for i in range(4):
            x[i] = np.conj(x[i])
        count = _add(found, count, x)
    return count


@jit
def eight_roots(forms: FloatArray, found: ComplexArray) -> int:
    """Write the common points of three quadrics (3, 4, 4), unit vectors (8, 4), and return how many were found.

    Eight is all; real ones have imaginary parts of exactly zero. Fewer are found where some are not isolated.
    """
    turned, block, rest, polynomial = np.empty((4, 4)), np.empty((3, 10)), np.empty((3, 7)), np.empty(9)
    roots, work = np.empty(8, np.complex128), np.empty((4, 5), np.complex128)
    x, real, real_work = np.empty(4, np.complex128), np.empty(4), np.empty((4, 5))
    count = 0
    for attempt in range(_ATTEMPTS):
        turn = _COORDINATES[attempt]
        if not _eliminate(forms, turn, turned, block, rest):
            continue
        _polynomial(rest, polynomial)
        if not _roots(polynomial, roots):
            continue
        # A complex root brings its conjugate along; the lower half plane is looked at if that left some out.
        for half in range(2):
            for k in range(8):
                if (roots[k].imag < -1e-6 * (1.0 + abs(roots[k]))) == (half == 1):
                    _start(rest, roots[k], turn, x)
                    count = _take(forms, x, work, real, real_work, found, count)
                    if count == 8:
                        return count
        # Pairs so close that Newton's method ended twice in one of them.
        for j in range(count):
            _partner(forms, found[j], work, x)
            count = _take(forms, x, work, real, real_work, found, count)
            if count == 8:
                return count
    return count
