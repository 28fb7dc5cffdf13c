"""Measurements and readings: their file, their uncertainty, and the detection of common mistakes in them."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.calibration.error_model import pose_errors
from spm_pin.calibration.frames import Frames
from spm_pin.calibration.observables import POSES, POSITIONS, Inclinations, Observable, poses_and_observable
from spm_pin.errors import ArgumentError, SingularConfigurationError, raised_as
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.rates_and_forces import platform_jacobian
from spm_pin.machine import LEGS, STAGE_LEGS, Machine, as_rigid_transform
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.machine import unit_hint
from spm_pin.support.arguments import (
    LARGEST,
    BoolArray,
    FloatArray,
    as_array,
    first_offender,
    real_array,
    symmetric_matrices,
)
from spm_pin.support.motion_table import POSITION, MotionTable
from spm_pin.support.pose import homogeneous

_SUSPICIOUS = 0.02
"""Median error, in sides of the middle platform, above which exchanged columns are looked for."""
_LEVELS = "roll", "pitch", "height"
"""Columns of the measurements of an IMU and a ruler."""
_SUBSET = 40
"""Measurements, evenly spread over all, with which exchanged columns are tried."""
TRACKER_NOISE, LEVEL_NOISE = (1e-5, 1e-5), (5e-4, 2e-3)
"""Standard deviations of lengths [m] and angles [rad] of a laser tracker, and of a ruler and an IMU."""
_BETTER = 5.0
"""Factor by which that error must decrease when columns are exchanged."""


class MeasurementError(ArgumentError):
    """Measurements that do not fit the machine, or do not determine the requested parameters.

    Attributes
    ----------
    rows : tuple of int
        The rows at fault that the message names, counted from zero.
    """

    def __init__(
        self,
        argument: str,
        expected: str,
        received: Any,
        cause: str = "",
        file: str = "",
        line: int = 0,
        index: str = "",
        rows: tuple[int, ...] = (),
    ) -> None:
        super().__init__(argument, expected, received, cause, file, line, index)
        self.rows = rows


@dataclass(frozen=True)
class Measurements:
    """N measurements and readings, checked."""

    poses: FloatArray  # measured poses of the target (N, 4, 4); what is not measured of them is arbitrary or NaN
    readings: FloatArray  # readings of the legs, (N, legs) [m] ([rad] for RRS legs)
    observable: Observable  # what is measured of the poses
    frames: Frames  # of the tracker

    @classmethod
    def check(cls, machine: Machine, poses: Any, readings: npt.ArrayLike, *, frames: bool) -> Measurements:
        """Read the arguments of `identify`, with its errors; `frames` says that those of the tracker are unknown."""
        array = as_array(poses) if not isinstance(poses, RigidTransform | Inclinations) else None
        if isinstance(poses, Inclinations):
            matrix, observable = poses_and_observable(poses)
        elif array is not None and array.shape[-1:] == (3,):
            position = real_array(poses, "poses", (3,), "positions of the platform's origin in {B} in metres")
            matrix, observable = homogeneous(np.eye(3), position), POSITIONS
        else:
            matrix, observable = as_rigid_transform(poses, "poses").as_matrix(), POSES
        names = machine.legs.names
        shape, meaning = (len(names),), f"readings of {', '.join(names)} in {machine.legs.unit_text()}"
        read = real_array(readings, "readings", shape, meaning)
        if matrix.ndim != 3 or read.shape != (len(matrix), *shape):
            expected = f"one row of {len(names)} readings for each of N poses, whose shape is {matrix.shape[:-2]}"
            raise ArgumentError("readings", expected, f"shape {read.shape}")
        measured = cls(matrix, read, observable, Frames.as_defined())
        if not len(matrix):
            return measured
        place = measured.position[np.isfinite(measured.position).all(axis=-1)]
        for name, values in (("readings", read * (np.array(machine.legs.units) == "m")), ("poses", place)):
            sizes = np.median(np.abs(values), axis=0) if len(values) else np.zeros(3)
            hint = unit_hint(machine, sizes.max())
            if hint:
                axes = ("x", "y", "height") if isinstance(poses, Inclinations) else POSITION
                column = (names if name == "readings" else axes)[int(sizes.argmax())]
                raise MeasurementError(name, "lengths in metres", f"values of {sizes.max():g} for {column}", hint)
        if frames:
            return measured._in_frames(machine)
        # Exchanged legs may explain positions as well as a mirrored axis does; only rotations tell the two apart. Of an
        # IMU a wrong sign is more likely than exchanged legs.
        checks = [measured._check_columns, measured._check_axes]
        for check in checks if observable == POSITIONS else checks[::-1]:
            check(machine)
        measured._check_rows(machine)
        return measured

    @property
    def position(self) -> FloatArray:
        """Measured positions (N, 3) [m]."""
        return self.poses[:, :3, 3]

    @cached_property
    def present(self) -> BoolArray:
        """Mask of the measured components of each row, (N, n)."""
        return ~np.isnan(self.observable.errors(np.tile(np.eye(4), (len(self.poses), 1, 1)), self.poses))

    def states(self, machine: Any) -> Configuration:
        """Return the states (N,) of a machine with the readings; missing if it has no such state."""
        impossible = np.any(self._impossible(machine), axis=-1)
        possible = np.where(impossible[:, None], machine.legs.offsets + 1.0, self.readings)
        states: Configuration = forward_physical(machine, possible).transformed(
            lambda array, inner: np.where(impossible.reshape(-1, *[1] * inner), np.nan, array)
        )
        return states

    def _impossible(self, machine: Machine) -> BoolArray:
        """Return which readings (N, legs) their legs cannot have, because the ball's circle would have no radius."""
        return np.asarray(machine.legs.circles(self.readings)[1] <= 0.0)

    def errors(self, machine: Machine, frames: Frames | None = None) -> FloatArray:
        """Return predicted less measured components (N, n) [m, rad]; NaN without a state, zero if not measured."""
        seen = (frames or self.frames).seen(self.states(machine))
        return np.where(self.present, self.observable.errors(seen, self.poses), 0.0)

    def slopes(self, machine: Machine, frames: Frames) -> FloatArray:
        """Return the derivatives of `errors` by errors of parameters and frames (N, n, p), zero without a state."""
        states = self.states(machine)
        slopes = self.observable.slopes(frames.seen(states), self.poses, frames.jacobian(states))
        return np.nan_to_num(np.where(self.present[..., None], slopes, 0.0))

    def _in_frames(self, machine: Machine) -> Measurements:
        """Return the same with the frames with which they are nearest to the states of a machine."""
        states = self.states(machine)
        self._check_states(machine, states.exists)
        estimated = Frames.levelled if self.observable.is_levelled else Frames.estimated
        return replace(self, frames=estimated(states, self.poses))

    def are_in_other_frames(self, machine: Machine) -> bool:
        """Return whether frames of a tracker explain the measurements much better than those given."""
        size, exists = self._typical_error(machine), self.states(machine).exists
        if not (exists.all() and size > _SUSPICIOUS * machine.ball_side):
            return False
        return size > _BETTER * self._in_frames(machine)._typical_error(machine)

    def _typical_error(self, machine: Machine, predicted: FloatArray | None = None) -> float:
        """Return the median size of the errors of a machine, or of predicted poses (N, 4, 4) [m]; infinite for none."""
        if predicted is None:
            predicted = self.frames.seen(self.states(machine))
        errors = np.where(self.present, self.observable.errors(predicted, self.poses), 0.0)
        return float(np.median(np.nan_to_num(self.observable.sizes(errors, machine.ball_side), nan=np.inf)))

    def _check_rows(self, machine: Machine) -> None:
        """Raise if transposed rotations, or readings of other rows, explain the poses much better."""
        predicted = self.states(machine).pose.as_matrix()
        if self.observable == POSES:
            rotation = self.poses[:, :3, :3]
            scalar_first = np.roll(Rotation.from_matrix(rotation).as_quat(), -1, axis=-1)
            rotations = {
                ("", ""): rotation,
                ("rotations from {B} to {m}", "Transposed"): rotation.mT,
                ("quaternions whose scalar is first", "Scalar last"): Rotation.from_quat(scalar_first).as_matrix(),
            }
            turns = {}
            for tried, matrices in rotations.items():
                turned = self.poses.copy()
                turned[:, :3, :3] = matrices
                turns[tried] = _median_size(pose_errors(predicted, turned)[:, 3:])
            _refuse_if_better("poses", "rotations from {m} to {B}", turns, _SUSPICIOUS, "mrad")
        shifts = [0, *(shift for k in range(1, len(self.position) // 2 + 1) for shift in (k, -k))]
        sizes = {
            (f"readings shifted by {shift} rows", "Shifted"): replace(
                self, poses=np.roll(self.poses, shift, axis=0)
            )._typical_error(machine, predicted)
            for shift in shifts
        }
        _refuse_if_better("poses", "poses in the order of the readings", sizes, _SUSPICIOUS * machine.ball_side)

    def _check_axes(self, machine: Machine) -> None:
        """Raise if coordinates that are exchanged or negated explain the measurements much better."""
        predicted = self.states(machine).pose.as_matrix()
        if self.observable == POSES:
            turns = pose_errors(predicted, self.poses)[:, 3:]
            if _median_size(np.nan_to_num(turns, nan=np.inf)) > _SUSPICIOUS:
                return
        if not np.isfinite(self._typical_error(machine, predicted)):
            return
        what = "roll and pitch" if self.observable.is_levelled else "positions"
        sizes = {
            (f"{what} along other axes", f"As {meant}"): replace(self, poses=poses)._typical_error(machine, predicted)
            for meant, poses in self.observable.other_axes(self.poses)
        }
        expected = f"{what}{'' if self.observable.is_levelled else ' x, y, z'} of the platform in {{B}}"
        _refuse_if_better("poses", expected, sizes, _SUSPICIOUS * machine.ball_side)

    def _check_columns(self, machine: Machine) -> None:
        """Raise if there is no state, or if exchanged columns explain the measurements much better."""
        names = machine.legs.names
        if (impossible := self._impossible(machine)).any():
            row, leg = first_offender(impossible)
            received = f"{self.readings[row, leg]:g} for {names[leg]} in row {row}"
            raise MeasurementError("readings", "readings that exceed the offsets", received, rows=(row,))
        typical = self._typical_error(machine)
        if typical > _SUSPICIOUS * machine.ball_side:
            sizes = {("", ""): typical}
            some = slice(None, None, -(-len(self.poses) // _SUBSET))
            for order in itertools.permutations(range(len(names))):
                swapped = replace(self, poses=self.poses[some], readings=self.readings[some][:, order])
                wrong = [f"{x} holds {names[order.index(i)]}" for i, x in enumerate(names) if order[i] != i]
                if wrong:
                    with np.errstate(invalid="ignore"):
                        size = swapped._typical_error(machine)
                    sizes[f"columns in another order: {', '.join(wrong)}", "In that order"] = size
            _refuse_if_better("readings", f"readings in the order {', '.join(names)}", sizes, 0.0)
        self._check_states(machine, self.states(machine).exists)

    def _check_states(self, machine: Machine, exists: BoolArray) -> None:
        """Raise at the first row whose readings the machine cannot have."""
        if not exists.all():
            row = int(exists.argmin())
            received = f"row {row} with {', '.join(f'{x:g}' for x in self.readings[row])}"
            cause = "A mistyped reading, offsets not subtracted, or another machine? Correct the row or leave it out"
            raise MeasurementError("readings", "readings that this machine can have", received, cause, rows=(row,))


def _median_size(vectors: FloatArray) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=-1)))


def _refuse_if_better(
    argument: str, expected: str, sizes: dict[tuple[str, str], float], least: float, unit: str = "mm"
) -> None:
    """Raise if a reading of the argument, named by what it is and how, has a much smaller error than the first one."""
    as_given, best = next(iter(sizes.values())), min(sizes, key=lambda tried: sizes[tried])
    if as_given > max(least, _BETTER * sizes[best]):
        received, how = best
        instead = f" instead of {1e3 * as_given:.3g} {unit}" if np.isfinite(as_given) else ""
        cause = f"{how} they agree to {1e3 * sizes[best]:.3g} {unit}{instead}"
        raise MeasurementError(argument, expected, received, cause)


def covariances(
    noise: npt.ArrayLike, argument: str, components: int, count: int, lengths: int | None = None
) -> FloatArray:
    """Read standard deviations or covariances of measurements with this many components, as (count, n, n).

    `noise` is one standard deviation, a pair (for the first `lengths` components and for the rest), n standard
    deviations, or covariances (n, n) or (count, n, n).
    """
    array = real_array(noise, argument, (), "standard deviations in metres and radians, or covariances")
    if (np.abs(array) > LARGEST).any() or (array.ndim < 2 and (array <= 0.0).any()):
        expected = "positive standard deviations, or covariances, in metres and radians"
        raise ArgumentError(argument, expected, f"{array.ravel()[0]:g}")
    if array.shape == () or (array.shape == (2,) and lengths is not None):
        first = components if lengths is None else lengths
        array = np.repeat(np.broadcast_to(array, 2), [first, components - first])
    if array.shape == (components,):
        array = np.diag(array**2)
    if array.shape not in ((components, components), (count, components, components)):
        expected = f"one standard deviation, {components}, or covariances of shape ({components}, {components})"
        raise ArgumentError(argument, expected, f"shape {array.shape}")
    array = symmetric_matrices(array, argument, components, "covariances", positive=True)
    return np.broadcast_to(array, (count, components, components))


def total_covariances(
    states: Any,
    frames: Frames,
    observable: Observable,
    measured: FloatArray,
    pose_noise: npt.ArrayLike | None,
    reading_noise: npt.ArrayLike,
) -> FloatArray:
    """Return covariances (N, n, n) of measured minus predicted poses, reading errors mapped to pose errors.

    Components that were not measured (NaN in `measured`) have the identity.
    """
    jacobian, legs = platform_jacobian(states), len(states.machine.legs.names)
    lost = np.isnan(jacobian).any(axis=(-1, -2)) & states.exists
    if lost.any():
        raise SingularConfigurationError("forward", 0.0, first_offender(lost))
    if pose_noise is None:
        pose_noise = LEVEL_NOISE if observable.is_levelled else TRACKER_NOISE
    count = len(observable.components)
    poses = covariances(pose_noise, "pose_noise", count, len(states), observable.lengths)
    slopes = observable.slopes(frames.seen(states), measured, frames.motions(states, jacobian))
    total = poses + slopes @ covariances(reading_noise, "reading_noise", legs, len(states)) @ slopes.mT
    return np.where(np.isnan(total) & states.exists[:, None, None], np.eye(count), total)


@raised_as(MeasurementError)
def read_measurements(path: str | Path) -> tuple[Any, FloatArray]:
    """Read a CSV file of measurements.

    The heading names the columns, in any order: x, y, z, the position of the platform in {B} [m]; qx, qy, qz, qw, if
    measured, its rotation from {m} to {B} as a unit quaternion, scalar last; r_b1 to r_c3, the readings [m] ([rad] for
    RRS legs), or r_1 to r_3 for a stage. Instead of a position roll and pitch [rad], height [m], or all three, as
    `Inclinations` takes them; cells may be empty there. A warning lists other columns, which are not used. A
    `MeasurementError` names the line and column of what cannot be read.

    Returns
    -------
    poses : RigidTransform, shape (N,), ndarray, shape (N, 3), or Inclinations
        Poses, or positions if there is no quaternion; or `Inclinations`, from an IMU and a ruler.
    readings : ndarray, shape (N, legs)
        Readings of the legs [m, rad].
    """
    table = MotionTable(path)
    legs = STAGE_LEGS if table.has(STAGE_LEGS) else LEGS
    poses: Any
    if table.has(_LEVELS) and not table.has(POSITION):
        names = [name for name in _LEVELS if table.has([name])]
        readings, columns = table.columns(legs), table.columns(names, missing=True).T
        with raised_as(MeasurementError, file=str(table.path)):
            poses = Inclinations(**dict(zip(names, columns, strict=True)))
    else:
        readings, poses = table.columns([*POSITION, *legs])[:, 3:], table.poses()
    if table.unused:
        warnings.warn(f"{table.path}: columns that are not used: {', '.join(table.unused)}", stacklevel=3)
    return poses, readings
