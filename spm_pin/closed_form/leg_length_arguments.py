"""Leg lengths as arguments of the forward displacement."""

from __future__ import annotations

import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, first_offender, instance, real_array
from spm_pin.mechanism.geometry import LEGS, Geometry

__all__ = ["read_lengths"]

_LARGEST = 1e5
"""Lengths, relative to the machine, beyond which eleven of sixteen digits are lost."""


def read_lengths(geometry: Geometry, leg_lengths: npt.ArrayLike) -> FloatArray:
    """Read leg lengths (..., 6) [m] that this machine can be resolved beside."""
    instance(geometry, Geometry, "geometry")
    meaning = f"{', '.join(LEGS)} in metres"
    lengths = real_array(leg_lengths, "leg_lengths", (6,), meaning)
    if (lengths <= 0.0).any():
        index = first_offender(lengths <= 0.0)
        where = f" for {LEGS[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        raise ArgumentError("leg_lengths", f"positive lengths {meaning}", f"{lengths[index]:g}{where}", cause)
    size = geometry.base_radius + geometry.platform_radius + geometry.middle_side
    if (lengths > _LARGEST * size).any():
        index = first_offender(lengths > _LARGEST * size)
        expected = f"lengths in metres up to {_LARGEST:.0e} times the machine's own {size:.3g} m"
        raise ArgumentError("leg_lengths", expected, f"{lengths[index]:g}", "Lengths in another unit?")
    return lengths
