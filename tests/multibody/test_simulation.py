"""Simulations: three engines, energy, closures, and every reason to end."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from engines import Drake, Mujoco, accelerations
from error_fields import with_fields
from multibody.chains import NAMES, PAPER, Array, chain

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.multibody import SimulationEnd
from spm_pin.multibody.simulation import LEAST_CONSTRAINED

pytest.importorskip("pinocchio")

UNTIL = 0.2
MOVING = [0.1, -0.2, 0.15, 0.05, -0.1, 0.2]


@cache
def reference() -> Array:
    """The paper's solution 3, from the leg lengths it was made of."""
    robot = chain()
    return np.asarray(robot.joint_values(spm.forward_physical(robot.machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5])))


@cache
def held() -> Array:
    return np.asarray(chain().state(reference()).inverse_dynamics(np.zeros(18)))


def driven(t: float, q: Array, v: Array) -> Array:
    robot = chain()
    return np.asarray(held() + 150.0 * np.sin(12.0 * t + np.arange(6)) - 50.0 * v[robot.leg_indices])


def start() -> tuple[Array, Array]:
    return reference(), chain().state(reference()).joint_rates(MOVING)


def rk4(rate: Callable[[float, Array], Array], state: Array, until: float, steps: int) -> Array:
    """The classical method, as in any textbook; nothing brings the state back onto the closures."""
    h = until / steps
    for k in range(steps):
        t = k * h
        k1 = rate(t, state)
        k2 = rate(t + h / 2, state + h / 2 * k1)
        k3 = rate(t + h / 2, state + h / 2 * k2)
        k4 = rate(t + h, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


@pytest.mark.parametrize("engine", [Mujoco, Drake])
def test_equations_of_other_engines_integrated_by_another_method(engine: Any) -> None:
    """Their masses and Jacobians with hard constraints, a method of order four: the error falls as the fourth power."""
    pytest.importorskip("mujoco" if engine is Mujoco else "pydrake")
    robot, (q, v) = chain(), start()
    run = robot.simulate(q, v, driven, [0.0, UNTIL], tolerance=1e-13)
    assert np.abs(run.readings[-1] - run.readings[0]).max() > 0.01
    other, legs = engine(), robot.leg_indices

    def rate(t: float, state: Array) -> Array:
        q, v = state[:18], state[18:]
        return np.concatenate([v, accelerations(other, legs, q, v, driven(t, q, v))])

    errors = []
    for steps in (16, 32, 64):
        end = rk4(rate, np.concatenate([q, v]), UNTIL, steps)[:18]
        errors.append(np.abs(robot.leg_lengths(end) - run.readings[-1]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(orders - 4.0) < 0.5).all()
    assert errors[-1] < 1e-8


@pytest.mark.parametrize("name", NAMES)
def test_a_conservative_run_keeps_its_energy(name: str) -> None:
    """Springs along the legs and no damping: the legs swing, and what the springs took is what the bodies lost."""
    robot = chain(name)
    home = robot.readings(np.zeros(18))
    q = robot.forward_kinematics(home * (1.0 + 0.05 * np.sin(np.arange(6))))
    rest, lengths = np.zeros(18), robot.leg_lengths(q)
    held = robot.state(q, rest).inverse_dynamics(rest)
    stiffness = 20.0 * np.abs(held).max() / robot.machine.middle_side

    def springs(t: float, q: Array, v: Array) -> Array:
        return np.asarray(0.7 * held - stiffness * (robot.leg_lengths(q) - lengths))

    run = robot.simulate(q, rest, springs, np.linspace(0.0, 2.0, 41))
    assert run.complete
    assert np.ptp(run.readings, axis=0).max() > 1e-3 * robot.machine.middle_side
    assert np.abs(run.energy_error).max() <= 1e-9 * np.abs(run.energy).max()
    assert run.closure_gap.max() <= 1e-13 * robot.machine.middle_side * 10.0
    opening = np.einsum("nij,nj->ni", robot.state(run.q).constraint_jacobian(), run.v)
    assert np.abs(opening).max() <= 1e-12 * max(1.0, np.abs(run.v).max())
    moved = run.readings - robot.readings(q)
    stored = 0.5 * stiffness * (moved**2).sum(axis=1) - 0.7 * moved @ held
    assert np.abs(run.energy + stored - run.energy[0] - stored[0]).max() <= 1e-9 * np.abs(run.energy).max()


def test_limits_and_singularities_are_passed_through() -> None:
    robot, q = chain(), chain().forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    run = robot.simulate(q, np.zeros(18), None, np.linspace(0.0, 1.5, 151))
    assert (run.readings < PAPER.limits.minimum).any()
    for kind in ("inverse", "forward"):
        matrices = [getattr(robot.state(place).kinematics.scaled_matrices(), kind) for place in run.q]
        values = np.linalg.det(matrices)
        crossed = int(np.flatnonzero(np.diff(np.sign(values)))[0])
        assert run.times.size > crossed + 2
    assert np.abs(run.energy_error).max() <= 1e-9 * run.energy[0]


def test_a_constraint_singularity_ends_a_run() -> None:
    robot, q = chain(), reference()
    run = robot.simulate(q, np.zeros(18), None, np.linspace(0.0, 5.0, 51))
    assert run.end is SimulationEnd.SINGULARITY
    assert robot.state(run.q[-1]).singular_values().constraint == pytest.approx(LEAST_CONSTRAINED, rel=1e-3)
    assert np.abs(run.energy_error).max() <= 1e-9 * run.energy[0]
    assert run.times[-1] < 5.0


def test_a_leg_of_no_length_ends_a_run() -> None:
    robot, rest = chain(), np.zeros(18)
    run = robot.simulate(rest, rest, np.full(6, -3000.0), np.linspace(0.0, 2.0, 21))
    assert run.end is SimulationEnd.EVENT
    assert run.detail in spm.machine.LEGS
    assert run.readings[-1].min() == pytest.approx(1e-6 * robot.machine.middle_side, rel=1e-6)


BAD: dict[str, dict[str, Any]] = {
    "q0": {"q0": [np.zeros(18)] * 2},
    "v0": {"v0": np.ones(18)},
    "v0 of NaN": {"v0": np.full(18, np.nan)},
    "forces": {"forces": np.zeros(5)},
    "forces of a function": {"forces": lambda t, q, v: np.zeros(5)},
    "forces of other arguments": {"forces": lambda t: np.zeros(6)},
    "wrench": {"wrench": np.zeros((2, 6))},
    "wrench of other arguments": {"wrench": lambda t, q: np.zeros(6)},
    "times": {"times": [0.0, 0.2, 0.1]},
    "times without one": {"times": []},
    "times of one number": {"times": 1.0},
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments(case: str) -> None:
    given: dict[str, Any] = {"q0": reference(), "v0": np.zeros(18), "forces": None, "times": [0.0, 0.1]}
    with pytest.raises(ArgumentError, check=with_fields(argument=case.partition(" ")[0])):
        chain().simulate(**{**given, **BAD[case]})
    with pytest.raises(ClosureError):
        chain().simulate(**{**given, "q0": reference() + 1e-3})


def test_a_run_says_where_its_legs_are_beyond_their_limits() -> None:
    robot = chain()
    q = robot.forward_kinematics([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    run = robot.simulate(q, np.zeros(18), None, np.linspace(0.0, 0.2, 3))
    np.testing.assert_array_equal(run.limit_excess, robot.machine.limits.excess(robot.readings(run.q)))
    assert (run.limit_excess[-1] < 0.0).tolist() == [True, True, False, False, False, False]
