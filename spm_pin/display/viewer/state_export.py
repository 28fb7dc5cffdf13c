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
from spm_pin.mechanism import LEGS, Configuration
from spm_pin.mechanism.geometry import geometry_data
from spm_pin.multibody.chain import ClosedChain

__all__ = ["command_line", "content", "json_text"]


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    values = [repr(float(x)) for x in pose_coordinates(configuration.pose)]
    words = ["spm-pin", "inverse", "--translation", *values[:3], "--xyx", *values[3:]]
    return shlex.join(words + (["--geometry", str(geometry_file)] if geometry_file is not None else []))


def content(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> dict[str, Any]:
    """Return the state as data, in metres, radians and newtons."""
    shown, readings = state.shown, state.readings
    return {
        "geometry": {"leg_limits": None, **geometry_data(shown.geometry)},
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
                name: dict(zip(("J_b", "J_c", "K"), values.tolist(), strict=True))
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
    found = _finite(content(state, chain, geometry_file))
    return json.dumps(found, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _finite(value: Any) -> Any:
    """Return the data with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
