"""Interval arithmetic with outward rounding on arrays of double-precision intervals.

IEEE 754 rounds +, -, × and the square root correctly, so the exact result lies between the neighbours of the computed
one; every operation moves its ends to these neighbours or one place further. An operation on intervals then contains
the exact result of the operation on any numbers in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.support.arguments import BoolArray, FloatArray

_PLACE = float(np.finfo(np.float64).eps)
_LEAST = float(np.finfo(np.float64).tiny)


def _below(x: FloatArray) -> FloatArray:
    # A step of |x| ε is at least one place and exact, or below the smallest normal number: a fifth of nextafter's time.
    return np.asarray(x - (np.abs(x) * _PLACE + _LEAST))


def _above(x: FloatArray) -> FloatArray:
    return np.asarray(x + (np.abs(x) * _PLACE + _LEAST))


@dataclass(frozen=True)
class Interval:
    """Closed intervals [low, high], low <= high: two arrays of one shape."""

    low: FloatArray
    high: FloatArray

    # NumPy leaves `array * interval` to this class.
    __array_ufunc__ = None

    @classmethod
    def from_numbers(cls, value: npt.ArrayLike) -> Interval:
        """Return intervals that contain exactly one double each."""
        array = np.asarray(value, dtype=np.float64)
        return cls(array, array)

    @classmethod
    def within(cls, bound: npt.ArrayLike) -> Interval:
        """Return the intervals of the numbers up to a bound in magnitude."""
        array = np.asarray(bound, dtype=np.float64)
        return cls(-array, array)

    def __add__(self, other: Interval | float) -> Interval:
        other = as_interval(other)
        return Interval(_below(self.low + other.low), _above(self.high + other.high))

    def __sub__(self, other: Interval | float) -> Interval:
        return self + -as_interval(other)

    def __rsub__(self, other: float) -> Interval:
        return as_interval(other) - self

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __mul__(self, other: Interval | float) -> Interval:
        other = as_interval(other)
        products = (self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high)
        low = np.minimum(np.minimum(products[0], products[1]), np.minimum(products[2], products[3]))
        high = np.maximum(np.maximum(products[0], products[1]), np.maximum(products[2], products[3]))
        return Interval(_below(low), _above(high))

    def __truediv__(self, other: Interval) -> Interval:
        return self * other.reciprocal()

    def __rtruediv__(self, other: float) -> Interval:
        return other * self.reciprocal()

    __radd__ = __add__
    __rmul__ = __mul__

    def square(self) -> Interval:
        """Return the squares; unlike a product of the interval with itself, never negative."""
        low, high = self.low * self.low, self.high * self.high
        least = np.where((self.low <= 0.0) & (self.high >= 0.0), 0.0, _below(np.minimum(low, high)))
        return Interval(np.maximum(least, 0.0), _above(np.maximum(low, high)))

    def root(self) -> Interval:
        """Return the square roots of the part that is not negative; 0 if that is empty."""
        low, high = np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0))
        return Interval(np.maximum(_below(low), 0.0), _above(high))

    def reciprocal(self) -> Interval:
        """Return 1/x; both ends NaN where the interval contains zero."""
        contains_zero = (self.low <= 0.0) & (self.high >= 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = _below(1.0 / self.high), _above(1.0 / self.low)
        return Interval(np.where(contains_zero, np.nan, low), np.where(contains_zero, np.nan, high))

    def least(self) -> FloatArray:
        """Return the smallest magnitudes of numbers in the intervals; 0 if one contains zero."""
        return np.maximum(np.maximum(self.low, -self.high), 0.0)

    def misses(self, other: Interval) -> BoolArray:
        """Return True for the intervals that have no point in common."""
        return np.asarray((self.low > other.high) | (self.high < other.low))


def as_interval(value: Interval | float) -> Interval:
    """Return an interval unchanged, and a number as the interval of that number."""
    return value if isinstance(value, Interval) else Interval.from_numbers(value)


def real_root(x: Interval) -> Interval:
    """Return the square roots of the part that is not negative; both ends NaN if that is empty."""
    root, absent = x.root(), x.high < 0.0
    return Interval(np.where(absent, np.nan, root.low), np.where(absent, np.nan, root.high))


def cosine(x: Interval | float) -> Interval:
    """Return the cosines."""
    x = as_interval(x)
    ends, width = np.cos(x.low), np.cos(x.high)
    low, high = np.minimum(ends, width) - _TRIGONOMETRIC, np.maximum(ends, width) + _TRIGONOMETRIC
    # Multiples of π within, or next to an end.
    first, last = np.ceil(x.low / np.pi - _TRIGONOMETRIC), np.floor(x.high / np.pi + _TRIGONOMETRIC)
    several = last > first
    high = np.where(several | ((first == last) & (first % 2.0 == 0.0)), 1.0, np.minimum(high, 1.0))
    low = np.where(several | ((first == last) & (first % 2.0 != 0.0)), -1.0, np.maximum(low, -1.0))
    return Interval(low, high)


def sine(x: Interval | float) -> Interval:
    """Return the sines."""
    return cosine(as_interval(x) - RIGHT_ANGLE)


def angle(y: Interval, x: Interval) -> Interval:
    """Return the angles of points (x, y), from -π to π: the whole range if they are on both sides of the cut."""
    corners = [np.arctan2(b, a) for a in (x.low, x.high) for b in (y.low, y.high)]
    low, high = np.minimum.reduce(corners) - 4.0 * _TRIGONOMETRIC, np.maximum.reduce(corners) + 4.0 * _TRIGONOMETRIC
    cut = (x.low <= 0.0) & (y.low <= 0.0) & (y.high >= 0.0)
    return Interval(np.where(cut, -_TURN, low), np.where(cut, _TURN, high))


_TRIGONOMETRIC = 1e-15
"""Relative error of NumPy's cosines, and of its angles over π: they are right to four places."""
_TURN = float(np.pi) + 1e-15
RIGHT_ANGLE = Interval(np.nextafter(np.pi / 2.0, 0.0), np.nextafter(np.pi / 2.0, 2.0))
"""The angle π/2."""
SQRT_3 = Interval(np.nextafter(np.sqrt(3.0), 0.0), np.nextafter(np.sqrt(3.0), 2.0))
"""The square root of three."""

INTERVALS: dict[str, Any] = {"sqrt": real_root, "cos": cosine, "sin": sine, "arctan2": angle}
INTERVALS |= {"RIGHT_ANGLE": RIGHT_ANGLE}
"""The operations of formulas on intervals."""
