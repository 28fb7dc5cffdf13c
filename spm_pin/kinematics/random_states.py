"""Random states of a machine, for comparisons, experiments and the ranges of controls."""

from __future__ import annotations

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.joint_angles import home_readings

_SPREAD = 1.33
"""Without limits, readings are those of the home times or divided by at most this."""
_ATTEMPTS = 100


def random_states(geometry: Geometry, count: int, rng: np.random.Generator) -> Configuration:
    """Draw physical states (count,) whose readings are uniform within the leg limits.

    Without limits the readings are those of the home, a third more or less; instead of limits that no leg has, such as
    lengths of zero and infinity, they are a third and three times those. Raises `ArgumentError` where the limits hold
    no state, or next to none.
    """
    home, limits = home_readings(geometry) + geometry.legs.offsets, geometry.limits
    low, high = home / _SPREAD, home * _SPREAD
    if limits is not None:
        least, most = np.array([limits.minimum, limits.maximum])
        shortest = np.repeat([kind.least_reading for kind in geometry.legs.kinds], 3)
        low = np.where(least == shortest, home / 3.0, least)
        high = np.where(np.isfinite(most), most, np.maximum(3.0 * home, 3.0 * low))
    readings = np.empty((0, 6))
    for _ in range(_ATTEMPTS):
        states = forward_physical(geometry, rng.uniform(low, high, (2 * count, 6)))
        readings = np.concatenate([readings, states.readings[states.exists]])[:count]
        if len(readings) == count:
            return forward_physical(geometry, readings)
    raise ArgumentError("geometry", "leg limits within which the machine has states", repr(limits))
