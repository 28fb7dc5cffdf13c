"""The programs of docs/theory/uniqueness.md, and the theorem against the package's rule."""

from __future__ import annotations

import numpy as np
import pytest
import uniqueness_check
import uniqueness_proof
from uniqueness_figure import share_of_aspects, values
from uniqueness_slides import SLIDES, slide_pair, slide_stage

from spm_pin.formulas.operations import on_arrays
from spm_pin.formulas.planar_legs import prs_reading
from spm_pin.formulas.stages import corners, in_home_aspect


def test_the_identities_hold() -> None:
    results = [(name, polynomial == 0) for name, polynomial in uniqueness_proof.identities()]
    assert [name for name, holds in results if not holds] == []
    numbers = {int(name[1:].split(")")[0]) for name, _ in results}
    assert numbers == set(range(4, 16)), "every numbered formula of the page but the definitions (1) to (3)"


def test_another_program_finds_the_same() -> None:
    found = uniqueness_check.results(points=2, trials=1_000)
    assert all(tried > 0 and failed == 0 for tried, failed in found.values()), found


def test_the_inequality_needs_its_assumption() -> None:
    # v < 0, that is ζ < 0, at this point.
    p, e, f, k = 47 / 10, -8 / 5, 9 / 5, 1
    assert f + k + p * e < 0
    assert uniqueness_check.second_polynomial(p, e, f, k) <= 0  # type: ignore[arg-type]
    terms = uniqueness_check.quartic(e, f, k)  # type: ignore[arg-type]
    assert sum(term * p ** (4 - i) for i, term in enumerate(terms)) < 0


def test_the_set_of_the_theorem_is_that_of_the_rule() -> None:
    rng = np.random.default_rng(0)
    ratios = np.geomspace(0.02, 10.0, 40)[:, None]
    p = rng.uniform(0.0, 1.0, (40, 2_000)) ** rng.choice([0.25, 1.0, 4.0], (40, 2_000))
    psi, height = rng.uniform(-np.pi, np.pi, p.shape), np.tan(rng.uniform(-1.5, 1.5, p.shape))
    x0, w = np.sqrt(1.0 - p), np.sqrt(p) * np.exp(1j * psi)
    rule = on_arrays(in_home_aspect)(*on_arrays(corners)(x0, w.real, w.imag, 0.0, height), ratios)
    theorem = np.array([values(*row).home for row in zip(ratios[:, 0], w, 2.0 * height * x0 / np.abs(w), strict=True)])
    np.testing.assert_array_equal(rule, theorem)
    assert 0.05 < rule.mean() < 0.5


def test_aspects_on_a_grid() -> None:
    assert [share_of_aspects(ratio, cells=61)[2] for ratio in (0.5, 5.0)] == [2, 5]


def test_a_stage_of_slides_has_two_states_in_one_aspect() -> None:
    epsilon, rod, end = SLIDES
    assert slide_pair(*SLIDES).proved
    assert slide_pair(*SLIDES).least > 0.137
    # The state between, and its mirror image in the plane of leg 2.
    low, high = 0.5, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        slides, _ = slide_stage(epsilon, rod, np.asarray(middle * end))
        low, high = (middle, high) if slides[0] < slides[2] else (low, middle)
    pair = low * np.array([end, np.conj(end)])
    slides, determinants = slide_stage(epsilon, rod, pair)
    np.testing.assert_allclose(slides[:, 0], slides[:, 1], atol=1e-15)
    assert (determinants > 0.137).all()
    # Carriages as the package reads them.
    x0 = np.sqrt(1.0 - np.abs(pair) ** 2)
    radii, heights = on_arrays(corners)(x0, pair.real, pair.imag, 0.0, 0.0)
    readings = [prs_reading(x - epsilon, z, 0.0, (rod, np.pi / 2.0, -1.0)) for x, z in zip(radii, heights, strict=True)]
    np.testing.assert_allclose(readings, slides, atol=1e-15)


def test_a_ray_is_looked_at_all_along_and_boxes_are_as_wide_as_their_parts() -> None:
    # D is negative on the way and positive at both ends; and few boxes are too wide to prove anything.
    crossing = 0.3258956548241154, 1.7170644929433232, -0.8680098392074113 + 0.18254336812748898j
    determinants = slide_stage(crossing[0], crossing[1], np.linspace(0.0, 1.0, 1001) * crossing[2])[1]
    assert np.nanmin(determinants) < 0.0 < determinants[[0, -1]].min()
    assert slide_pair(*crossing).least < 0.0
    assert not slide_pair(*SLIDES, boxes=5).proved


@pytest.mark.parametrize(
    ("epsilon", "rod", "end"), [(0.25, 1.4, 0.5 * SLIDES[2]), (1.0, 1.4, SLIDES[2]), (0.25, 0.9, SLIDES[2])]
)
def test_no_pair_is_proved_where_there_is_none(epsilon: float, rod: float, end: complex) -> None:
    assert not slide_pair(epsilon, rod, end).proved
