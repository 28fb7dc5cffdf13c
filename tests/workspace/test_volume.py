"""Volumes of positions, of poses, and of the orientations at a position."""

from __future__ import annotations

import numpy as np
import pytest
from problems import PAPER
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.crosscheck.paper_shell import workspace_shell
from spm_pin.workspace import orientation_workspace, reachable, reachable_boundary
from spm_pin.workspace.positions import (
    ROTATIONS,
    Estimate,
    _with_condition,
    pose_volume,
    reachable_volume,
    tilt_torsion,
)
from spm_pin.workspace.search import search_states
from spm_pin.workspace.state_set import states_within

NARROW = spm.LegLimits(1.2, 1.4)


def overlap(first: Estimate, second: Estimate) -> bool:
    """Test whether the intervals of two estimates have a number in common."""
    return first.low <= second.high and second.low <= first.high


def test_two_methods_agree_on_the_volume() -> None:
    sampled = reachable_volume(PAPER, NARROW, samples=600, rng=1)
    meshed = reachable_volume(PAPER, NARROW, method="mesh", spacing=0.25)
    assert overlap(sampled, meshed)
    assert sampled.unit == meshed.unit == "m³"
    assert 0.0 < sampled.low < sampled.value < sampled.high
    assert sampled.high - sampled.low < 0.3 * sampled.value
    assert np.isnan(meshed.confidence)
    assert str(Estimate(1.859, 1.853, 1.865, 0.95, "mesh", "m³").times(100.0, "")) == "185.9 [185.3, 186.5]"


def test_a_volume_scales_with_the_cube_of_the_machine() -> None:
    small = spm.Manipulator(0.1 * PAPER.base_radius, 0.1 * PAPER.platform_radius, 0.1 * PAPER.middle_side)
    metres = reachable_volume(PAPER, NARROW, samples=60, rng=2)
    tenth = reachable_volume(small, spm.LegLimits(0.12, 0.14), samples=60, rng=2)
    assert tenth.value == pytest.approx(1e-3 * metres.value, rel=0.02)


def test_intervals_cover_the_truth_at_the_stated_rate() -> None:
    rng = np.random.default_rng(5)
    truth = 0.03
    hits = rng.binomial(400, truth, 200)
    shares = [Estimate.from_hits(int(k), 400, 1.0, 0.9, "", "") for k in hits]
    # Clopper and Pearson's are never too short.
    assert np.mean([estimate.low <= truth <= estimate.high for estimate in shares]) >= 0.87
    means = [Estimate.from_mean(rng.exponential(2.0, 400), 3.0, 0.9, "", "") for _ in range(500)]
    assert 0.85 < np.mean([estimate.low <= 6.0 <= estimate.high for estimate in means]) < 0.95


@pytest.mark.slow
def test_the_reachable_volume_is_more_than_a_tenth_larger_than_the_shell() -> None:
    sampled = reachable_volume(PAPER, samples=20_000, rng=7)
    meshed = reachable_volume(PAPER, method="mesh", spacing=0.1)
    assert overlap(sampled, meshed)
    shell = workspace_shell(PAPER)
    for estimate in (sampled, meshed):
        ratio = estimate.times(1.0 / shell.volume, "")
        assert ratio.low > 1.10
        assert ratio.high < 1.16


def test_volumes_with_a_condition_are_shares_of_the_whole() -> None:

    def is_low(states: spm.Configuration) -> np.ndarray:
        return np.asarray(states.translation[:, 2] < 2.3)

    whole = reachable_volume(PAPER, NARROW, samples=60, rng=1)
    low, high = (
        reachable_volume(PAPER, NARROW, samples=60, rng=1, where=where)
        for where in (is_low, lambda states: ~is_low(states))
    )
    # The level is one of the position: a point counts for one of them. Points that do not count widen the interval.
    assert low.value + high.value == pytest.approx(whole.value, rel=1e-12)
    assert low.high == pytest.approx(whole.high)
    # A function of states is never given none of them.
    sizes: list[int] = []
    reachable_volume(PAPER, NARROW, samples=20, rng=1, where=lambda each: sizes.append(len(each.exists)) or each.exists)
    assert sizes
    assert min(sizes) > 0
    poses = pose_volume(PAPER, NARROW, samples=2_000, rng=2)
    parts = [pose_volume(PAPER, NARROW, samples=2_000, rng=2, where=w) for w in (is_low, lambda s: ~is_low(s))]
    assert sum(part.value for part in parts) == pytest.approx(poses.value, rel=1e-12)
    assert pose_volume(PAPER, NARROW, rng=2, where=lambda s: s.translation[:, 2] > 9.0).value == 0.0


def test_a_position_counts_if_one_of_its_states_satisfies_the_condition() -> None:
    """At a few positions many states are drawn by another function: where one counts, the search finds one as well."""
    states = states_within(PAPER, NARROW)
    points = states.positions(states.draw(12, np.random.default_rng(3)))
    drawn = [spm.workspace.orientation_workspace(PAPER, o, NARROW, samples=400, rng=4).states for o in points]
    tilts = [np.degrees(np.arccos(each.rotation[:, 2, 2])) for each in drawn]

    def is_level(each: spm.Configuration) -> np.ndarray:
        return np.asarray(each.rotation[:, 2, 2] > np.cos(np.deg2rad(20.0)))

    expected = np.array([(tilt < 20.0).any() for tilt in tilts])
    found = _with_condition(states, points, search_states(states, points), is_level, np.random.default_rng(5))
    assert 0 < expected.sum() < 12
    assert found[expected].all()
    # What is found is proved by a state; what has none is not.
    assert not found[[len(tilt) > 20 and tilt.min() > 25.0 for tilt in tilts]].any()
    with pytest.raises(spm.ArgumentError, match="booleans"):
        reachable_volume(PAPER, NARROW, samples=20, rng=0, where=lambda each: each.leg_lengths)


def test_conditions_of_metrics_hold_where_the_metric_is_within_the_bounds() -> None:
    states = spm.forward_physical(PAPER, np.random.default_rng(0).uniform(1.2, 1.4, (50, 6)))
    singular = spm.kinematics.singular_values(
        spm.kinematics.platform_jacobian(states) * np.repeat([1.0, PAPER.platform_radius], 3)[:, None]
    )
    inverse_condition = singular[:, -1] / singular[:, 0]
    found = spm.sweeps.condition("conditioning", least=0.01, most=0.02)(states)
    np.testing.assert_array_equal(found, (inverse_condition >= 0.01) & (inverse_condition <= 0.02))
    assert spm.sweeps.condition("conditioning", least=0.01, most=0.02)(states[3]) == found[3]
    for wrong in ({"least": 2.0, "most": 1.0}, {}):
        with pytest.raises(spm.ArgumentError, match="least"):
            spm.sweeps.condition("conditioning", **wrong)


def test_intervals_of_rare_conditions_cover() -> None:
    """About 3 of 2000 states count: Student's interval holds the truth, from 10⁶ states, in 69 of 100."""

    def where(states: spm.Configuration) -> np.ndarray:
        return np.asarray(states.translation[:, 2] < 2.0)

    truth = 9.2e-7  # to 7 %
    found = [pose_volume(PAPER, where=where, samples=2000, rng=k) for k in range(25)]
    assert sum(estimate.low <= truth <= estimate.high for estimate in found) >= 22
    # Nothing is covered by an end that says nothing.
    assert np.median([estimate.high for estimate in found]) < 5.0 * truth
    assert " of 2000 states count" in found[0].method
    nowhere = pose_volume(PAPER, where=lambda states: states.translation[:, 2] > 9.0, samples=2000, rng=0)
    assert nowhere.low == nowhere.value == 0.0 < nowhere.high < 2.0 * truth


# --- Orientations at a position --------------------------------------------------------------------------------------


def test_tilt_and_torsion_are_those_of_the_rotation() -> None:
    rng = np.random.default_rng(1)
    azimuth, torsion = rng.uniform(-np.pi, np.pi, (2, 200))
    tilt = np.arccos(rng.uniform(-0.999, 0.999, 200))
    angles = np.stack([azimuth, tilt, torsion - azimuth], axis=-1)
    found = tilt_torsion(Rotation.from_euler("ZYZ", angles).as_matrix())
    for angle, expected in zip(found, (azimuth, tilt, torsion), strict=True):
        np.testing.assert_allclose(np.exp(1j * angle), np.exp(1j * expected), atol=1e-9)
    # Upright there is no azimuth, but a torsion.
    _, level, turned = tilt_torsion(Rotation.from_euler("z", 0.3).as_matrix())
    assert level == 0.0
    assert turned == pytest.approx(0.3)


def test_the_volume_is_that_of_uniform_orientations() -> None:
    """In a box of tilt and torsion that holds all that was found; the inverse displacement alone decides there."""
    position = (0.3, 0.1, 2.45)
    answer = orientation_workspace(PAPER, position, samples=5_000, rng=2)
    assert answer.weights.sum() == pytest.approx(answer.volume.value)
    np.testing.assert_allclose(
        answer.states.translation, np.broadcast_to(position, (len(answer.weights), 3)), atol=1e-8
    )
    assert reachable(PAPER, answer.states.pose).reachable.mean() > 0.999

    # Around where the normal leans to, in the plane of its horizontal part; d(n_x) d(n_y) = cos θ sin θ dφ dθ.
    normal = answer.states.rotation[:, :2, 2]
    low, high = normal.min(axis=0), normal.max(axis=0)
    pad = 0.1 * (high - low)
    low, high = low - pad, high + pad
    twist = 1.1 * np.abs(answer.torsion).max()
    rng, count = np.random.default_rng(3), 30_000
    lean = rng.uniform(low, high, (count, 2))
    tilt = np.arcsin(np.linalg.norm(lean, axis=-1))
    azimuth, torsion = np.arctan2(lean[:, 1], lean[:, 0]), rng.uniform(-twist, twist, count)
    rotation = Rotation.from_euler("ZYZ", np.stack([azimuth, tilt, torsion - azimuth], axis=-1))
    hit = reachable(PAPER, spm.pose(position, rotation=rotation)).reachable
    density = np.where(hit, 1.0 / np.cos(tilt), 0.0)
    region = float((high - low).prod() * 2.0 * twist)
    assert hit.sum() > 50
    share = spm.workspace.Estimate.from_hits(
        int(hit.sum()), count, region * density.sum() / hit.sum(), 0.999, "", "rad³"
    )
    assert overlap(share, answer.volume)


def test_the_largest_tilt_in_each_sector() -> None:
    answer = orientation_workspace(PAPER, [0.02, 0.03, 2.5], samples=3000, rng=4)
    azimuth, largest = answer.largest_tilt(12)
    assert azimuth.shape == largest.shape == (12,)
    assert np.diff(azimuth) == pytest.approx(np.pi / 6)
    sector = np.floor((answer.azimuth + np.pi) / (np.pi / 6)).astype(int).clip(0, 11)
    for k in range(12):
        mine = answer.tilt[sector == k]
        assert np.isnan(largest[k]) if not len(mine) else largest[k] == mine.max()
    assert np.nanmax(largest) == answer.tilt.max()
    assert answer.share.value == pytest.approx(answer.volume.value / ROTATIONS)


def test_on_the_axis_the_platform_is_level_whatever_the_lower_stage() -> None:
    answer = orientation_workspace(PAPER, [0.0, 0.0, 2.5], samples=500, rng=5)
    assert len(answer.weights) > 100
    assert max(np.abs(answer.tilt).max(), np.abs(answer.torsion).max()) < 1e-12
    assert answer.volume.high < 1e-20


def test_poses_out_of_reach_have_no_branches() -> None:
    answer = orientation_workspace(PAPER, [0.0, 0.0, 5.0], samples=100, rng=6)
    assert answer.volume.value == answer.volume.low == 0.0
    assert answer.states.shape == answer.tilt.shape == (0,)
    assert np.isnan(answer.largest_tilt(4)[1]).all()


@pytest.mark.slow
def test_volumes_and_boundaries_of_small_errors_are_nearly_those_of_the_drawing() -> None:
    small = PAPER.perturbed(7, length=1e-4, angle=1e-4)
    volumes = [reachable_volume(machine, samples=3000, rng=8) for machine in (PAPER, small)]
    assert volumes[1].value == pytest.approx(volumes[0].value, rel=0.02)
    limits = spm.LegLimits(1.1, 1.5)
    poses = [pose_volume(machine, limits, samples=2000, rng=9) for machine in (PAPER, small)]
    assert poses[1].value == pytest.approx(poses[0].value, rel=0.05)
    turns = [orientation_workspace(machine, [0.3, 0.1, 2.45], samples=1500, rng=9).volume for machine in (PAPER, small)]
    assert turns[1].value == pytest.approx(turns[0].value, rel=0.1)
    built = PAPER.perturbed(3, length=5e-3, angle=5e-3)
    boundary = reachable_boundary(built, spacing=0.6)
    states = spm.forward_physical(built, boundary.readings)
    assert np.abs(states.translation - boundary.vertices).max() < 1e-5
    assert ((boundary.readings == 1.1) | (boundary.readings == 1.5)).any(axis=-1).all()
    points = boundary.sample(20, rng=1)
    assert points.violation.max() < 1e-6
