"""Leading axes: methods return for a batch what they return for its members, and errors name the member."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from multibody.chains import PAPER, Array, chain, placed

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError

pytest.importorskip("pinocchio")

SIGNATURES = {
    **dict.fromkeys(("configuration", "leg_lengths", "closure_gap", "constraint_jacobian"), "q"),
    **dict.fromkeys(("inverse_jacobian", "singular_values"), "q"),
    **dict.fromkeys(("joint_velocities", "joint_rates", "leg_forces", "cut_forces"), "qw"),
    **dict.fromkeys(("platform_dynamics", "energy"), "qv"),
    "joint_accelerations": "qvw",
    "forward_dynamics": "qvww",
    "inverse_dynamics": "qvaw",
}
"""Methods of a chain and of its state, which has q and v itself: their arguments, w of six numbers."""

OF_A_CHAIN: dict[str, Callable[[Any, Array, Array], Any]] = {
    "joint_values": lambda robot, q, w: robot.joint_values(robot.configuration(q)),
    "with_readings": lambda robot, q, w: robot.with_readings(q, 1.0 + 0.1 * w),
    "forward_kinematics": lambda robot, q, w: robot.forward_kinematics(1.3 + 0.1 * np.tanh(w)),
    "inverse_kinematics": lambda robot, q, w: robot.inverse_kinematics(
        spm.forward_physical(PAPER, 1.3 + 0.1 * np.tanh(w)).pose
    ),
    "closure_gap where it is open": lambda robot, q, w: robot.closure_gap(q + 0.01),
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
    given = {"q": q, "v": v, "w": w}
    if "a" in SIGNATURES[method]:
        given["a"] = robot.joint_accelerations(q, v, w)
    return arrays(getattr(robot, method)(*(given[name] for name in SIGNATURES[method])))


@pytest.mark.parametrize("method", [*OF_A_CHAIN, *SIGNATURES])
@pytest.mark.parametrize("shape", [(1,), (3, 1, 2), (0,)], ids=str)
def test_members(method: str, shape: tuple[int, ...]) -> None:
    robot, rng = chain(), np.random.default_rng(300)
    states = placed("paper", 3, seed=301)[: max(1, int(np.prod(shape)))]
    q = np.array([state[1] for state in states])[: int(np.prod(shape))].reshape(*shape, 18)
    w = rng.normal(size=(*shape, 6))
    v = robot.joint_velocities(q, 0.1 * w)
    together = results(method, robot, q, v, w)
    assert all(array.shape[: len(shape)] == shape for array in together)
    for index in np.ndindex(shape):
        alone = results(method, robot, q[index], v[index], w[index])
        assert all(np.array_equal(a[index], b) for a, b in zip(together, alone, strict=True))


@pytest.mark.parametrize("method", SIGNATURES)
def test_state_and_chain_return_the_same(method: str) -> None:
    robot, rng = chain(), np.random.default_rng(305)
    one = robot.state(np.zeros(18))
    states = [q for _, q in placed("paper", 2, seed=306)]
    for q in [*states, np.array(states[:4]).reshape(2, 2, 18)]:
        w = rng.normal(size=6)
        v = robot.joint_velocities(q, 0.1 * w)
        one.update(q, v)
        assert np.array_equal(one.q, q)
        assert np.array_equal(one.v, v)
        given = {"w": w, "a": one.joint_accelerations(w)}
        found = arrays(getattr(one, method)(*(given[name] for name in SIGNATURES[method].lstrip("qv"))))
        for a, b in zip(found, results(method, robot, q, v, w), strict=True):
            assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max() + 1e-15


def test_joint_values_that_change_in_place_are_computed_anew() -> None:
    robot, (_, q) = chain(), placed("paper", 1, seed=307)[0]
    once, before = robot.closure_gap(q), robot.constraint_jacobian(q)
    q = q.copy()
    assert np.array_equal(robot.constraint_jacobian(q), before)
    q[robot.leg_indices[0]] += 0.01
    assert np.abs(robot.closure_gap(q) - once).max() > 1e-3
    assert np.abs(robot.constraint_jacobian(q) - before).max() > 1e-4
    q[robot.leg_indices[0]] -= 0.01
    np.testing.assert_allclose(robot.constraint_jacobian(q), before, atol=1e-14)


def test_axes_broadcast() -> None:
    robot, rng = chain(), np.random.default_rng(302)
    q = np.array([state[1] for state in placed("paper", 2, seed=303)[:3]])
    wrenches = rng.normal(size=(2, 1, 6))
    forces = robot.leg_forces(q, wrenches)
    assert forces.shape == (2, 3, 6)
    assert np.array_equal(forces[1, 2], robot.leg_forces(q[2], wrenches[1, 0]))
    with pytest.raises(ArgumentError, match=r"^wrench: expected leading axes that broadcast .*, \(3,\), got \(2,\)"):
        robot.leg_forces(q, wrenches[:, 0])


def test_members_that_are_singular_or_open_are_nan_and_named() -> None:
    robot, home = chain(), np.zeros(18)
    q = placed("paper", 1, seed=304)[0][1]
    with pytest.raises(SingularConfigurationError):
        robot.inverse_jacobian(home)
    jacobians = robot.inverse_jacobian([[q, q], [q, home]])
    assert np.array_equal(np.isnan(jacobians).all(axis=(-1, -2)), [[False, False], [False, True]])
    assert np.array_equal(jacobians[1, 0], robot.inverse_jacobian(q))
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
        getattr(robot, method)(q + 1e-3, *arguments)
    state = robot.state([q, q + 1e-3])
    for closed, opened in arrays(getattr(state, method)(*arguments)):
        assert np.isfinite(closed).all()
        assert np.isnan(opened).all()
    assert {index: type(error) for index, error in state.failures.items()} == {(1,): ClosureError}


def test_wrong_arguments_name_the_member() -> None:
    robot, rest = chain(), np.zeros(18)
    q = placed("paper", 1, seed=304)[0][1]
    with pytest.raises(ArgumentError, match=r"^v: expected joint velocities .* at batch index \(2,\)"):
        robot.inverse_dynamics(q, [rest, rest, rest + 1.0], rest)
    with pytest.raises(ArgumentError, match=r"^v: expected leading axes that broadcast"):
        robot.state([q, q], [rest, rest, rest])


def test_threads_compute_at_the_same_time() -> None:
    robot, rest, forces = chain(), np.zeros(18), np.ones(6)
    states = [q for _, q in placed("paper", 2, seed=310)[:4]]
    expected = [robot.forward_dynamics(q, rest, forces) for q in states]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: robot.forward_dynamics(states[k % 4], rest, forces), range(200)))
    assert all(np.array_equal(a, expected[k % 4]) for k, a in enumerate(found))
