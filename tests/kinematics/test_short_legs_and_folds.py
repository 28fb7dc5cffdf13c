"""Forward displacements that were lost: of very short legs, and beside a forward singularity."""

from __future__ import annotations

import numpy as np
import pytest

import spm_pin as spm


@pytest.mark.parametrize(
    ("base_radius", "height", "normal"),
    [
        (0.3, 0.18680818426796822, [0.44170184109914623, 0.33240658803481, -0.833309872616832]),
        (0.3, 0.050345253700205164, [-0.13845340761157895, 0.06046002868811572, -0.9885217442483367]),
        (0.1, 0.3590289159892684, [0.30335710835808194, -0.9103484321109208, -0.2814963533721375]),
    ],
)
def test_a_home_state_with_a_leg_of_a_fiftieth_of_another_is_found(
    base_radius: float, height: float, normal: list[float]
) -> None:
    stage = spm.Stage(base_radius, 0.5)
    state = spm.inverse_displacement(stage, height, normal=normal)["T"]
    assert state.is_at_home
    assert state.readings.min() < 0.02 * state.readings.max()
    for readings in (state.readings, np.tile(state.readings, (3000, 1))):
        found = spm.forward_physical(stage, readings)
        np.testing.assert_allclose(found.translation - state.translation, 0.0, atol=1e-9)
        np.testing.assert_allclose(found.rotation - state.rotation, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("base_radius", "readings"),
    [
        (0.3, [-0.7163937000423664, 2.365776004855576, -0.02744454693893283]),
        (0.3, [-0.6555923625579361, 0.08156062970935496, 2.290716047793507]),
        (1.0, [1.0908720999720205, 1.2068145449183485, 1.090895630261346]),
        (1.0, [1.1050086814877584, 1.2545402431537556, 1.1051923852522283]),
        (1.0, [1.1536492748559284, 1.076327586601239, 1.0762821468662083]),
    ],
)
def test_the_two_modes_beside_a_fold_are_listed_once_each(base_radius: float, readings: list[float]) -> None:
    """They are some 20 µm apart; one was listed twice, and the other one, the physical state, was lost."""
    stage = spm.Stage(base_radius, 0.5, spm.RRS(crank=0.8, rod=0.9))
    modes = spm.forward_displacement(stage, readings)
    balls = modes.configurations.balls[modes.exists].reshape(-1, 9)
    gaps = np.abs(balls[:, None] - balls).max(axis=-1)[np.triu_indices(len(balls), 1)]
    assert gaps.min() > 5e-6
    assert np.count_nonzero(gaps < 1e-4) == 1
    state = spm.forward_physical(stage, readings)
    assert state.is_at_home
    again = spm.inverse_displacement(stage, float(state.height), normal=state.normal)["T"]
    np.testing.assert_allclose(again.readings, readings, rtol=0.0, atol=1e-14)


def test_angles_of_cranks_are_no_lengths_in_another_unit() -> None:
    stage = spm.Stage(0.062, 0.075, spm.RRS(crank=0.04, rod=0.085))
    state = spm.forward_physical(stage, [3.0, 3.0, 3.0])
    assert not state.exists
    assert "metres" not in state.missing_reason
