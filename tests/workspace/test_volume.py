from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES
from workspace.intervals import overlap

import spm_pin as spm
from spm_pin.workspace.paper_shell import workspace_shell
from spm_pin.workspace.positions import Estimate, _with_condition, pose_volume, reachable_volume
from spm_pin.workspace.search import search_states
from spm_pin.workspace.states import states_within

PAPER = GEOMETRIES["paper"]
NARROW = spm.LegLimits(1.2, 1.4)


def test_two_methods_agree_on_the_volume() -> None:
    sampled = reachable_volume(PAPER, NARROW, samples=2000, rng=1)
    meshed = reachable_volume(PAPER, NARROW, method="mesh", spacing=0.2)
    assert overlap(sampled, meshed)
    assert sampled.unit == meshed.unit == "m³"
    assert 0.0 < sampled.low < sampled.value < sampled.high
    assert sampled.high - sampled.low < 0.2 * sampled.value
    assert np.isnan(meshed.confidence)


def test_a_volume_scales_with_the_cube_of_the_machine() -> None:
    small = spm.Geometry(0.1 * PAPER.base_radius, 0.1 * PAPER.platform_radius, 0.1 * PAPER.middle_side)
    metres = reachable_volume(PAPER, NARROW, samples=150, rng=2)
    tenth = reachable_volume(small, spm.LegLimits(0.12, 0.14), samples=150, rng=2)
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


def test_text_of_an_estimate() -> None:
    estimate = Estimate(1.859, 1.853, 1.865, 0.95, 10, "mesh", "m³")
    assert str(estimate) == "1.859 [1.853, 1.865] m³"
    assert str(estimate.times(100.0, "")) == "185.9 [185.3, 186.5]"
    assert estimate.times(-1.0, "m³").low == -1.865


def test_computation_can_be_interrupted() -> None:
    def stop(what: str, done: int, of: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reachable_volume(PAPER, NARROW, samples=100, progress=stop)


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
    """The level of o splits the reachable positions; found by a predicate, and by counting uniform points."""

    def is_low(states: spm.Configuration) -> np.ndarray:
        return np.asarray(states.translation[:, 2] < 2.3)

    whole = reachable_volume(PAPER, NARROW, samples=300, rng=1)
    low, high = (
        reachable_volume(PAPER, NARROW, samples=300, rng=1, where=where)
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
    poses = pose_volume(PAPER, NARROW, samples=5_000, rng=2)
    parts = [pose_volume(PAPER, NARROW, samples=5_000, rng=2, where=w) for w in (is_low, lambda s: ~is_low(s))]
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
    with pytest.raises(spm.ArgumentError, match="least"):
        spm.sweeps.condition("conditioning", least=2.0, most=1.0)
    with pytest.raises(spm.ArgumentError, match="at least one of the two, got none"):
        spm.sweeps.condition("conditioning")


def test_intervals_of_rare_conditions_cover() -> None:
    """About 3 of 2000 states count: Student's interval holds the truth, from 10⁶ states, in 69 of 100."""

    def where(states: spm.Configuration) -> np.ndarray:
        return np.asarray(states.translation[:, 2] < 2.0)

    truth = 9.2e-7  # to 7 %
    found = [pose_volume(PAPER, where=where, samples=2000, rng=k) for k in range(60)]
    assert sum(estimate.low <= truth <= estimate.high for estimate in found) >= 56
    # Nothing is covered by an end that says nothing.
    assert np.median([estimate.high for estimate in found]) < 5.0 * truth
    assert " of 2000 states count" in found[0].method
    nowhere = pose_volume(PAPER, where=lambda states: states.translation[:, 2] > 9.0, samples=2000, rng=0)
    assert nowhere.low == nowhere.value == 0.0 < nowhere.high < 2.0 * truth
