"""Recorded paths read from CSV, JSON and NPZ files."""

from __future__ import annotations

import csv
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.display.viewer.recording import Recording
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import LEGS, as_rigid_transform, pose
from spm_pin.mechanism.arguments import FloatArray, file_path, real_array

_POSITION, _XYX, _QUATERNION = ("x", "y", "z"), ("alpha_deg", "beta_deg", "lambda_deg"), ("qx", "qy", "qz", "qw")
_KNOWN = {*LEGS, *_POSITION, *_XYX, *_QUATERNION, "t"}
_KNOWN |= {f"{leg}.{kind}" for leg in LEGS for kind in ("rate", "acceleration", "force")}
_COLUMNS = f"{', '.join(LEGS)}; or {', '.join(_POSITION)} with {', '.join(_XYX)}, or with {', '.join(_QUATERNION)}"
_KEYS = ("poses", "leg_lengths", "translation", "xyx_deg", "time")
_SECONDS = 10.0  # that a path without times takes


def read_recording(path: str | Path) -> Recording:
    """Read a recorded path from a CSV, JSON or NPZ file.

    Parameters
    ----------
    path : str or Path
        The file. A CSV has a header naming its columns: ``r_b1`` to ``r_c3`` [m]; or ``x, y, z`` [m] with
        ``alpha_deg, beta_deg, lambda_deg``, the X-Y-X angles in degrees, or with the quaternion ``qx, qy, qz, qw``;
        the further columns of ``spm-pin move`` are not shown.
        JSON and NPZ hold ``leg_lengths`` (n, 6); or ``poses`` (n, 4, 4); or ``translation`` (n, 3) with ``xyx_deg``
        (n, 3). All may have times [s]: a column ``t``, or the key ``time``; else the path takes ten seconds.

    Raises
    ------
    ArgumentError
        If the file cannot be read, holds something else, or has fewer than two points.
    """
    readers = {".csv": _csv, ".json": _json, ".npz": _npz}
    path = file_path(path, suffixes=readers)
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
    if not header or not {*header} <= _KNOWN or len({*header}) != len(header):
        raise ArgumentError(str(path), f"a header of the columns {_COLUMNS}; and t", ", ".join(header) or "none")
    if table.ndim != 2 or table.shape[1] != len(header):
        raise ArgumentError(str(path), f"rows of {len(header)} numbers", f"shape {table.shape}")
    groups = {"leg_lengths": LEGS, "translation": _POSITION, "xyx_deg": _XYX, "quaternion": _QUATERNION}
    found: dict[str, Any] = {
        key: table[:, [header.index(name) for name in names]] for key, names in groups.items() if {*names} <= {*header}
    }
    if "t" in header:
        found["time"] = table[:, header.index("t")]
    quaternion = found.pop("quaternion", None)
    if quaternion is not None and "translation" in found:
        norms = np.linalg.norm(quaternion, axis=-1)
        worst = int(np.abs(norms - 1.0).argmax())
        if not abs(norms[worst] - 1.0) <= 1e-3:
            raise ArgumentError(str(path), "unit quaternions", f"length {norms[worst]:g} in row {worst + 1}")
        found["poses"] = pose(found.pop("translation"), rotation=Rotation.from_quat(quaternion)).as_matrix()
    return found


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ArgumentError(str(path), "JSON", str(error)) from error
    if not isinstance(found, Mapping):
        raise ArgumentError(str(path), f"an object with keys of {', '.join(_KEYS)}", type(found).__name__)
    return dict(found)


def _npz(path: Path) -> dict[str, Any]:
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
    if "leg_lengths" in found:
        return _rows(found, "leg_lengths", path, (6,), f"{', '.join(LEGS)} in metres")
    if "poses" in found:
        matrices = _rows(found, "poses", path, (4, 4), "homogeneous transforms in metres")
        return as_rigid_transform(matrices, f"poses in {path}")
    if "xyx_deg" not in found:
        raise ArgumentError(str(path), "xyx_deg (or qx, qy, qz, qw in a CSV) with the positions", ", ".join(found))
    position = _rows(found, "translation", path, (3,), "positions of o in metres")
    angles = _rows(found, "xyx_deg", path, (3,), "X-Y-X angles in degrees")
    if len(angles) != len(position):
        raise ArgumentError(str(path), f"as many angles as positions, {len(position)}", len(angles))
    return pose(position, xyx=np.deg2rad(angles))


def _rows(found: Mapping[str, Any], key: str, path: Path, trailing: tuple[int, ...], meaning: str) -> FloatArray:
    array = real_array(found[key], f"{key} in {path}", trailing, meaning)
    if array.ndim != 1 + len(trailing):
        raise ArgumentError(f"{key} in {path}", "one point after another", f"shape {array.shape}")
    return array


def _times(value: Any, count: int, path: Path) -> FloatArray:
    if value is None:
        return np.linspace(0.0, _SECONDS, count)
    times = real_array(value, f"time in {path}", (), "seconds")
    if times.shape != (count,) or not (np.diff(times) > 0.0).all():
        expected = f"{count} growing times in seconds, one for each point"
        raise ArgumentError(f"time in {path}", expected, f"shape {times.shape}", "Not in order, or one twice?")
    return np.asarray(times - times[0])
