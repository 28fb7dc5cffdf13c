"""A session's state in forms that leave the page: a command line, JSON, q."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.display.viewer.slider_ranges import pose_coordinates
from spm_pin.display.viewer.state import State
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, LegLimits
from spm_pin.multibody.chain import ClosedChain

__all__ = ["command_line", "content", "json_text"]


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    values = [repr(float(x)) for x in pose_coordinates(configuration.pose)]
    words = ["spm-pin", "inverse", "--translation", *values[:3], "--xyx", *values[3:]]
    return shlex.join(words + (["--geometry", str(geometry_file)] if geometry_file is not None else []))


def content(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> dict[str, Any]:
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
        "xyx": np.deg2rad(pose_coordinates(shown.pose)[3:]).tolist(),
        "reached": state.distance == 0.0,
        "leg_lengths": dict(zip(LEGS, readings.leg_lengths.tolist(), strict=True)),
        "middle_joints": shown.middle_joints.tolist(),
        "closure_residual": float(shown.closure_residual),
        "q": dict(zip(chain.joint_names, chain.joint_values(shown).tolist(), strict=True)),
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


def json_text(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> str:
    """Return `content` as JSON text."""
    return json.dumps(content(state, chain, geometry_file), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _pairs(limits: LegLimits) -> dict[str, list[float | None]]:
    return {leg: [low, _finite(high)] for leg, low, high in zip(LEGS, limits.minimum, limits.maximum, strict=True)}


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None
