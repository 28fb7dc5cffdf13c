"""JAX: values, derivatives against J_f and against differences of many digits, and finite numbers everywhere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrays.array_problems import BUILT, LEVEL, NOWHERE, PAPER, random_readings

import spm_pin as spm
from spm_pin import arrays

pytestmark = pytest.mark.usefixtures("double_precision")


def twists(rotation: Any, rotation_rates: Any, position_rates: Any) -> Any:
    """Return (v, ω) from the derivatives (..., 3, 3, n) of a rotation and (..., 3, n) of a position."""
    spin = jnp.einsum("...ijn,...kj->...ikn", rotation_rates, rotation)
    omega = jnp.stack([spin[..., 2, 1, :], spin[..., 0, 2, :], spin[..., 1, 0, :]], -2)
    return jnp.concatenate([position_rates, omega], -2)


def test_rates_of_the_readings_are_undone_by_the_inverse_jacobian() -> None:
    readings = jnp.asarray(np.concatenate([random_readings(30)[:30], NOWHERE, LEVEL]))

    def state(x: Any) -> Any:
        found = arrays.forward_physical(PAPER, x)
        return tuple(found)[:4], found

    rates, found = jax.jit(jax.vmap(jax.jacfwd(state, has_aux=True)))(readings)
    kernel = spm.forward_physical(PAPER, np.asarray(readings))
    assert (found.exists == kernel.exists).all()
    assert isinstance(found.rotation, jax.Array)
    assert all(jnp.isfinite(x).all() for x in (*rates, *tuple(found)[:4]))
    # At a level state the legs' rates do not determine the twist's inverse, J_f.
    regular = np.flatnonzero(kernel.exists & (spm.singularities(kernel).sigma.min(axis=-1) > 1e-3))
    assert len(regular) > 15
    np.testing.assert_allclose(found.middle_joints[regular], kernel.middle_joints[regular], atol=1e-12)
    product = spm.inverse_jacobian(kernel[regular]) @ twists(found.rotation, rates[0], rates[1])[regular]
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-9)


@pytest.mark.slow
def test_derivatives_by_all_54_parameters_move_the_platform_as_the_error_jacobian_says() -> None:
    readings = jnp.asarray([1.25, 1.15, 1.40, 1.30, 1.20, 1.40])

    def place(parameters: Any) -> Any:
        return tuple(arrays.forward_physical(parameters, readings))[:2]

    state = spm.forward_physical(BUILT, np.asarray(readings))
    found = twists(state.rotation, *jax.jit(jax.jacrev(place))(jnp.asarray(BUILT.parameters)))
    expected = spm.calibration.error_jacobian(state)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_rates_of_the_readings_by_the_pose_are_the_inverse_jacobian() -> None:
    states = spm.forward_physical(BUILT, random_readings(40))
    states = states[states.exists]
    states = states[spm.singularities(states).sigma.min(axis=-1) > 1e-2]
    rotation, translation = jnp.asarray(states.rotation), jnp.asarray(states.translation)

    def readings(twist: Any, rotation: Any, translation: Any) -> Any:
        x, y, z = twist[3:]
        turn = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        turn = turn + jnp.stack([jnp.stack([0 * x, -z, y]), jnp.stack([z, 0 * x, -x]), jnp.stack([-y, x, 0 * x])])
        return arrays.inverse_physical(BUILT, turn @ rotation, translation + twist[:3]).readings

    found = jax.jit(jax.vmap(jax.jacrev(readings), (None, 0, 0)))(jnp.zeros(6), rotation, translation)
    expected = spm.inverse_jacobian(states)
    size = np.abs(expected).max(axis=(-1, -2), keepdims=True)
    assert (np.abs(found - expected) <= 1e-9 * size).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["inverse_physical", "inverse_displacement"])
def test_a_masked_cost_has_the_same_gradient_in_both_directions(name: str) -> None:
    # Level, symmetric, regular and out of reach.
    states = spm.forward_physical(PAPER, [[1.2, 1.4, 1.2, 1.3, 1.2, 1.3], [1.25, 1.15, 1.40, 1.30, 1.20, 1.40]])
    rotations = jnp.concatenate([jnp.eye(3)[None], states.rotation, states.rotation[1:]])
    places = jnp.concatenate([jnp.array([[0.0, 0.0, 2.2]]), states.translation, jnp.array([[3.0, 2.0, 9.0]])])

    def cost(dimensions: Any, rotations: Any, places: Any) -> Any:
        found = getattr(arrays, name)(dimensions, rotations, places)
        lengths = found.readings
        return jnp.where(found.exists, lengths.sum(axis=-1), 0.0).sum()

    arguments = jnp.asarray(PAPER.dimensions), rotations, places
    backward, forward = (way(cost, argnums=(0, 1, 2))(*arguments) for way in (jax.grad, jax.jacfwd))
    assert np.abs(forward[0]).min() > 0.0
    for found, expected in zip(backward, forward, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
