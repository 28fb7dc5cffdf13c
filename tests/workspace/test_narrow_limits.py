"""Limits narrower than a hundredth of the machine: what is reached is nearly a parallelepiped."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from problems import PAPER

import spm_pin as spm

READINGS = np.array([1.25, 1.15, 1.40, 1.30, 1.20, 1.40])


def limited(half: float) -> spm.Manipulator:
    return replace(PAPER, limits=spm.LegLimits(READINGS - half, READINGS + half))


@pytest.mark.parametrize("half", [3e-4, 1e-4, 1e-6, 1e-9])
def test_the_volume_of_poses_is_that_of_readings_over_the_determinant(half: float) -> None:
    machine = limited(half)
    expected = (2.0 * half) ** 6 / abs(np.linalg.det(spm.inverse_jacobian(spm.forward_physical(machine, READINGS))))
    estimate = spm.workspace.pose_volume(machine, samples=4_000, rng=0)
    assert estimate.low < expected < estimate.high < 1.3 * estimate.low


def test_the_volume_of_positions_is_that_of_a_projected_box() -> None:
    """The projection of a box of six readings: each three of its edges add |det| (Shephard 1974)."""
    half = 1e-4
    machine = limited(half)
    rates = np.linalg.inv(spm.inverse_jacobian(spm.forward_physical(machine, READINGS)))[:3]
    expected = (2.0 * half) ** 3 * sum(abs(np.linalg.det(rates[:, legs])) for legs in combinations(range(6), 3))
    # It is convex: a mesh of 20 steps across lies inside.
    assert 0.95 * expected < spm.workspace.reachable_boundary(machine).volume < expected
    estimate = spm.workspace.reachable_volume(machine, samples=4_000, rng=0)
    assert estimate.low < expected < estimate.high


@pytest.mark.parametrize("half", [1e-4, 1e-7])
def test_states_are_drawn_found_and_certified(half: float) -> None:
    machine = limited(half)
    states = spm.workspace.sample_reachable(machine, 200, rng=0)
    assert np.ptp(states.readings, axis=0).min() > 1.5 * half
    assert np.abs(states.readings - READINGS).max() <= half * (1.0 + 1e-6)
    assert spm.workspace.reachable(machine, states.pose).reachable.all()
    assert spm.certify(machine).holds
