"""Claims of the literature: the tetrahedron, ranks, freedoms, operation modes, non-singular assembly mode changes."""

from __future__ import annotations

import literature
import numpy as np
import pytest
from assembly_mode_changes import (
    RANGES,
    curve,
    determinant_on_curve,
    falling_on_curve,
    negative,
    nonsingular_changes,
    proved_ranges,
    reduced_determinant,
    stage_region,
)

from spm_pin.kinematics.intervals import Interval

pytestmark = pytest.mark.documents


def test_the_tetrahedron_of_the_revolute_axes_has_the_determinant_of_k() -> None:
    for row in literature.tetrahedron():
        assert row.ratio == pytest.approx(-1.0, abs=1e-12)
        assert row.deviation < 1e-10


def test_strata_have_their_rank_dimension_and_motion() -> None:
    found = {row.states: (row.rank, row.dimension, row.bound, row.finite) for row in literature.strata()}
    assert found == {
        "in general": (6, 6, 6, 0),
        "one stage turned by a half turn": (5, 5, 5, 0),
        "both tilted about the revolute axis of one leg": (5, 4, 5, 1),
        "upside down: opposite tilts that add up to a half turn": (5, 4, 5, 1),
        "the same about the revolute axis of one leg": (4, 3, 3, 2),
        "a half turn and a tilt about the revolute axis of one leg": (4, 3, 4, 1),
        "a half turn across the revolute axis of one leg, a tilt about it": (4, 3, 4, 1),
        "equal tilts, the symmetric home among them": (3, 4, 4, 3),
        "both stages turned by half turns": (3, 4, 4, 1),
        "one stage turned by a half turn, the other level": (3, 3, 3, 1),
        "equal half turns": (2, 3, 3, 3),
    }


def test_the_mechanism_has_six_freedoms() -> None:
    """Also where its platform has five or three."""
    found = literature.freedoms()
    assert [row.mechanism for row in found] == [6, 6, 6]
    assert [row.platform for row in found] == [6, 5, 3]


def test_modes_meet_at_half_turns_where_the_revolute_joints_are_dependent() -> None:
    before, between, after = literature.passages()
    assert (before.families, between.families, after.families) == ("T", "T or F", "F")
    assert (before.rank, between.rank, after.rank) == (3, 2, 3)
    assert abs(between.determinant) < 1e-15 < 1e-3 < min(abs(before.determinant), abs(after.determinant))
    assert max(before.closure, between.closure, after.closure) < 1e-15


def test_a_self_motion_passes_from_mode_t_to_mode_f() -> None:
    lengths, p = literature.self_motion()
    e = literature.MACHINE.platform_radius / literature.MACHINE.middle_radius
    expected = np.sqrt([3.0 * (1.0 - e**2), (3.0 * e) ** 2, 3.0 * (1.0 - e**2)])
    np.testing.assert_allclose(lengths, np.broadcast_to(expected, lengths.shape), atol=1e-13)
    np.testing.assert_array_equal(p[:, 0], 1.0)  # both halves begin at the half turn
    assert (np.diff(p, axis=1) <= 0.0).all()
    assert p[:, -1].max() < 0.9


def test_assembly_modes_of_equal_lengths_are_joined_without_a_singularity() -> None:
    found = nonsingular_changes(literature.MACHINE)
    hips = {mode: {round(row.hips, 9) for row in found if row.stage.endswith(mode)} for mode in ("T", "F")}
    assert hips["T"] >= {0.1, 0.233, 0.4, 0.6, 0.75, 1.0, 1.5, 3.0}
    assert hips["F"] >= {0.1, 0.5, 0.75, 1.0, 1.5}
    for row in found:
        assert row.lengths_differ < 1e-13, row
        assert row.apart > 0.1, row
        assert row.least > 0.0, row


def test_the_determinant_on_the_circle_is_the_quadratic_of_the_proof() -> None:
    rng = np.random.default_rng(0)
    for epsilon in (-2.0, -0.5, 0.1, 0.3, 0.75, 1.5, 4.0):
        p, psi = rng.uniform(0.01, 0.99, 50), rng.uniform(-np.pi, np.pi, 50)
        z = -(2.0 * epsilon - 1.0 + 2.0 * p) * np.sqrt(p / (1.0 - p)) / 2.0
        states = np.sqrt(p) * np.cos(psi), np.sqrt(p) * np.sin(psi), z
        found = stage_region(epsilon).evaluate(*(Interval.from_numbers(part) for part in states)).determinant
        expected = 27.0 * p**1.5 / (32.0 * np.sqrt(1.0 - p)) * reduced_determinant(p, epsilon, np.cos(3.0 * psi))
        np.testing.assert_allclose(0.5 * (found.low + found.high), expected, rtol=1e-9, atol=1e-9)
        kappa = 2.0 * epsilon - 1.0
        last = (
            (4 * p + 1 - 2 * epsilon) * (4 * p + 2 * epsilon - 3) * (8 * p**2 + 8 * (epsilon - 1) * p + 1 - 6 * epsilon)
        )
        np.testing.assert_allclose(
            reduced_determinant(p, epsilon, 1.0), 3.0 * kappa * (kappa + 2.0) ** 2, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(reduced_determinant(p, epsilon, -1.0), last, rtol=1e-9, atol=1e-9)


def test_the_ranges_of_the_proof_close_the_gap_between_the_circles() -> None:
    first, second = proved_ranges()
    assert first.least < 1.0 / 6.0
    assert first.most == second.least
    assert second.most == 0.5
    with pytest.raises(ValueError, match="not proved"):
        negative(RANGES[0][2], determinant_on_curve, (0.4, 0.6), (-1.0, 1.0))


def test_the_determinant_on_the_path_is_that_of_the_stage() -> None:
    for low, high, shape in RANGES:
        epsilon = 0.4 * low + 0.6 * high
        path, u = curve(epsilon, *shape), np.cos(3.0 * np.linspace(0.0, 2.0 * np.pi / 3.0, 49))
        expected = stage_region(epsilon).evaluate(*(Interval.from_numbers(path[:, i]) for i in range(3))).determinant
        lever = np.sqrt(1.0 - (path[:, :2] ** 2).sum(axis=1))
        found = determinant_on_curve(Interval.from_numbers(epsilon), Interval.from_numbers(u), shape)
        np.testing.assert_allclose(6.75 * lever * middle(found), middle(expected), atol=1e-13)
        if shape[0] == shape[1]:
            ends = [
                middle(determinant_on_curve(Interval.from_numbers(epsilon), Interval.from_numbers(u + h), shape))
                for h in (1e-6, -1e-6)
            ]
            slope = -middle(falling_on_curve(Interval.from_numbers(epsilon), Interval.from_numbers(u), shape))
            np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def middle(interval: Interval) -> np.ndarray:
    return np.asarray(0.5 * (interval.low + interval.high))


def test_every_table_of_the_page_is_made() -> None:
    text = literature.with_tables(literature.PAGE.read_text(encoding="utf-8"))
    assert "<!-- table" not in text
    assert text.count("\n|---|") == 6
