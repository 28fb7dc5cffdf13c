"""Paths between states of the physical mode."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from motion.example_paths import GOAL, PAPER, START

import spm_pin as spm
from spm_pin.motion import LegPath, MotionPlan
from spm_pin.workspace import JointLimits, leg_clearance

OF_START = spm.inverse_displacement(PAPER, spm.forward_physical(PAPER, START).pose)
ANOTHER_BRANCH = next(OF_START[label] for label in OF_START.labels if OF_START[label].exists and label != "TT+")


def check(found: MotionPlan, limits: spm.LegLimits, start: object, goal: object, samples: int = 400) -> None:
    """Samples of a plan keep the limits, move little from one to the next, and never cross a singularity."""
    states = found.configurations(samples)
    assert states.exists.all()
    assert (limits.margin(states.readings) > -1e-9).all()
    np.testing.assert_allclose(states.readings[[0, -1]], [start, goal], atol=1e-12)
    signs = np.sign(spm.determinants(states)[:, :2])
    assert (signs == signs[0]).all()
    moves = np.abs(np.diff(states.middle_joints, axis=0)).max()
    assert moves < 0.1 * found.machine.nominal.middle_side


def test_a_straight_line_is_taken_where_it_is_safe() -> None:
    found = spm.plan(PAPER, START, GOAL)
    assert found.method == "straight in leg lengths"
    assert isinstance(found.path, LegPath)
    np.testing.assert_allclose(found.path(0.25).lengths, 0.75 * np.array(START) + 0.25 * np.array(GOAL))
    assert found.reason == ""
    assert not found.certified
    check(found, spm.LegLimits(1.1, 1.5), START, GOAL)


def test_a_machine_as_built_is_planned_for_by_its_readings() -> None:
    machine = PAPER.perturbed(1, length=5e-3, angle=5e-3)
    limits = JointLimits(hip=(-1.2, 1.2), clearance=0.05)
    for line, goal in (("legs", GOAL), ("poses", [1.22, 1.22, 1.42, 1.3, 1.2, 1.45])):
        found = spm.plan(machine, START, goal, joint_limits=limits, line=line)
        check(found, spm.LegLimits(1.1, 1.5), START, goal)
        states = found.configurations(50)
        assert states.machine == machine
        assert (limits.angle_margin(states) > 0.0).all()
        assert (leg_clearance(states) > 0.05).all()
    wide, apart = spm.LegLimits(0.7, 1.9), JointLimits(clearance=0.415)
    near = PAPER.perturbed(1, length=1e-4, angle=1e-4)
    around = spm.plan(near, *NARROW, wide, joint_limits=apart, margin=0.0)
    assert around.method == "around"
    check(around, wide, *NARROW)
    assert (apart.clearance_margin(around.configurations(1000)) > -1e-4).all()
    certificate = spm.certify(PAPER, spm.LegLimits(1.1, 1.5), length_error=3e-4, angle_error=3e-4)
    assert spm.plan(near, START, GOAL, certificate=certificate).certified
    assert spm.plan(near, START, GOAL, certificate=spm.certify(near)).certified
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="certificate")):
        spm.plan(machine, START, GOAL, certificate=certificate)
    state = spm.forward_physical(PAPER, START)
    with pytest.raises(spm.GeometryError, check=with_fields(argument="start")):
        spm.plan(machine, state, GOAL)


def test_configurations_poses_and_lengths_are_places() -> None:
    start, goal = (spm.forward_physical(PAPER, lengths) for lengths in (START, GOAL))
    for first, last in ((start, goal), (start.pose, goal.pose), (START, goal)):
        found = spm.plan(PAPER, first, last)
        np.testing.assert_allclose(found.configurations(2).readings, [START, GOAL], atol=1e-9)


def test_states_and_certificates_of_the_machine_with_other_limits_are_of_the_same_machine() -> None:
    limits = spm.LegLimits(1.1, 1.5)
    bare = spm.Manipulator(*PAPER.dimensions)
    start, goal = (spm.forward_physical(bare, lengths) for lengths in (START, GOAL))
    assert start.machine != PAPER
    certificate = spm.certify(bare, limits)
    for line in ("legs", "poses"):
        found = spm.plan(PAPER, start, goal, limits, line=line, certificate=certificate)
        assert found.machine == PAPER
        assert found.certified is found.exists
    narrow = spm.certify(PAPER, spm.LegLimits(1.1, 1.45))
    assert not spm.plan(PAPER, START, GOAL, limits, certificate=narrow).certified
    assert spm.plan(PAPER, start, GOAL).exists
    other = spm.forward_physical(spm.Manipulator(0.5, 0.5, 0.6), [0.8] * 6)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="start")):
        spm.plan(PAPER, other, GOAL)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="certificate")):
        spm.plan(spm.Manipulator(0.5, 0.5, 0.6), [0.8] * 6, [0.7] * 6, certificate=certificate)


def test_via_points_are_passed() -> None:
    via = [[1.3, 1.4, 1.2, 1.3, 1.3, 1.3], [1.45, 1.3, 1.25, 1.2, 1.4, 1.3]]
    found = spm.plan(PAPER, START, GOAL, via=via)
    assert isinstance(found.path, LegPath)
    points = found.path(found.path.knots).lengths
    for place in via:
        assert np.abs(points - place).max(axis=-1).min() < 1e-12
    check(found, spm.LegLimits(1.1, 1.5), START, GOAL)


NARROW = ([1.295, 1.741, 1.194, 0.991, 1.063, 1.415], [0.835, 0.836, 1.872, 1.229, 1.239, 0.711])
"""Lengths between which, in a straight line, legs come nearer to each other than at either end."""


def test_a_leg_path_is_smooth_and_stays_between_its_points() -> None:
    points = np.random.default_rng(4).uniform(1.1, 1.5, (7, 6))
    path = LegPath(points)
    np.testing.assert_allclose(path(path.knots).lengths, points, atol=1e-14)
    s = np.linspace(0.0, 1.0, 20_001)
    motion = path(s)
    part = np.clip(np.searchsorted(path.knots, s, side="right") - 1, 0, 5)
    low, high = np.minimum(points[:-1], points[1:])[part], np.maximum(points[:-1], points[1:])[part]
    assert ((motion.lengths >= low - 1e-14) & (motion.lengths <= high + 1e-14)).all()
    # The derivatives are those of the lengths, and continuous.
    for values, derivative in ((motion.lengths, motion.first), (motion.first, motion.second)):
        slopes = (values[2:] - values[:-2]) / (s[2] - s[0])
        np.testing.assert_allclose(slopes, derivative[1:-1], atol=2e-3 * np.abs(derivative).max())
    # A straight line between two points.
    line = LegPath(points[:2])(s)
    np.testing.assert_allclose(line.first, np.broadcast_to(points[1] - points[0], line.first.shape), atol=1e-13)
    np.testing.assert_allclose(line.second, 0.0, atol=1e-12)


def test_a_way_around_keeps_the_clearance_that_the_line_breaks() -> None:
    limits, joints = spm.LegLimits(0.7, 1.9), JointLimits(clearance=0.415)
    pair = spm.forward_physical(PAPER, NARROW)
    assert leg_clearance(pair).min() > 0.415 > leg_clearance(spm.forward_physical(PAPER, np.linspace(*NARROW))).min()
    found = spm.plan(PAPER, *NARROW, limits, joint_limits=joints, margin=0.0)
    assert found.method == "around"
    assert "too near" in found.reason
    check(found, limits, *NARROW)
    assert (joints.clearance_margin(found.configurations(1000)) > -1e-4).all()
    # The search depends on its seed alone.
    again = spm.plan(PAPER, *NARROW, limits, joint_limits=joints, margin=0.0)
    np.testing.assert_array_equal(found.configurations(50).middle_joints, again.configurations(50).middle_joints)
    none = spm.plan(PAPER, *NARROW, limits, joint_limits=joints, margin=0.0, tries=0)
    assert not none.exists
    assert "no way around was found in 0 steps" in none.reason
    with pytest.raises(spm.ArgumentError, match="too near"):
        none.configurations()


def test_a_line_of_poses_turns_about_one_axis_and_passes_no_inverse_singularity() -> None:
    start, goal = (spm.forward_physical(PAPER, lengths) for lengths in (START, [1.22, 1.22, 1.42, 1.3, 1.2, 1.45]))
    found = spm.plan(PAPER, start, goal, line="poses")
    assert found.method == "straight in poses"
    states = found.configurations(11)
    line = np.linspace(start.translation, goal.translation, 11)
    np.testing.assert_allclose(states.translation, line, atol=1e-12)
    turns = (states.pose.rotation * start.pose.rotation.inv()).as_rotvec()
    np.testing.assert_allclose(turns, np.linspace(0.0, 1.0, 11)[:, None] * turns[-1], atol=1e-9)
    # From a tilt to the opposite one: level in between, where det K is zero.
    ends = spm.forward_physical(PAPER, [[1.3, 1.3, 1.4, 1.3, 1.3, 1.4], [1.4, 1.4, 1.3, 1.4, 1.4, 1.3]])
    assert not spm.plan(PAPER, ends[0], ends[1], line="poses").exists
    assert spm.plan(PAPER, ends[0], ends[1]).exists


def test_the_reason_against_a_line_of_poses_is_what_it_meets_first() -> None:
    rest = spm.forward_physical(PAPER, [1.3] * 6)
    pick = spm.forward_physical(PAPER, [1.46, 1.16, 1.27, 1.32, 1.14, 1.47])
    place = spm.forward_physical(PAPER, [1.23, 1.20, 1.15, 1.26, 1.21, 1.34])
    level = spm.plan(PAPER, rest, pick, line="poses").reason
    assert level == "the line of poses meets an inverse singularity, or what is out of reach, at 0 %"
    for start, goal in ((pick, place), (place, rest)):
        reason = spm.plan(PAPER, start, goal, line="poses").reason
        assert "r_c2 of 1.099 m is outside its limits" in reason
        assert "singularity" not in reason


@pytest.mark.parametrize(
    ("start", "goal", "options", "argument"),
    [
        ([1.6, 1.2, 1.4, 1.25, 1.2, 1.5], GOAL, {}, "start"),
        (START, [1.4, 1.2, 1.2, 1.2, 1.5, 1.0], {}, "goal"),
        (START, START, {}, "goal"),
        (START, [0.3, 0.3, 3.0, 1.2, 1.2, 1.2], {}, "goal"),
        (ANOTHER_BRANCH, GOAL, {}, "start"),
        ([1.3] * 6, GOAL, {"joint_limits": JointLimits(hip=(-0.02, 0.02))}, "goal"),
        (START, GOAL, {"margin": 2.0}, "start"),
        (START, GOAL, {"via": [1.3, 1.4, 1.2, 1.3, 1.3, 1.3]}, "via"),
    ],
)
def test_places_that_cannot_be_planned_to_are_named(
    start: object, goal: object, options: dict[str, object], argument: str
) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        spm.plan(PAPER, start, goal, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("machine", "count"),
    [(PAPER, 15), (spm.Manipulator(0.5, 0.5, 0.6), 15), pytest.param(PAPER, 150, marks=pytest.mark.slow)],
)
def test_random_pairs_have_a_plan_or_a_reason(machine: spm.Manipulator, count: int) -> None:
    rng = np.random.default_rng(count)
    size = machine.base_radius + machine.middle_side
    limits = spm.LegLimits(0.6 * size, 1.3 * size)
    starts, goals = (spm.forward_physical(machine, rng.uniform(0.6, 1.3, (count, 6)) * size) for _ in range(2))
    planned = eligible = 0
    for start, goal in zip(starts, goals, strict=True):
        if not (start.exists and goal.exists):
            continue
        least = min(np.abs(spm.determinants(state)[:2]).min() for state in (start, goal))
        if least < 0.05 * machine.middle_side**3:
            with pytest.raises(spm.ArgumentError, match="forward singularity"):
                spm.plan(machine, start, goal, limits)
            continue
        eligible += 1
        found = spm.plan(machine, start, goal, limits)
        assert found.exists or "%" in found.reason
        if found.exists:
            planned += 1
            check(found, limits, start.readings, goal.readings)
            assert found.margin > 0.05 - 1e-9
    assert planned >= 0.95 * eligible > 0
