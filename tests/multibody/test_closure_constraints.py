"""The closures' Jacobian: evaluated at the given q, and that of Pinocchio's frames wherever the tree is."""

from __future__ import annotations

import numpy as np
import pytest
from multibody.chains import EPS, NAMES, chain, closure_jacobian, placed, random_q

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
