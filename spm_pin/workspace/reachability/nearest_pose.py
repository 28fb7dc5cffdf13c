"""The reachable pose nearest to a given one: within leg limits, or where a branch is real.

Distance is measured where the platform is held: the root of the mean squared displacement of c_1, c_2, c_3.

Within leg limits this is least squares over the leg lengths l. With G the platform's Jacobian, a change δ of the
lengths moves the c_i by A G δ to first order, so each step solves min |r + A G δ|² for l_min <= l + δ <= l_max and for
δ within a trust region, and the configuration follows its own assembly mode there. G is finite at inverse
singularities, which legs can pass though a platform cannot: the branch may then end as another one. Without leg limits
see `spm_pin.workspace.reachability.family_slab`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import RigidTransform

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.jacobians import platform_jacobian
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES, FAMILIES, family, physical
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.workspace.reachability.family_slab import nearest_real_pose
from spm_pin.workspace.reachability.leg_box import leg_box

__all__ = ["NearestPose", "nearest_reachable_pose", "pose_distance"]

_STEPS = 20
_RADIUS = 0.15
"""First trust region: a leg changes by at most this share of d in a step."""
_DONE = 1e-5
"""Steps shorter than this share of d are not worth one more."""


@dataclass(frozen=True)
class NearestPose:
    """A reachable state near an unreachable pose; arrays over the poses asked for, of shape (...).

    Attributes
    ----------
    configuration : Configuration, shape (...)
        The nearest state found; NaN where none was found.
    distance : ndarray, shape (...)
        From the pose asked for, see `pose_distance` [m]; a float for one pose.
    """

    configuration: Configuration
    distance: Any


def pose_distance(geometry: Geometry, first: PoseLike, second: PoseLike) -> Any:
    """Return the root mean square displacement of c_1, c_2, c_3 between poses [m].

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    first, second : poses of shape (...)
        Of {m} in {B}; their shapes broadcast.

    Returns
    -------
    ndarray, shape (...)
        A float for two single poses.
    """
    places = [as_rigid_transform(pose, name).as_matrix() for pose, name in ((first, "first"), (second, "second"))]
    difference = places[0] - places[1]
    moved = difference[..., None, :3, 3] + geometry.platform_joints @ np.swapaxes(difference[..., :3, :3], -1, -2)
    distance = np.sqrt((moved**2).sum(axis=-1).mean(axis=-1))
    return distance if distance.shape else float(distance)


def nearest_reachable_pose(
    geometry: Geometry,
    pose: PoseLike,
    limits: LegLimits | None = None,
    *,
    branch: str | None = None,
    near: Configuration | None = None,
) -> NearestPose:
    """Find the reachable pose nearest to one that may be out of reach.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    pose : pose of shape (...)
        Of {m} in {B}, translation in metres.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given. With `LegLimits(0.0, inf)`, or without either, legs are not
        limited.
    branch : str, optional
        Without leg limits, the branch that has to be real, one of `BRANCHES`; if not given that of `near`, or "TT+".
        Within leg limits it must not be given: legs carry a configuration from one branch to another.
    near : Configuration, optional
        A single state to begin with, such as the last one. Within leg limits its assembly mode is kept; without `near`
        it is the mode of a real machine, and the search begins at the nearest of a sample of states.

    Returns
    -------
    NearestPose
        The pose itself where it is reachable. A local minimum of the distance in any case.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    ArgumentError
        If another argument is of the wrong kind, `near` does not exist, is outside the limits or of another geometry,
        or no lengths within the limits belong to a configuration.

    Examples
    --------
    >>> import spm_pin as spm
    >>> geometry = spm.Geometry.paper()
    >>> found = spm.workspace.nearest_reachable_pose(geometry, spm.pose([0.3, 0.1, 3.0], xyx=[0.1, 0.3, -0.1]))
    >>> bool(geometry.limits.contains(found.configuration.leg_lengths)), round(found.distance, 3)
    (True, 0.344)
    """
    if not isinstance(geometry, Geometry):
        raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
    if limits is not None and not isinstance(limits, LegLimits):
        raise ArgumentError("limits", "LegLimits or None", type(limits).__name__)
    target = as_rigid_transform(pose)
    limits = limits or geometry.limits or LegLimits(0.0, np.inf)
    limited = max(limits.minimum) > 0.0 or min(limits.maximum) < np.inf
    if near is not None:
        _check_near(geometry, near, limits)
    if branch is not None and (limited or branch not in BRANCHES):
        expected = "None where legs are limited" if limited else f"one of {', '.join(BRANCHES)}"
        raise ArgumentError("branch", expected, repr(branch))
    branch = branch or FAMILIES[0 if near is None else int(family(near))] + "+"
    found = np.empty(target.shape, dtype=object)
    for index in np.ndindex(target.shape):
        single = target[index] if target.shape else target
        if limited:
            found[index] = _within(_start(geometry, single, limits) if near is None else near, single, limits)
        else:
            real = nearest_real_pose(geometry, single, branch[:2], None if near is None else near.pose)
            found[index] = inverse_displacement(geometry, real)[branch]
    arrays = (
        np.reshape([getattr(state, name) for state in found.flat], (*target.shape, *trailing))
        for name, trailing in (("rotation", (3, 3)), ("translation", (3,)), ("middle_joints", (3, 3)))
    )
    states = Configuration.from_arrays(geometry, *arrays)
    distance = np.where(states.exists, pose_distance(geometry, states.pose, target), np.nan)
    return NearestPose(states, distance if target.shape else float(distance))


def _check_near(geometry: Geometry, near: Configuration, limits: LegLimits) -> None:
    if not isinstance(near, Configuration) or near.shape or not near.exists:
        raise ArgumentError("near", "a single Configuration that exists", repr(near))
    sizes = [(g.base_radius, g.platform_radius, g.middle_side) for g in (geometry, near.geometry)]
    if sizes[0] != sizes[1]:
        raise ArgumentError("near", "a configuration of the same geometry", repr(near.geometry))
    if not limits.margin(near.leg_lengths) >= -1e-9 * geometry.middle_side:
        raise ArgumentError("near", "a configuration within the leg limits", repr(near))


def _start(geometry: Geometry, target: RigidTransform, limits: LegLimits) -> Configuration:
    """Return the state nearest to `target` of a sample within the limits."""
    states = forward_physical(geometry, leg_box(geometry, limits).lengths)
    return states[int(np.argmin(pose_distance(geometry, states.pose, target)))]


def _within(start: Configuration, target: RigidTransform, limits: LegLimits) -> Configuration:
    """Move a configuration within leg limits as near to `target` as they allow."""
    geometry = start.geometry
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
