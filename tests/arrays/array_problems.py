"""Random poses and readings for the kinematics on arrays, and the machines that they are for."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

PAPER = spm.Manipulator.paper()
BUILT = PAPER.perturbed(1, length=2e-3, angle=2e-3)
NOWHERE = [[0.1, 0.1, 0.1, 5.0, 5.0, 5.0], [1.2, 1.2, 1.2, 1e-3, 1.0, 1.0], [0.1] * 6]
"""Readings of no state."""
LEVEL = [[1.2] * 6, [1.3, 1.3, 1.3, 1.2, 1.2, 1.2]]
"""Readings of level states, which are inverse singularities."""


def random_poses(count: int) -> RigidTransform:
    """Return poses in and around the workspace; about half of the branches are real, and few poses are physical."""
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(rng.normal(size=(count, 3)) * rng.choice([0.1, 0.5], (count, 1)))
    places = np.array([0.0, 0.0, 2.2]) + rng.normal(size=(count, 3)) * [0.4, 0.4, 0.3]
    return RigidTransform.from_components(places, turns)


def random_readings(count: int) -> np.ndarray:
    """Return readings, some of them beyond any state."""
    rng = np.random.default_rng(1)
    return np.where(rng.random((count, 1)) < 0.5, rng.uniform(0.8, 1.8, (count, 6)), rng.uniform(1.1, 1.5, (count, 6)))
