"""Paths of the platform in time, and the motion of all joints along one, in the formats that programs take."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, RotationSpline

from spm_pin.errors import ArgumentError, PoseError
from spm_pin.machine.legs import LEGS
from spm_pin.support.arguments import FloatArray, as_bool, frozen, increasing_times, real_array
from spm_pin.support.files import file_path, write_files
from spm_pin.support.motion_table import POSITION, QUATERNION, TIME, table_text, write_table
from spm_pin.support.pose import PoseLike, as_rigid_transform, pose


class PlatformMotion(NamedTuple):
    """Motion of the terminal platform at one time or several."""

    pose: RigidTransform
    """Pose of {m} in {B}, shape (...)."""
    twist: FloatArray
    """(v, ω): velocity of o [m/s], angular velocity [rad/s], in {B}, shape (..., 6)."""
    acceleration: FloatArray
    """Time derivative of the twist [m/s², rad/s²], shape (..., 6)."""


class PlatformPath:
    """A twice continuously differentiable motion of the platform through given poses, by SciPy's cubic splines.

    Parameters
    ----------
    times : array_like, shape (n,)
        Times of the poses [s], increasing, at least two.
    poses : RigidTransform or array_like (n, 4, 4)
        Poses of the terminal platform at these times, {m} in {B}.
    ease : bool
        Start from rest and end at rest, without acceleration: the path is gone through on a clock that runs from the
        first to the last time as 10 x³ - 15 x⁴ + 6 x⁵. The poses between are then met at other times.

    Attributes
    ----------
    start, end, duration : float
        First and last time, and the time from one to the other [s].
    """

    def __init__(self, times: npt.ArrayLike, poses: PoseLike, *, ease: bool = False) -> None:
        knots = increasing_times(times, least=2)
        transforms = as_rigid_transform(poses, "poses")
        if transforms.shape != knots.shape:
            raise PoseError("poses", f"one for each of {knots.size} times", f"shape {transforms.shape}")
        self.times = frozen(knots.copy())
        self.start, self.end = float(knots[0]), float(knots[-1])
        self.duration = self.end - self.start
        self._ease = as_bool(ease, "ease")
        self._translation = CubicSpline(knots, transforms.translation)
        self._rotation = RotationSpline(knots, transforms.rotation)

    def __call__(self, times: npt.ArrayLike) -> PlatformMotion:
        """Return the motion at times [s] of shape (...), none outside the path's own."""
        t = real_array(times, "times", (), "in seconds")
        outside = (t < self.start) | (t > self.end)
        if outside.any():
            raise ArgumentError("times", f"times from {self.start:g} to {self.end:g} s", f"{t[outside].flat[0]:g}")
        flat, speed, change = t.reshape(-1), np.ones(1), np.zeros(1)
        if self._ease:
            x = (flat - self.start) / self.duration
            # Rounding must not run past the end.
            flat = self.start + self.duration * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
            flat = np.clip(flat, self.start, self.end)
            speed = (30.0 * x**2 * (1.0 - x) ** 2)[:, None]
            change = (60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / self.duration)[:, None]
        rotation = self._rotation(flat)
        # SciPy's angular rates are in {m}; in {B} their derivative is that in {m}, because ω × ω = 0.
        first, second = (
            np.concatenate([self._translation(flat, order), rotation.apply(self._rotation(flat, order))], axis=-1)
            for order in (1, 2)
        )
        place = self._translation(flat).reshape(*t.shape, 3)
        turn = rotation.as_matrix().reshape(*t.shape, 3, 3)
        twist, acceleration = speed * first, speed**2 * second + change * first
        return PlatformMotion(pose(place, rotation=turn), *(v.reshape(*t.shape, 6) for v in (twist, acceleration)))


@dataclass(frozen=True)
class JointTrajectory:
    """All joints of a chain at given times; made by `ClosedChain.joint_trajectory`."""

    joint_names: tuple[str, ...]
    """Names of the joints as in the URDF, in the order of the columns."""
    times: FloatArray
    """Times [s], shape (n,)."""
    positions: FloatArray
    """Joint values [rad, m], shape (n, nq); an actuated joint's is its reading without offset less that at home. Angles
    are continuous in time, and not reduced to one turn."""
    velocities: FloatArray
    """Joint velocities [rad/s, m/s], shape (n, nv)."""
    accelerations: FloatArray
    """Joint accelerations [rad/s², m/s²], shape (n, nv)."""
    efforts: FloatArray
    """Forces of the actuators under gravity [N, N m], shape (n, nv); zero in passive joints."""
    readings: FloatArray
    """Readings of the legs' encoders [m] ([rad] for RRS legs), shape (n, legs)."""
    pose: RigidTransform
    """Poses (n,) of the terminal platform, {m} in {B}."""
    actuated: tuple[int, ...]
    """Columns of the joints that the actuators move, in the order of the legs."""
    units: tuple[str, ...]
    """Units of the readings, "m" or "rad"."""
    legs: tuple[str, ...] = LEGS
    """Names of the legs."""

    def __repr__(self) -> str:
        return f"<JointTrajectory: {len(self.joint_names)} joints at {self.times.size} times>"

    @property
    def leg_units(self) -> tuple[str, str, str, str]:
        """Units of readings, rates, accelerations and efforts of the legs, where stages differ both: "m/s, rad/s"."""
        units, efforts = list(dict.fromkeys(self.units)), {"m": "N", "rad": "N m"}
        position, rate, acceleration = (", ".join(unit + per for unit in units) for per in ("", "/s", "/s²"))
        return position, rate, acceleration, ", ".join(efforts[unit] for unit in units)

    @property
    def _joints(self) -> tuple[FloatArray, ...]:
        return self.positions, self.velocities, self.accelerations, self.efforts

    def to_dict(self) -> dict[str, Any]:
        """Return the fields of a ROS message `trajectory_msgs/JointTrajectory`, as plain Python.

        `time_from_start` counts from the first time, in `sec` and `nanosec` as ROS 2 has them. For a
        `sensor_msgs/JointState`, take `joint_names` and a point's `positions`.
        """
        points: list[dict[str, Any]] = []
        for time, *rows in zip(self.times.tolist(), *self._joints, strict=True):
            nanoseconds = round((time - float(self.times[0])) * 1e9)
            keys = "positions", "velocities", "accelerations", "effort"
            point: dict[str, Any] = {key: row.tolist() for key, row in zip(keys, rows, strict=True)}
            point["time_from_start"] = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
            points.append(point)
        return {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
            "joint_names": list(self.joint_names),
            "points": points,
        }

    def to_json(self, path: str | Path | None = None) -> str:
        """Return `to_dict` as JSON, and write it to a file if `path` is given."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        if path is not None:
            path = file_path(path)
            write_files({path: text})
        return text

    def to_csv(self, path: str | Path | None = None) -> str:
        """Return a table, and write it to a file if `path` is given.

        One row a time, with a heading: `time`; the readings `r_b1` to `r_c3`, or `r_1` to `r_3` for a stage; the pose
        as `x`, `y`, `z` [m] and the quaternion `qx`, `qy`, `qz`, `qw`; for each joint `position`, `velocity`,
        `acceleration` and `effort` as `name.position`. Numbers have the digits that float64 needs.
        `spm_pin.display.read_recording` and `spm_pin.calibration.read_measurements` take their columns of it.
        """
        if path is not None:
            write_table(self.columns(), path)
        return table_text(self.columns())

    def columns(self) -> dict[str, FloatArray]:
        """Return the columns (n,) of `to_csv` by their names."""
        columns = {TIME: self.times, **dict(zip(self.legs, self.readings.T, strict=True))}
        columns |= dict(zip(POSITION, self.pose.translation.T, strict=True))
        columns |= dict(zip(QUATERNION, self.pose.rotation.as_quat().T, strict=True))
        for kind, values in zip(("position", "velocity", "acceleration", "effort"), self._joints, strict=True):
            columns |= {f"{name}.{kind}": values[:, k] for k, name in enumerate(self.joint_names)}
        return columns


def read_motion(motion: Any) -> PlatformMotion:
    """Return what a path returned for one time, or raise `ArgumentError`."""
    try:
        place, *rates = PlatformMotion(*motion)
    except TypeError as error:
        received = f"{type(motion).__name__}, not of these three"
        raise ArgumentError("path", "a function that returns pose, twist and acceleration", received) from error
    names = "twist of the platform", "acceleration of the platform"
    twist, acceleration = (real_array(rate, "path", (6,), name) for rate, name in zip(rates, names, strict=True))
    return PlatformMotion(as_rigid_transform(place, "path"), twist, acceleration)
