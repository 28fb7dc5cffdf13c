"""The solids of a robot or of a stage: those of a stage are the lower half of a robot of two."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from spm_pin.description.visuals import VisualPart, part_placements, section_size, visual_parts
from spm_pin.mechanism import Configuration, Geometry, Stage, StageConfiguration
from spm_pin.mechanism.arguments import FloatArray

_PLATFORM = "middle_platform"
"""The body of the robot that is the platform of its lower stage."""


def machine_parts(machine: Geometry | Stage) -> tuple[list[VisualPart], float, str]:
    """Return the solids of a machine, the size of its sections [m], and the name of the platform that is moved."""
    if isinstance(machine, Geometry):
        return list(visual_parts(machine)), section_size(machine), "terminal_platform"
    robot = _robot_of(machine)
    return [visual_parts(robot)[k] for k in _lower_half(robot)], section_size(robot), _PLATFORM


def solid_matrices(states: Configuration | StageConfiguration) -> FloatArray:
    """Return `part_placements` (..., n, 4, 4) of the solids of states (...) of either machine."""
    if isinstance(states, Configuration):
        return part_placements(states)
    # The upper plate mirrors the base: whatever it is, it is not drawn.
    robot, n = _robot_of(states.stage), states.normal
    mirror = np.eye(3) - 2.0 * n[..., :, None] * n[..., None, :]
    distance = (n * states.translation).sum(axis=-1, keepdims=True)
    pose = mirror * [1.0, 1.0, -1.0], 2.0 * distance * n
    both = Configuration.from_arrays(robot, *pose, np.array(states.balls))
    return part_placements(both)[..., _lower_half(robot), :, :]


@lru_cache(maxsize=16)
def _robot_of(stage: Stage) -> Geometry:
    return Geometry.of_stages(stage, stage)


@lru_cache(maxsize=16)
def _lower_half(robot: Geometry) -> list[int]:
    """Return the places of the solids of the lower stage."""
    bodies = [part.body for part in visual_parts(robot)]
    return [k for k, body in enumerate(bodies) if body in ("base", _PLATFORM) or body.startswith("leg_b")]
