from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES, in_leg_space
from scipy.optimize import minimize

import spm_pin as spm
from spm_pin.mechanism import joint_angles
from spm_pin.workspace.joint_limits import JointLimits, leg_clearance

PAPER = GEOMETRIES["paper"]


@pytest.mark.parametrize("built", [False, True])
def test_clearance_is_the_least_distance_of_two_legs_without_a_common_joint(built: bool) -> None:
    states = in_leg_space(PAPER, 6, 3).configuration
    if built:
        machine = PAPER.perturbed(1, length=0.02, angle=0.02)
        states = spm.forward_physical(machine, states.leg_lengths)
    found = leg_clearance(states)
    for k in range(6):
        state = states[k]
        starts = np.concatenate([PAPER.base_joints, state.middle_joints])
        if built:
            starts = np.concatenate([machine.legs.pivots[:3], state.balls[3:]])
        least = np.inf
        for i in range(6):
            for j in range(i + 1, 6):
                if j == i + 3:
                    continue

                p, u, q, v = starts[i], state.leg_vectors[i], starts[j], state.leg_vectors[j]

                def gap(share: np.ndarray, start: np.ndarray = p - q, u: np.ndarray = u, v: np.ndarray = v) -> float:
                    return float(((start + share[0] * u - share[1] * v) ** 2).sum())

                # A convex function on a square: any start leads to the minimum.
                answer = minimize(gap, [0.5, 0.5], bounds=[(0, 1), (0, 1)], method="L-BFGS-B", options={"ftol": 1e-15})
                least = min(least, answer.fun)
        assert found[k] == pytest.approx(np.sqrt(least), abs=1e-6)


def test_crossed_legs_touch() -> None:
    """Two legs through one point inside both: nothing but the common normal sees it."""
    mirrored = PAPER.base_joints * [-1.0, -1.0, 1.0] * (PAPER.middle_radius / PAPER.base_radius) + [0.0, 0.0, 1.2]
    through = spm.Configuration(PAPER, spm.pose([0.0, 0.0, 2.4], rotation=np.eye(3)), mirrored)
    assert leg_clearance(through) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("built", [False, True])
def test_margins_are_the_worst_and_infinite_without_limits(built: bool) -> None:
    states = in_leg_space(PAPER, 50, 4).configuration
    if built:
        machine = PAPER.perturbed(1, length=0.02, angle=0.02)
        states = spm.forward_physical(machine, states.leg_lengths)
    angles = joint_angles(states)
    assert np.isposinf(JointLimits().angle_margin(states)).all()
    assert np.isposinf(JointLimits().clearance_margin(states)).all()
    both = JointLimits(hip=(-0.3, 0.4), ball_z=(-0.1, 0.2)).angle_margin(states)
    hip = np.minimum(angles.hip + 0.3, 0.4 - angles.hip).min(axis=-1)
    ball = np.minimum(angles.ball_z + 0.1, 0.2 - angles.ball_z).min(axis=-1)
    np.testing.assert_allclose(both, np.minimum(hip, ball), atol=1e-15)
    np.testing.assert_allclose(JointLimits(clearance=0.1).clearance_margin(states), leg_clearance(states) - 0.1)


def test_a_state_that_does_not_exist_has_no_margin() -> None:
    absent = spm.forward_physical(PAPER, [[10.0, 1.0, 1.0, 1.0, 1.0, 1.0]])
    limits = JointLimits(hip=(-1.0, 1.0), clearance=0.1)
    assert np.isnan(limits.angle_margin(absent)).all()
    assert np.isnan(limits.clearance_margin(absent)).all()


def test_invalid_limits_are_refused() -> None:
    for words, arguments in (
        ("exchanged", {"hip": (1.0, -1.0)}),
        ("minimum below", {"ball_x": (float("nan"), 1.0)}),
        ("a pair", {"ball_y": 0.3}),
        ("a pair", {"ball_z": ("a", "b")}),
        ("clearance", {"clearance": -0.1}),
        ("clearance", {"clearance": float("inf")}),
    ):
        with pytest.raises(spm.ArgumentError, match=words):
            JointLimits(**arguments)  # type: ignore[arg-type]
