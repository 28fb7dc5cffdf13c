from __future__ import annotations

import numpy as np

import spm_pin as spm
from spm_pin.workspace.positions import Estimate
from spm_pin.workspace.states import pose_densities, states_within


def overlap(first: Estimate, second: Estimate) -> bool:
    """Test whether the intervals of two estimates have a number in common."""
    return first.low <= second.high and second.low <= first.high


def pose_volume(limits: spm.LegLimits, count: int, seed: int, geometry: spm.Geometry | None = None) -> Estimate:
    """The volume of the reachable poses, by the densities that samples uniform in the poses are made with."""
    states, rng = states_within(geometry or spm.Geometry.paper(), limits), np.random.default_rng(seed)
    (lower, lower_volume), (upper, upper_volume) = (states.draw_stages(stage, count, rng) for stage in range(2))
    values = pose_densities(states, np.stack([lower, upper], axis=1))
    return Estimate.from_mean(values, lower_volume * upper_volume, 0.95, "densities", "m³ rad³", 2.0 / count)
