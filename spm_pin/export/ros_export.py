"""A ROS 2 package of a machine: description, a node for its joint states, and a controller on the exported C."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from spm_pin.description import srdf_text, urdf_text
from spm_pin.description.masses import Masses
from spm_pin.description.source_files import MESHES, description_directory
from spm_pin.errors import ArgumentError
from spm_pin.export.c_export import c_sources, machine_fields
from spm_pin.export.c_texts import common_values, rendered, template_names, write_sources
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.machine import Configuration, Manipulator
from spm_pin.machine.joint_angles import actuated_joints, home_readings, homes, joint_names
from spm_pin.support.arguments import FloatArray
from spm_pin.support.files import file_path

ASSUMED = {"m": (0.1, 1.0), "rad": (1.0, 10.0)}
"""Default largest rate [1/s] and acceleration [1/s²] of readings in exported files; a machine has none."""
_PATTERN = np.array([-1.0, 0.0, 1.0, -1.0, 0.0, 1.0])
"""Pattern of the readings at the start about the middle of the limits: the one with the smallest J_f of 3^6."""
_STEP = 0.1
"""Default largest step of a reading between two set-points in exported files, in strokes, see `_stroke`."""
_SHARE = 0.1
"""Largest deviation of these readings from the middle, in lengths of the legs in the home."""


def ros_package(
    machine: Manipulator, *, prefix: str = "", masses: Masses | None = None, package: str | None = None
) -> dict[str, str]:
    """Return a ROS 2 package that shows a machine and controls the pose of its platform.

    Parameters
    ----------
    machine : Manipulator
        The machine, nominal or calibrated.
    prefix : str
        Prefix of the name of every link, joint and function in C.
    masses : Masses, optional
        Masses of the bodies; by default assumed ones, see `urdf_text`.
    package : str, optional
        Name of the package; by default `spm_robot`, with the prefix in lower case before it.

    Returns
    -------
    dict of str
        The texts of the files by their paths in the package.
    """
    name = re.sub(r"[^a-z0-9]+", "_", f"{prefix}spm_".lower()).lstrip("_")
    package = f"{name}robot" if package is None else _checked_name(package, "package")
    urdf = urdf_text(machine, prefix=prefix, meshes=f"package://{package}/{MESHES}", masses=masses, root=True)
    sources = c_sources(machine, prefix=name, masses=masses)
    names = actuated_joints(machine), joint_names(machine)
    fields = machine_fields(machine)
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
        "machine_fields": {name: len(numbers) for name, numbers in fields.items()},
        "start": ", ".join(f"{reading - zero:.9g}" for reading, zero in zip(readings, zeros, strict=True)),
        "position": ", ".join(f"{name}: {x:.9g}" for name, x in zip("xyz", position, strict=True)),
        "orientation": ", ".join(f"{name}: {x:.9g}" for name, x in zip("xyzw", quaternion, strict=True)),
    }
    package_files = {
        path.removeprefix("ros/").removesuffix(".in"): rendered(path, values) for path in template_names("ros/")
    }
    hardware = _hardware(machine, package, slides, zeros, readings)
    package_files["urdf/spm.urdf"] = urdf.replace("</robot>", f"{hardware}</robot>")
    package_files["urdf/spm.srdf"] = srdf_text(machine=machine, prefix=prefix)
    package_files |= {
        f"src/{name}": sources[name] for name in sources if name.endswith(("kinematics.c", "kinematics.h"))
    }
    folder = description_directory()
    for path in (folder / "LICENSE", folder / "rviz" / "spm.rviz", *sorted((folder / MESHES).iterdir())):
        package_files[path.relative_to(folder).as_posix()] = path.read_text(encoding="utf-8")
    return package_files


def write_ros(
    machine: Manipulator, directory: str | Path, *, prefix: str = "", masses: Masses | None = None
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


def travel(machine: Manipulator) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest readings, without limits those of a `_stroke` about the home."""
    home = home_readings(machine) + machine.legs.offsets
    limits = machine.limits or machine.legs.free_limits
    return ends_of_travel(limits.ends, home, _stroke(machine))


def ends_of_travel(limits: FloatArray, home: FloatArray, stroke: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest readings of limits (2, legs), without limits a stroke about the home."""
    minimum, maximum = limits
    low = np.where(np.isfinite(minimum), minimum, home - stroke)
    return low, np.minimum(maximum, np.maximum(low, home) + stroke)


def _stroke(machine: Manipulator) -> FloatArray:
    """Return the change of each reading (6,) that moves a ball by at most its distance from the pivot in the home."""
    _, places = homes(machine)
    return np.asarray(np.hypot(*places.T) / np.abs(machine.legs.largest_slopes))


def start_readings(machine: Manipulator) -> tuple[list[float], Configuration]:
    """Return readings to start from, away from the ends of the limits and from a level platform, and a state nearby."""
    low, high = travel(machine)
    middle, reach = 0.5 * (low + high), np.minimum(0.25 * (high - low), _SHARE * _stroke(machine))
    for share in (1.0, 0.5, 0.2):
        readings = (middle + share * reach * _PATTERN).round(12)  # 1.2, not 1.2000000000000002
        states = forward_physical(machine, [readings, 0.5 * (middle + readings)])
        if states.exists.all():
            return readings.tolist(), states[1]
    raise ArgumentError("machine", "leg limits with a state in their middle", machine)


def _hardware(machine: Manipulator, name: str, slides: list[str], zeros: list[float], readings: list[float]) -> str:
    """Return the description's `<ros2_control>`: six actuated joints, their zeros and units the description's."""
    limits = machine.limits or machine.legs.free_limits
    lines = [f'  <ros2_control name="{name}" type="system">', "    <hardware>"]
    lines += ["      <plugin>mock_components/GenericSystem</plugin>", "    </hardware>"]
    for leg, (slide, zero, reading) in enumerate(zip(slides, zeros, readings, strict=True)):
        lines += [f'    <joint name="{slide}">', '      <command_interface name="position">']
        ends = (("min", limits.minimum[leg]), ("max", limits.maximum[leg]))
        lines += [f'        <param name="{end}">{x - zero!r}</param>' for end, x in ends if np.isfinite(x)]
        lines += ["      </command_interface>", '      <state_interface name="position">']
        lines += [f'        <param name="initial_value">{reading - zero!r}</param>', "      </state_interface>"]
        lines += ["    </joint>"]
    return "\n".join([*lines, "  </ros2_control>", ""])
