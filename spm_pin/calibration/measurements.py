"""Measurements of poses and readings: their file, their uncertainty, and mistakes in them that can be named."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.calibration.error_model import pose_errors
from spm_pin.calibration.frames import Frames
from spm_pin.errors import ArgumentError, SingularConfigurationError, raised_as
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.rates_and_forces import platform_jacobian
from spm_pin.machine import LEGS, Configuration, Manipulator, as_rigid_transform
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
"""Median error of the positions, in sides of the middle platform, from which on exchanged columns are looked for."""
_SUBSET = 40
"""Measurements, evenly spread over all, with which exchanged columns are tried."""
_BETTER = 5.0
"""How many times smaller that error must become when columns are exchanged."""


class MeasurementError(ArgumentError):
    """Measurements that do not fit the machine, or do not determine what is asked for.

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
    """N poses and readings, checked."""

    poses: FloatArray  # measured poses of the target (N, 4, 4); not turned if only positions were measured
    readings: FloatArray  # readings of the legs, (N, 6) [m], of RRS legs [rad]
    components: int  # 6 for poses, 3 for positions alone
    frames: Frames  # of the tracker

    @classmethod
    def check(cls, machine: Manipulator, poses: Any, readings: npt.ArrayLike, *, frames: bool) -> Measurements:
        """Read the arguments of `identify`, with its errors; `frames` says that those of the tracker are unknown."""
        array = as_array(poses) if not isinstance(poses, RigidTransform) else None
        if array is not None and array.shape[-1:] == (3,):
            position = real_array(poses, "poses", (3,), "positions of o in {B} in metres")
            matrix, components = homogeneous(np.eye(3), position), 3
        else:
            matrix, components = as_rigid_transform(poses, "poses").as_matrix(), 6
        read = real_array(readings, "readings", (6,), f"readings of {', '.join(LEGS)} in {machine.legs.unit_text()}")
        if matrix.ndim != 3 or read.shape != (len(matrix), 6):
            expected = f"one row of six readings for each of N poses, whose shape is {matrix.shape[:-2]}"
            raise ArgumentError("readings", expected, f"shape {read.shape}")
        measured = cls(matrix, read, components, Frames.as_defined())
        if not len(matrix):
            return measured
        for name, values in (("readings", read * (np.array(machine.legs.units) == "m")), ("poses", measured.position)):
            sizes = np.median(np.abs(values), axis=0)
            hint = unit_hint(machine, sizes.max())
            if hint:
                column = (LEGS if name == "readings" else POSITION)[int(sizes.argmax())]
                raise MeasurementError(name, "lengths in metres", f"values of {sizes.max():g} for {column}", hint)
        if frames:
            return measured._in_frames(machine)
        # Exchanged legs may explain positions as well as a mirrored axis does; only rotations tell the two apart.
        checks = [measured._check_columns, measured._check_axes]
        for check in checks if components == 3 else checks[::-1]:
            check(machine)
        measured._check_rows(machine)
        return measured

    @property
    def position(self) -> FloatArray:
        """Measured positions (N, 3) [m]."""
        return self.poses[:, :3, 3]

    def states(self, machine: Manipulator) -> Configuration:
        """Return the states (N,) of a machine with the readings; absent where it has none."""
        impossible = np.any(self._impossible(machine), axis=-1)
        possible = np.where(impossible[:, None], machine.legs.offsets + 1.0, self.readings)
        return forward_physical(machine, possible).transformed(
            lambda array, inner: np.where(impossible.reshape(-1, *[1] * inner), np.nan, array)
        )

    def _impossible(self, machine: Manipulator) -> BoolArray:
        """Return which readings (N, 6) their legs cannot have, because the ball's circle would have no radius."""
        return np.asarray(machine.legs.circles(self.readings)[1] <= 0.0)

    def errors(self, machine: Manipulator, frames: Frames | None = None) -> FloatArray:
        """Return the predicted less the measured poses (N, components) [m, rad]; NaN where there is no state."""
        seen = (frames or self.frames).seen(self.states(machine))
        return pose_errors(seen, self.poses)[:, : self.components]

    def _in_frames(self, machine: Manipulator) -> Measurements:
        """Return the same with the frames with which they are nearest to the states of a machine."""
        states = self.states(machine)
        self._check_states(machine, states.exists)
        return replace(self, frames=Frames.estimated(states, self.poses))

    def are_in_other_frames(self, machine: Manipulator) -> bool:
        """Return whether frames of a tracker explain the positions much better than those given."""
        size, exists = _median_size(self.errors(machine)[:, :3]), self.states(machine).exists
        if not (exists.all() and size > _SUSPICIOUS * machine.middle_side):
            return False
        return size > _BETTER * _median_size(self._in_frames(machine).errors(machine)[:, :3])

    def _check_rows(self, machine: Manipulator) -> None:
        """Raise if transposed rotations, or readings of other rows, explain the poses much better."""
        predicted = self.states(machine).pose.as_matrix()
        if self.components == 6:
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
            (f"readings shifted by {shift} rows", "Shifted"): _median_size(
                predicted[:, :3, 3] - np.roll(self.position, shift, axis=0)
            )
            for shift in shifts
        }
        _refuse_if_better("poses", "poses in the order of the readings", sizes, _SUSPICIOUS * machine.middle_side)

    def _check_axes(self, machine: Manipulator) -> None:
        """Raise if coordinates that are exchanged or negated explain the positions much better."""
        errors = np.nan_to_num(self.errors(machine), nan=np.inf)
        turned = self.components == 6 and _median_size(errors[:, 3:]) > _SUSPICIOUS
        if turned or not np.isfinite(_median_size(errors[:, :3])):
            return
        predicted, sizes = errors[:, :3] + self.position, {}
        for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1, -1), repeat=3)):
            meant = ", ".join(f"{'-' * (sign < 0)}{POSITION[k]}" for k, sign in zip(order, signs, strict=True))
            size = _median_size(predicted - self.position[:, order] * signs)
            sizes["positions along other axes", f"As {meant}"] = size
        _refuse_if_better("poses", "positions x, y, z of o in {B}", sizes, _SUSPICIOUS * machine.middle_side)

    def _check_columns(self, machine: Manipulator) -> None:
        """Raise if there is no state, or if exchanged columns explain the positions much better."""
        if (impossible := self._impossible(machine)).any():
            row, leg = first_offender(impossible)
            received = f"{self.readings[row, leg]:g} for {LEGS[leg]} in row {row}"
            raise MeasurementError("readings", "readings that exceed the offsets", received, rows=(row,))
        errors = self.errors(machine)
        typical = _median_size(np.nan_to_num(errors[:, :3], nan=np.inf))
        if typical > _SUSPICIOUS * machine.middle_side:
            sizes = {("", ""): typical}
            some = slice(None, None, -(-len(errors) // _SUBSET))
            for order in itertools.permutations(range(6)):
                swapped = replace(self, poses=self.poses[some], readings=self.readings[some][:, order], components=3)
                wrong = [f"{LEGS[i]} holds {LEGS[order.index(i)]}" for i in range(6) if order[i] != i]
                if wrong:
                    with np.errstate(invalid="ignore"):
                        size = _median_size(np.nan_to_num(swapped.errors(machine), nan=np.inf))
                    sizes[f"columns in another order: {', '.join(wrong)}", "In that order"] = size
            _refuse_if_better("readings", f"readings in the order {', '.join(LEGS)}", sizes, 0.0)
        self._check_states(machine, np.asarray(~np.isnan(errors).any(axis=-1)))

    def _check_states(self, machine: Manipulator, exists: BoolArray) -> None:
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


def covariances(noise: npt.ArrayLike, argument: str, components: int, count: int) -> FloatArray:
    """Read standard deviations or covariances of measurements with this many components, as (count, n, n).

    A pair for poses, one number for positions or readings, n numbers, or a covariance (n, n) or (count, n, n).
    """
    array = real_array(noise, argument, (), "standard deviations in metres and radians, or covariances")
    if (np.abs(array) > LARGEST).any() or (array.ndim < 2 and (array <= 0.0).any()):
        expected = "positive standard deviations, or covariances, in metres and radians"
        raise ArgumentError(argument, expected, f"{array.ravel()[0]:g}")
    if array.shape == () or (array.shape == (2,) and argument == "pose_noise"):
        array = np.repeat(np.broadcast_to(array, 2), 3)[:components]
    if array.shape == (components,):
        array = np.diag(array**2)
    if array.shape not in ((components, components), (count, components, components)):
        expected = f"one standard deviation, {components}, or covariances of shape ({components}, {components})"
        raise ArgumentError(argument, expected, f"shape {array.shape}")
    array = symmetric_matrices(array, argument, components, "covariances", positive=True)
    return np.broadcast_to(array, (count, components, components))


def pose_covariances(
    states: Configuration, frames: Frames, components: int, pose_noise: npt.ArrayLike, reading_noise: npt.ArrayLike
) -> FloatArray:
    """Return covariances (N, n, n) of measured less predicted poses: errors of readings as the poses they cause."""
    slopes = frames.motions(states, platform_jacobian(states))[:, :components]
    lost = np.isnan(slopes).any(axis=(-1, -2)) & states.exists
    if lost.any():
        raise SingularConfigurationError("forward", 0.0, first_offender(lost))
    poses = covariances(pose_noise, "pose_noise", components, len(states))
    return poses + slopes @ covariances(reading_noise, "reading_noise", 6, len(states)) @ slopes.mT


@raised_as(MeasurementError)
def read_measurements(path: str | Path) -> tuple[Any, FloatArray]:
    """Read a CSV file of measurements.

    The heading names the columns, in any order: x, y, z, the position of o in {B} [m]; qx, qy, qz, qw, if measured, the
    rotation from {m} to {B} as a unit quaternion, scalar last; r_b1 to r_c3, the readings [m], of RRS legs [rad]. A
    warning lists other columns, which are not used. A `MeasurementError` names the line and column of what cannot be
    read.

    Returns
    -------
    poses : RigidTransform, shape (N,), or ndarray, shape (N, 3)
        Poses, or positions if there is no quaternion.
    readings : ndarray, shape (N, 6)
        Readings of the legs [m, rad].
    """
    table = MotionTable(path)
    readings, poses = table.columns([*POSITION, *LEGS])[:, 3:], table.poses()
    if table.unused:
        warnings.warn(f"{table.path}: columns that are not used: {', '.join(table.unused)}", stacklevel=3)
    return poses, readings
