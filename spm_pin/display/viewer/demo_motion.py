"""A motion to begin with: a small loop from the first state and back, clear of singularities and limits."""

from __future__ import annotations

import numpy as np

from spm_pin.display.viewer.recording import Playback, Recording
from spm_pin.errors import SpmError
from spm_pin.mechanism.configuration import Configuration

__all__ = ["demo_motion"]

_SECONDS = 10.0
_POINTS = 81
# Directions of the six legs' motion, found by a search for large motions of the paper's machine: the legs go along the
# first and back, and swing along the second meanwhile.
_ALONG = np.array([0.52, 0.05, 0.25, 0.75, -0.11, -0.30])
_ACROSS = np.array([-0.45, 0.61, -0.25, -0.32, 0.34, 0.37])


def demo_motion(start: Configuration) -> Playback | None:
    """Return a closed path of leg lengths from a configuration, followed; None where there is no such path.

    Its size is halved until no singularity and no leg limit lies on it.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _POINTS)[:, None]
    swing = (1.0 - np.cos(angles)) * (_ALONG + 0.5 * np.sin(2.0 * angles) * _ACROSS)
    times = np.linspace(0.0, _SECONDS, _POINTS)
    for size in (0.1375, 0.07, 0.035):
        lengths = start.leg_lengths + size * start.geometry.middle_side * swing
        if lengths.min() <= 0.0:
            continue
        try:
            playback = Recording(lengths, times).follow(start.geometry, start)
        except SpmError:
            return None
        if playback.path.complete and not playback.path.events:
            return playback
    return None
