"""The closures' Jacobian: of this q and no other, and exact wherever the tree stands."""

from __future__ import annotations

from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import EPS, Array, chain, closure_jacobian, placed, random_q

from spm_pin.description.closures import KINDS, Closure
from spm_pin.errors import ArgumentError

pinocchio = pytest.importorskip("pinocchio")

from spm_pin.multibody.closures import ClosureConstraints  # noqa: E402

NAMES = list(problems.GEOMETRIES)


def agrees_with_frames(robot: Any, constraints: Any, visited: list[Array]) -> bool:
    """Whether one workspace gives, at each q in turn, the Jacobian that the frames have there."""
    own = constraints.workspace()
    agree = []
    for q in visited:
        found = constraints.evaluate(q, own)[1]
        expected = closure_jacobian(robot, q)
        # Each entry is an arm, seen through up to ten joints.
        agree.append(bool(np.abs(found - expected).max() <= 64 * EPS * (1.0 + np.abs(expected).max())))
    return all(agree)


class Uncalculated:
    """A constraint whose `calc` is left out."""

    def calc(self, *_: Any) -> None:
        pass


def test_it_is_the_jacobian_of_this_q() -> None:
    robot = chain()
    visited = [q for _, q in placed("paper", 5, seed=81)] + [random_q(robot, np.random.default_rng(s)) for s in (1, 2)]
    constraints = ClosureConstraints(robot.model, robot.closures)
    assert agrees_with_frames(robot, constraints, visited)


def test_leaving_calc_out_would_show() -> None:
    """Pinocchio says nothing where `calc` is missing: the matrix is that of an earlier q. The test above sees it."""
    robot = chain()
    visited = [q for _, q in placed("paper", 2, seed=81)]
    constraints = ClosureConstraints(robot.model, robot.closures)
    constraints._each = [Uncalculated() for _ in constraints._each]
    assert not agrees_with_frames(robot, constraints, visited)


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
    own = robot.workspace()
    for q in [q for _, q in placed(name, 5, seed=85)] + [random_q(robot, rng) for _ in range(10)]:
        jacobian = robot.constraint_jacobian(q, workspace=own)
        h = 1e-5
        for column, unit in zip(jacobian.T, np.eye(18), strict=True):
            ends = [robot.closure_gap(q + sign * h * unit, workspace=own).ravel() for sign in (1.0, -1.0)]
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


def test_the_order_of_the_closures_is_kept() -> None:
    robot = chain()
    q = random_q(robot, np.random.default_rng(87))
    backwards = ClosureConstraints(robot.model, robot.closures[::-1])
    gap, jacobian = backwards.evaluate(q, backwards.workspace())
    assert np.array_equal(gap, robot.closure_gap(q)[::-1])
    assert np.array_equal(jacobian.reshape(4, 3, 18), robot.constraint_jacobian(q).reshape(4, 3, 18)[::-1])


def test_other_kinds_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "frame", "6d")
    with pytest.raises(ArgumentError, match="closures of kind point, got 'frame'"):
        ClosureConstraints(chain().model, [Closure("weld", "frame", "middle_b2", "leg_b2_tip")])
