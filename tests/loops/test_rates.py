"""Rates of closed chains: derivatives of what `gap`, `close` and `forward` return, and the maps' own consistency."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from loops.mechanisms import MAKERS, Array, mechanism, states

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.loops.closed_chain import ClosedChain
from tests.loops.robots import at, closure, pose_of

DRIVEN = [name for name in MAKERS if name not in ("Delta", "parallelogram")]


def differences(chain: ClosedChain, q: Array, function: Any, directions: Array, step: float = 1e-5) -> Array:
    """Derivatives of a function of q along velocities, the rows of `directions`, as columns."""
    columns = []
    for v in directions:
        near, far = (
            function(pin.integrate(chain.model, q, s * v)) - function(pin.integrate(chain.model, q, -s * v))
            for s in (step, 2.0 * step)
        )
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.array(columns).T


@pytest.mark.parametrize("name", MAKERS)
def test_the_constraint_jacobian_is_the_derivative_of_the_gap(name: str) -> None:
    """Far from closed, where approximations for closed loops show."""
    chain, rng = mechanism(name), np.random.default_rng(10)
    q = pin.integrate(chain.model, chain.close(), 0.3 * rng.normal(size=chain.model.nv))
    expected = differences(chain, q, lambda q: chain.state(q).gap(), np.eye(chain.model.nv))
    assert np.abs(chain.state(q).constraint_jacobian() - expected).max() <= 1e-9


def test_joint_values_and_velocities_of_a_state_are_copies() -> None:
    chain = mechanism(DRIVEN[0])
    state = chain.state(chain.close(), np.ones(chain.model.nv))
    for array in (state.q, state.v):
        array[:] = np.nan
    assert np.isfinite(state.q).all()
    np.testing.assert_array_equal(state.v, 1.0)


@pytest.mark.parametrize("name", DRIVEN)
def test_joint_rates_are_differences_of_closed_configurations(name: str) -> None:
    chain, rng = mechanism(name), np.random.default_rng(11)
    step = 1e-5
    for q, _ in states(name, 3):
        rates = rng.normal(size=len(chain.actuated))
        v = chain.state(q).joint_rates(rates)
        assert v[chain.actuated_in_v] == pytest.approx(rates)
        assert v == pytest.approx(chain.state(q).joint_jacobian() @ rates)
        values = q[chain.actuated_in_q]
        ends = [chain.forward(values + s * step * rates, near=q) for s in (-1, 1)]
        assert np.abs(v - pin.difference(chain.model, *ends) / (2.0 * step)).max() <= 1e-7 * np.abs(v).max()


@pytest.mark.parametrize("name", MAKERS)
def test_the_twist_of_a_frame_is_that_of_its_motion(name: str) -> None:
    chain = mechanism(name)
    frame, step = chain.joint_names[-1], 1e-6
    for q, v in states(name, 3):
        before, after = (pose_of(chain.model, pin.integrate(chain.model, q, s * v), frame) for s in (-step, step))
        linear = (after.translation - before.translation) / (2.0 * step)
        angular = pin.log3(after.rotation @ before.rotation.T) / (2.0 * step)
        twist = chain.state(q, v).twist(frame)
        assert np.abs(twist - np.concatenate([linear, angular])).max() <= 1e-8
        if name in DRIVEN and name != "free ankle":
            mapped = chain.state(q).actuator_jacobian(frame) @ v[chain.actuated_in_v]
            assert np.abs(mapped - twist).max() <= 1e-9


@pytest.mark.parametrize("name", DRIVEN)
def test_accelerations_are_differences_of_velocities(name: str) -> None:
    """Along a motion at constant rates of the actuators, and of the twist that it gives a frame."""
    chain, rng = mechanism(name), np.random.default_rng(12)
    frame, step = chain.joint_names[-1], 1e-4
    for q, _ in states(name, 3):
        rates, accelerations = rng.normal(size=(2, len(chain.actuated)))
        values = q[chain.actuated_in_q]
        moments = []
        for t in (-step, step):
            there = chain.forward(values + t * rates + 0.5 * t * t * accelerations, near=q)
            v = chain.state(there).joint_rates(rates + t * accelerations)
            moments.append((v, chain.state(there, v).twist(frame)))
        a, twist_rate = ((after - before) / (2.0 * step) for before, after in zip(*moments, strict=True))
        state = chain.state(q, chain.state(q).joint_rates(rates))
        found = state.joint_accelerations(accelerations)
        assert np.abs(found - a).max() <= 1e-5 * max(1.0, np.abs(a).max())
        assert np.abs(state.frame_acceleration(frame, found) - twist_rate).max() <= 1e-5 * max(1.0, np.abs(a).max())


def test_rates_at_a_forward_singularity_are_refused() -> None:
    """A four-bar whose coupler and rocker are in line, 0.8 together: its crank stands still while they move."""
    pinned = closure("hinge", "coupler", at(0.5), "rocker", at(-0.3), "pin")
    chain = ClosedChain(mechanism("four-bar").model, [pinned], ["crank"], q0=[0.7, 0.1, 1.7])
    crank = np.arccos((0.3**2 + 1.0 - 0.8**2) / (2.0 * 0.3))
    direction = np.arctan2(-0.3 * np.sin(crank), 1.0 - 0.3 * np.cos(crank))
    q = np.array([crank, direction - crank, direction])
    assert np.abs(chain.state(q).gap()).max() <= 1e-15
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="forward")) as raised:
        chain.state(q).joint_rates([1.0])
    assert "coupler" in raised.value.cause
    assert "platform" not in str(raised.value)
    with pytest.raises(SingularConfigurationError):
        chain.state(q).joint_jacobian()


def test_velocities_that_open_loops_are_refused() -> None:
    chain = mechanism("Sarrus")
    (q, v), *_ = states("Sarrus")
    with pytest.raises(ArgumentError, check=with_fields(argument="v")):
        chain.state(q, v + 1e-6).joint_accelerations([0.0])
