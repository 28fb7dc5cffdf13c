"""Axes of a domain: the coordinates of a pose, or the six leg lengths, each with its range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS
from spm_pin.mechanism.arguments import FloatArray, real_array

AxisRange = float | Sequence[float]
"""One value, (start, stop, count) of a grid, or (start, stop) of a sample [m or rad]."""
Space = Literal["pose", "legs"]
"""The coordinates of a domain: poses of the platform, or six leg lengths."""

_LENGTHS = {k.lower(): f"{k} of o in {{B}}" for k in "XYZ"} | {leg: f"length of leg {leg}" for leg in LEGS}
_ANGLES = {name: f"X-Y-X Euler angle {sign}" for name, sign in (("alpha", "α"), ("beta", "β"), ("lambda_", "λ"))}
AXES: Mapping[str, tuple[str, ...]] = {"pose": ("x", "y", "z", *_ANGLES), "legs": LEGS}
"""Names of the six coordinates of each space."""
_MOST_VALUES = 10**8
"""Values along one axis; they are held in memory."""


@dataclass(frozen=True)
class Axis:
    """One coordinate of a domain and its values."""

    name: str
    """Name of the coordinate, one of `AXES`."""
    start: float
    """First value [m or rad]."""
    stop: float
    """Last value [m or rad]."""
    count: int
    """Number of equally spaced values, both ends included; 1 where the coordinate is fixed, 0 where it is sampled."""

    @staticmethod
    def of_range(name: str, value: AxisRange, sampled: bool) -> Axis:
        """Read one value, (start, stop, count), or (start, stop) where the coordinate is sampled."""
        unit = "radians" if name in _ANGLES else "metres"
        expected = f"one value or {'(start, stop)' if sampled else '(start, stop, count)'}, in {unit}"
        numbers = real_array(value, name, (), expected)
        if numbers.shape not in ((), (2 if sampled else 3,)):
            raise ArgumentError(name, expected, f"shape {numbers.shape}")
        start, stop = map(float, numbers[:2] if numbers.ndim else (numbers, numbers))
        if name in _ANGLES and max(abs(start), abs(stop)) > 2.0 * math.pi:
            raise ArgumentError(name, "angles within ±2π radians", value, "Degrees instead of radians?")
        if name in LEGS and start <= 0.0:
            raise ArgumentError(name, "positive lengths in metres", value)
        if numbers.ndim == 0:
            return Axis(name, start, stop, 1)
        if not start < stop:
            cause = "The ends exchanged?" if start > stop else "Give a fixed coordinate as one number."
            raise ArgumentError(name, "start < stop", f"{start:g} and {stop:g}", cause)
        count = 0.0 if sampled else float(numbers[2])
        if not sampled and (not 2 <= count <= _MOST_VALUES or count != int(count)):
            cause = "Give a fixed coordinate as one number." if count == 1 else ""
            raise ArgumentError(name, f"an integer count of at least 2, at most {_MOST_VALUES}", f"{count:g}", cause)
        return Axis(name, start, stop, int(count))

    @property
    def fixed(self) -> bool:
        """True if the coordinate has one value only."""
        return self.count == 1

    @property
    def values(self) -> FloatArray:
        """All values, shape (count,)."""
        return np.linspace(self.start, self.stop, self.count)

    @property
    def unit(self) -> str:
        """Unit, "rad" or "m"."""
        return "rad" if self.name in _ANGLES else "m"

    @property
    def description(self) -> str:
        """One line that says what the coordinate is."""
        return (_LENGTHS | _ANGLES)[self.name]
