"""Vibrations on elastic legs, against the spectrum of the mechanism's linearised simulation."""

from __future__ import annotations

import numpy as np
import pytest

import spm_pin as spm

PAPER = spm.Geometry.paper()
CHAIN = spm.ClosedChain.from_urdf()
LENGTHS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
LEGS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e9


def test_frequencies_are_the_spectrum_of_the_linearised_motion() -> None:
    """Accelerations of the legs when each is stretched in turn, its spring pulling back, less those without springs."""
    state = spm.forward_physical(PAPER, LENGTHS)
    q = CHAIN.joint_values(state)
    stiff = spm.stiffness(state, LEGS)
    step = 1e-6
    columns = []
    for leg in np.eye(6):
        ends = []
        for sign in (1.0, -1.0):
            moved = CHAIN.forward_kinematics(LENGTHS + sign * step * leg, near=q)
            pull = -LEGS * sign * step * leg
            rest = np.zeros(18)
            with_springs = CHAIN.forward_dynamics(moved, rest, pull)
            without = CHAIN.forward_dynamics(moved, rest, np.zeros(6))
            ends.append((with_springs - without)[CHAIN.leg_indices])
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    squares = np.sort(-np.linalg.eigvals(np.array(columns).T).real)
    found = CHAIN.natural_frequencies(q, stiff)
    np.testing.assert_allclose(found.frequencies, np.sqrt(squares) / (2.0 * np.pi), rtol=1e-6)


def test_modes_are_orthogonal_with_respect_to_mass_and_stiffness() -> None:
    states = spm.forward_physical(PAPER, np.random.default_rng(1).uniform(1.15, 1.45, (4, 6)))
    q, stiff = CHAIN.joint_values(states), spm.stiffness(states, LEGS)
    found = CHAIN.natural_frequencies(q, stiff)
    assert found.frequencies.shape == (4, 6)
    assert (np.diff(found.frequencies, axis=-1) >= 0.0).all()
    mass = CHAIN.platform_dynamics(q, np.zeros_like(q)).mass
    unit = found.modes @ mass @ found.modes.swapaxes(-1, -2)
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(6), unit.shape), atol=1e-9)
    squares = found.modes @ stiff @ found.modes.swapaxes(-1, -2)
    expected = (2.0 * np.pi * found.frequencies) ** 2
    np.testing.assert_allclose(np.diagonal(squares, axis1=-2, axis2=-1), expected, rtol=1e-9)


def test_open_loops_and_matrices_that_are_no_stiffness_are_refused() -> None:
    q = CHAIN.joint_values(spm.forward_physical(PAPER, LENGTHS))
    for wrong in (np.arange(36.0).reshape(6, 6), -np.eye(6)):
        with pytest.raises(spm.ArgumentError, match="stiffness"):
            CHAIN.natural_frequencies(q, wrong)
    with pytest.raises(spm.ClosureError):
        CHAIN.natural_frequencies(q + 0.01, np.eye(6))
