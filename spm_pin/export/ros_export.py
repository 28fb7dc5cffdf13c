"""A ROS 2 package of a robot or a stage: description, a node for its joint states, and a controller on exported C."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from spm_pin.casadi.symbolic_machine import in_casadi, parts
from spm_pin.description import srdf_text, urdf_text
from spm_pin.description.masses import Masses
from spm_pin.description.source_files import MESHES, description_directory
from spm_pin.errors import ArgumentError
from spm_pin.export.c_export import c_sources, machine_fields
from spm_pin.export.c_printer import c_function
from spm_pin.export.c_texts import common_values, rendered, template_names, write_sources
from spm_pin.export.stage_export import stage_c_sources, stage_numbers
from spm_pin.formulas.joint_values import LegFrame, ball_angles, leg_values, triangle_axes
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.machine import Manipulator, Stage
from spm_pin.machine.joint_angles import actuated_joints, home_readings, homes, joint_names, leg_frames, value_names
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.support.arguments import FloatArray
from spm_pin.support.files import file_path

ASSUMED = {"m": (0.1, 1.0), "rad": (1.0, 10.0)}
"""Default largest rate [1/s] and acceleration [1/s²] of readings in exported files; a machine has none."""
_PATTERN = np.array([-1.0, 0.0, 1.0, -1.0, 0.0, 1.0])
"""Pattern of the readings at the start about the middle of the limits: the one with the smallest J_f of 3^6.

A stage has its first half.
"""
_STEP = 0.1
"""Default largest step of a reading between two set-points in exported files, in strokes, see `_stroke`."""
_LIMITS = 18
"""Place of the limits among the numbers of a leg in a `stage_geometry`."""
_SHARE = 0.1
"""Largest deviation of these readings from the middle, in lengths of the legs in the home."""


def ros_package(
    machine: Manipulator | Stage, *, prefix: str = "", masses: Masses | None = None, package: str | None = None
) -> dict[str, str]:
    """Return a ROS 2 package that shows a machine and controls the pose of its platform.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine, nominal or calibrated. Of a pose a stage follows the height and the normal.
    prefix : str
        Prefix of the name of every link, joint and function in C.
    masses : Masses, optional
        Masses of the bodies; by default assumed ones, see `urdf_text`.
    package : str, optional
        Name of the package; by default `spm_robot`, or `spm_stage`, with the prefix in lower case before it.

    Returns
    -------
    dict of str
        The texts of the files by their paths in the package.
    """
    known: Any = check_machine(machine)
    is_stage = known.is_stage
    name = re.sub(r"[^a-z0-9]+", "_", f"{prefix}spm_{'stage_' * is_stage}".lower()).lstrip("_")
    default = name.rstrip("_") if is_stage else f"{name}robot"
    package = default if package is None else _checked_name(package, "package")
    urdf = urdf_text(machine, prefix=prefix, meshes=f"package://{package}/{MESHES}", masses=masses, root=True)
    if is_stage:
        sources, fields = _stage_sources(known, name)
    else:
        sources, fields = c_sources(known, prefix=name, masses=masses), machine_fields(known)
    names = actuated_joints(machine), joint_names(machine)
    slides, joints = ([f"{prefix}{joint}" for joint in each] for each in names)
    zeros = (home_readings(machine) + machine.legs.offsets).tolist()
    readings, goal = start_readings(machine)
    position, quaternion = goal.translation, goal.pose.rotation.as_quat()
    values = {
        **common_values(machine, name),
        "package": package,
        "base": f"{prefix}base",
        "slides": slides,
        "joints": joints,
        "zeros": zeros,
        "rates": [ASSUMED[unit][0] for unit in machine.legs.units],
        "accelerations": [ASSUMED[unit][1] for unit in machine.legs.units],
        "steps": (_STEP * _stroke(machine)).round(4).tolist(),
        "machine": "\n".join(
            f"      {name}: [{', '.join(map(repr, numbers.tolist())).replace('inf', '.inf')}]"
            for name, numbers in fields.items()
        ),
        "side": machine.ball_side if is_stage else "machine.dimensions[2]",
        "requested": ", whose height and normal count" * is_stage,
        "machine_fields": {name: len(numbers) for name, numbers in fields.items()},
        "start": ", ".join(f"{reading - zero:.9g}" for reading, zero in zip(readings, zeros, strict=True)),
        "position": ", ".join(f"{name}: {x:.9g}" for name, x in zip("xyz", position, strict=True)),
        "orientation": ", ".join(f"{name}: {x:.9g}" for name, x in zip("xyzw", quaternion, strict=True)),
    }
    package_files = {
        path.removeprefix("ros/").removesuffix(".in"): rendered(path, values) for path in template_names("ros/")
    }
    initial = [reading - zero for reading, zero in zip(readings, zeros, strict=True)]
    driven = list(zip(slides, initial, *(machine.reading_limits - zeros).tolist(), strict=True))
    hardware = rendered("ros2_control.xml", {"package": package, "joints": driven, "infinity": np.inf})
    package_files["urdf/spm.urdf"] = urdf.replace("</robot>", f"{hardware}</robot>")
    package_files["urdf/spm.srdf"] = srdf_text(machine=machine, prefix=prefix)
    package_files |= {
        f"src/{name}": sources[name] for name in sources if name.endswith(("kinematics.c", "kinematics.h", "stage.h"))
    }
    folder = description_directory()
    for path in (folder / "LICENSE", folder / "rviz" / "spm.rviz", *sorted((folder / MESHES).iterdir())):
        package_files[path.relative_to(folder).as_posix()] = path.read_text(encoding="utf-8")
    return package_files


def _stage_sources(stage: Stage, prefix: str) -> tuple[dict[str, str], dict[str, FloatArray]]:
    """Return the C of a stage with the functions of a manipulator's, and its numbers by the names of their fields."""
    numbers, frames = stage_numbers(stage), leg_frames(stage)
    own = numbers[2:].reshape(3, -1)
    fields = {"up": numbers[:1], "home_height": numbers[1:2]}
    fields |= {f"leg_{leg}": row for leg, row in enumerate(own[:, :_LIMITS], 1)}
    fields |= dict(zip(("minimum", "maximum", "middle"), own[:, _LIMITS:].T, strict=True))
    fields |= {f"frame_{leg}": _flat(frame) for leg, frame in enumerate(frames, 1)}
    values = {**common_values(stage, prefix), "fields": fields, "joint_values": c_function(_joint_values(stage))}
    texts = {f"{prefix}{file}": rendered(f"stage_{file}", values) for file in ("kinematics.h", "kinematics.c")}
    return texts | {"stage.h": stage_c_sources(stage)["stage.h"]}, fields


def _joint_values(stage: Stage) -> ca.Function:
    """Return the function of the balls and of the legs' frames to the values of the description's joints."""
    frames, kind = leg_frames(stage), stage.kind.bound(in_casadi)
    flat = [ca.SX.sym(f"leg_{leg}", _flat(frame).size) for leg, frame in enumerate(frames)]
    symbols = [LegFrame(*_like(frame, iter(ca.vertsplit(x)))) for frame, x in zip(frames, flat, strict=True)]
    balls = [ca.SX.sym(f"b_{leg}", 3) for leg in range(3)]
    legs = [in_casadi(leg_values)(parts(ball), frame, kind) for ball, frame in zip(balls, symbols, strict=True)]
    turns = in_casadi(ball_angles)(legs[0], symbols[0], in_casadi(triangle_axes)([parts(ball) for ball in balls]), 1.0)
    values = [ca.atan2(*angle) for angle in (*(leg.passive for leg in legs), *turns)] + [leg.actuated for leg in legs]
    named = dict(zip(value_names(stage), values, strict=True))
    result = ca.vertcat(*(named[name] for name in joint_names(stage)))
    return ca.Function("joint_values_of", [ca.vertcat(*balls), ca.vertcat(*flat)], [ca.cse(ca.densify(result))])


def _flat(frame: LegFrame) -> FloatArray:
    return np.concatenate([np.ravel(part) for part in frame])


def _like(value: Any, numbers: Iterator[Any]) -> Any:
    """Return nested tuples like `value` of other numbers."""
    return tuple(_like(part, numbers) for part in value) if isinstance(value, tuple) else next(numbers)


def write_ros(
    machine: Manipulator | Stage, directory: str | Path, *, prefix: str = "", masses: Masses | None = None
) -> list[Path]:
    """Write the files of `ros_package` into a directory, which is created if needed; all or none. Return the paths.

    The package has the name of the directory. Files of the same names are replaced.
    """
    path = file_path(directory, "directory", expected="the name of a directory")
    package = _checked_name(path.resolve().name, "directory")
    paths = write_sources(directory, lambda: ros_package(machine, prefix=prefix, masses=masses, package=package))
    for path in paths:
        if path.parent.name == "scripts":
            path.chmod(0o755)
    return paths


def _checked_name(name: str, argument: str) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
        expected = "a name of a ROS 2 package: lower-case letters, digits and single underscores, a letter first"
        raise ArgumentError(argument, expected, repr(name))
    return name


def travel(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest readings, without limits those of a `_stroke` about the home."""
    legs, stroke = machine.legs, _stroke(machine)
    home, (minimum, maximum) = home_readings(machine) + legs.offsets, machine.reading_limits
    minimum = np.maximum(minimum, legs.least_readings + legs.offsets)
    low = np.where(np.isfinite(minimum), minimum, home - stroke)
    return low, np.minimum(maximum, np.maximum(low, home) + stroke)


def _stroke(machine: Machine) -> FloatArray:
    """Return the change of each reading that moves a ball by at most its distance from the pivot in the home."""
    _, places = homes(machine)
    return np.asarray(np.hypot(*places.T) / np.abs(machine.legs.largest_slopes))


def start_readings(machine: Any) -> tuple[list[float], Any]:
    """Return readings to start from, away from the ends of the limits and from a level platform, and a state nearby."""
    low, high = travel(machine)
    middle, reach = 0.5 * (low + high), np.minimum(0.25 * (high - low), _SHARE * _stroke(machine))
    for share in (1.0, 0.5, 0.2):
        readings = (middle + share * reach * _PATTERN[: len(middle)]).round(12)  # 1.2, not 1.2000000000000002
        states = forward_physical(machine, [readings, 0.5 * (middle + readings)])
        if states.exists.all():
            return readings.tolist(), states[1]
    raise ArgumentError("machine", "leg limits with a state in their middle", machine)
