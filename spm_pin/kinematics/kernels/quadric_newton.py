"""Newton's method on three quadrics from eight points side by side, real or complex.

A point is a unit quaternion, up to a factor, at which the three quadratic forms of a calibrated machine vanish. Points
are one flat array, so that loops over them are vectorised: row i begins at i * POINTS. Rows 0 to 3 hold the real parts,
rows 4 to 7 the imaginary ones.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.formulas.circles import has_converged, is_next_to_solution
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.support.arguments import FloatArray

POINTS = 8
_SIZE, _LAST, STATE, ROWS = 8 * POINTS, 9 * POINTS, 10 * POINTS, 11
"""First rows of the size of the last step, of the size of the step before, and of the states; number of rows."""
PENDING, CONVERGED, FAILED = 0.0, 1.0, 2.0
"""States. Steps move the points that are pending."""


@jit
def polish(forms: FloatArray, points: FloatArray, imaginary: bool, contracting: bool, most: int) -> None:
    """Improve the pending points by Newton's method, in at most `most` steps; in the end each has converged or failed.

    `forms` (3, 10) are the quadrics, see `leg_planes.Form`. Imaginary parts are zero unless `imaginary`. If
    `contracting`, a point fails that is not next to a root by `circles.is_next_to_solution`.
    """
    for number in range(most):
        if imaginary:
            _complex_step(forms, points)
        else:
            _real_step(forms, points)
        again = False
        for k in range(POINTS):
            if points[STATE + k] != PENDING:
                continue
            size = points[_SIZE + k]
            last = points[_LAST + k] if number > 0 else np.nan
            if not size <= 4.0 or (contracting and number < 2 and not is_next_to_solution(size, last)):
                points[STATE + k] = FAILED
            elif has_converged(size, last):
                points[STATE + k] = CONVERGED
            else:
                points[_LAST + k] = size
                again = True
        if not again:
            return
    for k in range(POINTS):
        if points[STATE + k] == PENDING:
            points[STATE + k] = CONVERGED if points[_LAST + k] < 1e-9 else FAILED


@jit
def _real_step(forms: FloatArray, points: FloatArray) -> None:
    """Move the pending points, all of which are real, by a step."""
    quadrics = symmetric(forms, 0), symmetric(forms, 1), symmetric(forms, 2)
    for k in range(POINTS):
        x = real_part(points, k)
        y, size = _improved(products(quadrics, x), x)
        points[_SIZE + k] = size
        put_real_part(points, k, _chosen(points[STATE + k] == PENDING, y, x))


@jit
def _complex_step(forms: FloatArray, points: FloatArray) -> None:
    """Move the pending points by a step; real ones stay real."""
    quadrics = symmetric(forms, 0), symmetric(forms, 1), symmetric(forms, 2)
    for k in range(POINTS):
        x, y = real_part(points, k), imaginary_part(points, k)
        (a, b, c), (d, e, f) = products(quadrics, x), products(quadrics, y)
        z, size = _improved((_joined(a, d), _joined(b, e), _joined(c, f)), _joined(x, y))
        moves = points[STATE + k] == PENDING
        points[_SIZE + k] = size
        put_real_part(points, k, _chosen(moves, (z[0].real, z[1].real, z[2].real, z[3].real), x))
        put_imaginary_part(points, k, _chosen(moves, (z[0].imag, z[1].imag, z[2].imag, z[3].imag), y))


@jit_inline
def real_part(points, k):
    """Return the real parts of point k."""
    return points[k], points[k + POINTS], points[k + 2 * POINTS], points[k + 3 * POINTS]


@jit_inline
def imaginary_part(points, k):
    """Return the imaginary parts of point k."""
    return real_part(points, k + 4 * POINTS)


@jit_inline
def put_real_part(points, k, x):
    """Write the real parts of point k."""
    points[k], points[k + POINTS], points[k + 2 * POINTS], points[k + 3 * POINTS] = x


@jit_inline
def put_imaginary_part(points, k, x):
    """Write the imaginary parts of point k."""
    put_real_part(points, k + 4 * POINTS, x)


@jit_inline
def _chosen(first, x, y):
    """Return x or y, without a branch in the compiled code."""
    return x[0] if first else y[0], x[1] if first else y[1], x[2] if first else y[2], x[3] if first else y[3]


@jit_inline
def _improved(slopes, x):
    """Return x after Newton's step, which is across x, and the step's size; `slopes` are half the gradients at x."""
    a, b, c = slopes
    d = solve_bordered(slopes, x, 0.5 * product(a, x), 0.5 * product(b, x), 0.5 * product(c, x))
    size = math.sqrt(squared(d[0]) + squared(d[1]) + squared(d[2]) + squared(d[3]))
    return unit((x[0] - d[0], x[1] - d[1], x[2] - d[2], x[3] - d[3])), size


@jit_inline
def unit(x):
    """Return a vector of four numbers over its length."""
    scale = 1.0 / math.sqrt(squared(x[0]) + squared(x[1]) + squared(x[2]) + squared(x[3]))
    return x[0] * scale, x[1] * scale, x[2] * scale, x[3] * scale


@jit_inline
def solve_bordered(rows, x, u, v, w):
    """Solve a · d = u, b · d = v, c · d = w for d across x, by minors; not finite where that is singular.

    The rows a, b, c and x are tuples of four numbers, all real or all complex.
    """
    a, b, c = rows
    bc, ca, ab = _minors(b, c), _minors(c, a), _minors(a, b)
    n = np.conj(x[0]), np.conj(x[1]), np.conj(x[2]), np.conj(x[3])
    e = _normal(bc, n)
    determinant = product(a, e)
    # Not a division: complex ones have branches.
    scale = reciprocal(determinant)
    u, v, w = u * scale, v * scale, w * scale
    m01, m02 = u * bc[0] + v * ca[0] + w * ab[0], u * bc[1] + v * ca[1] + w * ab[1]
    m03, m12 = u * bc[2] + v * ca[2] + w * ab[2], u * bc[3] + v * ca[3] + w * ab[3]
    m13, m23 = u * bc[4] + v * ca[4] + w * ab[4], u * bc[5] + v * ca[5] + w * ab[5]
    return _normal((m01, m02, m03, m12, m13, m23), n)


@jit_inline
def _minors(p, q):
    """Return the minors 01, 02, 03, 12, 13, 23 of two rows."""
    p01, p02, p03 = p[0] * q[1] - p[1] * q[0], p[0] * q[2] - p[2] * q[0], p[0] * q[3] - p[3] * q[0]
    return p01, p02, p03, p[1] * q[2] - p[2] * q[1], p[1] * q[3] - p[3] * q[1], p[2] * q[3] - p[3] * q[2]


@jit_inline
def _normal(m, n):
    """Return e such that e · y is the determinant of two rows, given by their minors m, the row n and the row y."""
    e0, e1 = m[4] * n[2] - m[3] * n[3] - m[5] * n[1], m[1] * n[3] - m[2] * n[2] + m[5] * n[0]
    return e0, e1, m[2] * n[1] - m[0] * n[3] - m[4] * n[0], m[0] * n[2] - m[1] * n[1] + m[3] * n[0]


@jit_inline
def symmetric(forms, k):
    """Return the numbers of a quadric as scalars, so that loops need not ask whether memory is shared."""
    q = forms[k]
    return q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], q[9]


@jit_inline
def symmetric_product(q, x):
    """Return Q x for a quadric given as a `leg_planes.Form`."""
    xx, yy, zz, ww, xy, xz, yz, xw, yw, zw = q
    y0, y1 = product((xx, xy, xz, xw), x), product((xy, yy, yz, yw), x)
    return y0, y1, product((xz, yz, zz, zw), x), product((xw, yw, zw, ww), x)


@jit_inline
def products(quadrics, x):
    """Return Q x for three quadrics: half their gradients."""
    p, q, r = quadrics
    return symmetric_product(p, x), symmetric_product(q, x), symmetric_product(r, x)


@jit_inline
def product(a, b):
    """Return a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@jit_inline
def point(points, k):
    """Return point k as four complex numbers."""
    return _joined(real_part(points, k), imaginary_part(points, k))


@jit_inline
def _joined(re, im):
    """Return four complex numbers."""
    return complex(re[0], im[0]), complex(re[1], im[1]), complex(re[2], im[2]), complex(re[3], im[3])


@jit_inline
def squared(z):
    """Return |z|²."""
    return z.real * z.real + z.imag * z.imag


@jit_inline
def reciprocal(z):
    """Return 1/z, not a number for zero.

    Complex numbers are divided by this formula alone: Numba and NumPy round their quotients differently, and Numba
    raises for a divisor of zero.
    """
    return np.conj(z) * (1.0 / squared(z))


@jit_inline
def is_real(points, k):
    """Return whether point k is a real vector."""
    return product(imaginary_part(points, k), imaginary_part(points, k)) == 0.0


@jit_inline
def is_same_point(x, y, tolerance):
    """Return whether the sine of the angle between the lines through two unit vectors is at most `tolerance` << 1."""
    p = x[0] * np.conj(y[0]) + x[1] * np.conj(y[1]) + x[2] * np.conj(y[2]) + x[3] * np.conj(y[3])
    if squared(p) < 0.999:
        return False
    square = squared(x[0] - p * y[0]) + squared(x[1] - p * y[1])
    square += squared(x[2] - p * y[2]) + squared(x[3] - p * y[3])
    return square <= tolerance * tolerance
