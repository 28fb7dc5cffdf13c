"""Stages of every kind, drawn and as built, and states of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import spm_pin as spm

STAGES = {
    "RPS": spm.Stage(0.7, 0.46),
    "PRS": spm.Stage(0.35, 0.2, spm.PRS(rod=0.4)),
    "PRS inclined": spm.Stage(0.35, 0.2, spm.PRS(rod=0.4, direction=2.0)),
    "PRS radial": spm.Stage(0.3, 0.2, spm.PRS(rod=0.4, direction=0.0, sign=1)),
    "PRS hanging": spm.Stage(0.35, 0.2, spm.PRS(rod=0.4, sign=1)),
    "RRS": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)),
    "RRS inwards": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11, sign=1)),
}
HEIGHTS = {"RPS": 1.1, "PRS radial": 0.3, "RRS": 0.12, "RRS inwards": 0.12}
"""At which they stand well; of the others 0.5 m."""
STEP = 1e-6
"""Of differences [m, rad]."""
MACHINES = ("RPS", "PRS inclined", "RRS", "RPS as built", "PRS hanging as built", "RRS inwards as built")
"""Each kind of legs, nominal and with errors; knees of both signs, slides of several directions."""


def stage_and_height(machine: str) -> tuple[spm.Stage, float]:
    """Return a stage, with errors if its name ends with "as built", and a height at which it stands well."""
    name = machine.removesuffix(" as built")
    stage = STAGES[name]
    built = stage.perturbed(3, length=5e-3 * stage.size, angle=5e-3)
    return built if name != machine else stage, HEIGHTS.get(name, 0.5)


def requests(height: float, count: int, seed: int = 0) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return unit normals (count, 3), tilted by up to 35°, and heights (count,) near one."""
    rng = np.random.default_rng(seed)
    tilt, azimuth = rng.uniform(0.0, 0.6, count), rng.uniform(-np.pi, np.pi, count)
    normals = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], axis=-1)
    return normals, height * rng.uniform(0.9, 1.1, count)


def existing_states(stage: spm.Stage, height: float, count: int, seed: int = 0) -> spm.Configuration:
    """Return the physical states of `requests` that exist."""
    normals, heights = requests(height, count, seed)
    states = spm.inverse_physical(stage, heights, normal=normals)
    return states[states.exists]


def forward_determinants(states: spm.Configuration) -> npt.NDArray[np.float64]:
    """Return the determinants of the six forces about {B}'s origin, over d³, with the sign of home."""
    vectors, axes = states.leg_vectors, states.machine.legs.axes
    legs = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    forces = np.concatenate([legs, np.broadcast_to(axes, legs.shape)], axis=-2)
    rows = np.concatenate([forces, np.cross(np.concatenate([states.balls] * 2, axis=-2), forces)], axis=-1)
    return states.machine.kind.up * np.linalg.det(rows) / (np.sqrt(3.0) * states.machine.platform_radius) ** 3


def equilibrium(state: spm.Configuration) -> npt.NDArray[np.float64]:
    """Return the wrenches (6, 6) at o of the forces along the legs, per unit effort, and across their planes."""
    legs, arms = state.machine.legs, state.balls - state.translation
    # The reading's change per move of the ball within its plane, by differences of the legs' own formula.
    outward, upward = legs.planes
    changes, middles = [], state.machine.crank_middles
    for axis in range(2):
        ends = (legs.readings(state.places + sign * STEP * np.eye(2)[axis], middles) for sign in (1.0, -1.0))
        changes.append(np.subtract(*ends) / (2.0 * STEP))
    # By virtual work an effort t pushes the ball by t times the gradient of the reading.
    along = changes[0][:, None] * outward + changes[1][:, None] * upward
    forces = np.concatenate([along, legs.axes])
    return np.concatenate([forces, np.cross(np.tile(arms, (2, 1)), forces)], axis=-1).T
