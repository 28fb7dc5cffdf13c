"""Jacobians, rates and forces of the tree, against the paper, the closed form, Pinocchio's frames and differences."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from multibody.chains import EPS, NAMES, Array, chain, frame_jacobian, placed, random_q, wrench_conditions

import spm_pin as spm
from spm_pin.crosscheck.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")


def closure_jacobian(owner: Any, q: Array) -> Array:
    """J_tip - J_mb of every closure, (12, 18)."""
    return np.concatenate(
        [frame_jacobian(owner, q, c.frame_b)[:3] - frame_jacobian(owner, q, c.frame_a)[:3] for c in owner.closures]
    )


@pytest.mark.parametrize("name", NAMES)
def test_gaps_and_jacobians_of_the_frames(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(82)
    data = robot.model.createData()
    for q in [q for _, q in placed(name, 5, seed=83)] + [random_q(robot, rng) for _ in range(10)]:
        expected = closure_jacobian(robot, q)
        allowed = 64 * EPS * (1.0 + np.abs(expected).max())
        assert np.abs(robot.state(q).constraint_jacobian() - expected).max() <= allowed
        pinocchio.framesForwardKinematics(robot.model, data, q)
        for closure, gap in zip(robot.closures, robot.state(q).closure_gap(), strict=True):
            a, b = (data.oMf[robot.model.getFrameId(name)].translation for name in (closure.frame_a, closure.frame_b))
            assert np.abs(gap - (b - a)).max() <= allowed


def rounding(robot: Any, q: Array, wrench: Array, smallest: float) -> float:
    """Return the error of forces from a solve with [S; Jc]: eps / σ², times the load at the distance of o."""
    d = robot.machine.middle_side
    load = np.linalg.norm(wrench / np.array([1, 1, 1, d, d, d]))
    return float(32 * EPS * (1.0 + robot.leg_lengths(q).sum() / d) * load / smallest**2)


@pytest.mark.parametrize("name", NAMES)
def test_jacobians_and_forces_of_the_closed_form_in_every_family(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(111)
    d = robot.machine.middle_side
    scale = np.array([1, 1, 1, 1 / d, 1 / d, 1 / d])
    for state, q in placed(name, 60, seed=111):
        at = robot.state(q)
        values, conditions, found = at.singular_values(), wrench_conditions(state), at.inverse_jacobian()
        # A solve errs by eps / σ², times the size of the rows of the twist at o.
        reach = 1.0 + np.linalg.norm(state.translation - state.middle_joints.mean(axis=0)) / d
        allowed = 32 * EPS * reach / min(values.inverse, conditions[1]) ** 2
        for other in (spm.inverse_jacobian, paper.J_f) if robot.machine.is_nominal else (spm.inverse_jacobian,):
            assert np.linalg.norm((found - other(state)) * scale) <= allowed
        wrench = rng.normal(size=6) / scale
        error = np.linalg.norm(at.leg_forces(wrench) - spm.leg_forces(state, wrench))
        assert error <= rounding(robot, q, wrench, min(values.forward, conditions[0]))


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))])
def test_a_copy_of_a_state_moves_alone(copied: Any) -> None:
    readings = np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.5])
    start, end = chain().forward_kinematics([readings, 1.02 * readings])
    state = chain().state(start)
    moved = copied(state).update(end)
    np.testing.assert_array_equal(state.inverse_jacobian(), chain().state(start).inverse_jacobian())
    np.testing.assert_array_equal(moved.inverse_jacobian(), chain().state(end).inverse_jacobian())
