"""Functions of `spm_pin.kinematics` and `spm_pin.stages`, chosen by the machine: a `Manipulator` or a `Stage`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin import kinematics
from spm_pin.kinematics import random_states as drawn
from spm_pin.kinematics import rates_and_forces
from spm_pin.machine.machine import Machine
from spm_pin.machine.stage import Stage
from spm_pin.machine.stage_configuration import StageConfiguration
from spm_pin.stages import displacement
from spm_pin.stages import rates_and_forces as stage_rates
from spm_pin.support.arguments import FloatArray


def forward_physical(machine: Machine, readings: npt.ArrayLike) -> Any:
    """Return the physical states (...) with readings (..., legs)."""
    if isinstance(machine, Stage):
        return displacement.forward_physical(machine, readings)
    return kinematics.forward_physical(machine, readings)  # type: ignore[arg-type]


def random_states(machine: Machine, count: int, rng: np.random.Generator) -> Any:
    """Draw physical states (count,) whose readings are uniform within the limits."""
    return drawn.random_states(machine, count, rng, forward_physical)


def platform_jacobian(configuration: Any) -> FloatArray:
    """Return the twists of the platform (..., 6, legs) per unit rate of each reading."""
    if isinstance(configuration, StageConfiguration):
        return stage_rates.platform_jacobian(configuration)
    return rates_and_forces.platform_jacobian(configuration)


def stage_inverses(configuration: Any) -> FloatArray:
    """Return the twists of each stage's platform (..., stages, 6, 6) for unit rates along its legs and their axes."""
    if isinstance(configuration, StageConfiguration):
        return stage_rates.stage_inverses(configuration)
    return rates_and_forces.stage_inverses(configuration)
