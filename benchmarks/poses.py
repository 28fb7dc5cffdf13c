"""Poses of the benchmarks, from the generators of the tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from problems import at_discriminant, in_leg_space, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

MACHINE = spm.Manipulator.paper()

KINDS = ("leg lengths", "all rotations", "nearly level", "near a fold")
"""Kinds of poses that `mixture` makes."""


def as_built(size: float) -> spm.Manipulator:
    """Return a machine with random errors [m and rad] whose two balls at a corner coincide."""
    machine = MACHINE.perturbed(0, length=size, angle=size)
    balls = np.tile(machine.legs.balls[:3], (2, 1))
    legs = replace(machine.legs, balls=balls)
    return replace(machine, legs=legs)


def leg_space(count: int, seed: int = 0) -> RigidTransform:
    """Return poses (count,) of leg lengths drawn uniformly from the limits."""
    return in_leg_space(MACHINE, count, seed).pose


def mixture(kind: str, count: int, seed: int = 0) -> RigidTransform:
    """Return poses (count,) of one of `KINDS`.

    - leg lengths: as `leg_space`;
    - all rotations: both stages tilted by up to 180 degrees, in all four families;
    - nearly level: tilts from 0.01 down to 10⁻⁸ rad, turned and off the axis by as little;
    - near a fold: 10⁻⁶ r to 10⁻⁹ r on either side of where two branches meet.
    """
    rng = np.random.default_rng(seed)
    if kind == "leg lengths":
        return leg_space(count, seed)
    if kind == "all rotations":
        share = -(-count // 4)
        parts = [
            random_branches(MACHINE, family, share, seed + k).pose for k, family in enumerate(spm.machine.FAMILIES)
        ]
        return RigidTransform.concatenate(parts)[rng.permutation(4 * share)[:count]]
    r = MACHINE.middle_radius
    if kind == "nearly level":
        tilt = 10.0 ** -rng.uniform(2.0, 8.0, count)
        azimuth, aside = rng.uniform(-np.pi, np.pi, (2, count))
        zero = np.zeros(count)
        level = Rotation.from_rotvec(tilt[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth), zero], axis=-1))
        off = rng.uniform(0.0, 1.0, count) * r * tilt
        position = np.stack([off * np.cos(aside), off * np.sin(aside), zero + 2.2], axis=-1)
        turn = rng.uniform(-1.0, 1.0, count) * tilt
        return spm.pose(position, rotation=level * Rotation.from_euler("z", turn[:, None]))
    if kind == "near a fold":
        poses: list[RigidTransform] = []
        while len(poses) < count:
            start = leg_space(1, int(rng.integers(2**31)))[0]
            beyond = r * 10.0 ** -rng.uniform(6.0, 9.0) * rng.choice([-1.0, 1.0])
            poses.append(at_discriminant(start, int(rng.integers(4)), beyond, MACHINE))
        return RigidTransform.concatenate(poses)
    raise ValueError(f"kind: one of {', '.join(KINDS)}; received {kind!r}")


def tiled(count: int) -> RigidTransform:
    """Return poses (count,) in leg space of which ten thousand are different."""
    matrices = leg_space(min(count, 10_000)).as_matrix()
    repeated = np.resize(matrices, (count, 4, 4))
    return RigidTransform.from_matrix(repeated)
