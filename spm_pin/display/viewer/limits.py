"""The pose within the leg limits nearest to one that is not: a bounded Gauss-Newton search over the leg lengths.

With G the platform's Jacobian, a change δ of the lengths moves the c_i by A G δ to first order, so each step solves
min |r + A G δ|² for l_min <= l + δ <= l_max and for δ within a trust region, and the configuration follows its own
assembly mode there. G is finite at inverse singularities, which legs can pass though a platform cannot: the branch may
then end as another one.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import RigidTransform

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.jacobians import platform_jacobian
from spm_pin.errors import SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration

__all__ = ["nearest_within_limits"]

_STEPS = 20
_RADIUS = 0.15
"""First trust region: a leg changes by at most this share of d in a step."""
_DONE = 1e-5
"""Steps shorter than this share of d are not worth one more."""


def nearest_within_limits(start: Configuration, target: RigidTransform) -> Configuration:
    """Move a configuration as near to a pose as the leg limits of its geometry allow.

    Parameters
    ----------
    start : Configuration
        A single configuration within its limits, which its geometry has.
    target : RigidTransform
        The pose to come near to: the mean squared distance of the c_i is minimised, see
        `spm_pin.display.viewer.reach`.

    Returns
    -------
    Configuration
        Within the limits and in the assembly mode of `start`, from where it is found: a local minimum.
    """
    geometry = start.geometry
    limits = geometry.limits
    assert limits is not None
    low, high = np.array(limits.minimum), np.array(limits.maximum)
    wanted = target.apply(geometry.platform_joints)
    state, lengths, error = start, np.clip(start.leg_lengths, low, high), _error(start, wanted)
    home = bool(physical(start))
    radius = _RADIUS * geometry.middle_side
    for _ in range(_STEPS):
        try:
            delta = _step(state, wanted, np.maximum(low - lengths, -radius), np.minimum(high - lengths, radius))
        except SingularConfigurationError:
            break
        longest = float(np.abs(delta).max())
        if longest < _DONE * geometry.middle_side:
            break
        trial = np.clip(lengths + delta, low, high)
        # In the home mode no path needs to be followed, and finding it costs half as much.
        moved = forward_physical(geometry, trial, seed=None if home else state)
        there = _error(moved, wanted) if moved.exists else np.inf
        if there < error:
            radius = max(radius, 2.0 * longest) if there < 0.5 * error else radius
            state, lengths, error = moved, trial, there
        else:
            radius = 0.25 * longest
    return state


def _error(state: Configuration, wanted: FloatArray) -> float:
    return float(((state.platform_joints - wanted) ** 2).sum())


def _step(state: Configuration, wanted: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the change of the lengths (6,) [m], within bounds, that brings the c_i nearest to their places."""
    twists = platform_jacobian(state)
    arms = state.platform_joints - state.translation
    moves = twists[None, :3] + np.cross(twists[3:].T[None], arms[:, None]).swapaxes(-1, -2)
    # A length on its limit still needs an interval that is not empty.
    lower, upper = np.minimum(lower, 0.0) - 1e-12, np.maximum(upper, 0.0) + 1e-12
    error = (wanted - state.platform_joints).ravel()
    return np.asarray(lsq_linear(moves.reshape(9, 6), error, bounds=(lower, upper), method="bvls").x)
