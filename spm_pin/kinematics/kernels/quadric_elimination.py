"""Elimination of two unknowns from three quadrics: where Newton's method begins for each of their eight common points.

Two unknowns are eliminated as in Kukelova, Heller, Fitzgibbon, "Efficient intersection of three quadrics and
applications in computer vision", CVPR 2016: the squares and the product of two coordinates are expressed by the rest,
which makes three identities linear in both; their determinant is of degree eight in the third coordinate. The points
that belong to its roots have lost digits, which Newton's method on the quadrics themselves brings back.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.kinematics.formulas.operations import where
from spm_pin.kinematics.formulas.vectors import cross
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.elimination import reduce_rows
from spm_pin.kinematics.kernels.quadric_newton import (
    PENDING,
    POINTS,
    ROWS,
    STATE,
    product,
    put_imaginary_part,
    put_real_part,
    symmetric,
    symmetric_product,
)
from spm_pin.mechanism.arguments import FloatArray

Elimination = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Arrays to compute in: a matrix in turned coordinates (4, 4), the equations (3, 10) and what is left of them (21,),
the polynomial (9,), and the points, with the polynomial's roots in two more rows."""

ATTEMPTS = 4
"""Systems of coordinates to eliminate in."""
_LONGEST = 60
"""Iterations for the polynomial; 8 to 12 are usual."""
_RE, _IM = ROWS * POINTS, (ROWS + 1) * POINTS
"""Where the rows of the polynomial's roots begin, beside the points: loops over a single array are vectorised."""
_VALUE, _VALUE_I, _MOVED = 0, POINTS, 2 * POINTS
"""Rows of the points that hold other things before."""


def _coordinates() -> FloatArray:
    """Return orthogonal matrices, one for each attempt: products of a left and a right unit quaternion."""
    pairs = (
        ((3.0, 1.0, -2.0, 5.0), (2.0, -3.0, 1.0, 4.0)),
        ((1.0, 4.0, 2.0, -3.0), (5.0, 2.0, 3.0, 1.0)),
        ((-2.0, 3.0, 6.0, 1.0), (1.0, 5.0, -2.0, 2.0)),
        ((7.0, -2.0, 3.0, 4.0), (-3.0, 1.0, 4.0, 6.0)),
    )
    found = np.empty((ATTEMPTS, 4, 4))
    for k, ((a, b, c, d), (e, f, g, h)) in enumerate(pairs):
        left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
        right = np.array([[e, -f, -g, -h], [f, e, h, -g], [g, -h, e, f], [h, g, -f, e]])
        product = left @ right
        found[k] = product / math.sqrt((product[0] ** 2).sum())
    return found


_COORDINATES = _coordinates()
_ANGLES, _FIRST_ANGLES = 2.0 * np.pi / 9.0 * np.arange(POINTS), 2.0 * np.pi / POINTS * np.arange(POINTS) + 0.4
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)
"""The ninth roots of unity, without the last."""
_FIRST_COSINES, _FIRST_SINES = np.cos(_FIRST_ANGLES), np.sin(_FIRST_ANGLES)
"""Where the iteration for the polynomial begins, over the radius."""
_TURNED = 2.0 * np.pi / 9.0 * (np.outer(np.arange(9), np.arange(5)) % 9)
_COSINE_TABLE, _SINE_TABLE = np.cos(_TURNED) * (2.0 / 9.0), np.sin(_TURNED) * (2.0 / 9.0)


@jit_inline
def allocate_elimination() -> Elimination:
    """Allocate the arrays of an elimination."""
    return np.empty((4, 4)), np.empty((3, 10)), np.empty(21), np.empty(9), np.empty((ROWS + 2) * POINTS)


@jit_inline
def _scalars(s: FloatArray):  # type: ignore[no-untyped-def]
    """Return what is left of the equations as scalars."""
    first, second = (s[0], s[1], s[2], s[3], s[4], s[5], s[6]), (s[7], s[8], s[9], s[10], s[11], s[12], s[13])
    return first, second, (s[14], s[15], s[16], s[17], s[18], s[19], s[20])


@jit_inline
def _at(s, z):  # type: ignore[no-untyped-def]
    """Return d z + e, f z + g and h z² + i z + j."""
    a, b = complex(s[0] * z.real + s[1], s[0] * z.imag), complex(s[2] * z.real + s[3], s[2] * z.imag)
    zz = z * z
    return a, b, complex(s[4] * zz.real + s[5] * z.real + s[6], s[4] * zz.imag + s[5] * z.imag)


@jit_inline
def _identities(rest, z):  # type: ignore[no-untyped-def]
    """Return the 3 x 3 matrix at z, by rows, that takes (x, y, 1) to the three identities.

    `rest` has x², y², x y as (d z + e) x + (f z + g) y + h z² + i z + j.
    """
    a1, a2, a3 = _at(rest[0], z)
    b1, b2, b3 = _at(rest[1], z)
    c1, c2, c3 = _at(rest[2], z)
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
def _size(a):  # type: ignore[no-untyped-def]
    first, second = abs(a[0].real) + abs(a[0].imag), abs(a[1].real) + abs(a[1].imag)
    return first + second + (abs(a[2].real) + abs(a[2].imag))


@jit
def _eliminate(forms: FloatArray, turn: FloatArray, turned: FloatArray, block: FloatArray, rest: FloatArray) -> bool:
    """Write `rest` of `_identities`, row by row, in the coordinates y = turn · x with y_3 = 1."""
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
    if not reduce_rows(block) > 1e-12:
        return False
    for i in range(3):
        for k in range(7):
            rest[7 * i + k] = block[i, 3 + k]
    return True


@jit
def _put_polynomial(rest: FloatArray, points: FloatArray, polynomial: FloatArray) -> None:
    """Write the determinant's nine coefficients, from its values at the ninth roots of unity."""
    s = _scalars(rest)
    for k in range(POINTS):
        first, second, third = _identities(s, complex(_COSINES[k], _SINES[k]))
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
def _horner(numbers, x, y, coefficient):  # type: ignore[no-untyped-def]
    """Return value and derivative of a polynomial at x + iy, from those without its last coefficient."""
    value, value_i, slope, slope_i = numbers
    slope, slope_i = slope * x - slope_i * y + value, slope * y + slope_i * x + value_i
    return value * x - value_i * y + coefficient, value * y + value_i * x, slope, slope_i


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
        xs, ys = _eight(points, _RE), _eight(points, _IM)
        for k in range(POINTS):
            x, y = points[_RE + k], points[_IM + k]
            numbers = p8 * x + p7, p8 * y, p8, 0.0
            numbers = _horner(_horner(_horner(numbers, x, y, p6), x, y, p5), x, y, p4)
            numbers = _horner(_horner(_horner(_horner(numbers, x, y, p3), x, y, p2), x, y, p1), x, y, p0)
            value, value_i, slope, slope_i = numbers
            a, b, c, d = _term(xs, ys, 0, x, y), _term(xs, ys, 1, x, y), _term(xs, ys, 2, x, y), _term(xs, ys, 3, x, y)
            e, f, g, h = _term(xs, ys, 4, x, y), _term(xs, ys, 5, x, y), _term(xs, ys, 6, x, y), _term(xs, ys, 7, x, y)
            total = a[0] + b[0] + c[0] + d[0] + (e[0] + f[0] + g[0] + h[0])
            total_i = a[1] + b[1] + c[1] + d[1] + (e[1] + f[1] + g[1] + h[1])
            bottom = slope - (value * total - value_i * total_i)
            bottom_i = slope_i - (value * total_i + value_i * total)
            square = bottom * bottom + bottom_i * bottom_i
            scale = where(square > 0.0, 1.0 / square, 0.0)
            change = (value * bottom + value_i * bottom_i) * scale
            change_i = (value_i * bottom - value * bottom_i) * scale
            points[_MOVED + k] = (change * change + change_i * change_i) / (1.0 + x * x + y * y)
            points[_RE + k], points[_IM + k] = x - change, y - change_i
        moved = 0.0
        for k in range(POINTS):
            moved = max(moved, points[_MOVED + k])
        if moved < 1e-14:
            break
    return True


@jit_inline
def _eight(points: FloatArray, row: int):  # type: ignore[no-untyped-def]
    """Return a row as scalars."""
    low = points[row], points[row + 1], points[row + 2], points[row + 3]
    return *low, points[row + 4], points[row + 5], points[row + 6], points[row + 7]


@jit_inline
def _term(xs, ys, j, x, y):  # type: ignore[no-untyped-def]
    """Return the reciprocal of the distance from root j, zero of none."""
    gap, gap_i = x - xs[j], y - ys[j]
    scale = 1.0 / (gap * gap + gap_i * gap_i + 1e-300)
    return gap * scale, -gap_i * scale


@jit_inline
def _chosen(is_a, a, is_b, b, c):  # type: ignore[no-untyped-def]
    """Return one of three complex numbers, without a branch in the compiled code."""
    re = where(is_a, a.real, where(is_b, b.real, c.real))
    return complex(re, where(is_a, a.imag, where(is_b, b.imag, c.imag)))


@jit
def _put_vectors(rest: FloatArray, turn: FloatArray, points: FloatArray) -> None:
    """Write the unit vectors that belong to the roots of the determinant."""
    s = _scalars(rest)
    t0, t1, t2, t3 = _column(turn, 0), _column(turn, 1), _column(turn, 2), _column(turn, 3)
    for k in range(POINTS):
        z = complex(points[_RE + k], points[_IM + k])
        first, second, third = _identities(s, z)
        # The best of three is compared at the scale of the rows, whose degrees in z differ.
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
def _column(matrix, i):  # type: ignore[no-untyped-def]
    return matrix[0, i], matrix[1, i], matrix[2, i], matrix[3, i]


@jit
def put_starts(forms: FloatArray, attempt: int, work: Elimination) -> bool:
    """Write a pending point near each common point of three quadrics (3, 4, 4), if these coordinates suit them."""
    turned, block, rest, polynomial, points = work
    turn = _COORDINATES[attempt]
    if not _eliminate(forms, turn, turned, block, rest):
        return False
    _put_polynomial(rest, points, polynomial)
    if not _put_roots(polynomial, points):
        return False
    _put_vectors(rest, turn, points)
    return True
