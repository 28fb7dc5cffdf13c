"""Many machines at once: the same verdicts as each by itself over the whole disc of tilts, and never a wrong one."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import spm_pin as spm
from spm_pin.kinematics.path_following import existing_share
from spm_pin.proofs import stage_proof
from spm_pin.proofs.certificate import free_of_singularities

PAPER = spm.Manipulator.paper()


def machine(lower: tuple[float, float], upper: tuple[float, float], *sizes: float) -> spm.Manipulator:
    return spm.Manipulator(*(sizes or PAPER.dimensions), spm.LegLimits.stages(lower, upper))


def drawn(rng: np.random.Generator) -> spm.Manipulator:
    (low, other), strokes = rng.uniform(0.6, 1.4, 2), rng.uniform(0.05, 0.6, 2)
    sizes = map(float, rng.uniform([0.3, 0.2, 0.4], [1.0, 0.8, 1.2]))
    return machine((low, low + strokes[0]), (other, other + strokes[1]), *sizes)


def middle(one: spm.Manipulator) -> spm.Configuration:
    """Return the physical configuration with the lengths in the middle of the limits."""
    assert one.limits is not None
    return spm.forward_physical(one, 0.5 * (np.array(one.limits.minimum) + np.array(one.limits.maximum)))


def test_verdicts_are_those_of_each_machine_by_itself() -> None:
    machines = [
        machine((1.1, 1.5), (1.1, 1.5)),
        machine((1.0, 1.6), (1.0, 1.6)),
        machine((1.2, 1.4), (0.6, 1.6)),
        machine((1.2, 1.4), (1.1, 1.45), 0.463, 0.452, 1.056),
        machine((0.01, 0.02), (0.01, 0.02), 0.7, 0.35, 0.1),
    ]
    expected = [True, False, False, True, False]
    assert free_of_singularities(machines, 15_000).tolist() == expected
    assert [bool(free_of_singularities([one], 15_000)) for one in machines] == expected
    assert [spm.certify(one, boxes=30_000).holds for one in machines[:4]] == expected[:4]


def test_limits_that_differ_within_a_stage_and_machines_as_built_are_certified_too() -> None:
    limits = spm.LegLimits((1.2, 1.25, 1.3, 1.1, 1.25, 1.4), (1.25, 1.28, 1.4, 1.2, 1.3, 1.45))
    uneven = spm.Manipulator(*PAPER.dimensions, limits)
    built = machine((1.25, 1.35), (1.25, 1.35)).perturbed(0, length=1e-5, angle=1e-5)
    fold = spm.Manipulator(*PAPER.dimensions, spm.LegLimits((0.8, 1.0, 1.0, 1.1, 1.1, 1.1), 1.6))
    assert free_of_singularities([uneven, built, fold], 15_000).tolist() == [True, True, False]


@pytest.mark.parametrize("seed", range(3))
def test_no_machine_that_loses_its_configuration_on_a_line_is_free(seed: int) -> None:
    """Lines from the middle to corners, edges and faces of the limits, which are just wide enough to have a fold."""
    rng = np.random.default_rng(seed)
    directions = np.concatenate([rng.choice([-1.0, 0.0, 1.0], (200, 6)), rng.uniform(-1.0, 1.0, (200, 6))])
    machines = []
    while len(machines) < 8:
        one = drawn(rng)
        start = middle(one)
        if not start.exists:
            continue
        steps = 0.999 * start.readings * directions
        shares = existing_share(partial(spm.forward_physical, one), start.readings, start.readings + steps)
        if shares.min() < 1.0:
            # Of each stage as wide as the line that loses it soonest.
            half = 1e-3 + 1.01 * np.abs(shares.min() * steps[shares.argmin()]).reshape(2, 3).max(axis=-1)
            pairs = start.readings[[0, 3], None] + half[:, None] * [-1.0, 1.0]
            machines.append(machine(*(tuple(np.maximum(pair, 1e-3)) for pair in pairs), *one.dimensions))
    assert not free_of_singularities(machines, 3_000).any()


@pytest.mark.slow
def test_random_machines_have_the_verdict_of_their_certificates() -> None:
    rng = np.random.default_rng(5)
    machines = [one for one in (drawn(rng) for _ in range(30)) if middle(one).exists]
    found = free_of_singularities(machines, 20_000)
    assert 5 < found.sum() < len(machines) - 5
    for one, free in zip(machines, found, strict=True):
        if spm.certify(one, boxes=60_000).holds:
            assert free, one
        elif free:
            # The certificate ends at a singular state in its boxes, though it may not be joined to the home.
            low, high = np.array(one.limits.minimum), np.array(one.limits.maximum)
            ends = low + rng.choice([0.0, 0.5, 1.0], (2000, 6)) * (high - low)
            assert existing_share(partial(spm.forward_physical, one), 0.5 * (low + high), ends).min() == 1.0


def test_boxes_that_touch_are_found_at_any_sizes() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        boxes = np.tile(stage_proof.first_boxes(1), 2)
        boxes["stage"][8:] = 1
        for _ in range(3):
            divided = rng.random(len(boxes)) < 0.3
            boxes = np.concatenate([boxes[~divided], stage_proof.halves(boxes[divided])])
        boxes = boxes[rng.random(len(boxes)) < 0.4]
        low, high = np.moveaxis(stage_proof._ends(np.ones(3), boxes), -1, 0)
        touch = ((low[:, None] <= high) & (high[:, None] >= low)).all(axis=-1)
        touch &= boxes["stage"][:, None] == boxes["stage"]
        pairs = stage_proof._touching(boxes)
        assert touch[tuple(pairs.T)].all()
        graph = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=touch.shape)
        assert connected_components(graph, directed=False)[0] == connected_components(touch, directed=False)[0]
