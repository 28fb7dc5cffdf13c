"""Inverse displacement of a stage: pose and readings for a tilt and a height, in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.planar_legs import MOST_TURNED, RRS_LEGS
from spm_pin.formulas.stage_poses import LEAST_RISE
from spm_pin.kinematics.batches import run_kernel, with_batch_shape
from spm_pin.kinematics.readings import check_unit
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.solutions import BELOW, OPERATION_MODES, SolutionSet, Status
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import (
    FloatArray,
    broadcastable,
    check_instance,
    first_offender,
    real_array,
)

_MIN_BATCH_PER_THREAD = 1 << 14
_STEEP = 0.9
"""Cosine of a tilt, 26°, beyond which an error names the tilt in degrees: it may be in another unit."""


def inverse(
    stage: Stage,
    height: npt.ArrayLike,
    *,
    tilt: npt.ArrayLike | None = None,
    azimuth: npt.ArrayLike | None = None,
    roll: npt.ArrayLike | None = None,
    pitch: npt.ArrayLike | None = None,
    normal: npt.ArrayLike | None = None,
) -> SolutionSet:
    """Compute both states of a stage for a tilt and a height of its platform, in closed form.

    Parameters
    ----------
    stage : Stage
        The stage, nominal or calibrated. Its limits are not applied; see `SolutionSet.within`.
    height : array_like, shape (...)
        Height of the platform's origin, the centre of its balls, above the base's plane of pivots: z in {B} [m].
    tilt, azimuth : array_like, shape (...), optional
        Angle between the platform's normal and z, from 0 to less than π, and the direction to which the normal leans,
        where the platform is lowest: from x towards y, within a turn, with the legs at -30°, 90° and 210°
        [rad].
    roll, pitch : array_like, shape (...), optional
        Instead of tilt and azimuth: the normal is Rx(roll) Ry(pitch) z [rad], so that for a platform without torsion
        roll and pitch equal those of ROS; if only one is given the other is zero.
    normal : array_like, shape (..., 3), optional
        Instead of tilt and azimuth: the platform's normal in {B}, of any length but zero. Without any of these the
        platform is level.

    Returns
    -------
    SolutionSet
        The modes T, without torsion, and F, turned by half a turn, along the last axis, each with the whole pose: so
        `.rotation` is (..., 2, 3, 3), and `.configurations.shift` and `.torsion` are the parasitic motion. `.readings`
        has shape (..., 2, 3). Arrays of a missing mode are NaN. `.status` (...) is `Status.OK`, or `UNREACHABLE` if
        neither exists, because no platform pose has this normal, which includes those within 1.4 mrad of -z, where the
        legs hardly determine the torsion, or a leg does not reach its ball. `.physical()` is the one that an assembled
        machine is in. If the tilt is out of reach, `spm_pin.workspace.nearest_reachable_pose` finds the nearest one.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> balancer = spm.Stage(base_radius=0.08, platform_radius=0.09, legs=spm.RRS(crank=0.05, rod=0.11))
    >>> solutions = spm.inverse_displacement(balancer, height=0.12, roll=np.deg2rad(8), pitch=np.deg2rad(-5))
    >>> solutions
    <SolutionSet: ok, 1 of 2 real: T>
    >>> np.rad2deg(solutions.physical().readings).round(2)
    array([19.61, 33.38,  5.64])
    """
    shape, normals, heights = _read_request(stage, height, normals_of_request(tilt, azimuth, roll, pitch, normal))
    rotation, translation, readings, _ = poses(stage, normals, heights, 2)
    reached = np.isfinite(readings).all(axis=-1)
    arrays = with_batch_shape((rotation, translation, readings), shape)
    solutions = Configuration.from_arrays(stage, *arrays).where(reached.reshape(*shape, 2))
    if not shape and not reached.any():
        solutions.missing_reason = _why_unreachable(stage, heights, normals, readings, translation)
    status = np.where(reached.any(axis=-1), Status.OK, Status.UNREACHABLE)
    return SolutionSet(solutions, OPERATION_MODES, status.reshape(shape))


def inverse_physical(
    stage: Stage,
    height: npt.ArrayLike,
    *,
    tilt: npt.ArrayLike | None = None,
    azimuth: npt.ArrayLike | None = None,
    roll: npt.ArrayLike | None = None,
    pitch: npt.ArrayLike | None = None,
    normal: npt.ArrayLike | None = None,
) -> Configuration:
    """Compute the physical state for a tilt and a height: the same as ``inverse(…).physical()``, in half the time.

    Parameters
    ----------
    stage, height, tilt, azimuth, roll, pitch, normal
        As for `inverse`.

    Returns
    -------
    Configuration
        Of shape (...): in mode T, and reached from the level platform without a forward singularity. `.exists` is
        False, and everything NaN, if there is no such state. `.limit_excess` is the excess of readings beyond the
        limits.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> head = spm.Stage(base_radius=0.35, platform_radius=0.20, legs=spm.PRS(rod=0.40))
    >>> spm.inverse_physical(head, height=0.5, tilt=np.deg2rad(20), azimuth=np.pi / 2)
    <Configuration: tilt 20.00° towards 90.0°, height 0.5000 m, readings 0.1634, 0.0686, 0.1634 m>
    """
    shape, normals, heights = _read_request(stage, height, normals_of_request(tilt, azimuth, roll, pitch, normal))
    rotation, translation, readings, physical = (x[:, 0] for x in poses(stage, normals, heights, 1))
    state = Configuration.from_arrays(stage, *with_batch_shape((rotation, translation, readings), shape))
    kept = physical > 0
    if kept.all():
        return state
    state = state.where(kept.reshape(shape))
    if not shape:
        state.missing_reason = inverse(stage, heights[0], normal=normals[0]).physical().missing_reason
    return state


def poses(stage: Stage, normals: FloatArray, heights: FloatArray, modes: int) -> tuple[Any, ...]:
    """Return R (N, modes, 3, 3), t, readings (N, modes, 3) and a mask of physical states, for T, and for F if two."""
    from spm_pin.kinematics.kernels.one_stage import poses_of_stages

    legs, kind = stage.legs, stage.kind
    constants = (
        np.stack(legs.arrays[:3]),
        np.stack(legs.planes),
        kind.number,
        kind.numbers,
        stage.crank_middles,
        kind.up,
    )
    triple = ((modes, 3), np.float64)
    cosines: Any = triple if kind.number == RRS_LEGS else np.empty((0, modes, 3))
    results = ((modes, 3, 3), np.float64), triple, triple, cosines, ((modes,), np.uint8)
    solved = run_kernel(poses_of_stages, (normals, heights), constants, results, _MIN_BATCH_PER_THREAD)
    rotation, translation, readings, cosines, physical = solved
    if kind.number == RRS_LEGS:
        # As `rrs_reading` does, on arrays: NumPy takes several arc tangents at a time.
        np.arctan2(readings, cosines, out=readings)
        readings += stage.crank_middles
    if legs.offsets.any():
        readings += legs.offsets
    if (is_over := normals[:, 2] <= LEAST_RISE - 1.0).any():
        rotation[is_over] = translation[is_over] = readings[is_over] = np.nan
        physical[is_over] = 0
    return rotation, translation, readings, physical


def _read_request(
    stage: Stage, height: npt.ArrayLike, normals: FloatArray
) -> tuple[tuple[int, ...], FloatArray, FloatArray]:
    """Return the batch shape, unit normals (N, 3) and heights (N,)."""
    heights = read_heights(check_instance(stage, Stage, "stage"), height)
    shape = broadcastable("height", heights.shape, "the normals", normals.shape[:-1])
    normals = np.broadcast_to(normals, (*shape, 3)).reshape(-1, 3)
    return shape, normals, np.broadcast_to(heights, shape).reshape(-1)


def read_heights(stage: Stage, height: npt.ArrayLike, argument: str = "height") -> FloatArray:
    """Read heights (...) in proportion to this stage."""
    if hasattr(height, "rotation"):
        cause = "A manipulator takes a pose, a stage takes a height and a tilt"
        raise ArgumentError(argument, "a height of the platform in metres", "a pose", cause)
    heights = real_array(height, argument, (), "of the platform's origin above the pivots, in metres")
    check_unit(stage, heights, argument, "heights")
    return heights


def normals_of_request(
    tilt: npt.ArrayLike | None = None,
    azimuth: npt.ArrayLike | None = None,
    roll: npt.ArrayLike | None = None,
    pitch: npt.ArrayLike | None = None,
    normal: npt.ArrayLike | None = None,
) -> FloatArray:
    """Return the unit normals (..., 3) that arguments of `inverse` describe."""
    ways = {"tilt": tilt is not None or azimuth is not None, "roll": roll is not None or pitch is not None}
    ways["normal"] = normal is not None
    if sum(ways.values()) > 1:
        several = " and ".join(way for way, given in ways.items() if given)
        raise ArgumentError(several, "only one of: tilt and azimuth; roll and pitch; normal", "more than one")
    if ways["tilt"]:
        if tilt is None or azimuth is None:
            missing, given = ("tilt", "azimuth") if tilt is None else ("azimuth", "tilt")
            raise ArgumentError(missing, f"an angle in radians beside the {given}", "none")
        return _read_tilt(tilt, azimuth)
    if ways["roll"]:
        return _normals_of_roll(0.0 if roll is None else roll, 0.0 if pitch is None else pitch)
    return _read_normal([0.0, 0.0, 1.0] if normal is None else normal)


def normals_of_tilt(tilt: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit normals (..., 3)."""
    sine = np.sin(tilt)
    return np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(tilt)), axis=-1)


def _read_tilt(tilt: npt.ArrayLike, azimuth: npt.ArrayLike) -> FloatArray:
    angles = _angles(tilt, "tilt", math.pi), _angles(azimuth, "azimuth", MOST_TURNED)
    broadcastable("azimuth", angles[1].shape, "tilt", angles[0].shape)
    tilts, azimuths = angles
    if (wrong := (tilts < 0.0) | (tilts >= math.pi)).any():
        received = f"{tilts[first_offender(wrong)]:g}"
        cause = "For a tilt to the opposite side change the azimuth"
        raise ArgumentError("tilt", "angles from 0 to less than π, in radians", received, cause)
    return normals_of_tilt(tilts, azimuths)


def _normals_of_roll(roll: npt.ArrayLike, pitch: npt.ArrayLike) -> FloatArray:
    rolls, pitches = _angles(roll, "roll", math.pi), _angles(pitch, "pitch", math.pi)
    broadcastable("pitch", pitches.shape, "roll", rolls.shape)
    cosine = np.cos(pitches)
    return np.stack(np.broadcast_arrays(np.sin(pitches), -np.sin(rolls) * cosine, np.cos(rolls) * cosine), axis=-1)


def _angles(value: npt.ArrayLike, argument: str, most: float) -> FloatArray:
    angles = real_array(value, argument, (), "angles in radians")
    if (beyond := np.abs(angles) > most).any():
        expected, received = f"angles in radians within ±{most:.4g}", f"{angles[first_offender(beyond)]:g}"
        raise ArgumentError(argument, expected, received, "Are they in degrees, or do they count whole turns?")
    return angles


def _read_normal(normal: npt.ArrayLike) -> FloatArray:
    normals = real_array(normal, "normal", (3,), "normals of the platform in {B}")
    size = np.abs(normals).max(axis=-1, keepdims=True, initial=0.0)
    if (is_zero := size[..., 0] == 0.0).any():
        expected = "normals of the platform in {B}, of any length but zero"
        place = f" at index {first_offender(is_zero)}" * (normals.ndim > 1)
        raise ArgumentError("normal", expected, f"(0, 0, 0){place}")
    # Squares of short and of long vectors are not representable.
    units: FloatArray = normals / size
    units /= np.linalg.norm(units, axis=-1, keepdims=True)
    return units


def _why_unreachable(
    stage: Stage, heights: FloatArray, normals: FloatArray, readings: FloatArray, translation: FloatArray
) -> str:
    """Return the reason why a single request has no solution."""
    if np.isnan(translation[0, 0, 2]) or np.isnan(translation[0, 0, 0]):
        return "the planes of the legs allow no platform with this normal"
    names = ", ".join(name for name, reading in zip(stage.legs.names, readings[0, 0], strict=True) if np.isnan(reading))
    hint = BELOW * bool(heights[0] < 0.0)
    if not hint and normals[0, 2] < _STEEP:
        radians = ": angles are in radians" if normals[0, 2] < 0.0 else ""
        hint = f"The tilt is {math.degrees(math.acos(normals[0, 2])):.0f}°{radians}"
    return f"the ball is out of reach of {names}{hint and '. '}{hint}"
