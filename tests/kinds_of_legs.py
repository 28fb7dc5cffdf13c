"""Machines of the paper's triangles with RPS, PRS and RRS legs in either stage, and states of them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from problems import PAPER, Array

import spm_pin as spm
from spm_pin.kinematics import platform_jacobian
from spm_pin.machine import PRS, RPS, RRS, Stage

KINDS_OF_STAGES = {
    "RPS": RPS(),
    "PRS": PRS(rod=1.6, direction=1.3),
    "RRS": RRS(crank=1.1, rod=0.9),
    "PRS hanging": PRS(rod=1.6, direction=1.3, sign=1),
}
PAIRS = [("RPS", "RPS"), ("RPS", "PRS"), ("PRS", "RRS"), ("RRS", "PRS hanging"), ("PRS hanging", "RPS")]
"""Each of them once below and once above another, and twice the same."""
SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(-0.5, 1.5))
SCREWS = Stage(0.20, 0.25, PRS(rod=0.30), limits=(-0.05, 0.25))
SERVOS_AND_SCREWS = spm.Manipulator.of_stages(SERVOS, SCREWS)


def machine_of_kinds(lower: str, upper: str, *, built: bool = False) -> spm.Manipulator:
    """Return a machine of the paper's triangles with legs of these kinds."""
    radius = PAPER.middle_radius
    stages = zip((lower, upper), (PAPER.base_radius, PAPER.platform_radius), strict=True)
    drawn = spm.Manipulator.of_stages(*(Stage(base, radius, KINDS_OF_STAGES[kind]) for kind, base in stages))
    return drawn.perturbed(5, length=5e-3, angle=5e-3) if built else drawn


def states(machine: spm.Manipulator, count: int = 60) -> spm.Configuration:
    """Return physical states of a machine, away from singularities."""
    legs = np.random.default_rng(11).uniform(1.15, 1.45, (count, 6))
    other = spm.forward_physical(PAPER, legs)
    readings = spm.machine.Configuration(machine, other.pose, other.middle_joints).readings
    found = spm.forward_physical(machine, readings[np.isfinite(readings).all(axis=-1)])
    found = found[found.exists]
    regular = (np.abs(found.slopes) > 0.2 * machine.legs.largest_slopes).all(axis=-1)
    return found[regular & (np.abs(platform_jacobian(found)).max(axis=(-1, -2)) < 20.0)]


def sampled_clearance(states: Any, pairs: list[tuple[int, int]]) -> Array:
    """Return the least distance (N,) of points along two legs, 101 on each link, of these pairs of legs."""
    corners = np.broadcast_arrays(states.leg_bases, states.circle_centres, states.balls)
    share = np.linspace(0.0, 1.0, 101)[:, None]
    links = [p[..., None, :] + share * (q - p)[..., None, :] for p, q in pairwise(corners)]
    points = np.concatenate(links, axis=-2)
    gaps = [np.linalg.norm(points[:, i, :, None] - points[:, j, None], axis=-1).min(axis=(1, 2)) for i, j in pairs]
    return np.min(gaps, axis=0)
