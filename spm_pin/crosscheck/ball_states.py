"""States made of a requested pose and of ball positions that a method found, and how far they violate the equations.

For a manipulator the whole pose is requested, for a stage only its height and its normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spm_pin.machine import Configuration
from spm_pin.machine.legs import triangle_frames
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import FloatArray


def freedoms(machine: Machine) -> slice:
    """Return the rows of a twist (v, ω) that are the freedoms of a machine: v_z, ω_x and ω_y of a stage."""
    return slice(2, 5) if machine.is_stage else slice(None)


def states_with_balls(machine: Any, poses: FloatArray, balls: FloatArray) -> Any:
    """Return the states (...) for requests (..., 4, 4) with lower balls (..., 3, 3), where a stage's platform is."""
    poses = np.broadcast_to(poses, (*balls.shape[:-2], 4, 4))
    if not machine.is_stage:
        return Configuration.from_arrays(machine, poses[..., :3, :3], poses[..., :3, 3], balls)
    own = machine.legs.balls
    rotation = triangle_frames(balls) @ triangle_frames(own).T
    return Configuration.from_arrays(machine, rotation, balls.mean(axis=-2) - rotation @ own.mean(axis=0))


def closure_residuals(states: Any, poses: FloatArray, balls: FloatArray) -> FloatArray:
    """Return the largest violation of the loop equations and of the request [m], (...), for `states_with_balls`."""
    residual = np.asarray(states.closure_residual)
    if not states.machine.is_stage:
        return residual
    normal_error = states.machine.ball_side * np.linalg.norm(states.normal - poses[..., :3, 2], axis=-1)
    ball_error = np.abs(states.balls - balls).max(axis=(-1, -2))
    return np.asarray(np.max([residual, normal_error, np.abs(states.height - poses[..., 2, 3]), ball_error], axis=0))
