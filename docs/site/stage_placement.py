"""States composed from the two stages, of the paper's dimensions, by `tests/problems.py`: no solver takes part."""

from __future__ import annotations

import sys
from pathlib import Path

from assembly_mode_changes import Array

import spm_pin as spm

sys.path.append(str(Path(__file__).parents[2] / "tests"))
import problems

MACHINE = spm.Manipulator.paper()
SAMPLES = 50
"""States of each family or stratum."""


def compose(quaternions: Array, heights: Array) -> spm.Configuration:
    """Return the configurations (...) of two stages: quaternions (..., 2, 4) and heights (..., 2) [m]."""
    stages = (problems.stage_at(quaternions[..., k, :], heights[..., k], MACHINE.middle_radius) for k in range(2))
    return problems.compose(MACHINE, *stages).configuration
