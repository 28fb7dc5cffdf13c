"""Positions reached by construction: forward displacement of leg lengths drawn at random.

Drawn evenly, leg lengths seldom put the platform near the boundary of what it can reach; here many legs are at their
limits, or near them.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LegLimits

__all__ = ["reached_positions"]

_AT_A_LIMIT = 0.35
"""Share of the legs that are drawn at a limit."""


def reached_positions(
    geometry: Geometry, limits: LegLimits, *, count: int = 200_000, seed: int = 0
) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Draw leg lengths within limits; return positions of o (N, 3) [m] and the sign of det K (N,) in each state.

    Of `count` sets of leg lengths within positive and finite limits. If the limits are the same for the legs of a
    stage, each gives six positions: it stands for its images under the symmetries of the machine as well.
    """
    low, high = np.array(limits.minimum), np.array(limits.maximum)
    rng = np.random.default_rng(seed)
    share = np.sin(0.5 * math.pi * rng.random((count, 6))) ** 2
    share = np.where(rng.random(share.shape) < _AT_A_LIMIT, share.round(), share)
    states = forward_physical(geometry, (1.0 - share) * low + share * high)
    states = states[states.exists]
    positions, aspect = states.translation, np.sign(determinants(states)[:, 2]).astype(np.int8)
    if all(len(set(ends)) == 1 for ends in (low[:3], low[3:], high[:3], high[3:])):
        positions, aspect = _images(positions, aspect)
    return positions, aspect


def _images(positions: FloatArray, aspect: npt.NDArray[np.int8]) -> tuple[FloatArray, npt.NDArray[np.int8]]:
    """Return all positions turned by 0, 120 and 240 degrees, and mirrored; a mirror changes the sign of det K."""
    mirrored = positions * [-1.0, 1.0, 1.0]
    both, signs = np.concatenate([positions, mirrored]), np.concatenate([aspect, -aspect])
    turns = Rotation.from_euler("z", [[0.0], [120.0], [240.0]], degrees=True)
    return np.concatenate([turn.apply(both) for turn in turns]), np.tile(signs, 3)
