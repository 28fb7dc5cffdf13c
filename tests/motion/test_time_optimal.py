"""Fastest motions along a path, against a convex programme in CasADi, inverse dynamics and MuJoCo."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest
from engines import Mujoco
from error_fields import with_fields
from motion.example_paths import CHAIN, CURVE, GOAL, LEGS, LINE, PAPER, START, pose_line, shares

import spm_pin as spm
from spm_pin.motion import LegPath, Payload
from spm_pin.motion.paths import path_dynamics

LOAD = Payload(15.0, (0.02, -0.01, 0.1), np.diag([0.3, 0.2, 0.25]))


CASES = {
    "line, all": (LINE, {"leg_forces": 1500.0, "leg_rates": 0.4, "leg_accelerations": 5.0, "twist": (0.8, 0.9)}),
    "curve, payload": (CURVE, {"leg_forces": 1800.0, "leg_rates": 0.6, "payload": LOAD}),
    "curve, accelerations": (CURVE, {"leg_accelerations": 3.0}),
    "poses": (None, {"leg_forces": 1500.0, "twist": (0.5, 0.5)}),
}


@pytest.mark.parametrize("name", CASES)
def test_the_rows_keep_the_limits_and_some_limit_is_always_used(name: str) -> None:
    path, limits = CASES[name]
    # A bent path needs a fine grid for its limits to be used everywhere.
    motion = spm.time_optimal(CHAIN, path or pose_line(), **limits, grid=1000 if path is CURVE else 300, period=4e-3)
    used = shares(motion, limits)
    assert used.max() < 1.0 + 1e-6
    # The rows where the acceleration switches lie between two parts of the grid.
    assert (used.max(axis=-1) >= 0.99).mean() > 0.97
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=1e-6)
    assert CHAIN.state(motion.positions).closure_gap().max() < 1e-9


@pytest.mark.parametrize("jerk", [None, 400.0])
def test_rows_are_a_period_apart_and_set_points_are_of_the_same_motion(jerk: float | None) -> None:
    options = {"leg_accelerations": 3.0, "leg_rates": 0.4, "leg_jerks": jerk, "grid": 200}
    motion = spm.time_optimal(CHAIN, LINE, **options, period=0.01)
    steps = np.diff(motion.times)
    np.testing.assert_allclose(steps[:-1], 0.01, rtol=1e-12)
    assert 0.0 < steps[-1] <= 0.01001
    again = motion.at(motion.times)
    np.testing.assert_allclose(again.positions, motion.positions, atol=1e-12)
    np.testing.assert_allclose(again.efforts, motion.efforts, atol=1e-6)
    # Between the rows: closed loops, and rates that are the derivatives of the values.
    at = np.linspace(0.02, motion.times[-1] - 0.02, 50)
    between, h = motion.at(at), 1e-5
    assert CHAIN.state(between.positions).closure_gap().max() < 1e-9
    ahead, behind = motion.at(at + h), motion.at(at - h)
    np.testing.assert_allclose((ahead.positions - behind.positions) / (2.0 * h), between.velocities, atol=1e-4)
    np.testing.assert_allclose(between.readings, CHAIN.readings(between.positions), atol=1e-9)
    assert motion.at(0.05).times.shape == (1,)
    for times in ([0.1, motion.times[-1] + 1.0], [0.2, 0.1]):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="times")):
            motion.at(times)
    with pytest.raises(spm.ArgumentError, match="Plan it again"):
        pickle.loads(pickle.dumps(motion)).at(0.1)


@pytest.mark.parametrize("jerk", [None, 400.0])
def test_a_machine_as_built_moves_within_its_limits(jerk: float | None) -> None:
    limits = {"leg_forces": 1500.0, "leg_rates": 0.4}
    options = {**limits, "leg_jerks": jerk, "grid": 200, "period": 5e-3}
    nominal = spm.time_optimal(CHAIN, LINE, **options)
    machine = PAPER.perturbed(1, length=5e-3, angle=5e-3)
    chain = spm.ClosedChain.from_urdf(machine=machine)
    planned = spm.plan(machine, START, GOAL)
    motion = spm.time_optimal(chain, planned, **options)
    used = shares(motion, limits).max(axis=0)
    assert (used < 1.0 + 1e-6).all()
    assert used.max() > 0.97
    assert np.abs(chain.state(motion.positions).closure_gap()).max() < 1e-9
    np.testing.assert_allclose(chain.readings(motion.positions)[[0, -1]], [START, GOAL], atol=1e-9)
    forces = chain.state(motion.positions, motion.velocities).inverse_dynamics(motion.accelerations)
    np.testing.assert_allclose(motion.efforts[:, LEGS], forces, rtol=0, atol=1e-6)
    assert abs(motion.times[-1] / nominal.times[-1] - 1.0) > 1e-5
    with pytest.raises(spm.GeometryError, check=with_fields(argument="path")):
        spm.time_optimal(CHAIN, planned, **options)


@pytest.mark.parametrize("name", ["line, all", "curve, payload", "poses"])
def test_a_convex_programme_finds_the_same_duration(name: str) -> None:
    """Direct transcription with u and x = ṡ² on a finer grid, solved by IPOPT."""
    path, limits = CASES[name]
    way = path or pose_line()
    n = 300
    grid = np.linspace(0.0, 1.0, n + 1)
    chain = CHAIN.with_masses(spm.description.Masses(payload=limits.get("payload")))
    along = path_dynamics(chain, way, grid)
    first, second = along.first[:, LEGS], along.second[:, LEGS]
    problem = ca.Opti()
    x, u = problem.variable(n + 1), problem.variable(n)
    problem.subject_to(x[1:] - x[:-1] == 2.0 / n * u)
    problem.subject_to([x[0] == 0.0, x[-1] == 0.0])
    problem.subject_to(x[1:-1] >= 1e-9)
    middle = 0.5 * (x[1:] + x[:-1])
    for leg in range(6):
        mean = lambda values, leg=leg: ca.DM(0.5 * (values[1:, leg] + values[:-1, leg]))  # noqa: E731
        if "leg_forces" in limits:
            force = mean(along.inertial) * u + mean(along.centrifugal) * middle + mean(along.static)
            problem.subject_to(problem.bounded(-limits["leg_forces"], force, limits["leg_forces"]))
        if "leg_accelerations" in limits and first[:, leg].any():
            change = mean(first) * u + mean(second) * middle
            problem.subject_to(problem.bounded(-limits["leg_accelerations"], change, limits["leg_accelerations"]))
        if "leg_rates" in limits and first[:, leg].any():
            problem.subject_to(x * ca.DM(first[:, leg] ** 2) <= limits["leg_rates"] ** 2)
    for part, speed in enumerate(limits.get("twist", ())):
        size = np.linalg.norm(along.twist[:, 3 * part : 3 * part + 3], axis=-1)
        problem.subject_to(x * ca.DM(size**2) <= speed**2)
    roots = ca.sqrt(ca.fmax(x, 1e-12))
    problem.minimize(ca.sum1(2.0 / n / (roots[1:] + roots[:-1])))
    problem.set_initial(x, 0.01)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 1000})
    duration = float(problem.solve().value(problem.f))
    motion = spm.time_optimal(CHAIN, way, **limits, grid=200, period=1e-2)
    assert motion.times[-1] == pytest.approx(duration, rel=0.01)


def test_a_payload_weighs_at_rest_and_pushes_when_it_is_moved() -> None:
    """The same body added to the terminal platform of the model, by Pinocchio."""
    import pinocchio as pin

    heavy = spm.ClosedChain.from_urdf()
    inertia = pin.Inertia(LOAD.mass, np.asarray(LOAD.centre), np.asarray(LOAD.inertia))
    frame = heavy.model.frames[heavy.model.getFrameId("terminal_platform")]
    model = heavy.model
    body = model.inertias[frame.parentJoint]
    model.inertias[frame.parentJoint] = body + frame.placement.act(inertia)
    loaded = spm.time_optimal(CHAIN, CURVE, leg_forces=1800.0, payload=LOAD, grid=200, period=5e-3)
    expected = heavy.state(loaded.positions, loaded.velocities).inverse_dynamics(loaded.accelerations)
    # Made anew: a chain keeps memory of its model.
    np.testing.assert_allclose(loaded.efforts[:, LEGS], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "argument"),
    [
        ({"leg_forces": 1.0}, "leg_forces"),
        ({"leg_rates": 1.0}, "leg_forces, leg_accelerations"),
        ({"leg_forces": [[100.0] * 6, [-100.0] * 6]}, "leg_forces"),
        ({"leg_forces": [-100.0, 100.0]}, "leg_forces"),
        ({"leg_accelerations": 1.0, "leg_rates": [1.0] * 5}, "leg_rates"),
        ({"leg_accelerations": 1.0, "twist": (1.0, -1.0)}, "twist"),
        ({"leg_accelerations": 1.0, "period": 1e-9}, "period"),
    ],
)
def test_wrong_limits_are_named(wrong: dict[str, object], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        spm.time_optimal(CHAIN, LINE, grid=20, **wrong)  # type: ignore[arg-type]


def test_a_path_may_begin_at_any_time() -> None:
    """The first of these times plus their difference is above the last, by rounding."""
    times = [1.6255247663220262, 7.918391417807537]
    assert times[0] + (times[1] - times[0]) > times[1]
    limits = {"leg_accelerations": 3.0, "grid": 200, "period": 0.01}
    shifted = spm.time_optimal(CHAIN, pose_line(times), **limits)
    np.testing.assert_allclose(shifted.times[-1], spm.time_optimal(CHAIN, pose_line(), **limits).times[-1], rtol=1e-9)


def test_a_plan_made_with_other_limits_is_of_the_same_machine_and_a_coarse_grid_keeps_its_limits() -> None:
    wider = spm.Manipulator(*PAPER.dimensions, limits=spm.LegLimits(0.9, 1.8))
    planned, limits = spm.plan(wider, START, GOAL), {"leg_accelerations": 3.0, "leg_rates": 0.4}
    for path, grid in ((CURVE, 10), (CURVE, 60), (planned, 200)):
        motion = spm.time_optimal(CHAIN, path, grid=grid, period=5e-3, **limits)
        assert shares(motion, limits).max() < 1.0 + 1e-6
        np.testing.assert_allclose(CHAIN.leg_lengths(motion.positions[-1]), GOAL, atol=1e-9)


BACK = LegPath([[1.2] * 6, [1.3, *[1.2] * 5], [1.2] * 6])
"""One leg there and back: where it turns, the path has no direction, and its parameter must grow infinitely fast."""


def test_a_leg_that_turns_back_is_driven_at_full_acceleration_all_the_time() -> None:
    least = 4.0 * np.sqrt(0.1 / 2.0)
    durations = []
    for grid in (60, 800):
        motion = spm.time_optimal(CHAIN, BACK, leg_accelerations=2.0, grid=grid, period=5e-3)
        durations.append(motion.times[-1])
        assert least < durations[-1] < least * (1.0 + 1.5 * motion.error)
    assert durations == sorted(durations, reverse=True)
    assert durations[-1] < 1.002 * least
    assert np.median(np.abs(motion.accelerations[:, LEGS]).max(axis=-1)) > 1.99


@pytest.mark.parametrize("length", [1e-3, 1e-9])
def test_a_tiny_line_is_a_motion_too(length: float) -> None:
    line = LegPath([[1.2] * 6, 1.2 + length * np.array([1.0, 0.2, -0.3, 0.1, 0.0, 0.5])])
    motion = spm.time_optimal(CHAIN, line, leg_accelerations=2.0, grid=100)
    assert motion.times[-1] == pytest.approx(2.0 * np.sqrt(length / 2.0), rel=1e-6)
    assert spm.time_optimal(CHAIN, line, leg_forces=1500.0, leg_jerks=40.0, grid=100).times[-1] < 0.1


@pytest.mark.parametrize(("count", "seed"), [(1, 4), pytest.param(16, 120, marks=pytest.mark.slow)])
def test_every_plan_has_a_fastest_motion_within_its_limits_and_its_error(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = [
        {"leg_forces": 1500.0, "twist": (1.0, 1.5), "leg_accelerations": 4.0},
        {"leg_accelerations": 5.0, "leg_rates": 0.6},
        {"leg_forces": 1500.0, "leg_rates": 0.5},
        {"leg_accelerations": 0.5},
    ]
    for k in range(count):
        points = rng.uniform(1.1, 1.5, (rng.integers(2, 6), 6))
        planned, limits = spm.plan(PAPER, points[0], points[-1], via=list(points[1:-1])), kinds[k % 4]
        assert planned.exists
        coarse, fine = (spm.time_optimal(CHAIN, planned, grid=n, period=5e-3, **limits) for n in (100, 200))
        for motion in (coarse, fine):
            assert shares(motion, limits).max() < 1.0 + 1e-9
            assert motion.error < 0.02
        # Neither is longer than the least one by more than it says, to what IPOPT leaves where the grid adds nothing.
        assert fine.times[-1] < (1.0 + fine.error + 1e-9) * coarse.times[-1]
        assert coarse.times[-1] < (1.0 + 2.0 * coarse.error + 1e-9) * fine.times[-1]
        if k % 10 == 1:
            smooth = spm.time_optimal(CHAIN, planned, grid=200, period=5e-3, leg_jerks=1e4, **limits)
            assert fine.times[-1] < (1.0 + 2.0 * fine.error) * smooth.times[-1]


def test_paths_that_cannot_be_gone_along_are_named() -> None:
    tilts = spm.forward_physical(PAPER, [[1.3, 1.3, 1.4, 1.3, 1.3, 1.4], [1.4, 1.4, 1.3, 1.4, 1.4, 1.3]])
    eased = spm.PlatformPath([0.0, 1.0], spm.forward_physical(PAPER, [START, GOAL]).pose, ease=True)
    for path, says in (
        (LegPath([START, [0.2, 0.2, 3.0, 1.2, 1.2, 1.2]]), r"no state at parameter 0\.\d+"),
        (LegPath([START, [1.62, *START[1:]]]), r"r_b1 of 1\.50\d* m at parameter 0\.71"),
        (spm.PlatformPath([0.0, 1.0], tilts.pose), "parameter"),
        (eased, "ease"),
        (LegPath([[-1.0] * 6, START]), "positive lengths"),
    ):
        with pytest.raises(spm.ArgumentError, match=says):
            spm.time_optimal(CHAIN, path, leg_accelerations=1.0, grid=200)
    for rows in ([START], [START, START], [[1.0] * 5] * 2):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="lengths")):
            LegPath(rows)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="parameters")):
        LINE(1.5)


def test_a_replay_in_mujoco_tracks_the_motion() -> None:
    """Efforts as feed-forward, held for a step of 0.5 ms, with a weak spring and damper on the legs."""
    motion = spm.time_optimal(CHAIN, CURVE, leg_forces=1500.0, leg_rates=0.5, grid=300, period=5e-4)
    engine = Mujoco(step=5e-4, integrator="mjINT_IMPLICITFAST")
    errors, corrections, gaps = [], [], []

    def forces(time: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        k = min(round(time / motion.times[-1] * (len(motion.times) - 1)), len(motion.times) - 1)
        away = (motion.positions[k] - q)[LEGS]
        correction = 2e4 * away + 4e2 * (motion.velocities[k] - v)[LEGS]
        errors.append(np.abs(away).max())
        corrections.append(np.abs(correction).max())
        if k % 50 == 0:
            gaps.append(np.abs(CHAIN.state(q).closure_gap()).max())
        return motion.efforts[k, LEGS] + correction

    end = engine.run(motion.positions[0], motion.velocities[0], forces, float(motion.times[-1]), LEGS)
    assert max(errors) < 5e-4
    # Forces of up to 1500 N are right by themselves, and the loops stay closed.
    assert max(corrections) < 5.0
    assert max(gaps) < 1e-6
    assert np.abs((end - motion.positions[-1])[LEGS]).max() < 5e-4
