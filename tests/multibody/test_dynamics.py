"""Forces and accelerations: against plain equations, two other engines, finite differences and energy."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from multibody.chains import chain, six_branches

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError

pinocchio = pytest.importorskip("pinocchio")


def test_bad_arguments() -> None:
    robot, rest = chain(), np.zeros(18)
    q = robot.joint_values(six_branches()[0])
    v = robot.state(q).joint_velocities([0.1, 0, 0, 0, 0, 0.1])
    with pytest.raises(ClosureError) as caught:
        robot.state(q + 1e-4, rest).inverse_dynamics(rest)
    assert caught.value.residual == pytest.approx(np.linalg.norm(robot.state(q + 1e-4).closure_gap(), axis=-1).max())
    with pytest.raises(ArgumentError, check=with_fields(argument="v")):
        robot.state(q, v + 1e-4).forward_dynamics(np.zeros(6))
    with pytest.raises(ArgumentError, check=with_fields(argument="a")):
        robot.state(q, v).inverse_dynamics(rest)


LENGTHS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
LEGS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e9


def test_frequencies_are_the_spectrum_of_the_linearised_motion() -> None:
    """Accelerations of the legs when each is stretched in turn, its spring pulling back, less those without springs."""
    state = spm.forward_physical(chain().machine, LENGTHS)
    q = chain().joint_values(state)
    stiff = spm.stiffness(state, LEGS)
    step = 1e-6
    columns = []
    for leg in np.eye(6):
        ends = []
        for sign in (1.0, -1.0):
            moved = chain().forward_kinematics(LENGTHS + sign * step * leg, near=q)
            pull = -LEGS * sign * step * leg
            rest = np.zeros(18)
            with_springs = chain().state(moved, rest).forward_dynamics(pull)
            without = chain().state(moved, rest).forward_dynamics(np.zeros(6))
            ends.append((with_springs - without)[chain().leg_indices])
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    squares = np.sort(-np.linalg.eigvals(np.array(columns).T).real)
    found = chain().state(q).natural_frequencies(stiff)
    np.testing.assert_allclose(found.frequencies, np.sqrt(squares) / (2.0 * np.pi), rtol=1e-6)
    for wrong in (np.arange(36.0).reshape(6, 6), -np.eye(6)):
        with pytest.raises(ArgumentError, check=with_fields(argument="stiffness")):
            chain().state(q).natural_frequencies(wrong)
    with pytest.raises(ClosureError):
        chain().state(q + 0.01).natural_frequencies(np.eye(6))


def test_modes_are_orthogonal_with_respect_to_mass_and_stiffness() -> None:
    states = spm.forward_physical(chain().machine, np.random.default_rng(1).uniform(1.15, 1.45, (4, 6)))
    q, stiff = chain().joint_values(states), spm.stiffness(states, LEGS)
    found = chain().state(q).natural_frequencies(stiff)
    assert found.frequencies.shape == (4, 6)
    assert (np.diff(found.frequencies, axis=-1) >= 0.0).all()
    mass, turned = chain().state(q).platform_dynamics().mass, found.modes.swapaxes(-1, -2)
    np.testing.assert_allclose(found.modes @ mass @ turned, np.tile(np.eye(6), (4, 1, 1)), atol=1e-9)
    squares = np.diagonal(found.modes @ stiff @ turned, axis1=-2, axis2=-1)
    np.testing.assert_allclose(squares, (2.0 * np.pi * found.frequencies) ** 2, rtol=1e-9)
