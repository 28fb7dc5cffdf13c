"""The reachable pose nearest to a given one: within leg limits, or where a branch is real.

Distance is measured where the platform is held: the root of the mean squared displacement of c_1, c_2, c_3.

Within leg limits this is the least-squares problem of `spm_pin.workspace.reachability.nearest_points`, in the assembly
mode of the start. Derivatives with respect to the legs are finite at inverse singularities, which legs can pass though
a platform cannot: the branch may then end as another one. Without leg limits see
`spm_pin.workspace.reachability.nearest_real_pose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.mechanism import BRANCHES, FAMILIES, Configuration, Geometry, LegLimits, PoseLike, as_rigid_transform
from spm_pin.mechanism import pose as make_pose
from spm_pin.mechanism.arguments import FloatArray, check_instance, choice
from spm_pin.mechanism.branches import family, physical
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box
from spm_pin.workspace.reachability.nearest_points import nearest_states
from spm_pin.workspace.reachability.nearest_real_pose import nearest_real_pose
from spm_pin.workspace.reachability.position_map import PositionMap

_STARTS = 8
"""Starts of the search: the states of a sample whose platform joints are nearest to the target's."""
_MODE_TOLERANCE = 1e-7
"""Distance of the middle joints found from those of the lengths in the start's mode, over d, above which the search has
left that mode."""


@dataclass(frozen=True)
class NearestPose:
    """A reachable state near an unreachable pose; arrays over the given poses, of shape (...)."""

    configuration: Configuration
    """The nearest state found; NaN where none was found."""
    distance: Any
    """Distance from the given pose, see `pose_distance` [m]; a float for one pose."""


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
    check_instance(geometry, Geometry, "geometry")
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
        it is the physical mode, and the search begins at the nearest of a sample of states.

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
    >>> bool(geometry.limits.contains(found.configuration.readings)), round(found.distance, 3)
    (True, 0.344)
    """
    check_instance(geometry, Geometry, "geometry")
    limits = limits if limits is None else check_instance(limits, LegLimits, "limits")
    target = as_rigid_transform(pose)
    limits = limits or geometry.limits or LegLimits(0.0, np.inf)
    limited = max(limits.minimum) > 0.0 or min(limits.maximum) < np.inf
    if near is not None:
        _check_near(geometry, near, limits)
    if branch is not None:
        if limited:
            raise ArgumentError("branch", "None where legs are limited", repr(branch))
        choice(branch, "branch", BRANCHES)
    matrices = target.as_matrix().reshape(-1, 4, 4)
    if limited:
        states = _within_limits(geometry, matrices, limits, near)
    else:
        branch = branch or FAMILIES[0 if near is None else int(family(near))] + "+"
        from_near = None if near is None else near.pose
        poses = [nearest_real_pose(geometry, as_rigid_transform(matrix), branch[:2], from_near) for matrix in matrices]
        nearest = np.array([pose.as_matrix() for pose in poses]).reshape(-1, 4, 4)
        states = inverse_displacement(geometry, nearest)[branch]
    states = states.transformed(lambda array, inner: array.reshape(*target.shape, *array.shape[array.ndim - inner :]))
    turn = np.where(np.isnan(states.rotation), np.eye(3), states.rotation)
    place = make_pose(np.nan_to_num(states.translation), rotation=turn)
    distance = np.where(states.exists, pose_distance(geometry, place, target), np.nan)
    return NearestPose(states, distance if target.shape else float(distance))


def _check_near(geometry: Geometry, near: Configuration, limits: LegLimits) -> None:
    if check_instance(near, Configuration, "near").shape or not near.exists:
        raise ArgumentError("near", "a single Configuration that exists", repr(near))
    if geometry.dimensions != near.geometry.dimensions:
        raise ArgumentError("near", "a configuration of the same geometry", repr(near.geometry))
    if not limits.margin(near.readings) >= -1e-9 * geometry.middle_side:
        raise ArgumentError("near", "a configuration within the leg limits", repr(near))


def _within_limits(
    geometry: Geometry, matrices: FloatArray, limits: LegLimits, near: Configuration | None
) -> Configuration:
    """Return the states (N,) within leg limits nearest to poses (N, 4, 4)."""
    joints = geometry.platform_joints
    targets = (matrices[:, None, :3, 3] + joints @ np.swapaxes(matrices[:, :3, :3], -1, -2)).reshape(-1, 9)
    if near is None:
        box = leg_length_box(geometry, limits)
        tree = KDTree(box.map.points(box.sample, joints)[0])
        starts = box.sample[tree.query(targets, _STARTS)[1]]
    else:
        mapping = PositionMap(geometry, FAMILIES[int(family(near))])
        start = mapping.coordinates(Configuration(geometry, near.pose.as_matrix()[None], near.middle_joints[None]))
        lower, upper = np.sign(mapping.determinants(mapping.legs(start)[1]))[0]
        box = LegLengthBox(
            geometry, limits, np.array(limits.minimum), np.array(limits.maximum), mapping.family, (lower, upper)
        )
        starts = np.broadcast_to(start, (len(targets), 1, 2, 3))
    search = nearest_states(box, targets, starts, joints)
    # Newton's method takes long steps: the assembly mode is checked.
    home = near is None or bool(physical(near))
    lengths = np.clip(box.map.lengths(search.coordinates), limits.minimum, limits.maximum)
    proved = forward_physical(geometry, lengths, near=None if home else near)
    found, begun = box.map.states(search.coordinates), box.map.states(starts[:, 0])
    with np.errstate(invalid="ignore"):
        kept = (
            np.abs(proved.middle_joints - found.middle_joints).max(axis=(-1, -2))
            <= _MODE_TOLERANCE * geometry.middle_side
        )
    return Configuration.from_arrays(
        geometry,
        *(
            np.where(kept.reshape(-1, *(1,) * inner), getattr(proved, name), getattr(begun, name))
            for name, inner in (("rotation", 2), ("translation", 1), ("middle_joints", 2))
        ),
    )
