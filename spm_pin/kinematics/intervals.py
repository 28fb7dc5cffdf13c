"""Interval arithmetic with outward rounding on arrays of double-precision intervals.

IEEE 754 rounds +, -, × and the square root correctly, so the exact result lies between the neighbours of the computed
one; every operation moves its ends out to these neighbours or one place beyond. An operation on intervals then contains
the exact result of the operation on any numbers in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import BoolArray, FloatArray

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

    # NumPy leaves `array * interval` to the interval.
    __array_ufunc__ = None

    @classmethod
    def from_numbers(cls, value: npt.ArrayLike) -> Interval:
        """Return intervals of one number each: exactly those doubles."""
        array = np.asarray(value, dtype=np.float64)
        return cls(array, array)

    @classmethod
    def within(cls, bound: npt.ArrayLike) -> Interval:
        """Return the intervals of the numbers that are not larger than a bound, of either sign."""
        array = np.asarray(bound, dtype=np.float64)
        return cls(-array, array)

    def __add__(self, other: Interval | float) -> Interval:
        other = _interval(other)
        return Interval(_below(self.low + other.low), _above(self.high + other.high))

    def __sub__(self, other: Interval | float) -> Interval:
        return self + -_interval(other)

    def __rsub__(self, other: float) -> Interval:
        return _interval(other) - self

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __mul__(self, other: Interval | float) -> Interval:
        other = _interval(other)
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
        """Return the square roots of the part that is not negative; 0 where none is."""
        low, high = np.sqrt(np.maximum(self.low, 0.0)), np.sqrt(np.maximum(self.high, 0.0))
        return Interval(np.maximum(_below(low), 0.0), _above(high))

    def reciprocal(self) -> Interval:
        """Return 1/x; both ends NaN where the interval contains zero."""
        contains_zero = (self.low <= 0.0) & (self.high >= 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = _below(1.0 / self.high), _above(1.0 / self.low)
        return Interval(np.where(contains_zero, np.nan, low), np.where(contains_zero, np.nan, high))

    def least(self) -> FloatArray:
        """Return the smallest magnitudes of numbers in the intervals; 0 where one contains zero."""
        return np.maximum(np.maximum(self.low, -self.high), 0.0)

    def misses(self, other: Interval) -> BoolArray:
        """Return True for the intervals that have no point in common."""
        return np.asarray((self.low > other.high) | (self.high < other.low))


def _interval(value: Interval | float) -> Interval:
    return value if isinstance(value, Interval) else Interval.from_numbers(value)


SQRT_3 = Interval(np.nextafter(np.sqrt(3.0), 0.0), np.nextafter(np.sqrt(3.0), 2.0))
"""The square root of three."""
