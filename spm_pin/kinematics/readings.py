"""Readings of encoders, as arguments of functions."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.machine.legs import Legs
from spm_pin.support.arguments import LARGEST_RATIO, FloatArray, first_offender, real_array


def read_readings(legs: Legs, size: float, readings: npt.ArrayLike) -> FloatArray:
    """Check readings (..., n) of these legs; they must not be so large that rounding exceeds the `size` [m]."""
    meaning = f"in {legs.unit_text()}"
    read = real_array(readings, "readings", (len(legs.names),), f"{', '.join(legs.names)} {meaning}")
    own, farthest = np.asarray(read - legs.offsets), _farthest(legs.units, size)
    short, is_far = own <= legs.least_readings, np.abs(own) > farthest
    if not np.count_nonzero(short | is_far):
        return read
    if short.any():
        index = first_offender(short)
        where = f" for {legs.names[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        if legs.offsets[index[-1]]:
            expected = f"readings that exceed their offset, {legs.offsets[index[-1]]:g} m{where}"
            raise ArgumentError("readings", expected, f"{read[index]:g}")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        expected = f"positive lengths {', '.join(legs.names)} {meaning}"
        raise ArgumentError("readings", expected, f"{own[index]:g}{where}", cause)
    index = first_offender(is_far)
    if legs.units[index[-1]] == "rad":
        expected, cause = f"angles in radians within ±{MOST_TURNED:g} for {legs.names[index[-1]]}", "In degrees?"
    else:
        expected = f"lengths in metres up to {LARGEST_RATIO:.0e} times the machine's own {size:.3g} m"
        cause = "Lengths in another unit?"
    raise ArgumentError("readings", expected, f"{own[index]:g}", cause)


@functools.lru_cache
def _farthest(units: tuple[str, ...], size: float) -> FloatArray:
    """Return the largest readings of legs with these units in a machine of this size [m]."""
    return np.where([unit == "m" for unit in units], LARGEST_RATIO * size, MOST_TURNED)
