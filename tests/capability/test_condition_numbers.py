"""The numbers of the page on condition numbers."""

from __future__ import annotations

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.capability import wrench_polytope
from spm_pin.kinematics import platform_jacobian, singular_values

pytestmark = pytest.mark.documents

PAPER = spm.Manipulator.paper()
SHARES = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 6))
STATES = spm.forward_physical(PAPER, 1.3 + 0.2 * SHARES)


def values(states: spm.Configuration, length: float = PAPER.platform_radius) -> np.ndarray:
    return singular_values(platform_jacobian(states) * np.repeat([1.0, length], 3)[:, None])


def test_three_motions_are_lost_at_the_home() -> None:
    home = spm.forward_physical(PAPER, [1.3] * 6)
    np.testing.assert_allclose(values(home, 1.0), [4.13, 4.13, 0.82, 0.0, 0.0, 0.0], atol=0.006)
    assert wrench_polytope(home, 1.0).ball() == pytest.approx(0.52, abs=0.005)


def test_no_length_makes_the_mechanism_well_conditioned() -> None:
    lengths = np.array([0.03, 0.3, *np.geomspace(0.9, 1.9, 9), 6.0])
    medians = [np.median(x[:, 0] / x[:, -1]) for x in (values(STATES, length) for length in lengths)]
    assert min(medians) == pytest.approx(127.0, abs=1.0)
    assert lengths[np.argmin(medians)] == pytest.approx(1.3, abs=0.1)
    of_radius = values(STATES)
    assert np.median(of_radius[:, 0] / of_radius[:, -1]) == pytest.approx(255.0, abs=1.0)
    np.testing.assert_allclose([of_radius[:, 0].min(), of_radius[:, 0].max()], [3.0, 5.3], atol=0.05)


def test_states_of_larger_condition_numbers_hold_slightly_more() -> None:
    each, held = values(STATES), wrench_polytope(STATES, 1.0).ball()
    assert np.median(held) == pytest.approx(0.47, abs=0.005)
    assert np.corrcoef(np.log(each[:, 0] / each[:, -1]), held)[0, 1] > 0.1
    near = (
        spm.forward_physical(PAPER, 1.3 + 0.002 * SHARES[:500]),
        spm.forward_physical(PAPER, 1.3 + 0.02 * SHARES[:500]),
    )
    first, second = (np.median(x[:, 0] / x[:, -1]) for x in map(values, near))
    assert first / second == pytest.approx(10.0, rel=0.05)
