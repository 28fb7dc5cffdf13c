"""The displacements of a stage alone on arrays and in CasADi, with derivatives, against the kernels."""

from __future__ import annotations

from functools import partial

import array_api_strict as strict
import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from balancers import MACHINES, existing_states, requests, stage_and_height
from error_fields import with_fields

import spm_pin as spm
from spm_pin import arrays


@pytest.mark.parametrize("machine", MACHINES)
def test_states_are_those_of_the_kernel(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 300)
    expected = spm.inverse_displacement(stage, heights, normal=normals)["T"]
    found = arrays.stage_inverse(stage, normals, heights)
    np.testing.assert_array_equal(found.exists, expected.exists)
    for name in ("rotation", "translation", "readings"):
        real = getattr(expected, name)[expected.exists]
        np.testing.assert_allclose(getattr(found, name)[expected.exists], real, rtol=0, atol=1e-13)
        assert np.isfinite(getattr(found, name)).all()
    np.testing.assert_array_equal(found[7].readings, found.readings[7])
    np.testing.assert_array_equal(found[:5].rotation, found.rotation[:5])
    function = spm.casadi.stage_inverse(stage).map(len(heights))
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
    expected = spm.inverse_physical(stage, height).readings
    np.testing.assert_allclose(np.asarray(found.readings), expected, atol=1e-15)
    none = arrays.stage_inverse(stage, np.array([0.0, 0.0, 1.0]), np.array(np.nan))
    assert not none.exists.any()
    assert all(np.isfinite(numbers).all() for numbers in none)


def test_normals_of_any_length_have_the_state_of_the_unit_normal() -> None:
    stage, height = stage_and_height("RRS as built")
    normals, heights = requests(height, 50)
    expected = spm.inverse_physical(stage, heights, normal=normals)
    own = expected.exists
    function = spm.casadi.stage_inverse(stage).map(len(heights))
    for length in (1e-300, 0.9, 1e300):
        asked = length * normals
        for readings in (
            spm.inverse_physical(stage, heights, normal=asked).readings,
            arrays.stage_inverse(stage, asked, heights).readings,
            np.array(function(asked.T, heights)[0]).T,
        ):
            np.testing.assert_allclose(readings[own], expected.readings[own], rtol=0, atol=1e-12)
    for length in (1e-30, 1e30):
        found = arrays.stage_inverse(stage, np.float32(length) * normals.astype(np.float32), heights.astype(np.float32))
        np.testing.assert_allclose(found.rotation[own], expected.rotation[own], rtol=0, atol=1e-5)


def test_normals_that_are_none_have_no_state() -> None:
    stage, height = stage_and_height("RRS")
    none = [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1e-9, 0.0, -3.0], [np.nan, 0.0, 1.0], [0.0, np.inf, 1.0]]
    function = spm.casadi.stage_inverse(stage)
    jacobian = function.jacobian()
    for dtype in (np.float64, np.float32):
        found = arrays.stage_inverse(stage, np.array(none, dtype), np.full(len(none), height, dtype))
        assert not found.exists.any()
        assert all(np.isfinite(numbers).all() for numbers in found)
    for normal in none:
        outputs = function(normal, height)
        assert outputs[3] == 0.0
        derivatives = jacobian(normal, height, *outputs)
        assert all(np.isfinite(np.array(x)).all() for x in (*outputs, *derivatives))
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="normal")):
        spm.inverse_displacement(stage, height, normal=[[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert not spm.inverse_displacement(stage, height, normal=[0.0, 0.0, -1.0]).configurations.exists.any()


@pytest.mark.parametrize("machine", ["RPS", "RPS as built"])
def test_platforms_turned_over_are_right_or_do_not_exist(machine: str) -> None:
    """Rotations are such, with the normal asked for and balls in the planes of their legs."""
    stage, height = stage_and_height(machine)
    rng = np.random.default_rng(0)
    beside, azimuth = 10.0 ** rng.uniform(-9.0, -0.5, 2_000), rng.uniform(-np.pi, np.pi, 2_000)
    normals = np.stack([np.sin(beside) * np.cos(azimuth), np.sin(beside) * np.sin(azimuth), -np.cos(beside)], axis=-1)
    legs = stage.legs
    for dtype, least, tolerance in ((np.float64, 1.5e-3, 1e-9), (np.float32, 0.16, 1e-3)):
        asked = normals.astype(dtype)
        found = arrays.stage_inverse(stage, asked, np.full(len(asked), height, dtype))
        assert not found.exists[beside < 0.9 * least].any()
        assert found.exists[beside > least].mean() > 0.5
        own = found.exists
        rotation, translation = found.rotation[own].astype(float), found.translation[own].astype(float)
        eps = 20.0 * np.finfo(dtype).eps
        assert np.abs(rotation @ rotation.swapaxes(1, 2) - np.eye(3)).max() < eps
        assert np.abs(rotation[..., 2] - asked[own]).max() < eps
        balls = np.einsum("nij,kj->nki", rotation, legs.balls) + translation[:, None]
        offsets = np.einsum("ki,nki->nk", legs.axes, balls - legs.pivots)
        assert np.abs(offsets).max() < tolerance * stage.size
        # The mode is that of the exact pose, which double precision has.
        exact = arrays.stage_inverse(stage, asked[own].astype(float), np.full(own.sum(), float(dtype(height))))
        assert np.abs(rotation - exact.rotation).max() < tolerance


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize("machine", ["PRS as built", "RRS"])
def test_derivatives_are_the_rates_of_the_legs(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 8, seed=3)
    states = spm.inverse_physical(stage, heights, normal=normals)

    def readings(normal: jax.Array, z: jax.Array) -> jax.Array:
        return arrays.stage_inverse(stage, normal, z).readings

    by_normal, by_height = jax.vmap(jax.jacfwd(readings, (0, 1)))(jnp.asarray(normals), jnp.asarray(heights))
    # ω_x and ω_y, with the parasitic ω_z that goes with them, move the normal by ω x n.
    parasitic = spm.kinematics.parasitic_jacobian(states)
    turns = np.swapaxes(np.cross(parasitic[:, 3:].swapaxes(1, 2), normals[:, None]), 1, 2)
    expected = spm.inverse_jacobian(states)
    found = np.asarray(by_normal) @ turns + np.asarray(by_height)[..., None] * parasitic[:, 2:3]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    function = spm.casadi.stage_inverse(stage)
    normal, z = ca.SX.sym("n", 3), ca.SX.sym("z")
    jacobian = ca.Function("j", [normal, z], [ca.jacobian(function(normal, z)[0], ca.vertcat(normal, z))])
    exact = np.concatenate([np.asarray(by_normal)[0], np.asarray(by_height)[0][:, None]], axis=1)
    np.testing.assert_allclose(np.array(jacobian(normals[0], heights[0])), exact, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("machine", MACHINES)
def test_readings_lead_to_the_states_of_the_kernel(machine: str) -> None:
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, 300)
    shown = states.readings.copy()
    before = spm.inverse_physical(stage, states.height, normal=[0.0, 0.0, 1.0])
    middle = spm.forward_physical(stage, 0.9 * shown + 0.1 * before.readings)
    near = arrays.State(middle.rotation, middle.translation, middle.balls, middle.readings, middle.exists)
    assert near.exists.mean() > 0.99
    for start, begins in ((None, True), (near, near.exists)):
        found = arrays.forward_physical(stage, shown, near=start)
        exists = found.exists
        assert (exists == begins).all()
        np.testing.assert_allclose(found.rotation[exists], states.rotation[exists], rtol=0, atol=1e-11)
        np.testing.assert_allclose(found.translation[exists], states.translation[exists], rtol=0, atol=1e-11)
    # Readings of which many have no state.
    size = 1.0 if stage.unit == "rad" else stage.size
    shown = np.abs(shown + 0.2 * size * np.random.default_rng(2).standard_normal(shown.shape))
    shown[:2] = [[np.nan, 1.0, 1.0], [1e12, 1.0, 1.0]]
    found = arrays.forward_physical(stage, shown)
    assert not found.exists[:2].any()
    expected = spm.forward_physical(stage, shown[2:])
    assert 0 < expected.exists.sum() < len(shown)
    np.testing.assert_array_equal(found.exists[2:], expected.exists)
    real = found.exists
    np.testing.assert_allclose(found.rotation[real], expected.rotation[real[2:]], rtol=0, atol=1e-10)
    for array in found[:2]:
        assert np.isfinite(array).all()


@pytest.mark.parametrize("machine", MACHINES)
def test_readings_lead_to_the_states_of_the_kernel_in_casadi(machine: str) -> None:
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, 8, seed=3)
    forward, near = (spm.casadi.forward_physical(stage, near=near) for near in (False, True))
    jacobian = forward.jacobian()
    for state in states:
        beside = near(state.readings, state.rotation, np.add(state.translation, [0.0, 0.0, 0.01 * height]))
        for rotation, position, _, residual, exists in (forward(state.readings), beside):
            assert exists == 1.0
            assert residual < 1e-14
            np.testing.assert_allclose(rotation, state.rotation, rtol=0, atol=1e-12)
            np.testing.assert_allclose(np.array(position)[:, 0], state.translation, rtol=0, atol=1e-12)
        derivatives = jacobian(state.readings, *forward(state.readings))
        expected = spm.kinematics.platform_jacobian(state)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(derivatives[1], expected[:3], rtol=0, atol=1e-9 * scale)
        turns = np.array(derivatives[0]).reshape(3, 3, 3).swapaxes(0, 1)
        spins = np.einsum("ijk,lj->ilk", turns, state.rotation)
        found = np.stack([spins[2, 1], spins[0, 2], spins[1, 0]])
        np.testing.assert_allclose(found, expected[3:], rtol=0, atol=1e-9 * scale)
    without = states[0].readings + 2.0 * (1.0 if stage.unit == "rad" else stage.size)
    assert forward(without)[4] == spm.forward_physical(stage, without).exists


@pytest.mark.parametrize("turns", [-2, 2])
def test_cranks_turned_by_more_than_a_turn_are_taken_for_degrees(turns: int) -> None:
    """The same places of the cranks, which was the answer."""
    stage, height = stage_and_height("RRS")
    shown = spm.inverse_physical(stage, height, roll=0.1).readings
    wound = shown + 2.0 * np.pi * turns
    for once in (shown - 2.0 * np.pi, shown):
        assert spm.forward_physical(stage, once).exists
        assert arrays.forward_physical(stage, once).exists
        assert spm.casadi.forward_physical(stage)(once)[4] == 1.0
    assert not arrays.forward_physical(stage, wound).exists
    assert spm.casadi.forward_physical(stage)(wound)[4] == 0.0
    for solve in (spm.forward_displacement, spm.forward_physical):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="readings")):
            solve(stage, wound)


def test_states_and_machines_of_another_kind_are_refused() -> None:
    stage, height = stage_and_height("RRS")
    machine, lengths, load = spm.Manipulator.paper(), np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.45]), np.ones(6)
    level, state = spm.inverse_physical(stage, height), spm.forward_physical(machine, lengths)
    ours, theirs = arrays.forward_physical(stage, level.readings), arrays.forward_physical(machine, lengths)
    for argument, calls in {
        "state": [partial(arrays.leg_forces, machine, x, load) for x in (ours, level)]
        + [partial(f, machine, ours) for f in (arrays.inverse_jacobian, arrays.joint_values)],
        "near": [partial(arrays.forward_physical, machine, lengths, near=x) for x in (ours, level)]
        + [partial(arrays.forward_physical, stage, level.readings, near=x) for x in (theirs, state)]
        + [partial(arrays.inverse_physical, machine, theirs.rotation, theirs.translation, near=ours)],
        "machine": [
            partial(arrays.leg_forces, stage, theirs, load),
            partial(arrays.inverse_physical, stage, theirs.rotation, theirs.translation),
            partial(arrays.forward_physical, (stage, stage.parameters), level.readings),
            partial(spm.casadi.inverse_physical, stage),
            partial(spm.casadi.leg_forces, stage),
            partial(spm.casadi.gravity, stage),
        ],
    }.items():
        for call in calls:
            with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
                call()


@pytest.mark.usefixtures("double_precision")
@pytest.mark.parametrize("machine", ["RRS as built"])
def test_derivatives_by_readings_are_the_motion_of_the_platform(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 8, seed=3)
    states = spm.inverse_physical(stage, heights, normal=normals)

    def pose(readings: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(arrays.forward_physical(stage, readings))[:2]

    turns, velocities = map(np.asarray, jax.jit(jax.vmap(jax.jacfwd(pose)))(jnp.asarray(states.readings)))
    spins = np.einsum("nijk,nlj->nilk", turns, states.rotation)
    found = np.stack([*np.moveaxis(velocities, 1, 0), spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]], axis=1)
    expected = spm.kinematics.platform_jacobian(states)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
