"""A followed solution keeps its identity, and events are reported at their parameters."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from error_fields import with_fields
from problems import EXAMPLE, PAPER, as_built, at_discriminant, in_leg_space, random_branches
from scipy.optimize import brentq
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

import spm_pin as spm
from spm_pin.kinematics.path_following import existing_share, follow, last_on_line, watch_of
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.kinematics.tracking import EventKind, FollowedPath, Tracker

FREE = replace(PAPER, limits=None)
RESOLUTION = 1e-9


def pose_between(first: RigidTransform, last: RigidTransform, s: float | np.ndarray) -> RigidTransform:
    turn = Slerp([0.0, 1.0], Rotation.concatenate([first.rotation, last.rotation]))
    share = np.asarray(s)[..., None]
    return spm.pose((1 - share) * first.translation + share * last.translation, rotation=turn(s))


def stacked(*poses: RigidTransform) -> np.ndarray:
    return np.stack([pose.as_matrix() for pose in poses])


def of_kind(found: FollowedPath, kind: EventKind) -> list[float]:
    return [event.parameter for event in found.events if event.kind is kind]


@pytest.mark.parametrize(("points", "seed"), [*((3, seed) for seed in range(3)), (2, 103)])
def test_along_poses_a_solution_keeps_its_label(points: int, seed: int) -> None:
    """Labels are continuous up to a fold; another branch that is only near, as in the last case, is not taken."""
    problem = in_leg_space(PAPER, points, seed=seed)
    start = problem.configuration[0]
    found = follow(FREE, problem.pose, spm.Configuration(FREE, start.pose, start.middle_joints))
    assert len(set(found.labels)) == 1
    assert found.labels[0] in ("TT+", "TT-")
    assert not of_kind(found, EventKind.SWITCH)
    assert found.configurations.closure_residual.max() < 1e-13
    np.testing.assert_allclose(found.configurations[0].middle_joints, start.middle_joints, atol=1e-9)
    moves = np.abs(np.diff(found.configurations.middle_joints, axis=0)).max(axis=(1, 2))
    assert moves.max() <= 0.1 * PAPER.middle_side


@pytest.mark.parametrize("seed", range(2))
def test_sign_changes_are_those_of_a_dense_sample(seed: int) -> None:
    problem = in_leg_space(PAPER, 2, seed=100 + seed)
    first, last = problem.pose[0], problem.pose[1]
    start = problem.configuration[0]
    found = follow(FREE, problem.pose, spm.Configuration(FREE, start.pose, start.middle_joints))
    label = found.labels[0]
    end = found.parameters[-1]
    dense = np.linspace(0.0, end, 100_001)[1:-1]
    branch = spm.inverse_displacement(FREE, pose_between(first, last, dense))[label]
    scaled = spm.singularities(branch).scaled_determinants
    kinds = [EventKind.FORWARD_SINGULARITY, EventKind.INVERSE_SINGULARITY]
    for kind, columns in zip(kinds, (scaled[:, :2], scaled[:, 2:]), strict=True):
        middles = 0.5 * (dense[1:] + dense[:-1])
        crossings = np.concatenate([middles[np.diff(np.sign(column)) != 0.0] for column in columns.T])
        # Towards an end the legs may grow without bound, and a determinant be nothing but rounding.
        before = [s for s in of_kind(found, kind) if s < 0.99 * end]
        np.testing.assert_allclose(before, np.sort(crossings[crossings < 0.99 * end]), atol=2e-5 * end)


def test_an_end_is_where_two_branches_meet() -> None:
    problem = random_branches(PAPER, "TT", 3, seed=1)
    for n in range(3):
        inside, outside = (at_discriminant(problem.pose[n], 0, h, PAPER) for h in (0.01, -0.01))
        for label in ("TT+", "TT-"):
            found = follow(FREE, stacked(inside, outside), label)
            assert not found.complete
            (end,) = of_kind(found, EventKind.END)
            assert end == pytest.approx(0.5, abs=RESOLUTION)
            assert "inverse" in found.events[-1].detail
            branches = [spm.inverse_displacement(FREE, pose_between(inside, outside, end + x)) for x in (-1e-8, 1e-8)]
            assert branches[0][label].exists
            assert not branches[1][label].exists


def excess(s: float, ends: RigidTransform, label: str, leg: int, bound: float) -> float:
    branches = spm.inverse_displacement(PAPER, pose_between(ends[0], ends[1], s))
    return float(branches[label].leg_lengths[leg]) - bound


def test_a_limit_is_crossed_where_the_leg_is_as_long_as_it_may_be() -> None:
    checked = 0
    for seed in range(8):
        if checked >= 8:
            break
        problem = in_leg_space(PAPER, 2, seed=200 + seed)
        found = follow(PAPER, problem.pose, problem.configuration[0])
        label = found.labels[0]
        for event in found.events:
            if event.kind is not EventKind.LIMIT:
                continue
            leg = spm.machine.LEGS.index(event.detail.split()[0])
            bound = 1.5 if "maximum" in event.detail else 1.1
            beyond = functools.partial(excess, ends=problem.pose, label=label, leg=leg, bound=bound)
            low, high = event.parameter - 1e-5, event.parameter + 1e-5
            assert beyond(low) * beyond(high) < 0.0
            assert event.parameter == pytest.approx(brentq(beyond, low, high, xtol=1e-13), abs=RESOLUTION)
            outward = (beyond(high) > 0.0) == (bound == 1.5)
            assert ("goes beyond" in event.detail) == outward
            checked += 1
    assert checked >= 8


def test_two_crossings_within_one_step_are_found() -> None:
    length = float(spm.inverse_displacement(PAPER, EXAMPLE)["TT+"].leg_lengths[0])
    limits = spm.LegLimits(0.5, [length + 1e-7, 9, 9, 9, 9, 9])
    machine = replace(PAPER, limits=limits)

    def path(s: float) -> RigidTransform:
        # r_b1 grows with the height; at most 2e-7 m beyond the limit, for about a twentieth of a step.
        return spm.pose(
            EXAMPLE.translation + np.array([0, 0, 4e-7 - 2.0 * (s - 0.512) ** 2]), rotation=EXAMPLE.rotation
        )

    found = follow(machine, path, "TT+", samples=50)
    crossings = of_kind(found, EventKind.LIMIT)
    assert len(crossings) == 2
    assert crossings[0] < 0.512 < crossings[1]
    for s in crossings:
        there = spm.inverse_displacement(machine, path(s))["TT+"].leg_lengths[0]
        assert there == pytest.approx(length + 1e-7, abs=1e-12)


@pytest.mark.parametrize(
    ("lengths", "expected"),
    [
        ([1.3, 1.5], []),
        ([1.3, 1.5, 1.3], []),
        ([1.5, 1.3], []),
        ([1.5, 1.5], []),
        ([1.3, 1.5, 1.5, 1.3], []),
        ([1.3, 1.5, 1.6], [(0.5, "goes beyond")]),
        ([1.3, 1.5, 1.5, 1.6, 1.5], [(0.5, "goes beyond"), (1.0, "comes back within")]),
        ([1.4, 1.6], [(0.5, "goes beyond")]),
    ],
)
def test_a_leg_as_long_as_its_limit_is_within_it(lengths: list[float], expected: list[tuple[float, str]]) -> None:
    legs = np.full((len(lengths), 6), 1.25)
    legs[:, 3] = 1.3
    legs[:, 5] = lengths
    found = follow(PAPER, legs, samples=12)
    events = [event for event in found.events if event.kind is EventKind.LIMIT]
    assert [(event.parameter, event.detail) for event in events] == [
        (pytest.approx(parameter, abs=RESOLUTION), f"r_c3 {verb} its maximum, 1.5 m") for parameter, verb in expected
    ]


def test_along_leg_lengths_the_machine_stays_in_its_mode() -> None:
    rng = np.random.default_rng(2)
    for _ in range(4):
        legs = rng.uniform(1.1, 1.5, (3, 6))
        found = follow(PAPER, legs)
        assert found.complete
        assert not of_kind(found, EventKind.FORWARD_SINGULARITY)
        np.testing.assert_allclose(found.configurations.leg_lengths[-1], legs[-1], atol=1e-12)
        physical = spm.forward_physical(PAPER, legs[-1])
        np.testing.assert_allclose(found.configurations[-1].middle_joints, physical.middle_joints, atol=1e-11)
        # det K is not what holds the machine together: it may change sign on the way.
        dense = np.array([np.interp(np.linspace(0, 1, 4001), [0, 0.5, 1], column) for column in legs.T]).T
        structure = spm.singularities(spm.forward_physical(PAPER, dense)).scaled_determinants[:, 2]
        crossings = np.linspace(0, 1, 4001)[np.flatnonzero(np.diff(np.sign(structure)))]
        np.testing.assert_allclose(of_kind(found, EventKind.INVERSE_SINGULARITY), crossings, atol=5e-4)


def test_along_readings_of_servos_and_screws_events_are_no_numbers_of_modes() -> None:
    """The numbers of their modes are names only, and change without any event."""
    servos = spm.Stage(0.30, 0.25, spm.RRS(crank=0.15, rod=0.35), limits=(-0.5, 1.5))
    screws = spm.Stage(0.20, 0.25, spm.PRS(rod=0.30), limits=(-0.05, 0.25))
    machine = spm.Manipulator.of_stages(servos, screws)
    ends = np.array([[0.4, 0.5, 0.6, 0.10, 0.12, 0.14], [0.9, 0.1, 0.5, 0.15, 0.02, 0.20]])
    found = spm.follow(machine, ends)
    assert found.complete
    assert {event.kind for event in found.events} <= {EventKind.INVERSE_SINGULARITY}
    expected = spm.forward_physical(machine, ends[-1])
    np.testing.assert_allclose(found.configurations.middle_joints[-1], expected.middle_joints, atol=1e-12)
    signs = np.sign(determinants(found.configurations)[:, 2])
    assert np.count_nonzero(np.diff(signs)) == len(found.events)


def test_leg_lengths_that_can_no_longer_close_end_the_path() -> None:
    """One leg grows while the others stay: the stage ceases to close at a forward singularity."""
    start, grown = np.full((2, 6), 1.3)
    grown[0] = 2.6
    found = follow(FREE, np.stack([start, grown]), samples=100)
    assert not found.complete
    (end,) = of_kind(found, EventKind.END)
    assert "forward, lower stage" in found.events[-1].detail
    before, after = (spm.forward_physical(PAPER, start + (end + x) * (grown - start)) for x in (-1e-8, 1e-8))
    assert before.exists
    assert not after.exists


def test_two_solutions_that_coincide_are_not_followed_forever() -> None:
    state = in_leg_space(PAPER, 1, seed=0).configuration[0]
    twice = spm.Configuration(FREE, np.stack([state.pose.as_matrix()] * 2), np.stack([state.middle_joints] * 2))
    parameters = []

    def solve(s: float) -> spm.SolutionSet:
        parameters.append(s)
        return spm.SolutionSet(twice, ("one", "other"), spm.Status.OK)

    tracker = Tracker(watch_of(FREE), solve, solve(0.0), 0, has_legs=False)
    assert not tracker.advance(1.0)
    assert "coincides with another" in tracker.events[-1].detail
    assert len(parameters) < 1_000


@pytest.mark.parametrize(
    ("path", "start", "argument"),
    [
        (stacked(EXAMPLE, EXAMPLE), "FT+", "start"),
        (stacked(EXAMPLE), None, "path"),
        (np.zeros((4, 5)), None, "path"),
        (np.zeros(6), None, "path"),
        (stacked(spm.pose([9, 9, 9], rotation=EXAMPLE.rotation), EXAMPLE), None, "start"),
    ],
)
def test_invalid_paths_are_refused(path: object, start: str | None, argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        follow(PAPER, path, start)  # type: ignore[arg-type]


def test_the_share_of_a_line_in_the_home_mode_is_that_of_the_followed_path() -> None:
    start = spm.inverse_displacement(FREE, in_leg_space(PAPER, 1, seed=3).pose[0]).physical()
    ends = np.random.default_rng(5).uniform(0.2, 3.0, (8, 6))
    ends[0] = 1.05 * start.leg_lengths
    shares = existing_share(functools.partial(spm.forward_physical, FREE), start.leg_lengths, ends)
    for end, share in zip(ends, shares, strict=True):
        path = follow(FREE, np.stack([start.leg_lengths, end]), start, samples=20)
        singular = [*of_kind(path, EventKind.FORWARD_SINGULARITY), path.parameters[-1]]
        assert share <= singular[0] < share + 1.0 / 16**3 + 1e-6 or share == singular[0] == 1.0
        last, found = last_on_line(start, end)
        assert found == share
        np.testing.assert_allclose(last.leg_lengths, start.leg_lengths + share * (end - start.leg_lengths), atol=1e-9)
    assert [share == 1.0 for share in shares] == [True] + 7 * [False]
    finer = existing_share(functools.partial(spm.forward_physical, FREE), start.leg_lengths, ends, parts=64, rounds=2)
    np.testing.assert_allclose(finer, shares, atol=4e-4)


def test_a_followed_path_is_shown_by_its_events() -> None:
    first, second = [1.25, 1.15, 1.40, 1.30, 1.20, 1.40], [1.24, 1.16, 1.40, 1.30, 1.20, 1.41]
    path = follow(PAPER, np.array([first, second]), samples=10)
    assert repr(path) == f"<FollowedPath: complete, {len(path.parameters)} states of T1+/T1+; no events>"
    beyond = follow(PAPER, np.array([first, [0.5, 1.15, 1.4, 1.3, 1.2, 3.0]]), samples=10)
    assert repr(beyond).startswith(f"<FollowedPath: ends at {beyond.parameters[-1]:.4g}, ")


def test_a_path_of_a_machine_as_built_is_followed() -> None:
    built = as_built(PAPER, 1e-3)
    ends = np.array([[1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.3, 1.25, 1.2, 1.2, 1.4, 1.6]])
    by_legs = spm.follow(built, ends, samples=20)
    assert by_legs.complete
    assert [event.kind for event in by_legs.events if "LIMIT" in event.kind.name] == [EventKind.LIMIT]
    lines = ends[0] + by_legs.parameters[:, None] * (ends[1] - ends[0])
    np.testing.assert_allclose(by_legs.configurations.readings, lines, atol=1e-12)
    # The same states along their poses, where the branches are known with their labels.
    poses = by_legs.configurations.pose
    by_poses = spm.follow(built, poses, start=by_legs.configurations[0], samples=20)
    assert by_poses.complete
    np.testing.assert_allclose(by_poses.configurations[-1].readings, ends[1], atol=1e-9)
    # A state of another mode is followed too.
    turned = spm.inverse_displacement(built, EXAMPLE)["FF+"]
    other = spm.follow(built, np.stack([turned.readings, turned.readings + 0.01]), start=turned, samples=5)
    np.testing.assert_allclose(other.configurations[0].middle_joints, turned.middle_joints, atol=1e-12)
