"""A session's state in forms that leave the page: a command line, JSON, q."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.display.viewer.robot_meshes import Robot
from spm_pin.display.viewer.state import State
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, LegLimits

__all__ = ["command_line", "content", "json_text", "xyx_degrees"]


def xyx_degrees(configuration: Configuration) -> list[float]:
    """Return the X-Y-X angles of a single pose [degrees]."""
    angles = configuration.pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)
    return [float(angle) for angle in angles]


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    position = [repr(float(x)) for x in configuration.translation]
    angles = [repr(angle) for angle in xyx_degrees(configuration)]
    words = ["spm-pin", "inverse", "--translation", *position, "--xyx", *angles]
    return shlex.join(words + (["--geometry", str(geometry_file)] if geometry_file is not None else []))


def content(state: State, robot: Robot, geometry_file: Path | None = None) -> dict[str, Any]:
    """Return the state as data for JSON, in metres, radians and newtons."""
    shown, readings = state.shown, state.readings
    geometry = shown.geometry
    limits = geometry.limits
    return {
        "geometry": {
            "base_radius": geometry.base_radius,
            "platform_radius": geometry.platform_radius,
            "middle_side": geometry.middle_side,
            "leg_limits": None if limits is None else _pairs(limits),
        },
        "branch": state.label or None,
        "pose": shown.pose.as_matrix().tolist(),
        "translation": shown.translation.tolist(),
        "xyx": np.deg2rad(xyx_degrees(shown)).tolist(),
        "reached": state.distance == 0.0,
        "leg_lengths": dict(zip(LEGS, readings.leg_lengths.tolist(), strict=True)),
        "middle_joints": shown.middle_joints.tolist(),
        "closure_residual": float(shown.closure_residual),
        "q": dict(zip(robot.joint_names, robot.q(shown).tolist(), strict=True)),
        "physical": readings.physical,
        "singularity": {
            "kind": str(readings.kind),
            **{
                name: dict(zip(("J_b", "J_c", "K"), [_finite(x) for x in values.tolist()], strict=True))
                for name, values in (
                    ("sigma", readings.sigma),
                    ("condition", readings.condition),
                    ("index", readings.index),
                    ("leg_travel", readings.travel),
                )
            },
        },
        "wrench": state.wrench.tolist(),
        "leg_forces": None if readings.forces is None else dict(zip(LEGS, readings.forces.tolist(), strict=True)),
        "command": command_line(shown, geometry_file),
    }


def json_text(state: State, robot: Robot, geometry_file: Path | None = None) -> str:
    """Return `content` as JSON text."""
    return json.dumps(content(state, robot, geometry_file), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _pairs(limits: LegLimits) -> dict[str, list[float | None]]:
    return {leg: [low, _finite(high)] for leg, low, high in zip(LEGS, limits.minimum, limits.maximum, strict=True)}


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None
