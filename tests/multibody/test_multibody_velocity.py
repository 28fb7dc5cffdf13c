"""J_f from the spanning tree against the paper's 9 x 9, the closed form and finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import (
    EPS,
    NAMES,
    Array,
    chain,
    placed,
    six_branches,
    wrench_conditions,
)
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")

DRAWN = list(problems.GEOMETRIES)


@pytest.mark.parametrize("branch", range(6))
def test_three_methods_agree_at_the_six_branches(branch: int) -> None:
    state = six_branches()[branch]
    found = chain().inverse_jacobian(chain().joint_values(state))
    for other in (spm.inverse_jacobian(state), paper.J_f(state)):
        assert np.linalg.norm(found - other) <= 1e-11 * np.linalg.norm(other)


def check_witnesses(name: str, count: int, seed: int) -> None:
    robot, d = chain(name), chain(name).geometry.middle_side
    scale = np.array([1, 1, 1, 1 / d, 1 / d, 1 / d])
    for state, q in placed(name, count, seed):
        found = robot.inverse_jacobian(q)
        # A solve errs by eps / σ², times the size of the rows of the twist at o.
        reach = 1.0 + np.linalg.norm(state.translation - state.middle_joints.mean(axis=0)) / d
        allowed = 32 * EPS * reach / min(robot.singular_values(q).inverse, wrench_conditions(state)[1]) ** 2
        for other in (spm.inverse_jacobian(state), paper.J_f(state)):
            assert np.linalg.norm((found - other) * scale) <= allowed


@pytest.mark.parametrize("name", DRAWN)
def test_three_methods_agree_in_every_family(name: str) -> None:
    check_witnesses(name, 125, seed=101)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN)
def test_three_methods_agree_on_a_hundred_thousand_states(name: str) -> None:
    check_witnesses(name, 7000, seed=102)


def moved(robot: Any, q: Array) -> tuple[Array, Array, Array]:
    """Position of o, rotation of m and leg lengths in q."""
    state = robot.configuration(q)
    return state.translation, state.rotation, state.leg_lengths


def difference_quotients(robot: Any, forward: Array, backward: Array, h: float) -> tuple[Array, Array]:
    """Twist of m and leg rates between two configurations 2 h apart."""
    (o1, r1, l1), (o0, r0, l0) = moved(robot, forward), moved(robot, backward)
    turn = Rotation.from_matrix(r1 @ r0.T).as_rotvec()
    return np.concatenate([o1 - o0, turn]) / (2 * h), (l1 - l0) / (2 * h)


@pytest.mark.parametrize("name", NAMES)
def test_joint_velocities_give_the_twist_and_keep_the_loops_closed(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(103)
    d, h = robot.geometry.middle_side, 1e-5
    units = np.ones(18)
    units[robot.leg_indices] = d
    for state, q in placed(name, 15, seed=104):
        twist = rng.normal(size=6) * [d, d, d, 1, 1, 1]
        rates = robot.joint_velocities(q, twist)
        # Scaled to one unit of joint speed, so that the differences are well behaved at any conditioning.
        speed = np.linalg.norm(rates / units)
        rates, twist = rates / speed, twist / speed
        found, _ = difference_quotients(robot, q + h * rates, q - h * rates, h)
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        allowed = 10 * reach * d * (h**2 + 32 * EPS / h)
        inverse = robot.singular_values(q).inverse
        solved = 32 * EPS * reach * d / inverse**2 / speed
        assert np.abs((found - twist) * [1, 1, 1, d, d, d]).max() <= allowed + solved
        gaps = robot.closure_gap(q + h * rates) - robot.closure_gap(q - h * rates)
        assert np.abs(gaps).max() / (2 * h) <= allowed + solved
        legs = spm.leg_rates(state, twist)
        assert np.abs(rates[robot.leg_indices] - legs).max() <= 32 * EPS * reach * d / inverse**2


@pytest.mark.parametrize("name", NAMES)
def test_finite_differences_along_the_closed_manifold(name: str) -> None:
    robot, rng, h = chain(name), np.random.default_rng(105), 1e-4
    d = robot.geometry.middle_side
    units = np.ones(18)
    units[robot.leg_indices] = d
    tested = 0
    for _, q in placed(name, 40, seed=106):
        values = robot.singular_values(q)
        if min(values.inverse, values.constraint) < 0.02:
            continue
        jacobian = robot.constraint_jacobian(q)
        free = np.linalg.svd(jacobian * units)[2][12:]
        direction = units * (rng.normal(size=6) @ free)
        direction /= np.linalg.norm(direction / units)
        ends = [robot.project(q + sign * h * direction) for sign in (1.0, -1.0)]
        twist, legs = difference_quotients(robot, *ends, h)
        # Projected paths bend with the inverse of σ of the closures; J_f passes an error in the twist on.
        size = np.linalg.norm(robot.inverse_jacobian(q) / [1, 1, 1, d, d, d])
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        allowed = (1.0 + size) * d * (100 * reach * h**2 / values.constraint**2 + 64 * EPS * reach / h)
        assert np.abs(robot.inverse_jacobian(q) @ twist - legs).max() <= allowed
        tested += 1
    assert tested > 30
