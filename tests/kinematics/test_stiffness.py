"""Stiffness of the platform on elastic legs, against static equilibrium found by the forward displacement."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics import compliance, principal_stiffness

PAPER = spm.Manipulator.paper()
LENGTHS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
LEGS = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e7
STATE = spm.forward_physical(PAPER, LENGTHS)
MACHINE = PAPER.perturbed(2, length=0.01, angle=0.02)
STATES = {"nominal": STATE, "as built": spm.forward_physical(MACHINE, LENGTHS)}


def displacement(before: spm.Configuration, after: spm.Configuration) -> np.ndarray:
    turned = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
    return np.concatenate([after.translation - before.translation, turned])


@pytest.mark.parametrize("name", STATES)
def test_compliance_is_the_displacement_under_load(name: str) -> None:
    """Legs are shortened by their force over their stiffness; the pose follows from the new lengths."""
    state = STATES[name]

    def moved(load: np.ndarray) -> np.ndarray:
        shortened = LENGTHS - spm.leg_forces(state, load) / LEGS
        return displacement(state, spm.forward_physical(state.machine, shortened, near=state))

    expected = compliance(state, LEGS)
    for wrench, column in zip(np.eye(6), expected.T, strict=True):
        found = (moved(20.0 * wrench) - moved(-20.0 * wrench)) / 40.0
        np.testing.assert_allclose(found, column, rtol=1e-6, atol=1e-6 * np.abs(column).max())
    np.testing.assert_allclose(spm.stiffness(state, LEGS) @ expected, np.eye(6), atol=1e-9)


@pytest.mark.parametrize("name", STATES)
def test_compliance_is_the_error_of_changed_lengths_and_of_pivots_moved_along_their_axes(name: str) -> None:
    state, structure = STATES[name], LEGS[::-1] / 3.0
    machine = state.machine if name == "as built" else PAPER
    errors = spm.calibration.error_jacobian(state).reshape(6, 6, 9)
    along = errors[..., 8]
    across = (errors[..., 2:5] * machine.legs.axes).sum(axis=-1)
    expected = (along / LEGS) @ along.T + (across / structure) @ across.T
    found = compliance(state, LEGS, structure)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(spm.stiffness(state, LEGS, structure) @ found, np.eye(6), atol=1e-9)


def test_the_level_home_is_rigid_in_some_directions() -> None:
    """There the legs cannot tell some motions apart: an inverse singularity."""
    home = spm.forward_physical(PAPER, [1.3] * 6)
    with pytest.raises(spm.SingularConfigurationError, check=with_fields(kind="inverse")):
        spm.stiffness(home, 1e7)
    found = principal_stiffness(home, 1e7)
    assert np.isinf(found.translational).any() or np.isinf(found.rotational).any()
    assert np.isfinite(principal_stiffness(home, 1e7, 1e8).translational).all()


def test_principal_stiffness_is_force_over_displacement_in_its_directions() -> None:
    matrix, found = compliance(STATE, LEGS), principal_stiffness(STATE, LEGS)
    assert (np.diff(found.translational) >= 0.0).all()
    for block, values, directions in ((matrix[:3, :3], *found[:2]), (matrix[3:, 3:], *found[2:])):
        for value, direction in zip(values, directions, strict=True):
            np.testing.assert_allclose(block @ direction, direction / value, rtol=0, atol=1e-9 / value)
