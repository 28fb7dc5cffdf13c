"""Derivatives of the pose by the dimensions, and accuracy from tolerances, to first order and by random machines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from calibration.measured import PAPER, elsewhere
from error_fields import with_fields
from problems import as_built

import spm_pin as spm
from spm_pin.calibration import error_jacobian, tolerance

TABLE = {"direction": 1e-4, "pivot": 1e-4, "ball": 1e-4, "offset": 1e-4}


def test_forty_eight_combinations_move_the_platform_and_forty_five_its_position() -> None:
    state = spm.forward_physical(as_built(PAPER, 1e-2), np.random.default_rng(2).uniform(1.15, 1.45, (60, 6)))
    rows = error_jacobian(state)
    for components, count in ((6, 48), (3, 45)):
        values = np.linalg.svd(rows[:, :components].reshape(-1, 54), compute_uv=False)
        assert values[count - 1] > 1e-6 * values[0]
        assert values[count] < 1e-13 * values[0]


def test_linear_and_sampled_accuracy_agree() -> None:
    found = tolerance(PAPER, TABLE, elsewhere(), samples=300, rng=0)
    # The number known from elsewhere: 0.1 mm and 0.1 mrad give about 0.84 mm and 0.74 mrad.
    assert found.rms == pytest.approx((8.5e-4, 7.4e-4), rel=0.07)
    assert found.sampled_rms == pytest.approx(found.rms, rel=0.06)
    position, angle = found.percentile(95.0)
    assert 1.3 * found.rms[0] < position < 2.2 * found.rms[0]
    assert 1.3 * found.rms[1] < angle < 2.2 * found.rms[1]
    assert found.covariance.shape == (len(elsewhere()), 6, 6)
    assert found.samples.shape == (300, len(elsewhere()), 6)


def test_ranking_says_which_tolerance_pays() -> None:
    found = tolerance(PAPER, TABLE, elsewhere(), samples=0)
    assert found.shares.sum() == pytest.approx(1.0)
    for by, count in (("parameter", 54), ("component", 9), ("kind", 4), ("leg", 6)):
        ranking = found.ranking(by)
        assert len(ranking) == count
        assert sum(share for _, share in ranking) == pytest.approx(1.0)
        assert [share for _, share in ranking] == sorted((share for _, share in ranking), reverse=True)
    # Without the errors of a kind its share of the variance is gone.
    without = tolerance(PAPER, {**TABLE, "offset": 0.0}, elsewhere(), samples=0)
    share = dict(found.ranking("kind"))["offset"]
    assert (without.rms[0] / found.rms[0]) ** 2 == pytest.approx(1.0 - share, rel=1e-9)
    # A later name replaces an earlier one; numbers for all parameters are the same as names.
    table = np.tile(np.repeat([1e-4, 0.0], [8, 1]), 6)
    np.testing.assert_array_equal(tolerance(PAPER, table, elsewhere(), samples=0).shares, without.shares)


def test_states_are_drawn_within_the_leg_limits() -> None:
    found = tolerance(PAPER, {"ball": 1e-4}, 30, samples=3, rng=1)
    assert found.states.shape == (30,)
    assert PAPER.limits is not None
    assert PAPER.limits.contains(found.states.leg_lengths).all()
    assert np.isfinite(found.samples).all()
    assert "mm" in repr(found)
    assert tolerance(PAPER, {"ball": 0.0}, 5, samples=2, rng=1).rms == (0.0, 0.0)


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda: tolerance(PAPER, -np.ones(54)), "tolerances"),
        (lambda: tolerance(spm.Manipulator(0.7, 0.3, 0.8), TABLE), "machine"),
        (lambda: tolerance(PAPER.perturbed(1), TABLE, elsewhere()), "states"),
        (lambda: tolerance(PAPER, TABLE, elsewhere(), samples=0).percentile(), "samples"),
        (lambda: tolerance(PAPER, TABLE, elsewhere(), samples=0).ranking("machine"), "by"),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[], object], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        call()
