"""Arguments of the forward displacement: leg lengths, and the configuration to begin with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, broadcastable, check_instance, first_offender, real_array
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS

_OPEN = 1e-6
"""Closure residual of a seed, relative to d, from which on it is no configuration."""
_LARGEST = 1e5
"""Lengths, relative to the machine, beyond which eleven of sixteen digits are lost."""


def read_leg_lengths(geometry: Geometry, leg_lengths: npt.ArrayLike) -> FloatArray:
    """Read leg lengths (..., 6) [m] that this machine can be resolved beside; of one as built readings.

    Returned are the distances from pivots to balls.
    """
    nominal = check_instance(geometry, Geometry, "geometry").nominal
    offsets = geometry.legs.offsets if not geometry.is_nominal else None
    meaning = f"{', '.join(LEGS)} in metres"
    read = real_array(leg_lengths, "leg_lengths", (6,), meaning if offsets is None else f"readings of {meaning}")
    lengths = read if offsets is None else np.asarray(read - offsets)
    if (lengths <= 0.0).any():
        index = first_offender(lengths <= 0.0)
        where = f" for {LEGS[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        if offsets is not None:
            expected = f"readings that exceed their offset, {offsets[index[-1]]:g} m{where}"
            raise ArgumentError("leg_lengths", expected, f"{read[index]:g}")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        raise ArgumentError("leg_lengths", f"positive lengths {meaning}", f"{lengths[index]:g}{where}", cause)
    size = sum(nominal.dimensions)
    if (lengths > _LARGEST * size).any():
        index = first_offender(lengths > _LARGEST * size)
        expected = f"lengths in metres up to {_LARGEST:.0e} times the machine's own {size:.3g} m"
        raise ArgumentError("leg_lengths", expected, f"{lengths[index]:g}", "Lengths in another unit?")
    return lengths


def check_seed(geometry: Geometry, lengths: FloatArray, seed: Configuration) -> None:
    """Raise an ArgumentError if `seed` is no closed state of this geometry that goes with lengths (..., 6)."""
    check_configuration(seed, "seed", existing=True)
    if not geometry.is_same_machine(seed.geometry):
        raise ArgumentError("seed", f"a configuration of this geometry, {geometry!r}", repr(seed.geometry))
    broadcastable("seed", seed.shape, "leg_lengths", lengths.shape[:-1])
    torn = float(seed.closure_residual.max(initial=0.0))
    if torn > _OPEN * geometry.nominal.middle_side:
        raise ArgumentError("seed", "a configuration that closes", f"a closure residual of {torn:.1e} m")
