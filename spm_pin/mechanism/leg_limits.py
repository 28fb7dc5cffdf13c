"""The six legs: their names and order, and the limits of their lengths."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import BoolArray, FloatArray, as_array, number_pair, real_array, type_and_value

LEGS = ("r_b1", "r_b2", "r_b3", "r_c1", "r_c2", "r_c3")
"""Names and order of the legs: the lower stage's three, then the upper stage's."""

ORDERED = "0 <= minimum < maximum for every leg, in metres"


@dataclass(frozen=True, init=False, repr=False)
class LegLimits:
    """Shortest and longest length of each leg.

    Parameters
    ----------
    minimum, maximum : float or sequence of six floats
        Lengths in metres, in the order of `LEGS`. `maximum` may be infinite.
    """

    minimum: tuple[float, ...]
    maximum: tuple[float, ...]

    def __init__(self, minimum: float | Sequence[float], maximum: float | Sequence[float]) -> None:
        object.__setattr__(self, "minimum", _six(minimum, "minimum"))
        object.__setattr__(self, "maximum", _six(maximum, "maximum"))
        for leg, low, high in zip(LEGS, self.minimum, self.maximum, strict=True):
            if not 0.0 <= low < high:
                cause = "Minimum and maximum exchanged?" if low > high >= 0.0 else ""
                raise GeometryError("limits", ORDERED, f"[{low:g}, {high:g}] for {leg}", cause)

    @classmethod
    def stages(cls, lower: Sequence[float], upper: Sequence[float]) -> LegLimits:
        """Make limits from one (minimum, maximum) pair [m] for the lower legs and one for the upper."""
        pairs = [number_pair(lower, "lower", "metres", error=GeometryError)] * 3
        pairs += [number_pair(upper, "upper", "metres", error=GeometryError)] * 3
        return cls(*zip(*pairs, strict=True))

    def __repr__(self) -> str:
        pairs = [f"{low:.6g}, {high:.6g}" for low, high in zip(self.minimum, self.maximum, strict=True)]
        if len(set(pairs)) == 1:
            return f"LegLimits({pairs[0]})"
        if len(set(pairs[:3])) == len(set(pairs[3:])) == 1:
            return f"LegLimits.stages(({pairs[0]}), ({pairs[3]}))"
        bounds = (f"[{', '.join(f'{end:.6g}' for end in ends)}]" for ends in (self.minimum, self.maximum))
        return f"LegLimits({', '.join(bounds)})"

    def contains(self, readings: npt.ArrayLike) -> BoolArray:
        """Return which sets of readings (..., 6) [m] respect all limits; NaN does not."""
        return np.asarray(self.margin(readings) >= 0.0)

    def excess(self, readings: npt.ArrayLike) -> FloatArray:
        """Return by how much each leg of (..., 6) [m] is too long, or too short (negative); 0 within its limits."""
        lengths = real_array(readings, "readings", (6,), "what the encoders show, in metres", allow_nan=True)
        return np.asarray(np.maximum(lengths - self.maximum, 0.0) + np.minimum(lengths - self.minimum, 0.0))

    def margin(self, readings: npt.ArrayLike) -> FloatArray:
        """Return the margin [m] of the worst leg of (..., 6) [m] to its limits; negative outside, NaN for NaN."""
        lengths = real_array(readings, "readings", (6,), "what the encoders show, in metres", allow_nan=True)
        inside = np.minimum(lengths - np.array(self.minimum), np.array(self.maximum) - lengths)
        # Leg by leg: NumPy takes several times as long to reduce a short last axis.
        return np.asarray(functools.reduce(np.minimum, np.moveaxis(inside, -1, 0)))


def _six(value: float | Sequence[float], argument: str) -> tuple[float, ...]:
    expected = "one length or six in the order " + ", ".join(LEGS) + ", in metres"
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise GeometryError(argument, expected, type_and_value(value))
    if array.shape not in ((), (6,)):
        raise GeometryError(argument, expected, f"shape {array.shape}")
    if np.isnan(array).any():
        raise GeometryError(argument, expected, "NaN", "Use 0 and infinity where there is no limit")
    return tuple(float(x) for x in np.broadcast_to(array, 6))
