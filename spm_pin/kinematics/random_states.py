"""Random states of a machine, for comparisons, experiments and the ranges of controls."""

from __future__ import annotations

from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.machine.joint_angles import homes
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import FloatArray

_SPREAD = 1.33
"""Without limits, readings are those in the home times or divided by at most this."""
_ATTEMPTS = 100


def random_states(machine: Any, count: int, rng: np.random.Generator) -> Any:
    """Draw physical states (count,) whose readings are uniform within the leg limits.

    Without limits the balls are as far from their pivots as in the home, up to a third more or less; instead of limits
    of zero and infinity they are at a third and three times that distance. Raises `ArgumentError` if there are no
    states within the limits, or very few.
    """
    legs, limits = machine.legs, machine.limits
    low, high = _around_home(machine, _SPREAD)
    if limits is not None:
        least, most = limits.ends
        low, high = _around_home(machine, 3.0)
        low = np.where(least > legs.least_readings, least, low)
        high = np.where(np.isfinite(most), most, np.maximum(high, 3.0 * low))
    readings = np.empty((0, len(legs.names)))
    for _ in range(_ATTEMPTS):
        states = forward_physical(machine, rng.uniform(low, high, (2 * count, len(legs.names))))
        readings = np.concatenate([readings, states.readings[states.exists]])[:count]
        if len(readings) == count:
            return forward_physical(machine, readings)
    raise ArgumentError("machine", "leg limits within which the machine has states", repr(limits))


def _around_home(machine: Machine, factor: float) -> tuple[FloatArray, FloatArray]:
    """Return the readings (legs,) of balls so many times nearer to their pivots, or farther, than at home.

    For a ball out of a leg's reach it is the reading in the home.
    """
    home, places = homes(machine)
    ends = [machine.legs.readings(places * share, machine.crank_middles) for share in (1.0 / factor, factor)]
    near, far = (np.where(np.isnan(end), home + machine.legs.offsets, end) for end in ends)
    return np.minimum(near, far), np.maximum(near, far)
