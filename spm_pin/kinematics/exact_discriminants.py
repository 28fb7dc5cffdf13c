"""Signs of the families' discriminants in whole numbers, and their branches with more digits, one pose at a time.

Doubles are whole numbers times a power of two. With the unnormalised quaternion (S, W), σ = |S|² + |W|², of a rotation
matrix, S' = S, iS, -iS, S and P = √σ P', the quadratic of a family times σ |S| |W|³ √3 is

    d Re(iS [σ W³ e_q (Q - S'P')² + conj(W)³ e_p (S'Q - σP')²]) - √3 g (σP'² + Q² - 2κP'Q),    g = σ |W|² SW·o,

so its coefficients are α + β√3 with whole α and β, and so is its discriminant, whose sign is therefore known without
rounding. `spm_pin.formulas.branches._family` has the same quadratic for floats, in u and v. Notation and derivation:
`docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from mpmath import iv

from spm_pin.formulas.branches import product
from spm_pin.mechanism.arguments import FloatArray, IntArray

BITS = 400
"""Bits of the numbers in which branches are computed."""

_LOWER, _UPPER = (1, 1, -1, -1), (1, -1, 1, -1)
ROOT_SIGN = (1, -1, -1, 1, -1, 1, 1, -1)
"""The root, in this order, of the branches + and - of each family."""
_TURNS = ((1, 0), (0, 1), (0, -1), (1, 0))

Whole = tuple[int, int]
"""A complex number with whole parts, or α and β of α + β√3."""


def _surd_times(a: Whole, b: Whole) -> Whole:
    return a[0] * b[0] + 3 * a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def _surd_sign(a: Whole) -> int:
    first, second = (a[0] > 0) - (a[0] < 0), (a[1] > 0) - (a[1] < 0)
    if first * second >= 0:
        return first or second
    return first if a[0] * a[0] > 3 * a[1] * a[1] else second


def _surd(a: Whole) -> Any:
    """Return an enclosure of α + β√3, to nearly the working precision whatever cancels."""
    root, (first, second) = iv.sqrt(iv.mpf(3)), a
    if (first > 0) == (second > 0) or not first or not second:
        return first + second * root
    return iv.mpf(first * first - 3 * second * second) / (first - second * root)


def _conjugate(z: Any) -> Any:
    return iv.mpc(z.real, -z.imag)


def _whole(values: Iterable[float]) -> tuple[list[int], int]:
    """Return doubles as whole numbers over one power of two."""
    ratios = [float(value).as_integer_ratio() for value in values]
    scale = max(denominator for _, denominator in ratios)
    return [numerator * (scale // denominator) for numerator, denominator in ratios], scale


class ExactPose:
    """The four quadratics of one pose, in whole numbers.

    The pose is that of the quaternion which the doubles of the rotation matrix define, without rounding, by the formula
    of its largest component; the matrix is orthogonal to rounding only. `matrix` and `norm` are σR and σ, `position`
    and `side` o and d in units of 1 / `scale` metre; `vertical` is True if the Z axes are parallel.
    """

    def __init__(self, rotation: FloatArray, position: FloatArray, side: float) -> None:
        entries, unit = _whole(rotation.ravel())
        largest = int(largest_component(rotation))
        x0, x1, x2, x3 = self._quaternion = quaternions(entries, unit)[largest]
        (x, y, z, d), self.scale = _whole([*position, side])
        self.position, self.side = (x, y, z), d
        s, w = (x0, x3), (x1, x2)
        self._w_square = x1 * x1 + x2 * x2
        self.norm = x0 * x0 + x3 * x3 + self._w_square
        self.matrix = scaled_rotation(self._quaternion, lambda x: x * x)
        self.vertical = not self._w_square or self.norm == self._w_square
        cube, normal = product(w, product(w, w)), product(s, w)
        i_s, norm = (-x3, x0), self.norm
        first, second = product(i_s, cube), product(i_s, (cube[0], -cube[1]))
        g = norm * self._w_square * (normal[0] * x + normal[1] * y)
        self._turned = [product(s, turn) for turn in _TURNS]
        self._coefficients: list[tuple[Whole, Whole, Whole]] = []
        for (kappa, mu), e_p, e_q in zip(self._turned, _LOWER, _UPPER, strict=True):
            s_, ss = (kappa, mu), product((kappa, mu), (kappa, mu))
            pp = norm * (e_q * product(first, ss)[0] + e_p * norm * second[0])
            pq = -2 * norm * (e_q * product(first, s_)[0] + e_p * product(second, s_)[0])
            qq = norm * e_q * first[0] + e_p * product(second, ss)[0]
            self._coefficients.append(((d * pp, -g * norm), (d * pq, 2 * g * kappa), (d * qq, -g)))

    def _discriminant(self, family: int) -> Whole:
        pp, pq, qq = self._coefficients[family]
        square, product = _surd_times(pq, pq), _surd_times(pp, qq)
        return square[0] - 4 * product[0], square[1] - 4 * product[1]

    def sign(self, family: int) -> int | None:
        """Return the sign of a family's discriminant; None where the family is continuous or the Z axes parallel."""
        if self.vertical or not any(any(pair) for pair in self._coefficients[family]):
            return None
        return _surd_sign(self._discriminant(family))

    def discriminant(self, family: int) -> float:
        """Return a family's discriminant over r², to rounding."""
        iv.prec = BITS
        norm, w_square, kappa = self.norm, self._w_square, self._turned[family][0]
        size = 4 * norm**2 * (norm - w_square) * w_square**3 * (norm - kappa**2) * self.side**2
        return float((_surd(self._discriminant(family)) / size).mid)

    def middle_joints(self, branch: int) -> tuple[FloatArray, float]:
        """Return the joints of a real branch (3, 3) [m], and how far the exact ones, of `BITS` bits, can be."""
        iv.prec = BITS
        family, root_3 = branch // 2, iv.sqrt(iv.mpf(3))
        length, r = iv.sqrt(iv.mpf(self.norm)), iv.mpf(self.side) / self.scale / root_3
        x0, x1, x2, x3 = (iv.mpf(x) / length for x in self._quaternion)
        s, w, kappa = iv.mpc(x0, x3), iv.mpc(x1, x2), self._turned[family][0]
        pp, pq, qq = (_surd(pair) for pair in self._coefficients[family])
        sign = ROOT_SIGN[branch] * (-1 if kappa < 0 else 1)
        root = sign * iv.sqrt(_surd(self._discriminant(family)))
        # Of the two forms of a root the one without cancellation.
        cancels = sign * _surd_sign(self._coefficients[family][1]) > 0
        p, q = (2 * qq, -pq - root) if cancels else (root - pq, 2 * pp)
        p *= length
        size = iv.sqrt((x1 * x1 + x2 * x2) / (p * p + q * q - 2 * (kappa / length) * p * q))
        p, q = p * size * (1 if _LOWER[family] > 0 else 1j), q * size * (1 if _UPPER[family] > 0 else 1j)
        w_a = (_conjugate(q) - s * _conjugate(p)) / _conjugate(w)
        w_b = _conjugate((s * q - p) / w)
        below, above = (-1j * r * _conjugate(x * x) for x in (w_a, w_b))
        # o + R t_b = t_a along the tilt of {m} gives the upper height, and along Z the lower.
        rows = [[iv.mpf(entry) / self.norm for entry in row] for row in self.matrix]
        x, y, z = (
            iv.mpf(o) / self.scale + row[0] * above.real + row[1] * above.imag
            for o, row in zip(self.position, rows, strict=True)
        )
        tilt = iv.mpc(rows[0][2], rows[1][2])
        across = (_conjugate(tilt) * (below - iv.mpc(x, y))).real
        height = z + rows[2][2] * across / (tilt.real * tilt.real + tilt.imag * tilt.imag)
        joints, gaps = np.empty((3, 3)), []
        for i, u in enumerate((iv.mpc(root_3 / 2, -0.5), iv.mpc(0, 1), iv.mpc(-root_3 / 2, -0.5))):
            radius = r * ((p * p).real - 2 * (w_a * w_a * u).imag)
            exact = radius * u.real, radius * u.imag, height + 2 * r * (p * _conjugate(w_a) * u).imag
            joints[i] = [float(x.mid) for x in exact]
            gaps.append(iv.sqrt(sum((x - float(x.mid)) ** 2 for x in exact)))
        return joints, max(float(np.nextafter(float(gap.b), np.inf)) for gap in gaps)


def largest_component(rotation: FloatArray) -> IntArray:
    """Return which of `quaternions` the kernels take of matrices (..., 3, 3): that of the largest component."""
    a, b, c = np.moveaxis(np.diagonal(rotation, axis1=-2, axis2=-1), -1, 0)
    return np.asarray(np.argmax([a + b + c, c, b, a], axis=0))


def quaternions(rotation: Sequence[Any], unit: Any) -> tuple[tuple[Any, Any, Any, Any], ...]:
    """Return x0, x1, x2, x3, of any length, computed from x0, x3, x2 and x1 of a rotation matrix.

    The nine entries, row by row and in units of 1 / `unit`, are whole numbers or intervals.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation
    trace = r00 + r11 + r22
    return (
        (unit + trace, r21 - r12, r02 - r20, r10 - r01),
        (r10 - r01, r20 + r02, r21 + r12, unit - trace + 2 * r22),
        (r02 - r20, r10 + r01, unit - trace + 2 * r11, r21 + r12),
        (r21 - r12, unit - trace + 2 * r00, r10 + r01, r20 + r02),
    )


def scaled_rotation(quaternion: Sequence[Any], square: Callable[[Any], Any]) -> list[list[Any]]:
    """Return σR, σ the squared length of x0, x1, x2, x3, which are numbers or intervals with this `square`."""
    x0, x1, x2, x3 = quaternion
    ww, xx, yy, zz = map(square, quaternion)
    return [
        [ww + xx - (yy + zz), 2 * (x1 * x2 - x0 * x3), 2 * (x1 * x3 + x0 * x2)],
        [2 * (x1 * x2 + x0 * x3), ww + yy - (xx + zz), 2 * (x2 * x3 - x0 * x1)],
        [2 * (x1 * x3 - x0 * x2), 2 * (x2 * x3 + x0 * x1), ww + zz - (xx + yy)],
    ]
