"""Random machines within errors of a nominal one, and readings within limits."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

import spm_pin as spm

Machine = TypeVar("Machine", spm.Stage, spm.Manipulator)


def machine_within(nominal: Machine, length: float, angle: float, rng: np.random.Generator) -> Machine:
    """Return a random machine; half of them are at corners of the set."""
    errors = np.where(np.array(nominal.parameter_units) == "rad", angle, length)
    share = rng.uniform(-1.0, 1.0, len(errors)) if rng.uniform() < 0.5 else rng.choice([-1.0, 1.0], len(errors))
    return nominal.from_parameters(nominal.parameters + errors * share)


def readings_within(limits: spm.LegLimits, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return readings (count, n), a third of them at ends of the limits, by hardly more than the rounding of one."""
    low, high = np.array(limits.minimum) + 1e-12, np.array(limits.maximum) - 1e-12
    readings = rng.uniform(low, high, (count, len(low)))
    return np.where(rng.random((count, 1)) < 1.0 / 3.0, np.where(rng.random(readings.shape) < 0.5, low, high), readings)
