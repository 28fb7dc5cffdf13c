"""A configuration of LinuxCNC for a robot or a stage: a kinematics module on the exported C, and simulated joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.export.c_export import c_sources
from spm_pin.export.c_texts import common_values, rendered, write_sources
from spm_pin.export.ros_export import ASSUMED, start_readings, travel
from spm_pin.export.stage_export import stage_c_sources, stage_machine_sources
from spm_pin.kinematics import forward_physical, inverse_physical
from spm_pin.machine import Manipulator, Stage, pose
from spm_pin.machine.machine import check_machine
from spm_pin.support.arguments import FloatArray
from spm_pin.workspace import home_height

_UNITS = {"m": ("UNITS_PER_METRE", 1e3, "LINEAR"), "rad": ("1.0 / DEGREE", np.rad2deg(1.0), "ANGULAR")}
"""Units of a joint per unit of a reading, in C and as a number, and the joint's type."""
_SAMPLES = 4096
_STEP = 1e-4
"""Step of finite differences of the axes [mm, degrees]."""
_TURN = np.linspace(0.0, 2.0 * np.pi, 13)[:, None]
"""Angles of the program's points on the circle of the tilt's direction [rad]."""
_SIZES = 0.5 ** np.arange(10)
"""Sizes of that circle that are tried, from the largest, until the joints can follow."""
_SHARES = np.linspace(0.0, 1.0, 9)[:, None]
"""Fractions of the path between two points of the program at which the joints are checked."""


def linuxcnc_configuration(machine: Manipulator | Stage) -> dict[str, str]:
    """Return a configuration of LinuxCNC 2.9 that simulates a machine, with the source of its kinematics module.

    Parameters
    ----------
    machine : Manipulator or Stage
        The robot or the stage alone, nominal or calibrated, with legs of any kind.

    Returns
    -------
    dict of str
        The texts of the files by name: `spm.ini` and `spm.hal`, the sources of the module `spmkins`, the numbers
        of the machine `spm_machine.txt`, which it reads when LinuxCNC starts, a program `demo.ngc` and a tool table.
        Those of a stage are `stage.ini`, `stagekins.c` and so on. Lengths are in millimetres, angles in degrees. The
        axes of a robot are X Y Z A B C, those of a stage Z A B: the height, roll and pitch of `inverse_displacement`.
    """
    check_machine(machine, "machine")
    known: Any = (_StageAlone if machine.is_stage else _Robot)(machine)
    count, rates = len(known.home), known.axis_rates()
    home = dict(zip(known.axes, known.axis_values(known.home), strict=True))
    is_angle = np.isin([*known.axes], [*"ABC"])
    values = {
        **common_values(machine, f"{known.name}_"),
        "name": known.name,
        "joints_meaning": f"0 to {count - 1} are the readings of the legs {', '.join(machine.legs.names)}",
        "sources": ", ".join(name for name in known.sources if name.endswith((".c", ".h"))),
        "joints": count,
        "units": [_UNITS[unit][0] for unit in machine.legs.units],
        "coordinates": known.axes,
        "home": " ".join(_number(home.get(axis, 0.0)) for axis in "XYZABC"),
        "linear_velocity": f"{rates[~is_angle, 0].max():.4g}",
        "angular_velocity": f"{rates[is_angle, 0].max():.4g}",
        "axis_sections": list(zip(known.axes, *known.reached_box(), *rates.T, strict=True)),
        "joint_sections": [known.joint_section(joint) for joint in range(count)],
        "way": [list(zip(known.axes, map(_number, row), strict=True)) for row in known.way()],
    }
    kinds = ("kins.c", "kins.c"), (".ini", "machine.ini"), (".hal", "machine.hal")
    texts = {f"{known.name}{end}": rendered(f"linuxcnc/{template}", values) for end, template in kinds}
    texts["demo.ngc"], texts["tool.tbl"] = rendered("linuxcnc/demo.ngc", values), ""
    return {**texts, **known.sources}


def write_linuxcnc(machine: Manipulator | Stage, directory: str | Path) -> list[Path]:
    """Write the files of `linuxcnc_configuration` into a directory, which is created if needed; all or none.

    Files of the same names are replaced. Returns the paths.
    """
    return write_sources(directory, lambda: linuxcnc_configuration(machine))


class _Machine:
    """A machine in LinuxCNC's configuration. Values of axes are in millimetres and degrees."""

    machine: Any
    axes: str
    home: FloatArray  # readings of the home in LinuxCNC, shape (joints,)
    ends: tuple[FloatArray, FloatArray]  # smallest and largest readings, assumed if there is no limit
    axis_values: Any  # values of the axes (..., axes) for readings (..., joints), NaN if missing
    readings: Any  # readings for values of the axes near the home
    circle: Any  # values of the axes (n, axes) for a tilt whose direction moves round a circle, of size 1 or smaller

    def axis_rates(self) -> FloatArray:
        """Return rates and accelerations (axes, 2) for which no joint needs more than half of its own, in the home."""
        home, steps = self.axis_values(self.home), _STEP * np.eye(len(self.axes))
        changes = np.abs(self.readings(home + steps) - self.readings(home - steps)) / (2.0 * _STEP)
        assumed = np.array([ASSUMED[unit] for unit in self.machine.legs.units])
        return np.asarray(0.5 / (changes[..., None] / assumed).max(axis=1))

    def reached_box(self) -> tuple[FloatArray, FloatArray]:
        """Return the smallest and largest values of the axes in states within the limits, with a margin."""
        values = self.axis_values(np.random.default_rng(0).uniform(*self.ends, (_SAMPLES, len(self.home))))
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
        return np.floor(low - 0.1 * (high - low)), np.ceil(high + 0.1 * (high - low))

    def joint_section(self, joint: int) -> dict[str, Any]:
        """Return the values of the section of `machine.ini` about a joint."""
        unit, limits = self.machine.legs.units[joint], self.machine.reading_limits
        (_, scale, joint_type), (rate, acceleration) = _UNITS[unit], ASSUMED[unit]
        ends = zip(("MIN", "MAX"), limits[:, joint], strict=True)
        return {
            "type": joint_type,
            "limits": [(end, _number(scale * x)) for end, x in ends if np.isfinite(x)],
            "rate": scale * rate,
            "acceleration": scale * acceleration,
            "home": _number(scale * self.home[joint]),
        }

    def can_follow(self, way: FloatArray) -> bool:
        """Return whether the joints can follow straight lines between points (n, axes), the axes at their rates."""
        if not np.isfinite(way).all():
            return False
        steps, rates = np.diff(way, axis=0), np.array([ASSUMED[unit][0] for unit in self.machine.legs.units])
        times = (np.abs(steps) / self.axis_rates()[:, 0]).max(axis=-1)[:, None, None] / (len(_SHARES) - 1)
        readings, (low, high) = self.readings(way[:-1, None] + _SHARES * steps[:, None]), self.ends
        is_slow = np.abs(np.diff(readings, axis=1)) <= rates * times
        return bool(is_slow.all() and ((readings > low) & (readings < high)).all())

    def way(self) -> FloatArray:
        """Return the points (n, axes) of the program: a small circle of the platform's tilt, from the home and back."""
        home = self.axis_values(self.home)
        ways = (np.array([home, *self.circle(size), home]) for size in _SIZES)
        return next(filter(self.can_follow, ways), np.array([home]))


class _Robot(_Machine):
    name, axes = "spm", "XYZABC"

    def __init__(self, machine: Any) -> None:
        self.machine, self.ends = machine, travel(machine)
        readings, _ = start_readings(machine)
        self.home, self.state = np.array(readings), forward_physical(machine, readings)
        sources = c_sources(machine)
        names = "kinematics.c", "kinematics.h", "read_machine.h", "machine.txt"
        self.sources = {f"spm_{name}": sources[f"spm_{name}"] for name in names}

    def axis_values(self, readings: FloatArray) -> FloatArray:
        state = forward_physical(self.machine, readings)
        (r11, _, _), (r21, _, _), (r31, r32, r33) = np.moveaxis(state.rotation, (-2, -1), (0, 1))
        angles = np.arctan2(r32, r33), np.arctan2(-r31, np.hypot(r32, r33)), np.arctan2(r21, r11)
        return np.concatenate([1e3 * state.translation, np.rad2deg(np.stack(angles, axis=-1))], axis=-1)

    def readings(self, values: FloatArray) -> FloatArray:
        wanted = pose(1e-3 * values[..., :3], rpy=np.deg2rad(values[..., 3:]))
        return inverse_physical(self.machine, wanted, near=self.state).readings

    def circle(self, size: float) -> FloatArray:
        turn, home = _TURN[1:-1], self.home.reshape(2, 3)
        along = home - home.mean(axis=1, keepdims=True)
        across = np.ptp(home, axis=1, keepdims=True) * np.array([1.0, -2.0, 1.0]) / np.sqrt(3.0)
        turned = 0.2 * along.ravel() * (np.cos(turn) - 1.0) + 0.1 * np.sin(turn) * across.ravel()
        return self.axis_values(self.home + size * turned)


class _StageAlone(_Machine):
    name, axes = "stage", "ZAB"

    def __init__(self, stage: Any) -> None:
        self.machine, self.ends = stage, travel(stage)
        self.home = inverse_physical(stage, home_height(stage)).readings
        self.sources = {"stage.h": stage_c_sources(stage)["stage.h"], **stage_machine_sources(stage)}

    def axis_values(self, readings: FloatArray) -> FloatArray:
        state = forward_physical(self.machine, readings)
        return np.stack([1e3 * state.height, np.rad2deg(state.roll), np.rad2deg(state.pitch)], axis=-1)

    def readings(self, values: FloatArray) -> FloatArray:
        height, roll, pitch = 1e-3 * values[..., 0], np.deg2rad(values[..., 1]), np.deg2rad(values[..., 2])
        return inverse_physical(self.machine, height, roll=roll, pitch=pitch).readings

    def circle(self, size: float) -> FloatArray:
        height, tilt = np.full_like(_TURN, self.axis_values(self.home)[0]), 5.0 * size  # degrees
        return np.concatenate([height, tilt * np.cos(_TURN), tilt * np.sin(_TURN)], axis=-1)


def _number(x: float) -> str:
    return np.format_float_positional(round(float(x), 9) + 0.0, trim="0")
