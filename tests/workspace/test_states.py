"""The coordinates of the stages: states that close, derivatives against differences, machines as drawn and as built."""

from __future__ import annotations

import numpy as np
import pytest
from problems import PAPER

import spm_pin as spm
from spm_pin.machine.branch_of_state import FAMILIES, family
from spm_pin.workspace.state_set import StateSet, free_states, states_within

BUILT = PAPER.perturbed(1, length=5e-3, angle=5e-3)


@pytest.mark.parametrize("machine", [PAPER, BUILT], ids=["as drawn", "as built"])
@pytest.mark.parametrize("modes", FAMILIES)
def test_all_coordinates_in_the_unit_circle_are_states_of_their_family(machine: spm.Manipulator, modes: str) -> None:
    rng = np.random.default_rng(2)
    coordinates = rng.uniform([-0.5, -0.5, 2.0], [0.5, 0.5, 3.0], (200, 2, 3))
    coordinates[:, 1, 2] *= -1.0
    within = free_states(machine, modes)
    states = within.states(coordinates)
    assert states.closure_residual.max() < 1e-14
    np.testing.assert_array_equal(family(states), FAMILIES.index(modes))
    np.testing.assert_allclose(within.coordinates(states), coordinates, atol=1e-12)
    np.testing.assert_allclose(within.readings(coordinates), states.readings, atol=1e-13)
    # Derivatives of the pose, of the modes too.
    h = 1e-6
    for k in range(6):
        step = (h * np.eye(6)[k]).reshape(2, 3)
        ahead, behind = within.states(coordinates + step), within.states(coordinates - step)
        turn = (ahead.pose.rotation * behind.pose.rotation.inv()).as_rotvec() / (2.0 * h)
        shift = (ahead.translation - behind.translation) / (2.0 * h)
        np.testing.assert_allclose(within.jacobians(coordinates)[:, :, k], np.hstack([shift, turn]), atol=1e-7)
    coordinates[:, 0, 0] = 1.0
    assert np.isnan(within.readings(coordinates)[:, :3]).all()


@pytest.mark.parametrize("machine", [PAPER, BUILT], ids=["as drawn", "as built"])
def test_the_aspect_is_that_of_physical_states_and_the_determinant_vanishes_at_its_end(
    machine: spm.Manipulator,
) -> None:
    rng = np.random.default_rng(3)
    coordinates = rng.uniform(-0.8, 0.8, (3000, 2, 3)) * [1.0, 1.0, 2.0] + [[0.0, 0.0, 1.5], [0.0, 0.0, -1.5]]
    coordinates = coordinates[(np.hypot(coordinates[..., 0], coordinates[..., 1]) < 0.99).all(axis=-1)]
    within = StateSet(machine, np.zeros(6), np.full(6, 9.0))
    stages = [within.stages(stage, coordinates[:, stage]) for stage in range(2)]
    inside = stages[0].in_aspect & stages[1].in_aspect
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(inside, within.states(coordinates).is_at_home)
    # Zero where det J_b or det J_c is: signs agree over all coordinates, up to that of the aspect.
    determinants = spm.singularities(within.states(coordinates)).determinants[:, :2]
    for stage in range(2):
        sign = np.sign(determinants[:, stage] * stages[stage].determinant)
        assert len(set(sign)) == 1


def test_uniform_states_of_a_stage_are_within_the_limits_and_their_volume_is_that_by_the_legs() -> None:
    limits, rng = spm.LegLimits(1.1, 1.5), np.random.default_rng(5)
    for machine in (PAPER, BUILT):
        within = states_within(machine, limits)
        for stage in range(2):
            drawn, volume = within.draw_stages(stage, 20_000, rng)
            assert within.contains(stage, drawn).all()
            # ∫ dc = ∫ |det ∂c/∂l| dl.
            coordinates = within.coordinates(spm.forward_physical(machine, rng.uniform(1.1, 1.5, (20_000, 6))))
            slopes = np.empty((len(coordinates), 3, 3))
            for k in range(3):
                step = 1e-6 * np.eye(3)[k]
                ahead, behind = (within.stages(stage, coordinates[:, stage] + s * step).readings for s in (1, -1))
                slopes[..., k] = (ahead - behind) / 2e-6
            density = 0.4**3 / np.abs(np.linalg.det(slopes))
            assert volume == pytest.approx(density.mean(), rel=4.0 * density.std() / density.mean() / 141 + 0.03)
