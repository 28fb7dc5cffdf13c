"""Units of length, and which one a length is in that is out of proportion to its machine."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.mechanism import Mechanism

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""Units of length, and how many of them are a metre."""
_PROPORTION = 10.0
"""Lengths this many times the machine's size are read as a wrong unit."""
_USUAL = 0.4
"""Share of the machine's size that heights, readings and positions usually have."""


def likely_unit(machine: Mechanism, length: float, unit: str = "m") -> str | None:
    """Return the unit in which a length [m], if it was typed in `unit`, would be in proportion; None if it is."""

    def disproportion(tried: str, share: float = _USUAL) -> float:
        return abs(math.log(length * PER_METRE[unit] / PER_METRE[tried] / (share * machine.size)))

    if not (np.isfinite(length) and length > 0.0) or disproportion(unit, 1.0) < math.log(_PROPORTION):
        return None
    better = min(PER_METRE, key=disproportion)
    return better if better != unit else None


def unit_hint(machine: Mechanism, lengths: npt.ArrayLike) -> str:
    """Return a sentence on the unit that the largest of these lengths [m] may be in; empty if in proportion."""
    length = float(np.abs(lengths).max())
    unit = likely_unit(machine, length)
    if unit is None:
        return ""
    return f"Lengths are in metres, and {length:g} m are out of proportion to this machine; is it {length:g} {unit}?"
