"""Motions of limited jerk, against a transcription in time and against the motion without this limit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from motion.example_paths import CHAIN, CURVE, LEGS, LINE, jerks, pose_line, shares

import spm_pin as spm
from spm_pin.motion import LegPath, Payload
from spm_pin.motion.limited_jerk import EasedGrid, limited_jerk
from spm_pin.motion.paths import LimitRows

WINDING = LegPath(np.random.default_rng(4).uniform(1.1, 1.5, (5, 6)))
POSES = pose_line([3.0, 5.0])


@pytest.mark.parametrize(
    ("path", "limits", "jerk", "share"),
    [
        (
            CURVE,
            {"leg_forces": 1800.0, "leg_rates": 0.6, "payload": Payload(15.0, (0.02, -0.01, 0.1)), "grid": 1000},
            [400.0, 300.0, 200.0, 300.0, 400.0, 500.0],
            0.98,
        ),
        (POSES, {"leg_forces": 1500.0, "leg_rates": 0.15, "grid": 1000}, 40.0, 0.98),
        # Some thirty polynomials for each stretch between two points: the limits are followed less closely, see below.
        pytest.param(WINDING, {"leg_accelerations": 5.0, "leg_rates": 0.6}, 40.0, 0.8, marks=pytest.mark.slow),
    ],
)
def test_all_limits_hold_and_some_limit_is_used(
    path: object, limits: dict[str, object], jerk: object, share: float
) -> None:
    period = 4e-3
    motion = spm.time_optimal(CHAIN, path, **limits, leg_jerks=jerk, period=period)  # type: ignore[arg-type]
    used = np.maximum(shares(motion, limits)[1:].max(axis=-1), np.abs(jerks(motion) / jerk).max(axis=-1))
    assert used.max() < 1.0 + 1e-6
    assert (used > share).mean() > 0.9
    # The rows are those of one motion, from rest to rest and without acceleration there.
    np.testing.assert_allclose(motion.accelerations[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=1e-9)
    moved = np.diff(motion.positions, axis=0)
    h, v, a = np.diff(motion.times)[:, None], motion.velocities, motion.accelerations
    step = 0.5 * h * (v[1:] + v[:-1]) - h**2 / 12.0 * (a[1:] - a[:-1])
    # Exact where the jerk is linear in time; a jump of it by J is worth at most J h³ max(x³/6 - x²/4 + x/12), x <= 1.
    jumps = 2.0 * np.abs(np.diff(a, axis=0) / h).max(axis=0)
    assert (np.abs(moved - step) <= 0.00802 * jumps * period**3 + 1e-14).all()


@pytest.mark.slow
@pytest.mark.parametrize(("path", "jerk", "steps"), [(CURVE, 40.0, 40), (LINE, 400.0, 120)])
def test_a_transcription_in_time_finds_the_same_duration(path: LegPath, jerk: float, steps: int) -> None:
    motion = spm.time_optimal(CHAIN, path, leg_rates=0.6, leg_accelerations=3.0, leg_jerks=jerk)
    assert motion.times[-1] == pytest.approx(shooting_duration(path, 0.6, 3.0, jerk, steps), rel=0.005)


def shooting_duration(path: LegPath, rate: float, acceleration: float, jerk: float, steps: int) -> float:
    """Duration by multiple shooting: s⃛ constant in equal steps of time on each polynomial of the path."""
    problem, total, state = ca.Opti(), 0.0, ca.DM.zeros(3)
    for low, high in zip(path.knots[:-1], path.knots[1:], strict=True):
        samples = np.linspace(low, high, 6)
        s = ca.SX.sym("s")
        fits = [np.polynomial.Polynomial.fit(samples, lengths, 5).convert() for lengths in path(samples).lengths.T]
        derivatives = [ca.vertcat(*[sum(c * s**k for k, c in enumerate(fit.coef)) for fit in fits])]
        for _ in range(3):
            derivatives.append(ca.jacobian(derivatives[-1], s))
        legs = ca.Function("legs", [s], derivatives[1:])
        duration, speed_change, states = problem.variable(), problem.variable(steps), problem.variable(3, steps + 1)
        problem.subject_to(duration >= 1e-3)
        problem.subject_to(states[1, :] >= 0.0)
        problem.subject_to(states[:, 0] == state)
        for k in range(steps):
            for share in (0.0, 0.5, 1.0):
                h, third = share * duration / steps, speed_change[k]
                second = states[2, k] + h * third
                first = states[1, k] + h * states[2, k] + h**2 / 2.0 * third
                at = states[0, k] + h * states[1, k] + h**2 / 2.0 * states[2, k] + h**3 / 6.0 * third
                l1, l2, l3 = legs(at)
                problem.subject_to(problem.bounded(-1.0, l1 * first / rate, 1.0))
                problem.subject_to(problem.bounded(-1.0, (l1 * second + l2 * first**2) / acceleration, 1.0))
                change = l1 * third + 3.0 * l2 * first * second + l3 * first**3
                problem.subject_to(problem.bounded(-1.0, change / jerk, 1.0))
            problem.subject_to(states[:, k + 1] == ca.vertcat(at, first, second))
        problem.set_initial(duration, 3.0 * (high - low))
        problem.set_initial(states[0, :], np.linspace(low, high, steps + 1))
        problem.set_initial(states[1, :], 0.3)
        total, state = total + duration, states[:, steps]
        problem.subject_to(state[0] == high)
    problem.subject_to(state[1:] == 0.0)
    problem.minimize(total)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 2000})
    return float(problem.solve().value(total))


@pytest.mark.parametrize("path", [LINE, *(pytest.param(path, marks=pytest.mark.slow) for path in (POSES, CURVE))])
def test_a_large_jerk_takes_no_longer_than_none(path: object) -> None:
    options = {"leg_forces": 1500.0, "leg_rates": 0.6, "leg_accelerations": 5.0, "grid": 1000, "period": 1e-2}
    fast, smooth = (spm.time_optimal(CHAIN, path, **options, leg_jerks=jerk) for jerk in (None, 1e6))  # type: ignore[arg-type]
    assert smooth.times[-1] == pytest.approx(fast.times[-1], rel=0.01)


def test_a_smaller_jerk_takes_longer_and_the_result_is_the_same_every_time() -> None:
    motions = [
        spm.time_optimal(CHAIN, CURVE, leg_accelerations=3.0, leg_jerks=jerk, grid=150, period=1e-2)
        for jerk in (20.0, 40.0, 80.0, 80.0)
    ]
    durations = [motion.times[-1] for motion in motions]
    assert durations[0] > 1.1 * durations[1] > 1.1 * durations[2]
    np.testing.assert_array_equal(motions[2].positions, motions[3].positions)


def test_a_coarse_grid_and_a_long_period_keep_the_limits() -> None:
    motion = spm.time_optimal(CHAIN, CURVE, leg_accelerations=3.0, leg_jerks=30.0, grid=10, period=0.02)
    assert np.abs(motion.accelerations[:, LEGS]).max() < 3.0 * (1.0 + 1e-6)
    assert np.abs(jerks(motion)).max() < 30.0 * (1.0 + 1e-6)
    # By a few per cent slower than on a fine one.
    fine = spm.time_optimal(CHAIN, CURVE, leg_accelerations=3.0, leg_jerks=30.0, grid=300, period=1e-2)
    assert fine.times[-1] < motion.times[-1] < 1.5 * fine.times[-1]


def test_a_limit_that_only_just_holds_the_machine_is_named() -> None:
    """No acceleration below zero: it could not stop."""
    factor, absent = np.ones((101, 1)), np.zeros((101, 1))
    rows = LimitRows(factor, absent, absent, np.array([0.0]), np.array([1.0]), np.full(101, np.inf))
    with pytest.raises(spm.ArgumentError, match="no such motion"):
        limited_jerk(
            EasedGrid.from_knots(np.array([0.0, 1.0]), 100), rows, np.ones((101, 6)), np.zeros((101, 6)), np.ones(6)
        )
