"""The inverse of a stage alone on arrays and in CasADi, with derivatives, against the kernels."""

from __future__ import annotations

import array_api_strict as strict
import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from balancers import MACHINES, requests, stage_and_height

import spm_pin as spm
from spm_pin import arrays


@pytest.mark.parametrize("machine", MACHINES)
def test_states_are_those_of_the_kernel(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 300)
    expected = spm.stages.inverse(stage, heights, normal=normals)["T"]
    found = arrays.stage_inverse(stage, normals, heights)
    np.testing.assert_array_equal(found.exists, expected.exists)
    for name in ("rotation", "translation", "readings"):
        real = getattr(expected, name)[expected.exists]
        np.testing.assert_allclose(getattr(found, name)[expected.exists], real, rtol=0, atol=1e-13)
        assert np.isfinite(getattr(found, name)).all()
    function = spm.symbolic.stage_inverse(stage).map(len(heights))
    readings, rotation, position, exists = function(normals.T, heights)
    np.testing.assert_array_equal(np.array(exists)[0] == 1.0, expected.exists)
    own = expected.exists
    np.testing.assert_allclose(np.array(readings).T[own], expected.readings[own], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.array(position).T[own], expected.translation[own], rtol=0, atol=1e-12)
    turned = np.array(rotation).reshape(3, -1, 3).swapaxes(0, 1)
    np.testing.assert_allclose(turned[own], expected.rotation[own], rtol=0, atol=1e-12)


def test_a_strict_library_and_a_platform_turned_over() -> None:
    stage, height = stage_and_height("RRS")
    found = arrays.stage_inverse(stage, strict.asarray([0.0, 0.0, 1.0]), strict.asarray(height))
    assert bool(found.exists)
    expected = spm.stages.inverse_physical(stage, height).readings
    np.testing.assert_allclose(np.asarray(found.readings), expected, atol=1e-15)
    assert not arrays.stage_inverse(stage, np.array([[0.0, 0.0, -1.0]]), np.array([height])).exists.any()


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize("machine", ["RPS", "PRS as built", "RRS", "RRS as built"])
def test_derivatives_are_the_rates_of_the_legs(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 8, seed=3)
    states = spm.stages.inverse_physical(stage, heights, normal=normals)

    def readings(normal: jax.Array, z: jax.Array) -> jax.Array:
        return arrays.stage_inverse(stage, normal, z).readings

    by_normal, by_height = jax.vmap(jax.jacfwd(readings, (0, 1)))(jnp.asarray(normals), jnp.asarray(heights))
    # ω_x and ω_y, with the parasitic ω_z that goes with them, move the normal by ω x n.
    parasitic = spm.stages.parasitic_jacobian(states)
    turns = np.swapaxes(np.cross(parasitic[:, 3:].swapaxes(1, 2), normals[:, None]), 1, 2)
    expected = spm.stages.inverse_jacobian(states)
    found = np.asarray(by_normal) @ turns + np.asarray(by_height)[..., None] * parasitic[:, 2:3]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    function = spm.symbolic.stage_inverse(stage)
    normal, z = ca.SX.sym("n", 3), ca.SX.sym("z")
    jacobian = ca.Function("j", [normal, z], [ca.jacobian(function(normal, z)[0], ca.vertcat(normal, z))])
    exact = np.concatenate([np.asarray(by_normal)[0], np.asarray(by_height)[0][:, None]], axis=1)
    np.testing.assert_allclose(np.array(jacobian(normals[0], heights[0])), exact, rtol=1e-9, atol=1e-9)
