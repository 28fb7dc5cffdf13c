"""Following one solution of a manipulator along a path of poses or readings; `tracking` has the steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform, Slerp

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import stage_paths
from spm_pin.kinematics.either_machine import or_of_stage
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.kinematics.tracking import CertifiedLimits, EventKind, FollowedPath, Solver, Watch, followed
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.support.arguments import FloatArray, as_array, real_array, type_and_value
from spm_pin.support.pose import as_rigid_transform, pose


@or_of_stage(stage_paths.follow)
def follow(
    machine: Manipulator,
    path: Callable[[float], Any] | RigidTransform | FloatArray | Sequence[Any],
    start: Configuration | str | None = None,
    *,
    samples: int = 200,
    certificate: CertifiedLimits | None = None,
) -> FollowedPath:
    """Follow one solution along a path of poses or of leg lengths.

    For a stage the path is one of readings, or of heights and tilts, with the arguments of
    `spm_pin.kinematics.stage_paths.follow`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The manipulator. Where it has leg limits, crossing one is an event.
    path : callable, RigidTransform of shape (n,), or array_like of shape (n, 4, 4) or (n, 6)
        Poses of {m} in {B}, or readings of the legs [m]. A callable takes the parameter, 0 to 1. Between poses the
        rotation is interpolated at constant angular velocity and the position, like readings, on a line.
    start : Configuration or str, optional
        The solution at parameter 0: the one nearest to a configuration, or a label. By default the physical one.
    samples : int
        Least number of steps of the path. Two crossings within one step of the same limit or of the
        same kind of singularity are found if the function in between has its extremum beyond zero.
    certificate : Certificate, optional
        Certified leg limits, see `spm_pin.certify`: the result then says which states are within them.

    Returns
    -------
    FollowedPath
        With its events, each at its parameter to 1e-9.
    """
    check_manipulator(machine)
    if certificate is not None and not hasattr(certificate, "covers"):
        raise ArgumentError("certificate", "a Certificate", type(certificate).__name__)
    solve, knots, has_legs = _solver(machine, path)
    # Numbers of modes are names only where legs are not RPS.
    watch = watch_of(machine)._replace(has_labels=not has_legs or machine.legs.are_rps)
    path_followed = followed(watch, solve, knots, start, samples, has_legs=has_legs)
    if certificate is None:
        return path_followed
    return replace(path_followed, certified=certificate.covers(path_followed.configurations))


def watch_of(machine: Manipulator) -> Watch:
    """Return what of the states of a robot is watched: the determinants of J_b, J_c and K."""
    side = machine.middle_side
    kinds = [(EventKind.FORWARD_SINGULARITY, f"{stage} stage") for stage in ("lower", "upper")]
    kinds.append((EventKind.INVERSE_SINGULARITY, "det K changes sign"))
    return Watch(side, lambda states: determinants(states) / side**3, tuple(kinds))


def existing_share(
    solve: Callable[[FloatArray], Configuration],
    start: FloatArray,
    ends: FloatArray,
    *,
    parts: int = 16,
    rounds: int = 3,
) -> FloatArray:
    """Return up to which share of each line from readings (6,) to `ends` (n, 6) the states that `solve` finds exist.

    Each of `rounds` solves one part of every line at the ends of `parts` parts: a shorter gap may be missed.
    """
    low, high = np.zeros(len(ends)), np.ones(len(ends))
    for _ in range(rounds):
        shares = np.linspace(low, high, parts + 1)[1:]
        exists = np.asarray(solve(start + shares[..., None] * (ends - start)).exists)
        count = np.where(exists.all(axis=0), parts, exists.argmin(axis=0))
        ends_of_parts, places = np.concatenate([low[None], shares]), (count, np.minimum(count + 1, parts))
        low, high = (np.take_along_axis(ends_of_parts, place[None], axis=0)[0] for place in places)
    return low


def last_on_line(start: Configuration, readings: FloatArray) -> tuple[Configuration, float]:
    """Return the last configuration in the mode of `start` on the line to readings (6,), and its share of the line."""
    machine, first = start.machine, start.readings
    if not start.is_at_home:
        path = follow(machine, np.stack([first, readings]), start, samples=4)
        return path.configurations[-1], float(path.parameters[-1])
    share = float(existing_share(partial(forward_physical, machine), first, readings[None])[0])
    return forward_physical(machine, first + share * (readings - first)) if share else start, share


def _solver(machine: Manipulator, path: Any) -> tuple[Solver, FloatArray, bool]:
    """Return all solutions as a function of the parameter, the parameters of given points, and if those are legs."""
    point: Callable[[Any], Any] = path
    knots = np.array([0.0, 1.0])
    if callable(path):
        has_legs = np.shape(_matrices(path(0.0))) == (6,)
    else:
        array = as_array(_matrices(path))
        if array is None or array.ndim not in (2, 3) or len(array) < 2:
            expected = "a callable, or at least two poses (n, 4, 4) or sets of readings of the legs (n, 6)"
            raise ArgumentError("path", expected, type_and_value(path) if array is None else f"shape {array.shape}")
        has_legs, knots = array.ndim == 2, np.linspace(0.0, 1.0, len(array))
        if has_legs:
            readings = real_array(path, "path", (6,), "readings of the legs in metres, or poses of shape (n, 4, 4)")
            point = scipy.interpolate.make_interp_spline(knots, readings, k=1)
        else:
            poses = as_rigid_transform(path, "path")
            turn = Slerp(knots, poses.rotation)
            place = scipy.interpolate.make_interp_spline(knots, poses.translation, k=1)
            point = lambda s: pose(place(s), rotation=turn(s))  # noqa: E731
    if has_legs:
        return lambda s: forward_displacement(machine, point(s)), knots, True
    return lambda s: inverse_displacement(machine, point(s)), knots, False


def _matrices(value: Any) -> Any:
    return value.as_matrix() if isinstance(value, RigidTransform) else value
