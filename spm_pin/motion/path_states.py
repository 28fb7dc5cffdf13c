"""States of the machine along a path of the legs or of the platform, in the physical mode."""

from __future__ import annotations

import numpy as np

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.as_built import AsBuiltGeometry
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.motion.leg_path import LegPath
from spm_pin.multibody.platform_path import PlatformMotion, PlatformPath

__all__ = ["STEP", "Path", "line_states", "platform_motion", "spaced_parameters", "states_along"]

STEP = 0.005
"""Largest distance of two samples of a path in the leg lengths, in units of d."""

Path = LegPath | PlatformPath
"""A path; its parameter goes from 0 to 1, of a `PlatformPath` the share of its duration."""


def states_along(geometry: Geometry | AsBuiltGeometry, path: Path, parameters: FloatArray) -> Configuration:
    """Return the states at parameters (n,) from 0 to 1; some may not exist."""
    if isinstance(path, LegPath):
        return forward_physical(geometry, path(parameters).lengths)
    return inverse_physical(geometry, platform_motion(path, parameters).pose)


def platform_motion(path: PlatformPath, parameters: FloatArray) -> PlatformMotion:
    """Return the pose at parameters (n,) from 0 to 1, and its derivatives by the path's own time."""
    # Not beyond the end by rounding.
    return path(np.minimum(path.start + parameters * path.duration, path.end))


def line_states(geometry: Geometry | AsBuiltGeometry, start: FloatArray, end: FloatArray) -> Configuration:
    """Return the states on a straight line between leg lengths (6,), at most `STEP` apart."""
    parameters = spaced_parameters(geometry, np.array([start, end]))[:, None]
    return forward_physical(geometry, start + parameters * (end - start))


def spaced_parameters(geometry: Geometry | AsBuiltGeometry, lengths: FloatArray) -> FloatArray:
    """Return evenly spaced parameters from 0 to 1 for a path through leg lengths (n, 6), at most `STEP` apart."""
    distance = float(np.linalg.norm(np.diff(lengths, axis=0), axis=-1).sum())
    return np.linspace(0.0, 1.0, max(int(np.ceil(distance / (STEP * geometry.nominal.middle_side))), 2) + 1)
