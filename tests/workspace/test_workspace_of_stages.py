"""Volumes, limits of passive joints and conditions of what a stage reaches."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from balancers import MACHINES, existing_states, stage_and_height
from error_fields import with_fields
from kinds_of_legs import sampled_clearance
from scipy import optimize, stats

import spm_pin as spm
from spm_pin.workspace import JointLimits, leg_clearance, orientation_workspace, pose_volume, sample_reachable

BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))


def limited(machine: str) -> tuple[spm.Stage, float, spm.LegLimits]:
    """Return a stage, the height of a level state, and limits around its readings."""
    stage, height = stage_and_height(machine)
    level = spm.inverse_physical(stage, height).readings
    room = 0.3 if stage.unit == "rad" else 0.06 * stage.size
    return stage, height, spm.LegLimits(level - room, level + room)


@pytest.mark.parametrize("machine", ["RPS", "PRS as built", "RRS"])
def test_the_volume_is_that_of_the_heights_and_normals_reached(machine: str) -> None:
    stage, height, limits = limited(machine)
    stage = dataclasses.replace(stage, limits=limits)
    whole = pose_volume(stage, samples=4096, rng=0)
    upper = pose_volume(stage, where=lambda states: states.height > height, samples=4096, rng=0)
    corners = np.stack(np.meshgrid(*stage.reading_limits.T), axis=-1).reshape(-1, 3)
    states = spm.forward_physical(stage, corners)
    low, high, tilt = 0.9 * states.height.min(), 1.1 * states.height.max(), 1.3 * states.tilt.max()
    rng, count = np.random.default_rng(0), 60_000
    heights, cosines = rng.uniform(low, high, count), rng.uniform(np.cos(tilt), 1.0, count)
    azimuths = rng.uniform(-np.pi, np.pi, count)
    reached = spm.inverse_physical(stage, heights, tilt=np.arccos(cosines), azimuth=azimuths)
    counts = reached.exists & (reached.limit_excess == 0.0).all(axis=-1)
    box = (high - low) * 2.0 * np.pi * (1.0 - np.cos(tilt))
    for found, share in ((whole, np.mean(counts)), (upper, np.mean(counts & (heights > height)))):
        error = 4.0 * box * np.sqrt(share / count)
        assert found.low - error < box * share < found.high + error
        assert found.unit == "m sr"
        assert found.high < 1.2 * found.value
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="limits")):
        pose_volume(dataclasses.replace(stage, limits=None))


@pytest.mark.parametrize("machine", MACHINES)
def test_margins_of_passive_joints_are_those_of_angles_and_of_distances_between_legs(machine: str) -> None:
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, 10)
    angles = spm.machine.joint_angles(states)
    limits = JointLimits(hip=(-0.4, 0.5), ball_y=(-0.3, 0.2), clearance=0.01)
    worst = [
        np.minimum(angles.passive + 0.4, 0.5 - angles.passive),
        np.minimum(angles.ball_y + 0.3, 0.2 - angles.ball_y),
    ]
    expected = np.concatenate(worst, axis=-1).min(axis=-1)
    np.testing.assert_allclose(limits.angle_margin(states), expected, atol=1e-12)
    clearance, least = leg_clearance(states), sampled_clearance(states, [(0, 1), (0, 2), (1, 2)])
    assert (clearance <= least + 1e-12).all()
    np.testing.assert_allclose(clearance, least, rtol=2e-3)
    np.testing.assert_allclose(limits.clearance_margin(states), clearance - 0.01)


@pytest.mark.parametrize("machine", ["RPS as built", "RRS"])
def test_the_orientations_at_a_height_are_the_normals_within_the_reach(machine: str) -> None:
    """The solid angle of a star-shaped set of normals is ∫ (1 - cos tilt) dφ over its largest tilts."""
    stage, height, limits = limited(machine)
    for where in (None, JointLimits(ball_y=(-0.2, 0.3))):
        found = orientation_workspace(stage, height, limits, where=where, samples=2000, rng=1)
        within = dataclasses.replace(stage, limits=limits)
        tilts = spm.workspace.reach(within, height, directions=180, where=where).tilts[0]
        angle = 2.0 * np.pi * float(np.mean(1.0 - np.cos(tilts)))
        assert found.volume.low - 0.01 * angle < angle < found.volume.high + 0.01 * angle
        assert found.volume.unit == "sr"
        assert found.share.value == pytest.approx(found.volume.value / (4.0 * np.pi))
        states = found.states
        np.testing.assert_allclose(states.translation[:, 2], height, rtol=1e-9)
        np.testing.assert_allclose(found.weights.sum(), found.volume.value)
        assert limits.contains(states.readings).all()
        ends = np.interp(found.azimuth, np.linspace(-np.pi, np.pi, 181), np.append(tilts, tilts[0]))
        assert (found.tilt <= ends + 0.02).all()
        assert where is None or where(states).all()


@pytest.mark.parametrize("machine", ["RPS", "PRS as built", "RRS as built"])
def test_samples_of_a_stage_are_uniform_in_readings_or_in_heights_and_normals(machine: str) -> None:
    stage, _, limits = limited(machine)
    count, low, high = 2000, np.array(limits.minimum), np.array(limits.maximum)
    drawn = sample_reachable(stage, count, limits, rng=0)
    assert drawn.shape == (count,)
    again = spm.inverse_physical(stage, drawn.height, normal=drawn.normal)
    np.testing.assert_allclose(again.readings, drawn.readings, atol=1e-9 * stage.size)
    for column in ((drawn.readings - low) / (high - low)).T:
        assert stats.kstest(column, "uniform").pvalue > 1e-4
    # From a box of heights and normals, those are kept that the closed form allows.
    rng, number = np.random.default_rng(1), 60_000
    low, high, tilt = 0.98 * drawn.height.min(), 1.02 * drawn.height.max(), 1.3 * drawn.tilt.max()
    heights, cosines = rng.uniform(low, high, number), rng.uniform(np.cos(tilt), 1.0, number)
    azimuths = rng.uniform(-np.pi, np.pi, number)
    boxed = spm.inverse_physical(stage, heights, tilt=np.arccos(cosines), azimuth=azimuths)
    kept = boxed[boxed.exists & limits.contains(boxed.readings)]
    drawn = sample_reachable(stage, count, limits, space="poses", rng=0)
    for first, second in ((drawn.height, kept.height), (drawn.tilt, kept.tilt), (drawn.azimuth, kept.azimuth)):
        assert stats.ks_2samp(first, second).pvalue > 1e-4
    bends = JointLimits(ball_x=(-0.1, 0.1))
    some = sample_reachable(stage, 50, limits, where=bends, rng=0)
    assert some.shape == (50,)
    assert bends(some).all()


def test_the_nearest_tilt_within_limits_of_joints_is_the_best_of_a_search_by_scipy() -> None:
    bends = JointLimits(ball_y=(-0.2, 0.2))
    target = np.array([np.sin(0.5) * np.cos(0.7), np.sin(0.5) * np.sin(0.7), np.cos(0.5)])
    found = spm.workspace.nearest_reachable_pose(BALANCER, 0.12, normal=target, where=bends)
    assert bends(found.configuration)
    assert not found.configuration.limit_excess.any()
    assert found.distance == pytest.approx(float(np.arccos(found.configuration.normal @ target)), abs=1e-9)
    assert found.distance > spm.workspace.nearest_reachable_pose(BALANCER, 0.12, normal=target).distance + 0.05

    def room(x: np.ndarray) -> np.ndarray:
        state = spm.inverse_physical(BALANCER, 0.12, normal=[x[0], x[1], np.sqrt(1.0 - x @ x)])
        assert BALANCER.limits is not None
        readings = [*(state.readings - BALANCER.limits.minimum), *(BALANCER.limits.maximum - state.readings)]
        return np.array([bends.angle_margin(state), *readings])

    ends = []
    for start in ([0.0, 0.0], [0.1, 0.1], [0.1, -0.05]):
        end = optimize.minimize(
            lambda x: -(x @ target[:2] + np.sqrt(1.0 - x @ x) * target[2]),
            start,
            method="SLSQP",
            constraints={"type": "ineq", "fun": room},
            options={"ftol": 1e-14},
        )
        if room(end.x).min() > -1e-8:
            ends.append(float(np.arccos(-end.fun)))
    assert min(ends) == pytest.approx(found.distance, abs=2e-6)


def test_what_a_stage_does_not_have_is_refused_with_the_name_of_what_answers() -> None:
    for name, arguments, answer in (
        ("reachable_boundary", (), "workspace.reach"),
        ("reachable_position", ([0.0, 0.0, 0.1],), "workspace.reach"),
        ("reachable_volume", (), "workspace.pose_volume"),
    ):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="machine", received="Stage")) as caught:
            getattr(spm.workspace, name)(BALANCER, *arguments)
        assert answer in caught.value.cause


def test_the_reach_ends_where_a_condition_does() -> None:
    joints = JointLimits(ball_y=(-0.25, 0.25))

    def where(states: spm.Configuration) -> np.ndarray:
        return np.asarray(joints.angle_margin(states) >= 0.0)

    free = spm.workspace.reach(BALANCER, 0.12, directions=12)
    found = spm.workspace.reach(BALANCER, 0.12, directions=12, where=where)
    assert (found.tilts <= free.tilts).all()
    assert (found.tilts < free.tilts - 1e-3).any()
    shorter = found.tilts[0] < free.tilts[0] - 1e-9
    for beyond, counts in ((-1e-9, True), (1e-9, False)):
        states = spm.inverse_physical(BALANCER, 0.12, tilt=found.tilts[0] + beyond, azimuth=found.azimuths)
        np.testing.assert_array_equal(where(states)[shorter], counts)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="where")):
        spm.workspace.reach(BALANCER, 0.12, where=lambda states: states.tilt)
    payload = spm.sweeps.METRICS["payload_down"](push=0.25)
    level = spm.inverse_physical(BALANCER, 0.12).readings[None]
    least = 0.97 * float(payload.evaluate(spm.sweeps.Points(BALANCER, "legs", level))[0])
    held = spm.workspace.reach(BALANCER, 0.12, directions=12, where=spm.sweeps.condition(payload, least=least))
    ends = spm.inverse_physical(BALANCER, 0.12, tilt=held.tilts[0], azimuth=held.azimuths)
    efforts = np.abs(spm.leg_forces(ends, [0, 0, -least, 0, 0, 0])).max(axis=-1)
    assert efforts.max() == pytest.approx(0.25, rel=1e-6)
    assert (held.tilts < free.tilts - 0.01).any()


def test_tilts_are_reachable_within_limits_of_legs_and_of_joints() -> None:
    rng = np.random.default_rng(1)
    heights, azimuths, tilts = rng.uniform(0.09, 0.15, 40), rng.uniform(-np.pi, np.pi, 40), rng.uniform(0.0, 0.6, 40)
    joints = JointLimits(ball_y=(-0.3, 0.3))
    for stage in (BALANCER, BALANCER.perturbed(1, length=1e-3, angle=1e-2)):
        answer = spm.workspace.reachable(stage, heights, tilt=tilts, azimuth=azimuths, joints=joints)
        states = spm.inverse_physical(stage, heights, tilt=tilts, azimuth=azimuths)
        bent = np.abs(spm.machine.joint_angles(states).ball_y).max(axis=-1)
        expected = states.exists & (states.limit_excess == 0.0).all(axis=-1) & (bent <= 0.3)
        assert 0 < np.count_nonzero(expected) < 40
        np.testing.assert_array_equal(answer.reachable, expected)
        np.testing.assert_array_equal(answer.branch, np.where(expected, 0, -1))
        np.testing.assert_allclose(answer.configuration.readings[expected], states.readings[expected], atol=1e-12)
        single = spm.workspace.reachable(stage, heights[0], tilt=tilts[0], azimuth=azimuths[0], joints=joints)
        assert single.reachable is bool(expected[0])
    modes = spm.workspace.reachable(BALANCER, 0.12, branch="any").allowed
    np.testing.assert_array_equal(modes, [True, False])
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="branch")):
        spm.workspace.reachable(BALANCER, 0.12, branch="TT+")
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="limits")):
        spm.workspace.reachable(BALANCER, 0.12, limits=spm.LegLimits.stages((0.1, 0.2), (0.1, 0.3)))
