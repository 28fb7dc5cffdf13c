"""Newton's method on the closures: quadratic where it converges, an error where it does not."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import EPS, NAMES, PAPER, Array, chain, placed, random_q

from spm_pin.errors import ClosureError
from spm_pin.multibody.closure_solvers import close_loops

pinocchio = pytest.importorskip("pinocchio")


def rounding(robot: Any, q: Array) -> float:
    geometry = robot.geometry
    way = robot.leg_lengths(q).sum() + geometry.base_radius + geometry.platform_radius + geometry.middle_side
    return float(32 * EPS * way)


def residuals(robot: Any, q: Array) -> list[float]:
    """Largest gap after 0, 1, 2... steps, until closed."""
    found = []
    for steps in range(30):
        try:
            closed = close_loops(robot.state(q).kinematics, q, most=steps)
        except ClosureError as error:
            found.append(error.residual)
        else:
            return [*found, float(np.linalg.norm(robot.closure_gap(closed), axis=1).max())]
    raise AssertionError(found)


@pytest.mark.parametrize("name", NAMES)
def test_a_perturbed_q_is_closed(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(131)
    units = np.ones(18)
    units[robot.leg_indices] = robot.geometry.middle_side
    for _, q in placed(name, 25, seed=132):
        if robot.singular_values(q).constraint < 0.05:
            continue
        off = 0.01 * units * rng.uniform(-1, 1, 18)
        off[robot.leg_indices] = np.maximum(off[robot.leg_indices], -0.5 * robot.leg_lengths(q))
        found = robot.project(q + off)
        assert np.abs(robot.closure_gap(found)).max() <= rounding(robot, q)
        assert robot.configuration(found).closure_residual <= rounding(robot, q)
        # It goes to a point near by: to first order none is nearer, and q is one.
        assert np.linalg.norm((found - q - off) / units) <= 1.5 * np.linalg.norm(off / units)


def test_convergence_is_quadratic() -> None:
    robot, rng = chain(), np.random.default_rng(133)
    for state in problems.in_leg_space(PAPER, 10, seed=134).configuration:
        q = robot.joint_values(state) + 0.02 * rng.uniform(-1, 1, 18)
        with pytest.raises(ClosureError) as caught:
            close_loops(robot.state(q).kinematics, q, most=1)
        assert caught.value.iterations == 1
        logged = residuals(robot, q)
        assert 3 <= len(logged) <= 7
        assert logged[-1] <= rounding(robot, q)
        for before, after in itertools.pairwise(logged):
            # An error in q of gap/σ leaves a gap of its square; lengths are about a metre.
            assert after <= 100 * before**2 + rounding(robot, q)


def test_starts_that_do_not_converge() -> None:
    """Whatever the start: a closed q or an error, and both kinds occur."""
    robot, rng = chain(), np.random.default_rng(137)
    residuals_left = []
    for _ in range(40):
        q = 2 * random_q(robot, rng)
        if (robot.leg_lengths(np.zeros(18)) + q[robot.leg_indices] < 0).any():
            continue
        try:
            found = robot.project(q)
        except ClosureError as error:
            residuals_left.append(error.residual)
        else:
            assert np.abs(robot.closure_gap(found)).max() <= 10 * rounding(robot, found)
            assert (robot.leg_lengths(found) >= 0).all()
    assert 0 < len(residuals_left) < 40
    assert min(residuals_left) > 1e-6
