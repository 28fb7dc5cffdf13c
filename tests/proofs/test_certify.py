"""Certificates: checked in other arithmetic, and refused for limits with a singularity."""

from __future__ import annotations

import re
from functools import partial
from itertools import product

import mpmath
import numpy as np
import pytest
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval
from spm_pin.kinematics.path_following import existing_share
from spm_pin.proofs.stage_proof import StageProof, StageRegion, has_one_state, region_coordinates
from spm_pin.support.arguments import FloatArray

PAPER = spm.Manipulator.paper()
LIMITS = spm.LegLimits(1.1, 1.5)


@pytest.fixture(scope="module")
def certificate() -> spm.Certificate:
    return spm.certify(PAPER, LIMITS)


def stage(state, hips, side, number=float, root=np.sqrt):  # type: ignore[no-untyped-def]
    """Return the leg lengths and D of a stage, from its corners in space and written anew, in any arithmetic."""
    x, y, height = (number(float(value)) if isinstance(value, np.floating) else value for value in state)
    side, hips = number(side), number(hips)
    half_root, half = root(number(3)) / 2, number(1) / 2
    radius = side / root(number(3))
    x0 = root(1 - x * x - y * y)
    rotation = [
        [1 - 2 * y * y, 2 * x * y, 2 * x0 * y],
        [2 * x * y, 1 - 2 * x * x, -2 * x0 * x],
        [-2 * x0 * y, 2 * x0 * x, 1 - 2 * (x * x + y * y)],
    ]
    centre = [-2 * radius * x * y, radius * (y * y - x * x), height]
    directions = [(half_root, -half), (number(0), number(1)), (-half_root, -half)]
    lengths, legs, swings = [], [], []
    for u in directions:
        corner = [centre[i] + radius * (rotation[i][0] * u[0] + rotation[i][1] * u[1]) for i in range(3)]
        leg = [corner[0] - hips * u[0], corner[1] - hips * u[1], corner[2]]
        outward = leg[0] * u[0] + leg[1] * u[1]
        lengths.append(root(sum(part * part for part in leg)))
        legs.append(corner)
        swings.append([-leg[2] * u[0], -leg[2] * u[1], outward])

    def c(i: int, j: int):  # type: ignore[no-untyped-def]
        return sum((legs[i][k] - legs[j][k]) * swings[i][k] for k in range(3))

    return lengths, -(c(0, 1) * c(1, 2) * c(2, 0) + c(1, 0) * c(2, 1) * c(0, 2))


def test_the_papers_limits_are_proved(certificate: spm.Certificate) -> None:
    assert certificate.holds
    assert all(bound > 0.1 for bound in certificate.bounds)
    assert certificate.witness is None
    assert not any(len(boxes) for boxes in certificate.undecided)
    assert "Proved" in certificate.explain()
    shown = re.findall(r">= ([\d.]+) d³", certificate.explain())
    for text, bound in zip(shown, certificate.bounds, strict=True):
        assert 0.99 * bound < float(text) <= bound
    assert "proved" in repr(certificate)


def test_every_set_of_lengths_has_its_physical_mode_in_the_proved_boxes(certificate: spm.Certificate) -> None:
    legs, corners = (
        np.random.default_rng(0).uniform(1.1, 1.5, (2_000, 6)),
        np.array(list(product((1.1, 1.5), repeat=6))),
    )
    state = spm.forward_physical(PAPER, np.concatenate([legs, corners]))
    assert certificate.covers(state).all()
    # Limits count to rounding, and so far it is proved.
    assert certificate.covers(spm.forward_physical(PAPER, np.full(6, 1.5 + 1e-8))).all()
    outside = np.full(6, 1.5 + 1e-7)
    assert not certificate.covers(spm.forward_physical(PAPER, outside))
    found = np.abs(spm.determinants(state)[..., :2]).min(axis=0) / PAPER.middle_side**3
    assert (found >= certificate.bounds).all()
    assert (found <= 20.0 * np.array(certificate.bounds)).all(), "the bound is of use"


def test_other_assembly_modes_are_not_covered(certificate: spm.Certificate) -> None:
    modes = spm.forward_displacement(PAPER, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    covered = certificate.covers(modes.configurations) & modes.exists
    assert covered.sum() == 1
    np.testing.assert_array_equal(covered, modes.is_physical)


def check_in_balls(proof: StageProof, hips: float, boxes: FloatArray) -> None:
    """Check with Arb that all parts of boxes have |det J| above the bound, or no lengths within the limits."""
    rest = [(box, 0) for box in boxes]
    while rest:
        box, depth = rest.pop()
        ball = [arb(float(x), float(r)) for x, r in zip(box.mean(axis=-1), (box[:, 1] - box[:, 0]) / 2.0, strict=True)]
        lengths, determinant = stage(ball, hips, PAPER.middle_side, arb, arb.sqrt)
        if any(length < 1.1 or length > 1.5 for length in lengths):
            continue
        if determinant > proof.bound * lengths[0] * lengths[1] * lengths[2]:
            continue
        assert depth < 5
        middle = box.mean(axis=-1)
        for corner in product((0, 1), repeat=3):
            low, high = np.where(corner, middle, box[:, 0]), np.where(corner, box[:, 1], middle)
            rest.append((np.stack([low, high], axis=-1), depth + 1))


def test_the_bounds_of_all_boxes_hold_in_ball_arithmetic(certificate: spm.Certificate) -> None:
    check_in_balls(certificate.stages[0], PAPER.base_radius, certificate.stages[0].proved)
    check_in_balls(certificate.stages[1], PAPER.platform_radius, certificate.stages[1].proved)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_boxes_contain_the_values_of_forty_digits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hips, side = rng.uniform(0.1, 2.0, 2)
    region = StageRegion(hips, side, np.full(3, 0.1), np.full(3, 5.0))
    low = rng.uniform([-0.6, -0.6, -2.0], [0.6, 0.6, 2.0])
    high = low + rng.uniform(0.0, 0.1, 3)
    state = low + rng.uniform(size=3) * (high - low)
    _, squares, determinant, *_ = region.evaluate(
        *(Interval(np.array(a), np.array(b)) for a, b in zip(low, high, strict=True))
    )
    with mpmath.workdps(40):
        lengths, exact = stage(state, hips, side, mpmath.mpf, mpmath.sqrt)
        assert mpmath.mpf(float(determinant.low)) <= exact <= mpmath.mpf(float(determinant.high))
        for square, length in zip(squares, lengths, strict=True):
            assert mpmath.mpf(float(square.low)) <= length**2 <= mpmath.mpf(float(square.high))


@pytest.mark.parametrize("seed", range(2))
def test_limits_with_a_known_singularity_are_never_certified(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.2, 1.0)
    machine = spm.Manipulator(size * rng.uniform(0.6, 1.4), size * rng.uniform(0.6, 1.4), size)
    middle = np.full(6, size * rng.uniform(1.5, 2.2))
    ends = np.maximum(middle + 1.5 * size * rng.normal(size=(30, 6)), 0.01 * size)
    shares = existing_share(partial(spm.forward_physical, machine), middle, ends, parts=64)
    assert shares.min() < 1.0
    fold = middle + shares.min() * (ends[shares.argmin()] - middle)

    def certificate(end: np.ndarray) -> spm.Certificate:
        limits = spm.LegLimits(np.minimum(middle, end) * 0.999, np.maximum(middle, end) * 1.001)
        return spm.certify(machine, limits, boxes=30_000)

    assert certificate(middle + 0.8 * (fold - middle)).holds, "boxes suffice without the singularity"
    found = certificate(fold)
    assert not found.holds
    assert 0.0 in found.bounds


def test_counterexample_is_singular_in_fifty_digits_and_within_the_limits() -> None:
    limits = spm.LegLimits(1.0, 1.6)
    found = spm.certify(PAPER, limits, boxes=30_000)
    assert not found.holds
    assert limits.contains(found.witness.leg_lengths)
    assert found.witness.closure_residual < 1e-14
    assert found.verdict == "not proved"
    text = found.explain()
    assert "a configuration of the nominal machine within the limits is forward singular" in text
    # Seen from this singular state the machine as assembled ends, or is elsewhere: of equal readings found by itself.
    physical = spm.forward_physical(PAPER, found.witness.readings)
    is_same = np.abs(physical.balls - found.witness.balls).max() < 1e-6
    assert ("a regular one: |det J| is" in text) is not is_same
    with mpmath.workdps(50):
        for proof, hips in zip(found.stages, (PAPER.base_radius, PAPER.platform_radius), strict=True):
            state = proof.singular
            signs = set()
            for shift in np.vstack([np.eye(3), -np.eye(3)]) * 1e-12:
                moved = [mpmath.mpf(float(value)) + float(change) for value, change in zip(state, shift, strict=True)]
                lengths, determinant = stage(moved, hips, PAPER.middle_side, mpmath.mpf, mpmath.sqrt)
                signs.add(int(mpmath.sign(determinant)))
                assert all(1.0 <= length <= 1.6 for length in lengths)
            assert signs == {-1, 1}, "D changes its sign within 1e-12 of the state"


@pytest.mark.parametrize("half", [0.1, 0.02, 1e-4])
def test_bounds_of_narrow_limits_are_within_a_factor_of_two_of_a_sample(half: float) -> None:
    found = spm.certify(PAPER, spm.LegLimits(1.3 - half, 1.3 + half))
    lengths = np.random.default_rng(0).uniform(1.3 - half, 1.3 + half, (5_000, 6))
    values = np.abs(spm.determinants(spm.forward_physical(PAPER, lengths))[:, :2]) / PAPER.middle_side**3
    assert (values.min(axis=0) >= found.bounds).all()
    assert (values.min(axis=0) < 2.0 * np.array(found.bounds)).all()
    assert (np.array(found.bounds) > [0.30, 0.48]).all()


# In the last machine a singular state that is not joined to the home does not narrow the limits.
@pytest.mark.parametrize(
    ("machine", "centre", "error", "least"),
    [(PAPER, 1.3, 1e-3, 0.15), (spm.Manipulator(1.0, 1.0, 3.0), 3.6, 0.0, 0.85)],
)
def test_the_widest_limits_hold(machine: spm.Manipulator, centre: float, error: float, least: float) -> None:
    options = {"tolerance": 0.2, "boxes": 60_000, "length_error": error, "angle_error": error}
    found = spm.largest_certified_limits(machine, centre, **options)
    assert found.holds
    assert found.errors == (error, error)
    assert found.limits.maximum[0] - centre > least
    assert found.limits.minimum[0] == pytest.approx(2.0 * centre - found.limits.maximum[0])


def test_too_few_boxes_leave_it_undecided() -> None:
    found = spm.certify(PAPER, LIMITS, boxes=5_000)
    assert not found.holds
    assert 0.0 in found.bounds
    assert any(len(boxes) for boxes in found.undecided)
    assert not found.covers(spm.forward_physical(PAPER, np.full(6, 1.3)))


def test_errors_do_not_make_the_nominal_machine_singular_where_it_is_proved_not_to_be() -> None:
    machine, wide, narrow = spm.Manipulator(0.25, 0.12, 0.30), spm.LegLimits(0.35, 0.5), spm.LegLimits(0.38, 0.46)
    assert spm.certify(machine, wide).holds
    found = spm.certify(machine, narrow, boxes=60_000, length_error=0.0132, angle_error=0.0019)
    assert any(proof.singular is not None for proof in found.stages)
    assert (found.verdict, found.witness) == ("undecided", None)
    assert "for errors this large" in found.explain()


def test_states_of_a_path_in_certified_limits(certificate: spm.Certificate) -> None:
    inside, outside = [1.2, 1.2, 1.4, 1.25, 1.2, 1.45], [1.2, 1.2, 1.4, 1.25, 1.2, 1.6]
    straight = spm.follow(PAPER, np.array([inside, [1.3] * 6]), samples=20, certificate=certificate)
    assert straight.certified.all()
    assert "in certified limits" in repr(straight)
    leaving = spm.follow(PAPER, np.array([inside, outside]), samples=20, certificate=certificate)
    beyond = (leaving.configurations.leg_lengths > 1.5).any(axis=-1)
    np.testing.assert_array_equal(leaving.certified, ~beyond)
    assert spm.follow(PAPER, np.array([inside, outside]), samples=5).certified is None
    with pytest.raises(spm.ArgumentError, match="certificate"):
        spm.follow(PAPER, np.array([inside, outside]), certificate=LIMITS)  # type: ignore[arg-type]


def test_a_second_state_with_the_same_lengths_is_found_among_the_boxes() -> None:
    lengths = np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    modes = spm.forward_displacement(PAPER, lengths)
    states = region_coordinates(modes.configurations[modes.exists])[:, 0]
    states = states[np.isfinite(states).all(axis=-1)]
    states = states[states[:, 2] > 0.0]
    region = StageRegion(PAPER.base_radius, PAPER.middle_side, lengths[:3], lengths[:3])
    distinct = np.unique(states.round(9), axis=0)
    assert len(distinct) >= 2
    boxes = np.stack([distinct - 0.01, distinct + 0.01], axis=-1)
    assert all(has_one_state(region, box[None]) for box in boxes)
    assert not has_one_state(region, boxes)
    assert not has_one_state(region, boxes[:1] + 0.05)
