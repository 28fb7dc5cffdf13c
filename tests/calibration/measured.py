"""Measurements of a machine with known errors, with the noise of a laser tracker and of encoders."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin import calibration

PAPER = spm.Manipulator.paper()


@cache
def plan() -> spm.Configuration:
    return calibration.choose_poses(PAPER, 40, candidates=300, rng=0)


@cache
def elsewhere() -> spm.Configuration:
    """States over the whole range of the legs, none of them measured."""
    legs = np.random.default_rng(99).uniform(1.1, 1.5, (60, 6))
    found = spm.forward_physical(PAPER, legs)
    return found[found.exists]


def measure(
    machine: spm.Manipulator, seed: int, noise: float = 1.0, states: spm.Configuration | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (N, 4, 4) and readings (N, 6): 10 µm and 10 µrad, and 1 µm, times `noise`."""
    random = np.random.default_rng(seed)
    readings = (plan() if states is None else states).leg_lengths
    poses = spm.forward_physical(machine, readings).pose.as_matrix()
    poses[:, :3, 3] += 1e-5 * noise * random.standard_normal((len(poses), 3))
    turns = Rotation.from_rotvec(1e-5 * noise * random.standard_normal((len(poses), 3))).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    return poses, readings + 1e-6 * noise * random.standard_normal(readings.shape)


def position_errors(first: spm.Manipulator, second: spm.Manipulator) -> np.ndarray:
    """Distances [m] of the platform of two machines at the same readings, all over the workspace."""
    legs = elsewhere().leg_lengths
    places = (spm.forward_physical(machine, legs).translation for machine in (first, second))
    return np.linalg.norm(next(places) - next(places), axis=-1)
