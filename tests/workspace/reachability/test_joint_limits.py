from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES, in_leg_space, random_branches
from scipy.optimize import minimize

import spm_pin as spm
from spm_pin.description.states import joint_values
from spm_pin.workspace.reachability.joint_limits import JointLimits, joint_angles, leg_clearance

PAPER = GEOMETRIES["paper"]


@pytest.mark.parametrize("name", list(GEOMETRIES))
def test_angles_are_those_of_the_descriptions_joints(name: str) -> None:
    for family in ("TT", "TF", "FT", "FF"):
        states = random_branches(GEOMETRIES[name], family, 8, 1).configuration
        angles = joint_angles(states)
        for k in range(8):
            values = joint_values(states[k])
            hips = [values[f"leg_{leg}_hip"] for leg in ("b1", "b2", "b3", "c1", "c2", "c3")]
            assert _turn(angles.hip[k] - hips) == pytest.approx(0.0, abs=1e-9)
            for place, ball in ((0, "ball_b1"), (3, "ball_c1")):
                for axis in "xyz":
                    mine = getattr(angles, f"ball_{axis}")[k, place]
                    assert _turn(mine - values[f"{ball}_{axis}"]) == pytest.approx(0.0, abs=1e-9)


def _turn(angle: np.ndarray) -> np.ndarray:
    return np.asarray((np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi)


def test_a_machine_turned_by_a_third_has_the_angles_of_its_legs_in_turn() -> None:
    """The frames of legs 2 and 3 are those of leg 1, turned, and half round about z: hip, x and y change their sign."""
    legs = np.random.default_rng(2).uniform(1.1, 1.5, (20, 2, 3))
    one = joint_angles(spm.forward_physical(PAPER, legs.reshape(20, 6)))
    other = joint_angles(spm.forward_physical(PAPER, np.roll(legs, 1, axis=-1).reshape(20, 6)))
    sign = np.array([1.0, -1.0, -1.0])
    for name, flips in (("hip", True), ("ball_x", True), ("ball_y", True), ("ball_z", False)):
        values = getattr(one, name).reshape(20, 2, 3) * (sign if flips else 1.0)
        turned = getattr(other, name).reshape(20, 2, 3) * (sign if flips else 1.0)
        assert turned == pytest.approx(np.roll(values, 1, axis=-1), abs=1e-12)


def test_home_has_all_angles_zero() -> None:
    angles = joint_angles(spm.forward_physical(PAPER, [1.3] * 6))
    for name in ("hip", "ball_x", "ball_y", "ball_z"):
        assert getattr(angles, name) == pytest.approx(0.0, abs=1e-12)


def test_clearance_is_the_least_distance_of_two_legs_without_a_common_joint() -> None:
    states = in_leg_space(PAPER, 6, 3).configuration
    found = leg_clearance(states)
    for k in range(6):
        state = states[k]
        starts = np.concatenate([PAPER.base_joints, state.middle_joints])
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


def test_margins_are_the_worst_and_infinite_without_limits() -> None:
    states = in_leg_space(PAPER, 50, 4).configuration
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


def test_limits_that_make_no_sense_are_refused() -> None:
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
