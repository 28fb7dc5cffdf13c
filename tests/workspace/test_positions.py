"""Positions in some orientation: the map from legs to positions, and membership against searches of other kinds."""

from __future__ import annotations

import numpy as np
import pytest
from problems import PAPER

import spm_pin as spm
from spm_pin.workspace import reachable_position
from spm_pin.workspace.search import nearest_points, start_table
from spm_pin.workspace.state_set import states_within

BUILT = PAPER.perturbed(3, length=5e-3, angle=5e-3)


def test_far_points_are_not_reachable_and_have_a_distance() -> None:
    points = [[5.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 0.0, 40.0]]
    answer = reachable_position(PAPER, points)
    assert not answer.reachable.any()
    np.testing.assert_allclose(np.linalg.norm(answer.nearest - points, axis=-1), answer.distance)
    # Straight above, all legs at their longest are nearest.
    height = spm.forward_physical(PAPER, [1.5] * 6).translation[2]
    assert answer.distance[2] == pytest.approx(40.0 - height, abs=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_shapes(shape: tuple[int, ...]) -> None:
    answer = reachable_position(PAPER, np.full((*shape, 3), [0.1, 0.2, 2.4]))
    assert answer.reachable.shape == answer.distance.shape == answer.undecided.shape == shape
    assert answer.nearest.shape == (*shape, 3)
    assert answer.readings.shape == (*shape, 6)
    assert answer.reachable.all()


@pytest.mark.parametrize("machine", [PAPER, BUILT], ids=["as drawn", "as built"])
def test_states_with_the_optimality_conditions_are_nearest_among_many(machine: spm.Manipulator) -> None:
    extent = start_table(states_within(machine)).extent
    rng = np.random.default_rng(7)
    points = rng.uniform(extent[0] - 0.2, extent[1] + 0.2, (80, 3))
    nearest = nearest_points(states_within(machine), points)
    sample = spm.forward_physical(machine, 1.1 + 0.4 * rng.beta(0.3, 0.3, (10_000, 6))).translation
    least = np.array([np.sqrt(((sample - point) ** 2).sum(axis=-1)).min() for point in points])
    assert (nearest.distance <= least + 1e-9).all()
    assert (nearest.optimality < 1e-6).all()
    assert np.median(least - nearest.distance) < 0.1
