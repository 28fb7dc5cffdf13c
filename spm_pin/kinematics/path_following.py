"""Following one solution along a path of poses, readings, or heights and tilts; `tracking` has the steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import RigidTransform, Slerp

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.kinematics.stage_displacement import inverse, normals_of_request, read_heights
from spm_pin.kinematics.tracking import CertifiedLimits, EventKind, FollowedPath, Solver, Watch, followed
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.machine.manipulator import Manipulator
from spm_pin.machine.solutions import SolutionSet
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import FloatArray, as_array, broadcastable, real_array, type_and_value
from spm_pin.support.pose import as_rigid_transform, pose


def follow(
    machine: Manipulator | Stage,
    path: Callable[[float], Any] | RigidTransform | npt.ArrayLike | None = None,
    start: Configuration | str | None = None,
    *,
    height: npt.ArrayLike | None = None,
    tilt: npt.ArrayLike | None = None,
    azimuth: npt.ArrayLike | None = None,
    roll: npt.ArrayLike | None = None,
    pitch: npt.ArrayLike | None = None,
    normal: npt.ArrayLike | None = None,
    samples: int = 200,
    certificate: CertifiedLimits | None = None,
) -> FollowedPath:
    """Follow one solution along a path of poses or of readings, or of heights and tilts of a stage.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine. Where it has leg limits, crossing one is an event.
    path : callable, RigidTransform of shape (n,), or array_like of shape (n, 4, 4) or (n, 6), for a stage (n, 3)
        Poses of {m} in {B}, or readings of the legs [m], for RRS legs [rad]; a stage has no poses. A callable takes
        the parameter, 0 to 1. Between poses the rotation is interpolated at constant angular velocity and the position,
        like readings, on a line.
    start : Configuration or str, optional
        The solution at parameter 0: the one nearest to a configuration, or a label. By default the physical one.
    height, tilt, azimuth, roll, pitch, normal
        For a stage, instead of `path`: as for `inverse_displacement`, of shape (n,) together. Between two points the
        height and the components of the normal are interpolated on a line, and the normal is then made one of unit
        length.
    samples : int
        Least number of steps of the path. Two crossings within one step of the same limit or of the
        same kind of singularity are found if the function in between has its extremum beyond zero.
    certificate : Certificate, optional
        Certified leg limits, see `spm_pin.certify`: the result then says which states are within them.

    Returns
    -------
    FollowedPath
        With its events, each at its parameter to 1e-9: singularities, limits, changes of labels and the end of the
        solution. Modes of readings keep the label of the first point, except in nominal machines with RPS legs.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> balancer = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
    >>> spm.follow(balancer, height=0.12, tilt=np.radians([0, 30]), azimuth=0.0)
    <FollowedPath: complete, 214 states of T; leg limit at 0.8901>
    """
    check_machine(machine)
    if certificate is not None and not hasattr(certificate, "covers"):
        raise ArgumentError("certificate", "a Certificate", type(certificate).__name__)
    tilts = {"tilt": tilt, "azimuth": azimuth, "roll": roll, "pitch": pitch, "normal": normal}
    names = [name for name, value in {"height": height, **tilts}.items() if value is not None]
    if not names:
        solve, knots, has_legs = _solver(machine, path)
    elif isinstance(machine, Manipulator) or path is not None:
        expected = "none for a Manipulator, which takes a path" if path is None else "none beside a path"
        raise ArgumentError(names[0], expected, "a value")
    else:
        solve, knots, has_legs = *_tilts_solver(machine, height, tilts), False
    # Numbers of modes are names only in nominal machines with RPS legs.
    watch = watch_of(machine)._replace(has_labels=not has_legs or (machine.is_nominal and machine.legs.are_rps))
    path_followed = followed(watch, solve, knots, start, samples, has_legs=has_legs)
    if certificate is None:
        return path_followed
    return replace(path_followed, certified=certificate.covers(path_followed.configurations))


def watch_of(machine: Machine) -> Watch:
    """Return what of the states of a machine is watched: the determinants of `determinants`, made dimensionless."""
    if machine.is_stage:
        units: Any = machine.stage_radii[0][1] ** np.array([3, 1])
        details: tuple[str, ...] = "the actuators do not hold the platform", "the modes T and F meet"
    else:
        units, details = machine.ball_side**3, ("lower stage", "upper stage", "det K changes sign")
    kinds = [(EventKind.FORWARD_SINGULARITY, detail) for detail in details[:-1]]
    kinds.append((EventKind.INVERSE_SINGULARITY, details[-1]))
    return Watch(machine.ball_side, lambda states: determinants(states) / units, tuple(kinds))


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


def _solver(machine: Manipulator | Stage, path: Any) -> tuple[Solver, FloatArray, bool]:
    """Return all solutions as a function of the parameter, the parameters of given points, and if those are legs."""
    point: Callable[[Any], Any] = path
    knots, count, poses = np.array([0.0, 1.0]), len(machine.legs.names), "poses (n, 4, 4) or " * (not machine.is_stage)
    if callable(path):
        has_legs = machine.is_stage or np.shape(_matrices(path(0.0))) == (count,)
    else:
        array = as_array(_matrices(path))
        if array is None or array.ndim not in ((2,) if machine.is_stage else (2, 3)) or len(array) < 2:
            expected = f"a callable, or at least two {poses}sets of readings of the legs (n, {count})"
            raise ArgumentError("path", expected, type_and_value(path) if array is None else f"shape {array.shape}")
        has_legs, knots = array.ndim == 2, np.linspace(0.0, 1.0, len(array))
        if has_legs:
            meaning = f"readings of the legs in {machine.legs.unit_text()}{poses and ', or poses of shape (n, 4, 4)'}"
            point = _on_lines(knots, real_array(path, "path", (count,), meaning))
        else:
            places = as_rigid_transform(path, "path")
            turn, place = Slerp(knots, places.rotation), _on_lines(knots, places.translation)
            point = lambda s: pose(place(s), rotation=turn(s))  # noqa: E731
    if has_legs:
        return lambda s: forward_displacement(machine, point(s)), knots, True
    return lambda s: inverse_displacement(machine, point(s)), knots, False


def _tilts_solver(
    stage: Stage, height: npt.ArrayLike | None, tilts: dict[str, npt.ArrayLike | None]
) -> tuple[Solver, FloatArray]:
    """Return all solutions as a function of the parameter, and the parameters of given heights and tilts."""
    if height is None:
        raise ArgumentError("height", "heights of the platform beside its tilts", None)
    heights, normals = read_heights(stage, height), normals_of_request(**tilts)
    shape = broadcastable("height", heights.shape, "the tilts", normals.shape[:-1])
    if len(shape) != 1 or shape[0] < 2:
        raise ArgumentError("height", "two points or more, (n,)", shape)
    points = [np.broadcast_to(normals, (*shape, 3)), np.broadcast_to(heights, shape)[:, None]]
    knots = np.linspace(0.0, 1.0, shape[0])
    point = _on_lines(knots, np.concatenate(points, axis=-1))

    def solve(parameter: float) -> SolutionSet:
        here = point(parameter)
        return inverse(stage, here[3], normal=here[:3] / np.linalg.norm(here[:3]))

    return solve, knots


def _on_lines(knots: FloatArray, points: FloatArray) -> Callable[[float], FloatArray]:
    """Return a function of the parameter that is linear between points (n, k) at knots (n,)."""
    line: Callable[[float], FloatArray] = scipy.interpolate.make_interp_spline(knots, points, k=1)
    return line


def _matrices(value: Any) -> Any:
    return value.as_matrix() if isinstance(value, RigidTransform) else value
