"""J_f from the spanning tree against the paper's 9 x 9 and the closed form; joint velocities against differences."""

from __future__ import annotations

import numpy as np
import pytest
from multibody.chains import EPS, NAMES, chain, placed, wrench_conditions
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")


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
