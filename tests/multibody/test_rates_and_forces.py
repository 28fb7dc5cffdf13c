"""Jacobians, rates and forces of the tree, against the paper, the closed form, Pinocchio's frames and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody.chains import (
    EPS,
    NAMES,
    Array,
    chain,
    closure_jacobian,
    frame_jacobian,
    placed,
    random_q,
    six_branches,
    wrench_conditions,
)
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")


@pytest.mark.parametrize("name", NAMES)
def test_frame_jacobians(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(82)
    for q in [q for _, q in placed(name, 20, seed=83)] + [random_q(robot, rng) for _ in range(20)]:
        expected = closure_jacobian(robot, q)
        assert np.abs(robot.constraint_jacobian(q) - expected).max() <= 64 * EPS * (1.0 + np.abs(expected).max())


def test_gaps_are_those_of_the_frames() -> None:
    robot = chain()
    q = random_q(robot, np.random.default_rng(86))
    data = robot.model.createData()
    pinocchio.framesForwardKinematics(robot.model, data, q)
    for closure, gap in zip(robot.closures, robot.closure_gap(q), strict=True):
        a, b = (data.oMf[robot.model.getFrameId(name)].translation for name in (closure.frame_a, closure.frame_b))
        assert np.allclose(gap, b - a, atol=16 * EPS * 10)


@pytest.mark.parametrize(("count", "seed"), [(60, 101), pytest.param(600, 102, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_three_methods_agree_in_every_family(name: str, count: int, seed: int) -> None:
    robot, d = chain(name), chain(name).geometry.middle_side
    scale = np.array([1, 1, 1, 1 / d, 1 / d, 1 / d])
    for state, q in placed(name, count, seed):
        found = robot.inverse_jacobian(q)
        # A solve errs by eps / σ², times the size of the rows of the twist at o.
        reach = 1.0 + np.linalg.norm(state.translation - state.middle_joints.mean(axis=0)) / d
        allowed = 32 * EPS * reach / min(robot.singular_values(q).inverse, wrench_conditions(state)[1]) ** 2
        for other in (spm.inverse_jacobian, paper.J_f) if robot.geometry.is_nominal else (spm.inverse_jacobian,):
            assert np.linalg.norm((found - other(state)) * scale) <= allowed


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
        ahead, behind = (robot.configuration(q + sign * h * rates) for sign in (1.0, -1.0))
        turn = Rotation.from_matrix(ahead.rotation @ behind.rotation.T).as_rotvec()
        found = np.concatenate([ahead.translation - behind.translation, turn]) / (2 * h)
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        allowed = 10 * reach * d * (h**2 + 32 * EPS / h)
        inverse = robot.singular_values(q).inverse
        solved = 32 * EPS * reach * d / inverse**2 / speed
        assert np.abs((found - twist) * [1, 1, 1, d, d, d]).max() <= allowed + solved
        gaps = robot.closure_gap(q + h * rates) - robot.closure_gap(q - h * rates)
        assert np.abs(gaps).max() / (2 * h) <= allowed + solved
        legs = spm.leg_rates(state, twist)
        assert np.abs(rates[robot.leg_indices] - legs).max() <= 32 * EPS * reach * d / inverse**2


def rounding(robot: Any, q: Array, wrench: Array) -> float:
    """Return the error of forces from a solve with [S; Jc]: eps / σ², times the load at the distance of o."""
    d = robot.geometry.middle_side
    load = np.linalg.norm(wrench / np.array([1, 1, 1, d, d, d]))
    reach = 1.0 + robot.leg_lengths(q).sum() / d
    return float(64 * EPS * reach * load / robot.singular_values(q).forward ** 2)


@pytest.mark.parametrize(("count", "seed"), [(60, 111), pytest.param(600, 112, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_the_closed_form_in_every_family(name: str, count: int, seed: int) -> None:
    robot, rng = chain(name), np.random.default_rng(seed)
    d = robot.geometry.middle_side
    for state, q in placed(name, count, seed):
        wrench = rng.normal(size=6) * [1, 1, 1, d, d, d]
        error = np.linalg.norm(robot.leg_forces(q, wrench) - spm.leg_forces(state, wrench))
        load = np.linalg.norm(wrench / [1, 1, 1, d, d, d])
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        smallest = min(robot.singular_values(q).forward, wrench_conditions(state)[0])
        assert error <= 32 * EPS * reach * load / smallest**2


@pytest.mark.parametrize("name", NAMES)
def test_the_tree_is_in_equilibrium(name: str) -> None:
    """Legs, cut balls and the load leave no generalized force, and the Jacobian's transpose is how they act."""
    robot, rng = chain(name), np.random.default_rng(113)
    for _, q in placed(name, 10, seed=114):
        wrench = rng.normal(size=6)
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        total = frame_jacobian(robot, q, "terminal_platform").T @ wrench + closure_jacobian(robot, q).T @ cuts.ravel()
        total[robot.leg_indices] += legs
        assert np.abs(total).max() <= rounding(robot, q, wrench) * (1.0 + robot.leg_lengths(q).sum())
        again = robot.constraint_jacobian(q).T @ cuts.ravel()
        assert np.allclose(again, closure_jacobian(robot, q).T @ cuts.ravel(), atol=rounding(robot, q, wrench))


def test_cut_forces_act_onto_the_tips() -> None:
    """Along its leg, what the ball gives the tip is what the actuator takes: it pushes the tip outwards.

    Across the leg the ball gives what the hip takes, along its axis alone.
    """
    robot = chain()
    wrench = np.concatenate(paper.load())
    for state in six_branches():
        q = robot.joint_values(state)
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        directions = state.leg_vectors / state.leg_lengths[:, None]
        axes = np.concatenate([state.geometry.revolute_axes, state.platform_axes])
        names = [closure.name for closure in robot.closures]
        allowed = rounding(robot, q, wrench)
        for leg, name in enumerate(("b1", "b2", "b3", "c1", "c2", "c3")):
            if f"closure_{name}" in names:
                # Outwards from the hip: b - a, and b - c.
                outwards = directions[leg] if leg < 3 else -directions[leg]
                assert cuts[names.index(f"closure_{name}")] @ outwards == pytest.approx(-legs[leg], abs=allowed)
                axis = axes[leg]
                left = cuts[names.index(f"closure_{name}")] + legs[leg] * outwards
                assert np.linalg.norm(left - (left @ axis) * axis) <= allowed
