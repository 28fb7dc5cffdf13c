"""The program of the proof that the rule of `in_home_aspect` describes the home's aspect."""

from __future__ import annotations

import numpy as np
import pytest
from home_aspect_proof import PAIRS, RATIOS, ascents, determinant_and_slope, exits, factors, rest

from spm_pin.formulas.stages import corners, stage_pairs


@pytest.mark.parametrize(
    ("least", "most"),
    [
        *((ratio * (1.0 - 1e-6), ratio * (1.0 + 1e-6)) for ratio in (0.02, 0.8660254, 10.0)),
        *(pytest.param(*ends, marks=pytest.mark.slow) for ends in RATIOS[::10]),
    ],
)
def test_the_rule_cannot_be_left_without_a_singularity(least: float, most: float) -> None:
    assert rest(least, most) == 0


def test_what_does_not_hold_is_not_proved() -> None:
    # Hips at radius zero, and a base that is too large for the subdivision.
    assert exits(0.0, 1e-3, 10_000) > 0
    assert exits(0.5, 5.0, 10_000) > 0
    assert ascents(0.5, 5.0, 10_000) > 0


def point(*coordinates: float) -> np.ndarray:
    """Return the cell of one p, ψ, θ and ε."""
    return np.array([coordinates])[..., None].repeat(2, axis=-1)


def test_the_factors_are_those_of_the_package() -> None:
    rng = np.random.default_rng(0)
    for p, psi, height, ratio in rng.uniform([0.0, -3.0, -2.0, 0.1], [1.0, 3.0, 2.0, 3.0], (20, 4)):
        radii, heights = corners(np.sqrt(1.0 - p), np.sqrt(p) * np.cos(psi), np.sqrt(p) * np.sin(psi), 0.0, height)
        reach = 2.0 * np.sqrt((1.0 - p) * p)
        cell = point(p, psi, np.arctan2(reach, height), ratio)
        found, _ = factors(cell, *cell[:, 1].T, 1)
        nearby, _ = factors(cell, *cell[:, 1].T + 1e-6, 0)
        size, expected = np.hypot(height, reach), dict(zip(PAIRS, stage_pairs(radii, heights, ratio), strict=True))
        for pair, (value, slope) in found.items():
            assert size * value.low[0] <= expected[pair] + 1e-12
            assert expected[pair] - 1e-12 <= size * value.high[0]
            assert slope.low[0] == pytest.approx((nearby[pair][0].low[0] - value.low[0]) / 1e-6, abs=1e-4)


def test_series_of_the_determinant_in_the_azimuth() -> None:
    rng = np.random.default_rng(2)

    def values(*coordinates: float) -> tuple[float, float]:
        cell = point(*coordinates)
        return tuple(float(x[0].low[0] + x[0].high[0]) / 2.0 for x in determinant_and_slope(cell, *cell[:, 1].T, 2)[1:])

    for number in (0, 1) * 4:
        plane = number * np.pi / 3.0
        p, theta, ratio = rng.uniform([0.0, 0.0, 0.1], [1.0, 1.5, 2.0])
        cell = point(p, plane, theta, ratio)
        for k, found in enumerate(determinant_and_slope(cell, *cell[:, 1].T, 2)[1:]):
            below, here, above = (values(p, plane + h, theta, ratio)[k] for h in (-1e-4, 0.0, 1e-4))
            assert below == pytest.approx(above, abs=1e-12), "even about the plane"
            assert found[2].low[0] == pytest.approx((below - 2.0 * here + above) / 1e-8, abs=1e-5)
        ahead, behind = (values(p + h, plane, theta, ratio)[0] for h in (1e-6, -1e-6))
        assert values(p, plane, theta, ratio)[1] == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)
        side = np.sin(theta) * (1 - 2 * number)
        z, third = np.cos(theta) - side / 2.0, np.cos(theta) + side
        u, v = z * (ratio + 0.5 - 1.5 * p) + third * (1 - ratio), third * (ratio + 0.5) + z * (1 - 3 * p - ratio)
        assert values(p, plane, theta, ratio)[0] == pytest.approx(3.0 * z * u * v, abs=1e-12)
