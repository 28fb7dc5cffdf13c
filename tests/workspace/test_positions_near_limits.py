from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.workspace.sampling import sample_positions_near_limits

PAPER = spm.Geometry.paper()
LIMITS = spm.LegLimits(1.1, 1.5)


def test_positions_are_those_of_legs_within_their_limits() -> None:
    limits = spm.LegLimits([1.1, 1.2, 1.3, 1.1, 1.2, 1.3], [1.5, 1.4, 1.5, 1.2, 1.4, 1.5])
    positions, aspect = sample_positions_near_limits(PAPER, limits, count=300, seed=1)
    assert positions.shape == (300, 3)
    # The same numbers again, through a solver that returns more than positions.
    rng = np.random.default_rng(1)
    share = np.sin(np.pi / 2 * rng.random((300, 6))) ** 2
    share = np.where(rng.random((300, 6)) < 0.35, share.round(), share)
    legs = np.array(limits.minimum) + share * (np.array(limits.maximum) - np.array(limits.minimum))
    states = spm.forward_physical(PAPER, legs)
    np.testing.assert_allclose(positions, states.translation, rtol=0.0, atol=1e-12)
    assert 0.3 < (share == share.round()).mean() < 0.4
    np.testing.assert_array_equal(aspect, np.sign(spm.singularities(states).determinants[:, 2]))


def test_symmetric_limits_give_all_images_with_the_signs_that_belong_to_them() -> None:
    positions, aspect = sample_positions_near_limits(PAPER, LIMITS, count=50, seed=2)
    assert positions.shape == (300, 3)
    tree = KDTree(np.column_stack([positions, aspect]))
    turned = Rotation.from_euler("z", 120, degrees=True).apply(positions)
    for image, sign in ((turned, 1), (positions * [-1.0, 1.0, 1.0], -1)):
        gap, match = tree.query(np.column_stack([image, sign * aspect]))
        assert gap.max() < 1e-12
        assert len(set(match)) == 300


def test_a_mirror_changes_the_sign_of_det_K() -> None:
    legs = np.random.default_rng(3).uniform(1.1, 1.5, (500, 6))
    state, mirrored = (
        spm.forward_physical(PAPER, legs[:, order]) for order in ([0, 1, 2, 3, 4, 5], [2, 1, 0, 5, 4, 3])
    )
    np.testing.assert_allclose(mirrored.translation, state.translation * [-1.0, 1.0, 1.0], atol=1e-12)
    here, there = (spm.singularities(configuration).determinants[:, 2] for configuration in (state, mirrored))
    np.testing.assert_allclose(there, -here, atol=1e-12)


def test_lengths_that_close_nothing_are_left_out() -> None:
    positions, _ = sample_positions_near_limits(PAPER, spm.LegLimits(0.3, 4.0), count=400)
    assert 0 < len(positions) < 6 * 400
    assert np.isfinite(positions).all()
