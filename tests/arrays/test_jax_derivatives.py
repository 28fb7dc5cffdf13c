"""JAX: values, derivatives against J_f and against differences of many digits, and finite numbers everywhere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from arrays.array_problems import BUILT, LEVEL, NOWHERE, PAPER, random_poses, random_readings
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin import arrays
from spm_pin.formulas import ball_motions, circles, joint_values, leg_constants, vectors
from spm_pin.formulas.operations import bind

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
def test_derivatives_by_all_54_parameters_and_the_readings_are_differences_of_forty_digits() -> None:
    readings = np.array([1.25, 1.15, 1.40, 1.30, 1.20, 1.40])

    def place(parameters: Any, readings: Any) -> Any:
        state = arrays.forward_physical(parameters, readings)
        return jnp.concatenate([state.rotation.ravel(), state.translation, state.middle_joints.ravel()])

    arguments = jnp.asarray(BUILT.parameters), jnp.asarray(readings)
    found = np.concatenate(jax.jit(jax.jacrev(place, argnums=(0, 1)))(*arguments), axis=-1)
    start = spm.forward_physical(BUILT, readings)
    with mpmath.workdps(40):
        numbers, step = [mpmath.mpf(x) for x in (*BUILT.parameters.tolist(), *readings.tolist())], mpmath.mpf(10) ** -12
        for k in range(60):
            changed = [[x + (sign * step if i == k else 0) for i, x in enumerate(numbers)] for sign in (1, -1)]
            (above, below) = (exact_place(x, start) for x in changed)
            expected = [float((a - b) / (2 * step)) for a, b in zip(above, below, strict=True)]
            np.testing.assert_allclose(found[:, k], expected, rtol=0, atol=1e-9 * max(1.0, np.abs(expected).max()))


def exact_place(numbers: list[Any], start: spm.Configuration) -> list[Any]:
    """Return R, o and the b_i of a machine's 54 parameters and six readings, by Newton's method in mpmath."""

    def run(formula: Any, *arguments: Any) -> Any:
        return bind(formula, sqrt=mpmath.sqrt, cos=mpmath.cos, sin=mpmath.sin)(*arguments)

    legs = [numbers[9 * i : 9 * i + 9] for i in range(6)]
    axes = [run(leg_constants.turned_axis, leg_constants.AXES[i % 3], *leg[:2]) for i, leg in enumerate(legs)]
    lengths = [reading - leg[8] for reading, leg in zip(numbers[54:], legs, strict=True)]
    turn, o = start.rotation, start.translation
    starts = start.balls[:3], (start.balls[3:] - o) @ turn
    places = []
    for k, b in zip((0, 3), starts, strict=True):
        b = tuple(tuple(mpmath.mpf(x) for x in row) for row in b.tolist())
        own = tuple(tuple(leg[5:8]) for leg in legs[k : k + 3])
        pivots = tuple(tuple(leg[2:5]) for leg in legs[k : k + 3])
        squares = run(circles.squared_sides, own)
        stage = circles.Circles(tuple(axes[k : k + 3]), pivots, tuple(lengths[k : k + 3]), squares)
        e = run(circles.directions_to, stage, b)
        for _ in range(5):
            e = run(circles.turned_back, stage, e, run(circles.newton_step, stage, e))
        b = run(circles.balls_at, stage, e)
        triangles = run(joint_values.triangle_axes, b), run(joint_values.triangle_axes, own)
        places.append((b, run(ball_motions.frame_of_triangle, *triangles, b, own)))
    (b, (first, p)), (_, (second, p_m)) = places
    rotation = run(vectors.matrix_product, first, run(vectors.transposed, second))
    position = run(vectors.minus, p, run(vectors.times, rotation, p_m))
    return [x for row in (*rotation, position, *b) for x in row]


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
def test_all_branches_have_finite_derivatives_in_every_pose() -> None:
    poses = random_poses(200)
    rotations, places = poses.rotation.as_matrix(), poses.translation
    special = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0.3], [np.pi, 0, 0], [0.1, 0, 0], [1.5, 1.0, 0.2]]).as_matrix()
    rotations = jnp.asarray(np.concatenate([rotations, special]))
    places = jnp.asarray(np.concatenate([places, [[0, 0, 2.2]] * 4, [[3.0, 2.0, 9.0]]]))
    found = jax.jit(lambda r, o: arrays.inverse_displacement(PAPER, r, o))(rotations, places)
    kernel = arrays.inverse_displacement(PAPER, np.asarray(rotations), np.asarray(places))
    assert (found.exists == kernel.exists).all()
    real = kernel.exists
    np.testing.assert_allclose(found.middle_joints[real], kernel.middle_joints[real], atol=1e-9)
    along = jnp.ones_like(rotations), jnp.ones_like(places)
    _, rates = jax.jit(lambda x, v: jax.jvp(lambda r, o: arrays.inverse_displacement(PAPER, r, o)[:2], x, v))(
        (rotations, places), along
    )
    assert all(jnp.isfinite(x).all() for x in rates)


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


@pytest.mark.slow
def test_second_derivatives_are_differences_of_the_first() -> None:
    def height(readings: Any) -> Any:
        return arrays.forward_physical(PAPER, readings).translation[2]

    at = jnp.asarray([1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
    slope, step = jax.jit(jax.grad(height)), 1e-5
    differences = [(slope(at.at[k].add(step)) - slope(at.at[k].add(-step))) / (2 * step) for k in range(6)]
    np.testing.assert_allclose(jax.jit(jax.hessian(height))(at), np.stack(differences), rtol=0, atol=1e-7)
