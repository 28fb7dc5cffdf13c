"""Leading axes: methods return for a batch what they return for its members, and errors name the member."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields
from multibody.chains import PAPER, Array, chain, placed, plain_accelerations

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError

pytest.importorskip("pinocchio")

SIGNATURES = {
    **dict.fromkeys(("configuration", "closure_gap", "constraint_jacobian", "inverse_jacobian", "singular_values"), ""),
    **dict.fromkeys(("joint_velocities", "joint_rates", "leg_forces", "cut_forces", "joint_accelerations"), "w"),
    **dict.fromkeys(("platform_dynamics", "energy"), ""),
    "forward_dynamics": "ww",
    "inverse_dynamics": "aw",
}
"""Methods of a state, and their arguments: w of six numbers, a of eighteen."""

OF_A_CHAIN: dict[str, Callable[[Any, Array, Array], Any]] = {
    "leg_lengths": lambda robot, q, w: robot.leg_lengths(q),
    "joint_values": lambda robot, q, w: robot.joint_values(robot.state(q).configuration()),
    "with_readings": lambda robot, q, w: robot.with_readings(q, 1.0 + 0.1 * w),
    "forward_kinematics": lambda robot, q, w: robot.forward_kinematics(1.3 + 0.1 * np.tanh(w)),
    "inverse_kinematics": lambda robot, q, w: robot.inverse_kinematics(
        spm.forward_physical(PAPER, 1.3 + 0.1 * np.tanh(w)).pose
    ),
    "closure_gap where it is open": lambda robot, q, w: robot.state(q + 0.01).closure_gap(),
    "project": lambda robot, q, w: robot.project(q + 1e-3),
}


def arrays(result: Any) -> list[Array]:
    """The numbers of a result: an array, several in a tuple, or a configuration."""
    if isinstance(result, spm.Configuration):
        return [result.translation, result.rotation, result.middle_joints]
    return list(result) if isinstance(result, tuple) else [result]


def results(method: str, robot: Any, q: Array, v: Array, w: Array) -> list[Array]:
    if method in OF_A_CHAIN:
        return arrays(OF_A_CHAIN[method](robot, q, w))
    return results_of_state(method, robot.state(q, v), w)


def results_of_state(method: str, state: Any, w: Array) -> list[Array]:
    given = {"w": w}
    if "a" in SIGNATURES[method]:
        given["a"] = state.joint_accelerations(w)
    return arrays(getattr(state, method)(*(given[name] for name in SIGNATURES[method])))


@pytest.mark.parametrize("method", [*OF_A_CHAIN, *SIGNATURES])
@pytest.mark.parametrize("shape", [(3, 1, 2), (0,)], ids=str)
def test_members(method: str, shape: tuple[int, ...]) -> None:
    robot, rng = chain(), np.random.default_rng(300)
    states = placed("paper", 3, seed=301)[: max(1, int(np.prod(shape)))]
    q = np.array([state[1] for state in states])[: int(np.prod(shape))].reshape(*shape, 18)
    w = rng.normal(size=(*shape, 6))
    v = robot.state(q).joint_velocities(0.1 * w)
    together = results(method, robot, q, v, w)
    assert all(array.shape[: len(shape)] == shape for array in together)
    for index in np.ndindex(shape):
        alone = results(method, robot, q[index], v[index], w[index])
        assert all(np.array_equal(a[index], b) for a, b in zip(together, alone, strict=True))


@pytest.mark.parametrize("method", SIGNATURES)
def test_a_state_that_was_updated_returns_the_same_as_a_new_one(method: str) -> None:
    robot, rng = chain(), np.random.default_rng(305)
    one = robot.state(np.zeros(18))
    states = [q for _, q in placed("paper", 2, seed=306)]
    for q in [*states, np.array(states[:4]).reshape(2, 2, 18)]:
        w = rng.normal(size=6)
        v = robot.state(q).joint_velocities(0.1 * w)
        one.update(q, v)
        assert np.array_equal(one.q, q)
        assert np.array_equal(one.v, v)
        for a, b in zip(results_of_state(method, one, w), results(method, robot, q, v, w), strict=True):
            assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max() + 1e-15


def test_axes_broadcast() -> None:
    robot, rng = chain(), np.random.default_rng(302)
    q = np.array([state[1] for state in placed("paper", 2, seed=303)[:3]])
    wrenches = rng.normal(size=(2, 1, 6))
    forces = robot.state(q).leg_forces(wrenches)
    assert forces.shape == (2, 3, 6)
    assert np.array_equal(forces[1, 2], robot.state(q[2]).leg_forces(wrenches[1, 0]))
    with pytest.raises(ArgumentError, check=with_fields(argument="wrench")):
        robot.state(q).leg_forces(wrenches[:, 0])


def test_members_that_are_singular_or_open_are_nan_and_named() -> None:
    robot, home = chain(), np.zeros(18)
    q = placed("paper", 1, seed=304)[0][1]
    with pytest.raises(SingularConfigurationError):
        robot.state(home).inverse_jacobian()
    jacobians = robot.state([[q, q], [q, home]]).inverse_jacobian()
    assert np.array_equal(np.isnan(jacobians).all(axis=(-1, -2)), [[False, False], [False, True]])
    assert np.array_equal(jacobians[1, 0], robot.state(q).inverse_jacobian())
    state = robot.state([q, home, q + 0.1])
    dynamics = state.platform_dynamics()
    for array in dynamics:
        assert np.isfinite(array[0]).all()
        assert np.isnan(array[1:]).all()
    assert {index: type(error) for index, error in state.failures.items()} == {
        (1,): SingularConfigurationError,
        (2,): ClosureError,
    }
    assert "inverse singularity" in str(state.failures[1,])
    # Forces exist at an inverse singularity; the next call has failures of its own.
    assert np.isfinite(state.leg_forces(np.ones(6))[1]).all()
    assert list(state.failures) == [(2,)]
    assert np.isfinite(state.closure_gap()).all()
    assert state.failures == {}
    # Where a ball joint's middle angle is 90°, the tree loses a rotation; the other members are computed.
    turned = q.copy()
    turned[robot.joint_indices("ball_b1_y")] = np.pi / 2
    jacobians = (state := robot.state([q, turned])).inverse_jacobian()
    assert np.array_equal(np.isnan(jacobians).any(axis=(-1, -2)), [False, True])
    assert "away from ±90°" in str(state.failures[1,])
    far = robot.forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, 1.45]) + 1.5
    projected = robot.project([q + 1e-3, far])
    assert np.array_equal(np.isnan(projected).any(axis=-1), [False, True])


@pytest.mark.parametrize(
    "method",
    ["inverse_jacobian", "joint_velocities", "joint_rates", "leg_forces", "cut_forces", "singular_values"],
)
def test_rates_and_forces_of_open_loops_do_not_exist(method: str) -> None:
    robot, q = chain(), placed("paper", 1, seed=307)[0][1]
    arguments = [np.ones(6)] if "w" in SIGNATURES[method] else []
    with pytest.raises(ClosureError):
        getattr(robot.state(q + 1e-3), method)(*arguments)
    state = robot.state([q, q + 1e-3])
    for closed, opened in arrays(getattr(state, method)(*arguments)):
        assert np.isfinite(closed).all()
        assert np.isnan(opened).all()
    assert {index: type(error) for index, error in state.failures.items()} == {(1,): ClosureError}


def test_compiled_dynamics_of_a_batch_are_those_of_plain_equations() -> None:
    robot, rng = chain(), np.random.default_rng(308)
    robot.loops.compile_dynamics()
    q = np.array([state[1] for state in placed("paper", 2, seed=309)])
    v, forces = robot.state(q).joint_rates(0.1 * rng.normal(size=(len(q), 6))), rng.normal(size=(len(q), 6))
    a = robot.state(q, v).forward_dynamics(forces)
    push = np.zeros((len(q), 18))
    push[:, robot.leg_indices] = forces
    for k in range(len(q)):
        plain = plain_accelerations(robot.model, robot.closures, q[k], v[k], push[k])
        np.testing.assert_allclose(a[k], plain, rtol=0, atol=1e-8 * np.abs(plain).max())
    q[1, robot.joint_indices("ball_c1_y")] = -np.pi / 2
    state = robot.state(q, v)
    assert np.array_equal(np.isnan(state.forward_dynamics(forces)).all(axis=-1), np.arange(len(q)) == 1)
    assert {index: type(error) for index, error in state.failures.items()} == {(1,): ArgumentError}
