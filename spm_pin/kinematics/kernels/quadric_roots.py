"""All eight common points of three quadrics in the projective space of quaternions.

Two unknowns are eliminated as in Kukelova, Heller, Fitzgibbon, "Efficient intersection of three quadrics and
applications in computer vision", CVPR 2016: x², y² and x y are expressed by x, y and z, which makes three identities
linear in x and y; their determinant is of degree eight in z. The points that belong to its roots have lost digits,
which Newton's method on the quadrics themselves brings back. Eight distinct answers are all there are. Where both
members of a close pair led to one answer, the other is looked for in the direction in which the quadrics hardly change.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.formulas.operations import where
from spm_pin.formulas.vectors import cross
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.quadric_newton import (
    CONVERGED,
    FAILED,
    PENDING,
    POINTS,
    ROWS,
    STATE,
    imaginary_part,
    is_real,
    is_same_point,
    point,
    polish,
    product,
    products,
    put_imaginary_part,
    put_real_part,
    real_part,
    solve_bordered,
    squared,
    symmetric,
    symmetric_product,
    unit,
)
from spm_pin.support.arguments import FloatArray

Elimination = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Arrays to compute in: a matrix in turned coordinates (4, 4), the equations (3, 10), the polynomial (9,), and the
points, with the polynomial's roots in two more rows."""

_LONGEST = 60  # iterations for the polynomial; 8 to 12 are usual
_RE, _IM = ROWS * POINTS, (ROWS + 1) * POINTS
"""First rows of the polynomial's roots, beside the points: loops over a single array are vectorised."""
_VALUE, _VALUE_I, _MOVED = 0, POINTS, 2 * POINTS  # rows of `points`, reused after other data

_NORMALS = np.array([[3.0, 1.0, -2.0, 5.0], [1.0, 4.0, 2.0, -3.0], [-2.0, 3.0, 6.0, 1.0], [7.0, -2.0, 3.0, 4.0]])
_COORDINATES = np.eye(4) - 2.0 * _NORMALS[:, :, None] * _NORMALS[:, None] / (_NORMALS**2).sum(axis=-1)[:, None, None]
"""Orthogonal matrices, one for each attempt: reflections."""
_SEPARATE = 1e-8
"""Projective distance above which two roots differ: rounding moves both members of a pair by less than their distance
as long as that is above the square root of the precision."""
_ANGLES, _FIRST_ANGLES = 2.0 * np.pi / 9.0 * np.arange(POINTS), 2.0 * np.pi / POINTS * np.arange(POINTS) + 0.4
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)  # the ninth roots of unity, without the last
_FIRST_COSINES, _FIRST_SINES = np.cos(_FIRST_ANGLES), np.sin(_FIRST_ANGLES)
"""Starts of the iteration for the polynomial, divided by the radius."""
_TURNED = 2.0 * np.pi / 9.0 * (np.outer(np.arange(9), np.arange(5)) % 9)
_COSINE_TABLE, _SINE_TABLE = np.cos(_TURNED) * (2.0 / 9.0), np.sin(_TURNED) * (2.0 / 9.0)


@jit_inline
def allocate_elimination() -> Elimination:
    """Allocate the arrays of an elimination."""
    return np.empty((4, 4)), np.empty((3, 10)), np.empty(9), np.empty((ROWS + 2) * POINTS)


@jit_inline
def _at(s, z):
    """Return d z + e, f z + g and h z² + i z + j of the coefficients s."""
    a, b = complex(s[0] * z.real + s[1], s[0] * z.imag), complex(s[2] * z.real + s[3], s[2] * z.imag)
    zz = z * z
    return a, b, complex(s[4] * zz.real + s[5] * z.real + s[6], s[4] * zz.imag + s[5] * z.imag)


@jit_inline
def _identities(right_sides, z):
    """Return the 3 x 3 matrix at z, by rows, that takes (x, y, 1) to the three identities.

    `right_sides` have x², y², x y as (d z + e) x + (f z + g) y + h z² + i z + j.
    """
    a1, a2, a3 = _at(right_sides[0], z)
    b1, b2, b3 = _at(right_sides[1], z)
    c1, c2, c3 = _at(right_sides[2], z)
    # x (x y) = y x², y (x y) = x y², (x y)² = x² y², their squares and products replaced.
    first = c1 * c2 + c3 - a2 * b1, c1 * a2 + (c2 - a1) * c2 - a2 * b2 - a3, c1 * a3 + (c2 - a1) * c3 - a2 * b3
    second = (c1 - b2) * c1 + c2 * b1 - b1 * a1 - b3, c1 * c2 + c3 - b1 * a2, (c1 - b2) * c3 + c2 * b3 - b1 * a3
    xx, xy, yy = c1 * c1 - a1 * b1, c1 * c2 + c1 * c2 - a1 * b2 - a2 * b1, c2 * c2 - a2 * b2
    third = (
        xx * a1 + xy * c1 + yy * b1 + (c1 * c3 + c1 * c3) - a1 * b3 - a3 * b1,
        xx * a2 + xy * c2 + yy * b2 + (c2 * c3 + c2 * c3) - a2 * b3 - a3 * b2,
        xx * a3 + xy * c3 + yy * b3 + c3 * c3 - a3 * b3,
    )
    return first, second, third


@jit_inline
def _size(a):
    first, second = abs(a[0].real) + abs(a[0].imag), abs(a[1].real) + abs(a[1].imag)
    return first + second + (abs(a[2].real) + abs(a[2].imag))


@jit
def reduce_rows(rows: FloatArray) -> float:
    """Make the left square of a matrix the identity by Gauss–Jordan elimination, and return the smallest pivot.

    The rows are not finite where that is zero.
    """
    height, width = rows.shape
    least = np.inf
    for j in range(height):
        pivot = j
        for i in range(j + 1, height):
            if abs(rows[i, j]) > abs(rows[pivot, j]):
                pivot = i
        least = min(least, abs(rows[pivot, j]))
        for k in range(width):
            rows[j, k], rows[pivot, k] = rows[pivot, k], rows[j, k]
        scale = 1.0 / rows[j, j]
        for k in range(width):
            rows[j, k] *= scale
        for i in range(height):
            factor = rows[i, j]
            if i != j:
                for k in range(width):
                    rows[i, k] -= factor * rows[j, k]
    return least


@jit
def _eliminate(forms: FloatArray, turn: FloatArray, turned: FloatArray, block: FloatArray) -> bool:
    """Write the `right_sides` of `_identities`, in y = turn · x with y_3 = 1, into the last columns of `block`."""
    for k in range(3):
        form = symmetric(forms, k)
        for j in range(4):
            column = symmetric_product(form, (turn[j, 0], turn[j, 1], turn[j, 2], turn[j, 3]))
            for i in range(j + 1):
                turned[i, j] = product((turn[i, 0], turn[i, 1], turn[i, 2], turn[i, 3]), column)
        block[k, 0], block[k, 1], block[k, 2] = turned[0, 0], turned[1, 1], 2.0 * turned[0, 1]
        block[k, 3], block[k, 4] = -2.0 * turned[0, 2], -2.0 * turned[0, 3]
        block[k, 5], block[k, 6] = -2.0 * turned[1, 2], -2.0 * turned[1, 3]
        block[k, 7], block[k, 8], block[k, 9] = -turned[2, 2], -2.0 * turned[2, 3], -turned[3, 3]
    return reduce_rows(block) > 1e-12


@jit_inline
def _right_sides(block):
    """Return the right sides of the reduced rows as scalars."""
    a, b, c = block[0], block[1], block[2]
    first, second = (a[3], a[4], a[5], a[6], a[7], a[8], a[9]), (b[3], b[4], b[5], b[6], b[7], b[8], b[9])
    return first, second, (c[3], c[4], c[5], c[6], c[7], c[8], c[9])


@jit
def _put_polynomial(block: FloatArray, points: FloatArray, polynomial: FloatArray) -> None:
    """Write the determinant's nine coefficients, from its values at the ninth roots of unity."""
    right_sides = _right_sides(block)
    for k in range(POINTS):
        first, second, third = _identities(right_sides, complex(_COSINES[k], _SINES[k]))
        normal = cross(first, second)
        value = normal[0] * third[0] + normal[1] * third[1] + normal[2] * third[2]
        points[_VALUE + k], points[_VALUE_I + k] = value.real, value.imag
    for j in range(9):
        # The other roots of unity are the conjugates of these, and so are the values there.
        total = points[_VALUE] / 9.0
        for m in range(1, 5):
            total += points[_VALUE + m] * _COSINE_TABLE[j, m] + points[_VALUE_I + m] * _SINE_TABLE[j, m]
        polynomial[j] = total


@jit_inline
def _horner(numbers, z, coefficient):
    """Return value and derivative of a polynomial at z, from those without its last coefficient."""
    value, slope = numbers
    across = value * z
    return complex(across.real + coefficient, across.imag), slope * z + value


@jit
def _put_roots(polynomial: FloatArray, points: FloatArray) -> bool:
    """Write the eight roots by the method of Ehrlich and Aberth; return whether the degree is eight."""
    largest = 0.0
    for j in range(9):
        largest = max(largest, abs(polynomial[j]))
    if not abs(polynomial[8]) > 1e-14 * largest:
        return False
    p0, p1, p2, p3, p4 = polynomial[0], polynomial[1], polynomial[2], polynomial[3], polynomial[4]
    p5, p6, p7, p8 = polynomial[5], polynomial[6], polynomial[7], polynomial[8]
    radius = min(max(abs(p0 / p8) ** 0.125, 1e-2), 1e2)
    for k in range(POINTS):
        points[_RE + k], points[_IM + k] = radius * _FIRST_COSINES[k], radius * _FIRST_SINES[k]
    for _ in range(_LONGEST):
        roots = _eight(points)
        for k in range(POINTS):
            z = complex(points[_RE + k], points[_IM + k])
            numbers = complex(p8 * z.real + p7, p8 * z.imag), complex(p8, 0.0)
            numbers = _horner(_horner(_horner(numbers, z, p6), z, p5), z, p4)
            value, slope = _horner(_horner(_horner(_horner(numbers, z, p3), z, p2), z, p1), z, p0)
            a, b, c, d = _term(roots[0], z), _term(roots[1], z), _term(roots[2], z), _term(roots[3], z)
            e, f, g, h = _term(roots[4], z), _term(roots[5], z), _term(roots[6], z), _term(roots[7], z)
            bottom = slope - value * (a + b + c + d + (e + f + g + h))
            square, across = squared(bottom), value * bottom.conjugate()
            scale = where(square > 0.0, 1.0 / square, 0.0)
            change = complex(across.real * scale, across.imag * scale)
            points[_MOVED + k] = squared(change) / (1.0 + squared(z))
            points[_RE + k], points[_IM + k] = z.real - change.real, z.imag - change.imag
        moved = 0.0
        for k in range(POINTS):
            moved = max(moved, points[_MOVED + k])
        if moved < 1e-14:
            break
    return True


@jit_inline
def _eight(points):
    """Return the polynomial's roots as scalars."""
    re, im = points[_RE : _RE + POINTS], points[_IM : _IM + POINTS]
    low = complex(re[0], im[0]), complex(re[1], im[1]), complex(re[2], im[2]), complex(re[3], im[3])
    return *low, complex(re[4], im[4]), complex(re[5], im[5]), complex(re[6], im[6]), complex(re[7], im[7])


@jit_inline
def _term(root, z):
    """Return 1 / (z - root), zero where they coincide."""
    gap = z - root
    scale = 1.0 / (squared(gap) + 1e-300)
    return complex(gap.real * scale, -gap.imag * scale)


@jit_inline
def _chosen(is_a, a, is_b, b, c):
    """Return one of three complex numbers, without a branch in the compiled code."""
    re = where(is_a, a.real, where(is_b, b.real, c.real))
    return complex(re, where(is_a, a.imag, where(is_b, b.imag, c.imag)))


@jit
def _put_vectors(block: FloatArray, turn: FloatArray, points: FloatArray) -> None:
    """Write the unit vectors that belong to the roots of the determinant."""
    right_sides = _right_sides(block)
    t0, t1, t2, t3 = _column(turn, 0), _column(turn, 1), _column(turn, 2), _column(turn, 3)
    for k in range(POINTS):
        z = complex(points[_RE + k], points[_IM + k])
        first, second, third = _identities(right_sides, z)
        # The longest of three cross products, each at the scale of all rows, whose degrees in z differ.
        a, b, c = cross(first, second), cross(first, third), cross(second, third)
        size_a, size_b, size_c = _size(a) * _size(third), _size(b) * _size(second), _size(c) * _size(first)
        is_a, is_b = (size_a >= size_b) & (size_a >= size_c), size_b >= size_c
        y0, y1 = _chosen(is_a, a[0], is_b, b[0], c[0]), _chosen(is_a, a[1], is_b, b[1], c[1])
        y3 = _chosen(is_a, a[2], is_b, b[2], c[2])
        y2 = z * y3
        re, im = (y0.real, y1.real, y2.real, y3.real), (y0.imag, y1.imag, y2.imag, y3.imag)
        scale = 1.0 / math.sqrt(product(re, re) + product(im, im))
        x0, x1, x2, x3 = product(t0, re), product(t1, re), product(t2, re), product(t3, re)
        put_real_part(points, k, (scale * x0, scale * x1, scale * x2, scale * x3))
        x0, x1, x2, x3 = product(t0, im), product(t1, im), product(t2, im), product(t3, im)
        put_imaginary_part(points, k, (scale * x0, scale * x1, scale * x2, scale * x3))
        points[STATE + k] = PENDING


@jit_inline
def _column(matrix, i):
    return matrix[0, i], matrix[1, i], matrix[2, i], matrix[3, i]


@jit
def _put_starts(forms: FloatArray, attempt: int, work: Elimination) -> bool:
    """Write a pending point near each common point of three quadrics (3, 10), if these coordinates suit them."""
    turned, block, polynomial, points = work
    turn = _COORDINATES[attempt]
    if not _eliminate(forms, turn, turned, block):
        return False
    _put_polynomial(block, points, polynomial)
    if not _put_roots(polynomial, points):
        return False
    _put_vectors(block, turn, points)
    return True


@jit
def _put_partner(forms: FloatArray, roots: FloatArray, points: FloatArray, k: int) -> None:
    """Write the start for a root close to root k: along the direction in which the quadrics hardly change."""
    x = point(roots, k)
    quadrics = symmetric(forms, 0), symmetric(forms, 1), symmetric(forms, 2)
    slopes, half = products(quadrics, x), complex(0.5, 0.0)
    y = half, half, half, half
    for _ in range(2):
        y = unit(solve_bordered(slopes, x, y[0], y[1], y[2]))
    above, below = 0.0 * half, 0.0
    halves = products(quadrics, y)
    for i in range(3):
        linear, square = 2.0 * product(slopes[i], y), product(halves[i], y)
        above += np.conj(square) * linear
        below += squared(square)
    step = -above * (1.0 / below) if below > 0.0 else 0.0 * half
    y = unit((x[0] + step * y[0], x[1] + step * y[1], x[2] + step * y[2], x[3] + step * y[3]))
    put_real_part(points, k, (y[0].real, y[1].real, y[2].real, y[3].real))
    put_imaginary_part(points, k, (y[0].imag, y[1].imag, y[2].imag, y[3].imag))
    points[STATE + k] = PENDING


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
def _add(roots: FloatArray, count: int, points: FloatArray, k: int, sign: float) -> int:
    """Append point k, its imaginary part times a sign, if it differs from the roots found; return their number."""
    y = imaginary_part(points, k)
    put_real_part(roots, count, real_part(points, k))
    put_imaginary_part(roots, count, (sign * y[0], sign * y[1], sign * y[2], sign * y[3]))
    for j in range(count):
        if is_same_point(point(roots, count), point(roots, j), _SEPARATE):
            return count
    return count + 1


@jit
def _collect(forms: FloatArray, points: FloatArray, roots: FloatArray, count: int) -> int:
    """Improve the points, append them and their conjugates to the roots found as far as they are new."""
    polish(forms, points, True, False, 30)
    for k in range(POINTS):
        if points[STATE + k] == CONVERGED and _made_real(points, k):
            points[STATE + k] = PENDING
    polish(forms, points, False, False, 10)
    for k in range(POINTS):
        if count < 8 and points[STATE + k] == CONVERGED:
            before, count = count, _add(roots, count, points, k, 1.0)
            if before < count < 8 and not is_real(points, k):
                count = _add(roots, count, points, k, -1.0)
    return count


@jit
def eight_roots(forms: FloatArray, work: Elimination, roots: FloatArray) -> int:
    """Write the common points of three quadrics (3, 10) as the first rows of `roots`, and return how many they are.

    Eight is all; real ones have imaginary parts of exactly zero. Fewer are found where some are not isolated.
    """
    points, count = work[3], 0
    for attempt in range(len(_COORDINATES)):
        if count == 8 or not _put_starts(forms, attempt, work):
            continue
        count = _collect(forms, points, roots, count)
        if count == 8:
            continue
        # Pairs so close that Newton's method ended twice in one of them.
        for k in range(POINTS):
            points[STATE + k] = FAILED
            if k < count:
                _put_partner(forms, roots, points, k)
        count = _collect(forms, points, roots, count)
    return count
