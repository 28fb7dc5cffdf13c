"""Lower bounds of |det K| over leg limits: checked in other arithmetic, and refused beside a singularity."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from error_fields import with_fields
from hypothesis import given, settings
from hypothesis import strategies as st

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval
from spm_pin.proofs import certify_inverse
from spm_pin.proofs.inverse_certificate import structure_determinant
from spm_pin.proofs.stage_proof import region_coordinates

PAPER = spm.Manipulator.paper()
LEGS = np.array([1.2, 1.2, 1.4, 1.25, 1.2, 1.45])


def determinant(tilts: list[object]) -> object:
    """Return det K / d³ in mpmath, the determinant of six forces on the middle platform, from (x, y) of both stages."""
    root = mpmath.sqrt(3)
    radial = [(root / 2, mpmath.mpf(-1) / 2), (mpmath.mpf(0), mpmath.mpf(1)), (-root / 2, mpmath.mpf(-1) / 2)]
    rows = []
    for x, y in ((tilts[0], tilts[1]), (-tilts[2], -tilts[3])):
        x0 = mpmath.sqrt(1 - x * x - y * y)
        turn = mpmath.matrix(
            [
                [1 - 2 * y * y, 2 * x * y, 2 * x0 * y],
                [2 * x * y, 1 - 2 * x * x, -2 * x0 * x],
                [-2 * x0 * y, 2 * x0 * x, 1 - 2 * (x * x + y * y)],
            ]
        )
        for u, v in radial:
            force = turn.T * mpmath.matrix([-v, u, 0])
            arm = (u / root, v / root)
            moment = [arm[1] * force[2], -arm[0] * force[2], arm[0] * force[1] - arm[1] * force[0]]
            rows.append([*force, *moment])
    return mpmath.det(mpmath.matrix(rows))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_boxes_contain_the_determinant_of_forty_digits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-0.6, 0.6, 4)
    high = low + rng.uniform(0.0, 0.1, 4)
    inside = low + rng.uniform(size=4) * (high - low)
    cells = [Interval(np.array(a), np.array(b)) for a, b in zip(low, high, strict=True)]
    found = structure_determinant((cells[0], cells[1]), (cells[2], cells[3]))
    with mpmath.workdps(40):
        exact = determinant([mpmath.mpf(float(x)) for x in inside])
        assert mpmath.mpf(float(found.low)) <= exact <= mpmath.mpf(float(found.high))


def test_the_determinant_is_that_of_configurations() -> None:
    states = spm.forward_physical(PAPER, np.random.default_rng(0).uniform(1.1, 1.5, (50, 6)))
    tilts = region_coordinates(states)[..., :2].reshape(-1, 4)
    expected = spm.determinants(states)[:, 2] / PAPER.middle_side**3
    with mpmath.workdps(30):
        found = [float(determinant([mpmath.mpf(float(x)) for x in row])) for row in tilts]
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-14)


def singular_at_fifty_digits(state: spm.Configuration) -> bool:
    """Return whether det K changes its sign within 1e-11 of the tilts of a state, along its gradient."""
    tilts = region_coordinates(state)[:, :2].ravel()
    with mpmath.workdps(50):
        point = [mpmath.mpf(float(x)) for x in tilts]
        step = mpmath.mpf("1e-20")
        slope = [
            (determinant([*point[:i], point[i] + step, *point[i + 1 :]]) - determinant(point)) / step for i in range(4)
        ]
        size = mpmath.sqrt(sum(s * s for s in slope))
        ends = [
            determinant([x + sign * mpmath.mpf("1e-11") * s / size for x, s in zip(point, slope, strict=True)])
            for sign in (-1, 1)
        ]
    return bool(ends[0] < 0 < ends[1])


@pytest.mark.parametrize("half", [0.003, 0.01])
def test_narrow_limits_are_proved(half: float) -> None:
    limits = spm.LegLimits(tuple(LEGS - half), tuple(LEGS + half))
    found = certify_inverse(PAPER, limits)
    assert found.holds
    assert found.witness is None
    assert "Proved" in found.explain()
    legs = np.random.default_rng(1).uniform(LEGS - half, LEGS + half, (3_000, 6))
    corners = np.array(np.meshgrid(*[[-half, half]] * 6)).reshape(6, -1).T + LEGS
    values = np.abs(spm.determinants(spm.forward_physical(PAPER, np.concatenate([legs, corners])))[:, 2])
    assert values.min() / PAPER.middle_side**3 >= found.bound
    assert found.bound >= 0.4 * found.least, "the bound is of use"


@pytest.mark.parametrize(
    "limits",
    [*(spm.LegLimits(tuple(LEGS - half), tuple(LEGS + half)) for half in (0.02, 0.05)), spm.LegLimits(1.1, 1.5)],
    ids=["narrow", "wider", "paper"],
)
def test_limits_in_which_the_determinant_changes_its_sign_have_a_witness(limits: spm.LegLimits) -> None:
    found = certify_inverse(PAPER, limits)
    assert not found.holds
    assert limits.contains(found.witness.leg_lengths)
    assert singular_at_fifty_digits(found.witness)
    assert "Disproved" in found.explain()


@pytest.mark.slow
def test_a_witness_is_found_where_the_straight_way_between_samples_has_no_states() -> None:
    limits = spm.LegLimits(1.08319, 1.59089)
    found = certify_inverse(spm.Manipulator(1.33448, 0.932207, 0.821107, limits))
    assert found.witness is not None
    assert limits.contains(found.witness.leg_lengths)
    assert abs(spm.determinants(found.witness)[2]) < 1e-14


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(spm.GeometryError, match="limits"):
        certify_inverse(spm.Manipulator(0.6, 0.4, 0.5))
    with pytest.raises(spm.GeometryError, check=with_fields(argument="machine")):
        certify_inverse(PAPER.perturbed(0))
