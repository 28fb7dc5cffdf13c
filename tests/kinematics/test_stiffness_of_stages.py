"""Rates, forces and stiffness by the functions of both machines, of stages of every kind, by differences of states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from balancers import MACHINES, existing_states, stage_and_height
from error_fields import with_fields
from finite_differences import extrapolated
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics import MOTION, compliance, principal_stiffness

LEGS, STRUCTURE = np.array([1.0, 2.0, 3.0]) * 1e6, np.array([3.0, 1.0, 2.0]) * 4e7


def state_of(machine: str) -> spm.Configuration:
    """Return a regular state of a stage, tilted by some degrees."""
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, 30)
    singular = spm.singularities(states)
    return states[int(np.argmax(np.minimum(singular.forward, singular.leg.min(axis=-1)) * (states.tilt > 0.1)))]


def shifted_along_axes(state: spm.Configuration, shifts: npt.ArrayLike) -> spm.Configuration:
    """Return the state with the same readings of a stage whose pivots are moved along their axes [m]."""
    legs = state.machine.legs
    pivots = legs.pivots + legs.axes * np.asarray(shifts)[:, None]
    moved = spm.machine.Legs(legs.axes, pivots, legs.balls, legs.offsets, legs.kinds)
    stage = spm.Stage(state.machine.base_radius, state.machine.platform_radius, moved)
    near = spm.inverse_physical(stage, state.height, normal=state.normal)
    return spm.forward_physical(stage, state.readings, near=near)


def displacements(state: spm.Configuration, structure: bool) -> np.ndarray:
    """Return the derivatives of the pose by readings, or by shifts of legs along their axes, (6, 3)."""

    def central(h: float) -> np.ndarray:
        columns = []
        for unit in np.eye(3):
            if structure:
                after, before = (shifted_along_axes(state, x * unit) for x in (h, -h))
            else:
                ends = (state.readings + x * unit for x in (h, -h))
                after, before = (spm.forward_physical(state.machine, x, near=state) for x in ends)
            turned = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
            columns.append(np.concatenate([after.translation - before.translation, turned]) / (2.0 * h))
        return np.stack(columns, axis=-1)

    return np.asarray(extrapolated(central, 1e-4))


@pytest.mark.parametrize("machine", MACHINES)
def test_the_compliance_adds_what_a_unit_force_does_to_each_spring(machine: str) -> None:
    """By virtual work a wrench w strains the spring of a reading by Gᵀ w / k, and so the structure's springs."""
    state = state_of(machine)
    along, across = displacements(state, False), displacements(state, True)
    rigid = (along / LEGS) @ along.T
    np.testing.assert_allclose(compliance(state, LEGS), rigid, rtol=1e-6, atol=1e-6 * np.abs(rigid).max())
    elastic = rigid + (across / STRUCTURE) @ across.T
    found = compliance(state, LEGS, STRUCTURE)
    np.testing.assert_allclose(found, elastic, rtol=1e-6, atol=1e-6 * np.abs(elastic).max())
    product = spm.stiffness(state, LEGS, STRUCTURE) @ elastic
    np.testing.assert_allclose(product, np.eye(6), atol=1e-4)


@pytest.mark.parametrize("machine", MACHINES)
def test_the_stiffness_in_tilt_and_height_is_the_second_derivative_of_the_springs_energy(machine: str) -> None:
    # Of a level platform the turns about x and y are those of its normal.
    stage, height = stage_and_height(machine)
    state = spm.inverse_physical(stage, height)

    def energy(motion: np.ndarray) -> float:
        normal = Rotation.from_rotvec([*motion[1:], 0.0]).apply([0.0, 0.0, 1.0])
        moved = spm.inverse_physical(state.machine, state.height + motion[0], normal=normal)
        return float(0.5 * (LEGS * (moved.readings - state.readings) ** 2).sum())

    scales = np.array([1.0, 1.0 / state.machine.platform_radius, 1.0 / state.machine.platform_radius])

    def hessian(h: float) -> np.ndarray:
        steps = np.diag(h * scales)
        entries = [[energy(a + b) - energy(a - b) - energy(b - a) + energy(-a - b) for b in steps] for a in steps]
        return np.asarray(entries) / (4.0 * h**2) / np.multiply.outer(scales, scales)

    found = spm.stiffness(state, LEGS)
    assert found.shape == (3, 3)
    scaled = found * np.multiply.outer(scales, scales)
    expected = np.asarray(extrapolated(hessian, 1e-3)) * np.multiply.outer(scales, scales)
    np.testing.assert_allclose(scaled, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(found @ compliance(state, LEGS)[MOTION, MOTION], np.eye(3), atol=1e-9)


def test_a_level_tripod_of_vertical_legs_has_the_stiffness_of_three_springs() -> None:
    radius, k = 0.2, 1e6
    level = spm.inverse_physical(spm.Stage(radius, radius), 0.5)
    expected = np.diag([3.0 * k, 1.5 * k * radius**2, 1.5 * k * radius**2])
    np.testing.assert_allclose(spm.stiffness(level, k), expected, atol=1e-6)
    principal = principal_stiffness(level, k)
    np.testing.assert_allclose(principal.translational, [3.0 * k, np.inf, np.inf])
    np.testing.assert_allclose(principal.rotational, [1.5 * k * radius**2, 1.5 * k * radius**2, np.inf])


def test_batches_have_the_stiffness_of_their_members_and_nan_where_none_exists() -> None:
    states = spm.inverse_physical(spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)), [0.1, 0.12, 0.9])
    for structure in (None, 1e7):
        found = spm.stiffness(states, LEGS, structure)
        np.testing.assert_allclose(found[1], spm.stiffness(states[1], LEGS, structure))
        assert np.isnan(found[2]).all()
    for argument, call in (("legs", spm.stiffness), ("twist", spm.leg_rates)):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
            call(states, np.ones(6))
