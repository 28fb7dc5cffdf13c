"""The reachable set, for legs of each kind: against the forward displacement, differences, and random readings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from kinds_of_legs import machine_of_kinds, sampled_clearance
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.machine import LegLimits
from spm_pin.workspace import leg_clearance, nearest_reachable_pose, pose_distance, reachable, reachable_position
from spm_pin.workspace.state_set import StateSet, states_within

LIMITS = {"RPS": (1.1, 1.5), "PRS": (-0.5, 0.1), "RRS": (0.2, 1.2), "PRS hanging": (2.4, 3.0)}
MACHINES = [
    *(("RPS", "RPS", True), ("PRS", "PRS", False)),
    *(("RRS", "PRS", True), ("RPS", "RRS", True), ("PRS hanging", "PRS hanging", True)),
]
NAMES = [f"{lower} and {upper}{', calibrated' * built}" for lower, upper, built in MACHINES]


def limited(lower: str, upper: str, built: bool) -> spm.Manipulator:
    return dataclasses.replace(
        machine_of_kinds(lower, upper, built=built), limits=LegLimits.stages(LIMITS[lower], LIMITS[upper])
    )


@pytest.fixture(scope="module", params=MACHINES, ids=NAMES)
def machine(request: pytest.FixtureRequest) -> spm.Manipulator:
    return limited(*request.param)


@pytest.fixture(scope="module")
def within(machine: spm.Manipulator) -> StateSet:
    return states_within(machine)


def random_states(machine: spm.Manipulator, count: int, seed: int) -> spm.Configuration:
    """Return states at readings drawn uniformly, which no search has seen; some have legs at limits."""
    assert machine.limits is not None
    rng = np.random.default_rng(seed)
    share = rng.uniform(size=(60 * count, 6))
    share = np.where((rng.random((len(share), 1)) < 0.25) & (rng.random(share.shape) < 0.5), share.round(), share)
    low, high = np.array([machine.limits.minimum, machine.limits.maximum])
    readings = low + share * (high - low)
    found = spm.forward_physical(machine, readings)
    return found[found.exists][:count]


def test_coordinates_are_those_of_the_forward_displacement(machine: spm.Manipulator, within: StateSet) -> None:
    states = random_states(machine, 50, 1)
    coordinates = within.coordinates(states)
    np.testing.assert_allclose(within.readings(coordinates), states.readings, atol=1e-9)
    again = within.states(coordinates)
    np.testing.assert_allclose(again.translation, states.translation, atol=1e-12)
    np.testing.assert_allclose(again.rotation, states.rotation, atol=1e-12)
    np.testing.assert_allclose(again.balls, states.balls, atol=1e-12)
    joints = within.positions(coordinates, machine.platform_joints).reshape(-1, 3, 3)
    for k, joint in enumerate(machine.platform_joints):
        np.testing.assert_allclose(joints[:, k], states.pose.apply(joint), atol=1e-12)


def test_readings_of_reachable_positions_assemble_beside_a_fold_too() -> None:
    machine = limited("RRS", "PRS", True)
    points = random_states(machine, 40, 3).translation
    reach = reachable_position(machine, points)
    assert reach.reachable.all()
    found = spm.forward_physical(machine, reach.readings)
    within = states_within(machine)
    lower = within.stages(0, within.coordinates(found)[:, 0])
    assert lower.determinant.min() == pytest.approx(1e-6, rel=0.01), "one search ends beside the fold"
    np.testing.assert_allclose(found.translation, points, rtol=0.0, atol=1e-8)


def test_the_set_holds_what_is_physical_within_the_limits_and_within_reach(
    machine: spm.Manipulator, within: StateSet
) -> None:
    assert machine.limits is not None
    rng = np.random.default_rng(2)
    coordinates = within.sample[:1500] + rng.normal(0.0, 0.15, (1500, 2, 3))
    coordinates = coordinates[(np.hypot(coordinates[..., 0], coordinates[..., 1]) < 0.99).all(axis=-1)]
    states = within.states(coordinates)
    expected = states.is_at_home & machine.limits.contains(states.readings)
    held = within.contains(0, coordinates[:, 0]) & within.contains(1, coordinates[:, 1])
    assert 0.05 < held.mean() < 0.95
    np.testing.assert_array_equal(held, expected)
    slopes = states[held].slopes * machine.legs.slope_signs
    assert slopes.min() > 0.0


def test_derivatives_are_those_by_differences(within: StateSet) -> None:
    from spm_pin.kinematics.kernels.stage_states import SLOPE_NUMBERS, STAGE_NUMBERS, stage_states

    for stage, upward in ((0, 1.0), (1, -1.0)):
        coordinates = within.sample[:200, stage]
        states = within.states(within.sample[:200])
        # Nearer to its own singularity a leg's rates are bounded.
        regular = np.abs(states.slopes) > 0.2 * within.machine.legs.largest_slopes
        coordinates = coordinates[regular[:, 3 * stage : 3 * stage + 3].all(axis=-1)]
        assert len(coordinates) > 20
        count = len(coordinates)

        def run(c: np.ndarray, stage: int = stage, upward: float = upward, n: int = count) -> tuple[np.ndarray, ...]:
            values, slopes = np.empty((n, STAGE_NUMBERS)), np.empty((n, SLOPE_NUMBERS, 3))
            places = np.empty(n, dtype=np.int64)
            stage_states(c, within.legs[stage], within.radius, upward, 2.0, values, slopes, places)
            return values, slopes

        for k in range(3):
            step = 1e-6 * np.eye(3)[k]
            change = (run(coordinates + step)[0] - run(coordinates - step)[0]) / 2e-6
            np.testing.assert_allclose(run(coordinates)[1][:, 3:, k], change[:, 9:], rtol=1e-6, atol=1e-6)


def test_positions_of_random_readings_are_reachable_and_the_readings_found_lead_there(
    machine: spm.Manipulator,
) -> None:
    assert machine.limits is not None
    states = random_states(machine, 25, 3)
    away = states.translation + np.random.default_rng(4).normal(0.0, 0.3, (len(states), 3))
    for points, all_reached in ((states.translation, True), (away, False)):
        reach = reachable_position(machine, points)
        assert reach.reachable.all() or not all_reached
        assert machine.limits.contains(reach.readings).all()
        # The nearest of the others may be beside a forward singularity, where rounding decides what is physical.
        there = spm.forward_physical(machine, reach.readings[reach.reachable]).translation
        np.testing.assert_allclose(there, points[reach.reachable], atol=1e-6)


def test_no_state_that_a_random_search_finds_is_nearer_than_the_nearest(machine: spm.Manipulator) -> None:
    assert machine.limits is not None
    rng, states = np.random.default_rng(5), random_states(machine, 2, 6)
    for pose in states.pose:
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)) * pose.rotation
        target = spm.pose(pose.translation + rng.normal(0.0, 0.3, 3), rotation=turn)
        found = nearest_reachable_pose(machine, target)
        state = found.configuration
        assert machine.limits.contains(state.readings)
        assert state.is_at_home
        assert (state.slopes * machine.legs.slope_signs > 0.0).all()
        steps = rng.normal(0.0, 1.0, (2000, 6)) * np.geomspace(1e-4, 0.4, 2000)[:, None]
        readings = np.clip(state.readings + steps, machine.limits.minimum, machine.limits.maximum)
        others = spm.forward_physical(machine, readings)
        others = others[others.exists]
        assert found.distance < pose_distance(machine, others.pose, target).min() + 2e-5


def test_a_reachable_pose_is_said_to_be_one(machine: spm.Manipulator) -> None:
    states = random_states(machine, 20, 7)
    answer = reachable(machine, states.pose)
    # With all legs of a stage at one limit the pose is degenerate.
    assert (answer.reachable | answer.undecided).all()
    assert answer.reachable.mean() > 0.9
    assert nearest_reachable_pose(machine, states.pose[0]).distance < 1e-7


def test_the_distance_of_legs_is_that_of_points_along_them(machine: spm.Manipulator) -> None:
    states = random_states(machine, 5, 8)
    apart = sampled_clearance(states, [(i, j) for i in range(6) for j in range(i + 1, 6) if j != i + 3])
    assert (leg_clearance(states) <= apart + 1e-12).all()
    np.testing.assert_allclose(leg_clearance(states), apart, atol=0.03)


def test_limits_of_angles_have_to_be_finite() -> None:
    machine = machine_of_kinds("RRS", "RRS")
    with pytest.raises(spm.ArgumentError, match="finite minimum and maximum"):
        reachable_position(machine, [0.0, 0.0, 1.5], LegLimits(-np.inf, 1.0))
