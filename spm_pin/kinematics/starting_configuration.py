"""A regular configuration of any manipulator, to begin with where none is given."""

from __future__ import annotations

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_frames import home_lengths

_START = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50]) / 1.30


def starting_configuration(geometry: Geometry) -> Configuration:
    """Return a regular configuration of the manipulator: the paper's solution 3, in proportion.

    Its leg lengths are the paper's 120, 120, 140, 125, 120 and 150 cm over 130 cm, times the home lengths.

    Raises
    ------
    ArgumentError
        If the manipulator has no such configuration.
    """
    home = np.repeat(home_lengths(geometry), 3)
    for share in (1.0, 0.5, 0.2, 0.05):
        state = forward_physical(geometry, home * (1.0 + share * (_START - 1.0)))
        if state.exists:
            return state
    raise ArgumentError("geometry", "a manipulator that stands near its home", geometry, "Give a pose instead")
