"""Derivatives of the platform's pose with respect to the dimensions."""

from __future__ import annotations

import numpy as np
import pytest
from calibration.measured import PAPER
from problems import GEOMETRIES
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.calibration import error_jacobian


def machine(geometry: spm.Geometry, size: float) -> spm.Geometry:
    return geometry.perturbed(3, length=size * geometry.middle_side, angle=10 * size)


@pytest.mark.parametrize("size", [0.0, 5e-3])
@pytest.mark.parametrize("name", GEOMETRIES)
def test_it_is_the_derivative_of_the_pose_at_constant_readings(name: str, size: float) -> None:
    geometry = GEOMETRIES[name]
    built, side = machine(geometry, size), geometry.middle_side
    legs = (1.6 + np.random.default_rng(0).uniform(-0.15, 0.15, (30, 6))) * max(
        side, 1.2 * abs(geometry.base_radius - geometry.middle_radius)
    )
    state = spm.forward_physical(built, legs)
    state = state[state.exists]
    assert len(state) > 5
    jacobian = error_jacobian(state)
    for k in range(54):
        step = np.zeros(54)
        step[k] = 1e-6 * (1.0 if k % 9 < 2 else side)
        ahead, behind = (
            spm.forward_physical(built.from_parameters(built.parameters + s * step), state.readings) for s in (1, -1)
        )
        turn = Rotation.from_matrix(ahead.rotation @ np.swapaxes(behind.rotation, -1, -2)).as_rotvec()
        moved = np.concatenate([(ahead.translation - behind.translation), turn * side], axis=-1) / (2.0 * step[k])
        expected = jacobian[..., k] * np.repeat([1.0, side], 3)
        np.testing.assert_allclose(moved, expected, atol=2e-7 * max(np.abs(expected).max(), 1.0))


def test_forty_eight_combinations_move_the_platform_and_forty_five_its_position() -> None:
    state = spm.forward_physical(machine(PAPER, 2e-3), np.random.default_rng(2).uniform(1.15, 1.45, (60, 6)))
    rows = error_jacobian(state)
    for components, count in ((6, 48), (3, 45)):
        values = np.linalg.svd(rows[:, :components].reshape(-1, 54), compute_uv=False)
        assert values[count - 1] > 1e-6 * values[0]
        assert values[count] < 1e-13 * values[0]
