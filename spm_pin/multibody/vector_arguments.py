"""Reading joint values, rates, twists, wrenches and gains; quick for a single vector, as control loops need it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array


class Gains(NamedTuple):
    """Gains of the constraint stabilisation, kp on the gap [1/s²] and kd on its rate [1/s]."""

    kp: float
    kd: float


WrenchLike = npt.ArrayLike | Mapping[str, npt.ArrayLike] | None
"""A wrench (..., 6) on the platform, wrenches by the name of their frame, or none."""
GainsLike = tuple[float, float] | None
"""Gains of the constraint stabilisation on gap [1/s²] and gap rate [1/s], or none."""

_FLOAT = np.dtype(np.float64)
JOINTS = "joint values in rad and m in Pinocchio's order"
RATES = "rates of the joints in Pinocchio's order"
MEANINGS = {
    **dict.fromkeys(("q", "q0", "near"), JOINTS),
    **dict.fromkeys(("v", "v0", "a"), RATES),
    **dict.fromkeys(("other", "chain"), "in Pinocchio's order"),
    "readings": "of r_b1 to r_c3 in m",
    "leg_rates": "of r_b1 to r_c3 in m/s",
    "leg_accelerations": "of r_b1 to r_c3 in m/s²",
    "forces": "of the actuators in N and N m",
    "twist": "(v, ω) at o in {B} in m/s and rad/s",
    "acceleration": "of o in m/s², angular in rad/s², in {B}",
    "wrench": "(f, m) in N and N m in the axes of {B}",
}
"""Meaning of each argument, for messages."""


def read_vectors(value: npt.ArrayLike, argument: str, size: int) -> FloatArray:
    """Return vectors (..., size) as float64, or raise `ArgumentError`."""
    if (
        type(value) is np.ndarray
        and value.shape == (size,)
        and value.dtype == _FLOAT
        # Quicker than NumPy's own tests; far too large numbers may have a sum that is not finite, either.
        and (math.isfinite(sum(value.tolist())) or np.isfinite(value).all())
    ):
        return value
    return real_array(value, argument, (size,), MEANINGS[argument])


def read_vector(value: npt.ArrayLike, argument: str, size: int) -> FloatArray:
    """Return one vector (size,) as float64, or raise `ArgumentError`."""
    array = read_vectors(value, argument, size)
    if array.ndim != 1:
        raise ArgumentError(argument, f"shape ({size},), {MEANINGS[argument]}", f"shape {array.shape}")
    return array


def read_gains(gains: GainsLike) -> Gains | None:
    """Return the gains of a drift control, or raise `ArgumentError`."""
    if gains is None:
        return None
    array = real_array(gains, "gains", (2,), "kp in 1/s² and kd in 1/s")
    if array.ndim != 1 or (array < 0.0).any():
        raise ArgumentError("gains", "a pair (kp, kd), not negative", repr(gains))
    return Gains(float(array[0]), float(array[1]))
