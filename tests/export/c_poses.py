"""Poses for comparisons of the exported C: spread over all families, and hard ones."""

from __future__ import annotations

import numpy as np
from problems import at_discriminant, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm

Poses = tuple[np.ndarray, np.ndarray]


def spread_poses(machine: spm.Manipulator, count: int, seed: int) -> Poses:
    """Poses of known branches of all families, and some anywhere, most out of reach."""
    rng = np.random.default_rng(seed)
    size = sum(machine.dimensions)
    made = [
        random_branches(machine, family, count // 5, seed + k).pose for k, family in enumerate(spm.machine.FAMILIES)
    ]
    rest = count - sum(len(pose) for pose in made)
    rotation = [pose.rotation.as_matrix() for pose in made] + [Rotation.random(rest, rng=rng).as_matrix()]
    return np.concatenate(rotation), np.concatenate(
        [*(pose.translation for pose in made), size * rng.uniform(-1.0, 1.0, (rest, 3))]
    )


def hard_poses(machine: spm.Manipulator, count: int, seed: int) -> Poses:
    """Level and nearly level platforms, half turns, folds, and platforms upside down, on the axis and off it."""
    rng = np.random.default_rng(seed)
    r = machine.middle_radius
    size = sum(machine.dimensions)
    azimuth, aside, turn = rng.uniform(-np.pi, np.pi, (3, count))
    small = 10.0 ** rng.uniform(-17.0, -1.0, count)
    tilt = rng.choice([0.0, 1.0, -1.0], count) * small + rng.choice([0.0, np.pi], count)
    turn = np.where(rng.random(count) < 0.3, turn, rng.choice([0.0, 1.0], count) * small)
    turn += rng.choice([0.0, np.pi], count, p=[0.7, 0.3])
    across = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1)
    rotation = Rotation.from_rotvec(tilt[:, None] * across) * Rotation.from_euler("z", turn[:, None])
    matrix = rotation.as_matrix()
    exact = rng.random(count) < 0.2
    snapped = np.array([np.eye(3), np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0])])
    matrix[exact] = snapped[rng.integers(0, 4, int(exact.sum()))]
    off = r * rng.choice([0.0, 1.0, 2.0], count) * np.where(rng.random(count) < 0.5, small, rng.random(count))
    # |o| = 2 r |sin τ| makes a family where the platform is level.
    off = np.where(rng.random(count) < 0.3, 2.0 * r * np.abs(np.sin(turn)), off)
    position = np.stack([off * np.cos(aside), off * np.sin(aside), rng.uniform(0.3, 1.5, count) * size], axis=-1)
    folds = []
    for index, family in enumerate(spm.machine.FAMILIES):
        problem = random_branches(machine, family, 20, seed + index)
        for n in range(20):
            beyond = (-1.0) ** n * 10.0 ** rng.uniform(-15, -4) * machine.middle_side
            folds.append(at_discriminant(problem.pose[n], index, beyond, machine))
    matrix = np.concatenate([matrix, [pose.rotation.as_matrix() for pose in folds]])
    return matrix, np.concatenate([position, [pose.translation for pose in folds]])


def possible_lengths(machine: spm.Manipulator, count: int, seed: int, spread: float) -> np.ndarray:
    """Leg lengths (count, 6) [m] of level stages, varied by up to `spread` times the middle platform's radius."""
    rng = np.random.default_rng(seed)
    size = sum(machine.dimensions)
    aside = np.repeat([machine.base_radius, machine.platform_radius], 3) - machine.middle_radius
    level = np.hypot(aside, size * rng.uniform(0.3, 0.9, (count, 2)).repeat(3, axis=-1))
    return np.abs(level + spread * machine.middle_radius * rng.uniform(-1.0, 1.0, (count, 6)))


def held_states(machine: spm.Manipulator, count: int, seed: int) -> spm.Configuration:
    """Configurations in the home's aspect, a part of `count` of them."""
    found = spm.forward_physical(machine, possible_lengths(machine, count, seed, 0.5))
    return found[found.exists]
