"""Recorded paths, read from CSV files and followed on a branch, and the motion of the demo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.kinematics.path_following import FollowedPath, follow
from spm_pin.mechanism import LEGS, Configuration, Geometry, pose
from spm_pin.mechanism.arguments import FloatArray, file_path

_POSITION, _XYX, _QUATERNION = ("x", "y", "z"), ("alpha_deg", "beta_deg", "lambda_deg"), ("qx", "qy", "qz", "qw")
_NOT_SHOWN = {f"{leg}.{kind}" for leg in LEGS for kind in ("rate", "acceleration", "force")}  # of `spm-pin move`
_KNOWN = {*LEGS, *_POSITION, *_XYX, *_QUATERNION, "t", *_NOT_SHOWN}
_COLUMNS = f"{', '.join(LEGS)}; or {', '.join(_POSITION)} with {', '.join(_XYX)}, or with {', '.join(_QUATERNION)}"
_SECONDS = 10.0  # duration of the demo motion, and of a path without times
_POINTS = 81
# Directions of the six legs' motion, found by a search for large motions of the paper's machine: the legs go along the
# first and back, and swing along the second meanwhile.
_ALONG = np.array([0.52, 0.05, 0.25, 0.75, -0.11, -0.30])
_ACROSS = np.array([-0.45, 0.61, -0.25, -0.32, 0.34, 0.37])


@dataclass(frozen=True)
class Recording:
    """A recorded path."""

    points: RigidTransform | FloatArray
    """Poses (n,) of {m} in {B}, or readings of the encoders [m], shape (n, 6)."""
    times: FloatArray
    """When it was at each (n,) [s], increasing from 0."""

    def follow(self, geometry: Geometry, start: Configuration | str | None = None) -> Playback:
        """Follow a solution along the path, by default the physical one; see `spm_pin.follow`."""
        return Playback(follow(geometry, self.points, start), self.times)


def read_recording(path: str | Path) -> Recording:
    """Read a recorded path from a CSV file.

    Parameters
    ----------
    path : str or Path
        The file: a header naming its columns, then numbers. ``r_b1`` to ``r_c3``, the readings [m]; or ``x, y, z`` [m]
        with ``alpha_deg, beta_deg, lambda_deg``, the X-Y-X angles in degrees, or with the quaternion
        ``qx, qy, qz, qw``. With a column ``t``, times [s]; else the path takes ten seconds. The further columns of
        ``spm-pin move`` are not shown.
    """
    path = file_path(path, suffixes=(".csv",))
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
        heading, *rows = [line for line in lines if line and not line.startswith("#")] or [""]
        table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    except OSError as error:
        raise ArgumentError(str(path), "a readable file", error.strerror) from error
    except ValueError as error:
        raise ArgumentError(str(path), "a text file of a header, then numbers only", str(error)) from error
    header = [name.strip() for name in heading.split(",")]
    if len({*header} & _KNOWN) != len(header):
        raise ArgumentError(str(path), f"a header of the columns {_COLUMNS}; and t", heading or "none")
    if table.ndim != 2 or table.shape[1] != len(header) or len(table) < 2 or not np.isfinite(table).all():
        raise ArgumentError(str(path), f"two rows or more of {len(header)} finite numbers", f"shape {table.shape}")
    columns = dict(zip(header, table.T, strict=True))
    groups = [names for names in (LEGS, _POSITION, _XYX, _QUATERNION) if {*names} <= {*header}]
    values = [np.stack([columns[name] for name in names], axis=-1) for names in groups]
    points: RigidTransform | FloatArray
    if groups == [LEGS]:
        points = values[0]
    elif groups == [_POSITION, _XYX]:
        points = pose(values[0], xyx=np.deg2rad(values[1]))
    elif groups == [_POSITION, _QUATERNION]:
        errors = np.abs(np.linalg.norm(values[1], axis=-1) - 1.0)
        if errors.max() > 1e-3:
            raise ArgumentError(str(path), "unit quaternions", f"another length in row {errors.argmax() + 1}")
        points = pose(values[0], rotation=Rotation.from_quat(values[1]))
    else:
        raise ArgumentError(str(path), f"the columns {_COLUMNS}", heading)
    times = columns.get("t", np.linspace(0.0, _SECONDS, len(table)))
    if not (np.diff(times) > 0.0).all():
        raise ArgumentError(f"t in {path}", "growing times in seconds", "others", "Not in order, or one twice?")
    return Recording(points, times - times[0])


@dataclass(frozen=True)
class Playback:
    """A followed path, to be shown at any time."""

    path: FollowedPath
    """The solution followed along the recorded points."""
    times: FloatArray
    """When the recorded points (n,) were reached [s]."""

    @property
    def duration(self) -> float:
        """Time of the last recorded point [s], whether or not the solution lasts so long."""
        return float(self.times[-1])

    def time(self, parameter: float | FloatArray) -> FloatArray:
        """Return when the path is at parameters (...) from 0 to 1 [s]."""
        return np.asarray(np.interp(parameter, np.linspace(0.0, 1.0, len(self.times)), self.times))

    def state_at(self, time: float) -> Configuration:
        """Return the solved configuration nearest to a time [s], its last where the solution ended."""
        return self.path.configurations[int(np.abs(self.time(self.path.parameters) - time).argmin())]

    def report(self, now: float, most: int = 12) -> list[str]:
        """Return lines on how far the solution lasts and on its first events; ● marks those before `now` [s]."""
        events = self.path.events
        lines = [f"{len(self.path.parameters)} configurations of {self.path.labels[0]}"]
        if not self.path.complete:
            last = self.time(self.path.parameters[-1])
            lines.append(f"⚠ The solution ends at {last:.2f} s; the last is shown from there on.")
        for event in events[:most]:
            time = self.time(event.parameter)
            lines.append(f"{'●' if time <= now else '○'} {time:.2f} s: {event.kind}, {event.detail}")
        if len(events) > most:
            lines.append(f"… and {len(events) - most} more events")
        return lines


def demo_motion(start: Configuration) -> Playback | None:
    """Return a small loop of leg lengths from a configuration and back, followed; None where there is no such path.

    Its size is halved until no singularity and no leg limit lies on it.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS)[:, None]
    swing = (1.0 - np.cos(angles)) * (_ALONG + 0.5 * np.sin(2.0 * angles) * _ACROSS)
    times = np.linspace(0.0, _SECONDS, _POINTS)
    for size in (0.1375, 0.07, 0.035):
        lengths = start.readings + size * start.geometry.middle_side * swing
        if lengths.min() <= 0.0:
            continue
        try:
            playback = Recording(lengths, times).follow(start.geometry, start)
        except SpmError:
            return None
        if playback.path.complete and not playback.path.events:
            return playback
    return None
