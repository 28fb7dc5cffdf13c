"""A motion of all joints, as programs that show or drive robots take it."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spm_pin.mechanism.arguments import FloatArray

__all__ = ["JointTrajectory"]


@dataclass(frozen=True)
class JointTrajectory:
    """All joints of a chain at given times; made by `ClosedChain.joint_trajectory`.

    Attributes
    ----------
    joint_names : tuple of str
        As in the URDF, in the order of the columns.
    times : ndarray, shape (n,)
        [s].
    positions, velocities, accelerations : ndarray, shape (n, 18)
        [rad, m], [rad/s, m/s], [rad/s², m/s²]; a slide is its leg's length less that at home. Angles are continuous
        in time, and not reduced to one turn.
    efforts : ndarray, shape (n, 18)
        Of the actuators under gravity [N]; zero in passive joints.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    efforts: FloatArray

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
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        return _written(text, path)

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
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["time", *(f"{name}.{column}" for column in columns for name in self.joint_names)])
        for k, time in enumerate(self.times):
            writer.writerow([repr(float(time)), *(repr(x) for column in columns.values() for x in column[k].tolist())])
        return _written(buffer.getvalue(), path)


def _written(text: str, path: str | Path | None) -> str:
    if path is not None:
        Path(path).write_text(text, encoding="utf-8")
    return text
