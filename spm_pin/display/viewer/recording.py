"""Recorded paths: read from a file, followed on a branch, played back by time."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.closed_form.path_following import FollowedPath, follow
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, Geometry
from spm_pin.mechanism.pose import as_rigid_transform
from spm_pin.mechanism.pose import pose as make_pose

__all__ = ["Playback", "Recording", "read_recording"]

_POSITION, _XYX, _QUATERNION = ("x", "y", "z"), ("alpha_deg", "beta_deg", "lambda_deg"), ("qx", "qy", "qz", "qw")
_COLUMNS = f"{', '.join(LEGS)}; or {', '.join(_POSITION)} with {', '.join(_XYX)}, or with {', '.join(_QUATERNION)}"
_KEYS = ("poses", "leg_lengths", "translation", "xyx_deg", "time")
_SECONDS = 10.0  # that a path without times takes


@dataclass(frozen=True)
class Recording:
    """A recorded path.

    Attributes
    ----------
    points : RigidTransform of shape (n,), or ndarray of shape (n, 6)
        Poses of {m} in {B}, or leg lengths [m].
    times : ndarray, shape (n,)
        When it was at each [s], increasing from 0.
    """

    points: RigidTransform | FloatArray
    times: FloatArray

    def follow(self, geometry: Geometry, start: Configuration | str | None = None) -> Playback:
        """Follow a solution along the path, by default the physical one; see `spm_pin.follow`."""
        return Playback(follow(geometry, self.points, start), self.times)

    def follow_from(self, geometry: Geometry, start: Configuration | str | None) -> Playback:
        """Follow from `start` where the path begins there, else the physical solution."""
        try:
            return self.follow(geometry, start)
        except ArgumentError:
            return self.follow(geometry)


@dataclass(frozen=True)
class Playback:
    """A followed path, to be shown at any time.

    Attributes
    ----------
    path : FollowedPath
        The solution.
    times : ndarray, shape (n,)
        Of the recorded points [s].
    """

    path: FollowedPath
    times: FloatArray

    @property
    def duration(self) -> float:
        """Until the end of the recorded path [s], whether or not the solution lasts so long."""
        return float(self.times[-1])

    def parameter(self, time: float) -> float:
        """Return the path's parameter, 0 to 1, at a time [s]."""
        return float(np.interp(time, self.times, np.linspace(0.0, 1.0, len(self.times))))

    def time(self, parameter: float) -> float:
        """Return when the path is at a parameter [s]."""
        return float(np.interp(parameter, np.linspace(0.0, 1.0, len(self.times)), self.times))

    def at(self, time: float) -> tuple[Configuration, str]:
        """Return the solved configuration nearest to a time [s], its last where the solution ended, and its label."""
        index = int(np.abs(self.path.parameters - self.parameter(time)).argmin())
        return self.path.configurations[index], self.path.labels[index]

    def report(self, now: float, most: int = 12) -> list[str]:
        """Return lines on how far the solution lasts and on its first events; ● marks those before `now` [s]."""
        events = self.path.events
        lines = [f"{len(self.path.parameters)} configurations of {self.path.labels[0]}"]
        if not self.path.complete:
            last = self.time(float(self.path.parameters[-1]))
            lines.append(f"⚠ The solution ends at {last:.2f} s; the last is shown from there on.")
        for event in events[:most]:
            time = self.time(event.parameter)
            lines.append(f"{'●' if time <= now else '○'} {time:.2f} s: {event.kind}, {event.detail}")
        if len(events) > most:
            lines.append(f"… and {len(events) - most} more events")
        return lines


def read_recording(path: str | Path) -> Recording:
    """Read a recorded path from a CSV, JSON or NPZ file.

    Parameters
    ----------
    path : str or Path
        The file. A CSV has a header naming its columns: ``r_b1`` to ``r_c3`` [m]; or ``x, y, z`` [m] with
        ``alpha_deg, beta_deg, lambda_deg``, the X-Y-X angles in degrees, or with the quaternion ``qx, qy, qz, qw``.
        JSON and NPZ hold ``leg_lengths`` (n, 6); or ``poses`` (n, 4, 4); or ``translation`` (n, 3) with ``xyx_deg``
        (n, 3). All may have times [s]: a column ``t``, or the key ``time``; else the path takes ten seconds.

    Raises
    ------
    ArgumentError
        If the file cannot be read, holds something else, or has fewer than two points.
    """
    path = Path(path)
    readers = {".csv": _csv, ".json": _json, ".npz": _npz}
    if path.suffix.lower() not in readers:
        raise ArgumentError("path", "a file name ending in .csv, .json or .npz", repr(path.name))
    try:
        found = readers[path.suffix.lower()](path)
    except OSError as error:
        raise ArgumentError("path", "a readable file", path, str(error.strerror or error)) from error
    except UnicodeDecodeError as error:
        raise ArgumentError("path", "a text file in UTF-8", path, str(error)) from error
    points = _points(found, path)
    if len(points) < 2:
        raise ArgumentError(str(path), "at least two points", len(points))
    return Recording(points, _times(found.get("time"), len(points), path))


def _csv(path: Path) -> dict[str, Any]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(line for line in file if line.strip() and not line.lstrip().startswith("#"))
        header = [name.strip() for name in next(rows, [])]
        try:
            table = np.array([[float(cell) for cell in row] for row in rows])
        except ValueError as error:
            raise ArgumentError(str(path), "a header, then numbers only", str(error)) from error
    known = {*LEGS, *_POSITION, *_XYX, *_QUATERNION, "t"}
    if not header or not set(header) <= known or len(set(header)) != len(header):
        raise ArgumentError(str(path), f"a header of the columns {_COLUMNS}; and t", ", ".join(header) or "none")
    if table.ndim != 2 or table.shape[1] != len(header):
        raise ArgumentError(str(path), f"rows of {len(header)} numbers", f"shape {table.shape}")
    columns = dict(zip(header, table.T, strict=True))

    def stacked(names: tuple[str, ...]) -> FloatArray | None:
        return np.stack([columns[name] for name in names], axis=-1) if set(names) <= columns.keys() else None

    found: dict[str, Any] = {"time": columns.get("t"), "leg_lengths": stacked(LEGS)}
    position, angles, quaternion = stacked(_POSITION), stacked(_XYX), stacked(_QUATERNION)
    found |= {"translation": position, "xyx_deg": angles}
    if quaternion is not None and position is not None:
        _check_quaternions(quaternion, path)
        rotation = Rotation.from_quat(quaternion)
        found |= {"poses": make_pose(position, rotation=rotation).as_matrix(), "translation": None}
    return {key: value for key, value in found.items() if value is not None}


def _check_quaternions(quaternion: FloatArray, path: Path) -> None:
    norms = np.linalg.norm(quaternion, axis=-1)
    if not np.allclose(norms, 1.0, atol=1e-3):
        worst = int(np.abs(norms - 1.0).argmax())
        raise ArgumentError(str(path), "unit quaternions", f"length {norms[worst]:g} in row {worst + 1}")


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ArgumentError(str(path), "JSON", str(error)) from error
    if not isinstance(found, Mapping):
        raise ArgumentError(str(path), f"an object with keys of {', '.join(_KEYS)}", type(found).__name__)
    return dict(found)


def _npz(path: Path) -> dict[str, Any]:
    import zipfile

    try:
        with np.load(path, allow_pickle=False) as file:
            return {str(key): file[key] for key in file}
    except (ValueError, zipfile.BadZipFile) as error:
        raise ArgumentError(str(path), "an NPZ file of numbers", str(error)) from error


def _points(found: Mapping[str, Any], path: Path) -> RigidTransform | FloatArray:
    kinds = {"poses", "leg_lengths", "translation"} & found.keys()
    if len(kinds) != 1 or not found.keys() <= set(_KEYS):
        expected = "exactly one of leg_lengths, poses, and translation with xyx_deg (and time)"
        raise ArgumentError(str(path), expected, ", ".join(found) or "nothing")
    where = f"{kinds.copy().pop()} in {path}"
    if "leg_lengths" in found:
        return _rows(real_array(found["leg_lengths"], where, (6,), f"{', '.join(LEGS)} in metres"), where)
    if "poses" in found:
        matrices = real_array(found["poses"], where, (4, 4), "homogeneous transforms in metres")
        return as_rigid_transform(_rows(matrices, where, 3), where)
    if "xyx_deg" not in found:
        raise ArgumentError(str(path), "xyx_deg (or qx, qy, qz, qw in a CSV) with the positions", ", ".join(found))
    position = _rows(real_array(found["translation"], where, (3,), "positions of o in metres"), where)
    angles = _rows(real_array(found["xyx_deg"], f"xyx_deg in {path}", (3,), "X-Y-X angles in degrees"), where)
    if len(angles) != len(position):
        raise ArgumentError(str(path), f"as many angles as positions, {len(position)}", len(angles))
    return make_pose(position, xyx=np.deg2rad(angles))


def _rows(array: FloatArray, where: str, dimensions: int = 2) -> FloatArray:
    if array.ndim != dimensions:
        raise ArgumentError(where, "one point after another", f"shape {array.shape}")
    return array


def _times(value: Any, count: int, path: Path) -> FloatArray:
    if value is None:
        return np.linspace(0.0, _SECONDS, count)
    times = real_array(value, f"time in {path}", (), "seconds")
    if times.shape != (count,) or not (np.diff(times) > 0.0).all():
        expected = f"{count} growing times in seconds, one for each point"
        raise ArgumentError(f"time in {path}", expected, f"shape {times.shape}", "Not in order, or one twice?")
    return np.asarray(times - times[0])
