"""Readings of encoders, as arguments of functions."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.machine.machine import Machine, check_machine, likely_unit
from spm_pin.support.arguments import LARGEST_RATIO, FloatArray, first_offender, real_array


def read_readings(machine: Machine, readings: npt.ArrayLike) -> FloatArray:
    """Read readings (..., n) of a machine, none so large that rounding hides the machine.

    Lengths of a stage are in proportion to it, as cylinders have a state with lengths in another unit too.
    """
    legs, size = check_machine(machine).legs, machine.size
    meaning = f"in {legs.unit_text()}"
    read = real_array(readings, "readings", (len(legs.names),), f"{', '.join(legs.names)} {meaning}")
    own, farthest = np.asarray(read - legs.offsets), _farthest(legs.units, size)
    short, is_far = own <= legs.least_readings, np.abs(own) > farthest
    if not np.count_nonzero(short | is_far):
        if machine.is_stage and legs.units[0] == "m":
            check_unit(machine, own, "readings", "lengths")
        return read
    if short.any():
        index = first_offender(short)
        where = f" for {legs.names[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        if legs.offsets[index[-1]]:
            expected = f"readings above their offset, {legs.offsets[index[-1]]:g} m{where}"
            raise ArgumentError("readings", expected, f"{read[index]:g}")
        cause = "Are they strokes of the actuators instead of distances between joint centres?"
        expected = f"positive lengths {', '.join(legs.names)} {meaning}"
        raise ArgumentError("readings", expected, f"{own[index]:g}{where}", cause)
    index = first_offender(is_far)
    if legs.units[index[-1]] == "rad":
        expected, cause = f"angles in radians within ±{MOST_TURNED:g} for {legs.names[index[-1]]}", "In degrees?"
    else:
        expected = f"lengths in metres up to {LARGEST_RATIO:.0e} times the machine's own {size:.3g} m"
        cause = "Are they in another unit?"
    raise ArgumentError("readings", expected, f"{own[index]:g}", cause)


@functools.lru_cache
def _farthest(units: tuple[str, ...], size: float) -> FloatArray:
    """Return the largest accepted readings of legs with these units in a machine of this size [m]."""
    return np.where([unit == "m" for unit in units], LARGEST_RATIO * size, MOST_TURNED)


def check_unit(stage: Machine, lengths: FloatArray, argument: str, meaning: str) -> None:
    """Raise `ArgumentError` for lengths in another unit than metres, out of proportion to a stage."""
    longest = float(np.abs(lengths).max(initial=0.0))
    if unit := likely_unit(stage, longest):
        expected = f"{meaning} in metres, in proportion to a stage about {stage.size:.3g} m high"
        raise ArgumentError(argument, expected, f"{longest:g}", f"Is it {longest:g} {unit}?")
