from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES
from scipy.spatial.transform import Rotation
from workspace.intervals import overlap

import spm_pin as spm
from spm_pin.workspace.orientation import ROTATIONS, orientation_workspace, tilt_torsion
from spm_pin.workspace.poses import reachable

PAPER = GEOMETRIES["paper"]


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


@pytest.mark.parametrize("position", [(0.3, 0.1, 2.45), (0.02, 0.03, 2.5)])
def test_the_volume_is_that_of_uniform_orientations(position: tuple[float, float, float]) -> None:
    """In a box of tilt and torsion that holds all that was found; the inverse displacement alone decides there."""
    answer = orientation_workspace(PAPER, position, samples=12_000, confidence=0.999, rng=2)
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
    rng, count = np.random.default_rng(3), 60_000
    lean = rng.uniform(low, high, (count, 2))
    tilt = np.arcsin(np.linalg.norm(lean, axis=-1))
    azimuth, torsion = np.arctan2(lean[:, 1], lean[:, 0]), rng.uniform(-twist, twist, count)
    rotation = Rotation.from_euler("ZYZ", np.stack([azimuth, tilt, torsion - azimuth], axis=-1))
    hit = reachable(PAPER, spm.pose(position, rotation=rotation)).reachable
    density = np.where(hit, 1.0 / np.cos(tilt), 0.0)
    region = float((high - low).prod() * 2.0 * twist)
    assert hit.sum() > 100
    share = spm.workspace.Estimate.from_hits(
        int(hit.sum()), count, region * density.sum() / hit.sum(), 0.999, "", "rad³"
    )
    assert overlap(share, answer.volume)


def test_the_largest_tilt_in_each_sector() -> None:
    answer = orientation_workspace(PAPER, [0.02, 0.03, 2.5], samples=8000, rng=4)
    azimuth, largest = answer.largest_tilt(12)
    assert azimuth.shape == largest.shape == (12,)
    assert np.diff(azimuth) == pytest.approx(np.pi / 6)
    sector = np.floor((answer.azimuth + np.pi) / (np.pi / 6)).astype(int).clip(0, 11)
    for k in range(12):
        mine = answer.tilt[sector == k]
        assert np.isnan(largest[k]) if not len(mine) else largest[k] == mine.max()
    assert np.nanmax(largest) == answer.tilt.max()
    assert answer.share.value == pytest.approx(answer.volume.value / ROTATIONS)
    with pytest.raises(spm.ArgumentError, match="sectors"):
        answer.largest_tilt(0)


def test_orientations_turn_with_the_position_by_a_third_of_a_turn() -> None:
    means, errors = [], []
    for k in range(3):
        turn = Rotation.from_euler("z", 2.0 * np.pi / 3.0 * k)
        answer = orientation_workspace(PAPER, turn.apply([0.3, 0.1, 2.45]), samples=6000, rng=5 + k)
        # The volume, and where the platform's normal leans, with standard errors.
        normals = (answer.states.rotation[:, :, 2] @ turn.as_matrix())[:, :2]
        share = answer.weights / answer.weights.sum()
        mean = share @ normals
        error = np.sqrt((share**2) @ (normals - mean) ** 2)
        means.append([answer.volume.value, *mean])
        errors.append([(answer.volume.high - answer.volume.low) / 3.92, *error])
    spread = np.linalg.norm(errors, axis=0)
    assert (np.ptp(means, axis=0) < 3.0 * spread).all()
    assert spread[0] < 0.06 * means[0][0]
    assert (spread[1:] < 0.02).all()


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
