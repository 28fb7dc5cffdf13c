from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES
from scipy.spatial.transform import Rotation
from workspace.intervals import overlap, pose_volume

import spm_pin as spm
from spm_pin.workspace.paper_shell import workspace_shell
from spm_pin.workspace.poses import reachable
from spm_pin.workspace.positions import Estimate, reachable_volume
from spm_pin.workspace.states import pose_multiplicity, states_within

PAPER = GEOMETRIES["paper"]
NARROW = spm.LegLimits(1.2, 1.4)


def density_over_legs(states: spm.Configuration, limits: spm.LegLimits) -> np.ndarray:
    """|det ∂(o, R)/∂l| over how many states have the same pose: by leg lengths, as the package does not."""
    determinant = np.linalg.det(spm.kinematics.platform_jacobian(states))
    return np.abs(determinant) / pose_multiplicity(states_within(PAPER, limits), states)


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
    metres = reachable_volume(PAPER, NARROW, samples=400, rng=2)
    tenth = reachable_volume(small, spm.LegLimits(0.12, 0.14), samples=400, rng=2)
    assert tenth.value == pytest.approx(1e-3 * metres.value, rel=0.02)


def test_the_volume_of_poses_is_that_of_uniform_poses_in_a_part_of_them() -> None:
    """Both counted in one region of positions and rotations: by leg lengths, and by the inverse displacement alone."""
    rng = np.random.default_rng(3)
    limits = spm.LegLimits(1.1, 1.5)
    states = spm.forward_physical(PAPER, rng.uniform(1.1, 1.5, (60_000, 6)))
    centre, half = np.array([0.2, 0.1, 2.5]), 0.25
    near = (np.abs(states.translation - centre) < half).all(axis=-1)
    # Rotations are counted from one that depends on the position: that changes no volume.
    known = np.column_stack([states.translation[near], np.ones(near.sum())])
    usual = np.linalg.lstsq(known, states.pose.rotation[near].as_rotvec(), rcond=None)[0]

    def reference(position: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(np.column_stack([position, np.ones(len(position))]) @ usual)

    vectors = (states.pose.rotation * reference(states.translation).inv()).as_rotvec()
    width = np.array([0.1, 0.1, 0.03])
    inside = near & (np.abs(vectors) < width).all(axis=-1)
    values = np.zeros(60_000)
    values[inside] = density_over_legs(states[inside], limits)
    by_legs = Estimate.from_mean(values, 0.4**6, 0.999, "legs", "m³ rad³")

    count = 40_000
    position = centre + rng.uniform(-half, half, (count, 3))
    turn = width * rng.uniform(-1.0, 1.0, (count, 3))
    angle = np.linalg.norm(turn, axis=-1)
    hit = reachable(PAPER, spm.pose(position, rotation=Rotation.from_rotvec(turn) * reference(position))).reachable
    region = (2 * half) ** 3 * 8 * width.prod()
    # Rotation vectors carry the uniform measure of rotations times (2 sin(θ/2)/θ)².
    by_poses = Estimate.from_mean(hit * (2.0 * np.sin(0.5 * angle) / angle) ** 2, region, 0.999, "poses", "m³ rad³")
    assert hit.sum() > 300
    assert inside.sum() > 300
    assert overlap(by_legs, by_poses)

    whole = pose_volume(limits, 20_000, 4)
    assert by_legs.value < whole.value


def test_intervals_cover_the_truth_at_the_stated_rate() -> None:
    rng = np.random.default_rng(5)
    truth = 0.03
    hits = rng.binomial(400, truth, 500)
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
