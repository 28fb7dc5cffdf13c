"""A motion of all joints along a path of the platform, in the formats that programs take."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.pose import as_rigid_transform
from spm_pin.multibody.batched_states import LOCATED, ChainLike, located
from spm_pin.multibody.closure_checks import require_closed
from spm_pin.multibody.closure_solvers import ContinuationSolver
from spm_pin.multibody.constrained_state import ChainState
from spm_pin.multibody.platform_path import PlatformMotion, PlatformPath, increasing_times


@dataclass(frozen=True)
class JointTrajectory:
    """All joints of a chain at given times; made by `ClosedChain.joint_trajectory`."""

    joint_names: tuple[str, ...]
    """As in the URDF, in the order of the columns."""
    times: FloatArray
    """Times [s], shape (n,)."""
    positions: FloatArray
    """Joint values [rad, m], shape (n, 18); a slide is its leg's length less that at home. Angles are continuous in
    time, and not reduced to one turn."""
    velocities: FloatArray
    """Joint velocities [rad/s, m/s], shape (n, 18)."""
    accelerations: FloatArray
    """Joint accelerations [rad/s², m/s²], shape (n, 18)."""
    efforts: FloatArray
    """Forces of the actuators under gravity [N], shape (n, 18); zero in passive joints."""

    def __repr__(self) -> str:
        return f"<JointTrajectory: {len(self.joint_names)} joints at {self.times.size} times>"

    def to_dict(self) -> dict[str, Any]:
        """Return the fields of a ROS message `trajectory_msgs/JointTrajectory`, as plain Python.

        `time_from_start` counts from the first time, in `sec` and `nanosec` as ROS 2 has them. For a
        `sensor_msgs/JointState`, take `joint_names` and a point's `positions`.
        """
        columns = self.positions, self.velocities, self.accelerations, self.efforts
        keys = "positions", "velocities", "accelerations", "effort"
        points: list[dict[str, Any]] = []
        for k, time in enumerate(self.times):
            nanoseconds = round((float(time) - float(self.times[0])) * 1e9)
            point: dict[str, Any] = {key: column[k].tolist() for key, column in zip(keys, columns, strict=True)}
            point["time_from_start"] = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
            points.append(point)
        return {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
            "joint_names": list(self.joint_names),
            "points": points,
        }

    def to_json(self, path: str | Path | None = None) -> str:
        """Return `to_dict` as JSON, and write it to a file if `path` is given."""
        return _write(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", path)

    def to_csv(self, path: str | Path | None = None) -> str:
        """Return a table, and write it to a file if `path` is given.

        One row a time, with a head: `time`, then for each joint `position`, `velocity`, `acceleration` and `effort`
        as `name.position`. Numbers have the digits that float64 needs.
        """
        columns = {
            "position": self.positions,
            "velocity": self.velocities,
            "acceleration": self.accelerations,
            "effort": self.efforts,
        }
        head = ["time", *(f"{name}.{column}" for column in columns for name in self.joint_names)]
        table = np.column_stack([self.times, *columns.values()]).tolist()
        return _write("".join(",".join(row) + "\n" for row in (head, *(map(repr, row) for row in table))), path)


def joint_trajectory(
    self: ChainLike, path: Callable[[float], PlatformMotion], times: npt.ArrayLike, near: npt.ArrayLike
) -> JointTrajectory:
    """Return the motion of all joints for one of the platform, with the leg forces of it under gravity.

    `path`, a `PlatformPath` or another callable, takes a time [s] and returns pose, twist and acceleration of the
    terminal platform; `times` (n,) [s] increase at any rate; `near` (18,) is a closed q in the branch wanted, near
    the path's start. Raises as `inverse_kinematics`, with the index of the time.
    """
    constrained = self._states.constrained
    q, at = constrained.checked(near, "near", single=True), increasing_times(times)
    if not callable(path):
        raise ArgumentError("path", "a PlatformPath or another function of time", type(path).__name__)
    state = ChainState(constrained).update(q)
    require_closed(state.kinematics)
    rows: list[tuple[FloatArray, ...]] = []
    # All at once where that is known to be allowed.
    motions = zip(*path(at), strict=True) if isinstance(path, PlatformPath) else map(path, at.tolist())
    for k, motion in enumerate(motions):
        try:
            rows.append(_moving(state, q, motion))
        except LOCATED as error:
            raise located(error, (k,)) from error
        q = rows[-1][0]
    columns = (np.array(column).reshape(at.size, -1) for column in zip(*rows, strict=True))
    return JointTrajectory(constrained.layout.names_in_model, at, *columns)


def _moving(state: ChainState, q: FloatArray, motion: Any) -> tuple[FloatArray, ...]:
    """Return q, v, a and the actuators' forces of what a path returned for one time."""
    try:
        pose, *rates = PlatformMotion(*motion)
    except TypeError as error:
        received = f"{type(motion).__name__}, not of these three"
        raise ArgumentError("path", "a function that returns pose, twist and acceleration", received) from error
    transform = as_rigid_transform(pose, "path")
    twist, acceleration = (
        real_array(value, "path", (6,), f"{name} of the platform")
        for value, name in zip(rates, ("twist", "acceleration"), strict=True)
    )
    solver = ContinuationSolver(state.kinematics)
    q = solver.to_pose(q, transform.rotation.as_matrix(), transform.translation)
    state._set_checked(q)
    v = state.joint_velocities(twist)
    state._set_checked(q, v)
    a = state.joint_accelerations(acceleration)
    efforts = np.zeros(q.size)
    efforts[state.kinematics.layout.legs] = state.inverse_dynamics(a)
    return q, v, a, efforts


def _write(text: str, path: str | Path | None) -> str:
    """Return a text, written to a file if there is a path."""
    if path is not None:
        Path(path).write_text(text, encoding="utf-8")
    return text
