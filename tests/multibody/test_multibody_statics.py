"""Forces of the closed tree: four ways to the same numbers, and the equilibrium of the tree."""

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
    six_branches,
    wrench_conditions,
)

import spm_pin as spm
from spm_pin.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")


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
