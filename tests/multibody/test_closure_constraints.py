"""The closures' Jacobian: evaluated at the given q, and exact everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from multibody.chains import EPS, NAMES, chain, closure_jacobian, placed, random_q

pinocchio = pytest.importorskip("pinocchio")


def test_pinocchio_s_own_constraints_have_the_same_jacobian() -> None:
    """`PointAnchorConstraintModel` differentiates a gap in the axes of its first frame: the same where it is closed."""
    robot = chain()
    constraints, states = pinocchio.StdVec_ConstraintModel(), pinocchio.StdVec_ConstraintData()
    for closure in robot.closures:
        ends = [robot.model.frames[robot.model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b)]
        places = [part for end in ends for part in (end.parentJoint, end.placement)]
        constraints.append(pinocchio.ConstraintModel(pinocchio.PointAnchorConstraintModel(robot.model, *places)))
        states.append(constraints[len(constraints) - 1].createData())
    data = robot.model.createData()
    for _, q in placed("paper", 5, seed=88):
        pinocchio.computeJointJacobians(robot.model, data, q)
        for constraint, state in zip(constraints, states, strict=True):
            # Without it, the Jacobian below is silently that of an earlier q.
            constraint.calc(robot.model, data, state)
        found = pinocchio.getConstraintsJacobian(robot.model, data, constraints, states).reshape(4, 3, 18)
        axes = np.array([state.extract().oMc1.rotation for state in states])
        expected = robot.constraint_jacobian(q)
        assert np.abs((axes @ found).reshape(12, 18) - expected).max() <= 64 * EPS * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("name", NAMES)
def test_frame_jacobians(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(82)
    for q in [q for _, q in placed(name, 20, seed=83)] + [random_q(robot, rng) for _ in range(20)]:
        expected = closure_jacobian(robot, q)
        assert np.abs(robot.constraint_jacobian(q) - expected).max() <= 64 * EPS * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("name", NAMES)
def test_finite_differences_of_the_gap(name: str) -> None:
    """Also where the closures are wide open, which Newton's method relies on."""
    robot, rng = chain(name), np.random.default_rng(84)
    for q in [q for _, q in placed(name, 5, seed=85)] + [random_q(robot, rng) for _ in range(10)]:
        jacobian = robot.constraint_jacobian(q)
        h = 1e-5
        for column, unit in zip(jacobian.T, np.eye(18), strict=True):
            ends = [robot.closure_gap(q + sign * h * unit).ravel() for sign in (1.0, -1.0)]
            # A gap is trigonometric in each joint: its third derivative is no larger than an arm.
            arm = robot.leg_lengths(q).sum() + 3 * (robot.geometry.base_radius + robot.geometry.middle_side)
            assert np.abs((ends[0] - ends[1]) / (2 * h) - column).max() <= arm * (h**2 + 32 * EPS / h)


def test_gaps_are_those_of_the_frames() -> None:
    robot = chain()
    q = random_q(robot, np.random.default_rng(86))
    data = robot.model.createData()
    pinocchio.framesForwardKinematics(robot.model, data, q)
    for closure, gap in zip(robot.closures, robot.closure_gap(q), strict=True):
        a, b = (data.oMf[robot.model.getFrameId(name)].translation for name in (closure.frame_a, closure.frame_b))
        assert np.allclose(gap, b - a, atol=16 * EPS * 10)
