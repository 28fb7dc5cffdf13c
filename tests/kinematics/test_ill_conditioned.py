"""Assembly modes beside continuous families and with very short legs, counted as exact elimination counts them."""

from __future__ import annotations

import numpy as np
import pytest
from stage_oracle import certified_modes, scanned_modes

import spm_pin as spm

PAPER = spm.Geometry.paper()
D, R = PAPER.middle_side, PAPER.middle_radius
REGULAR = [1.2, 1.3, 1.4]


def lower_count(solutions: spm.SolutionSet) -> int:
    return int(solutions.exists.reshape(16, 16).any(axis=-1).sum())


@pytest.mark.parametrize("ratio", [0.4, 0.75, 0.99, 0.5])
@pytest.mark.parametrize("away", [1e-7, 1e-8, 1e-10, 1e-12, 1e-13])
def test_all_modes_beside_a_continuous_family_are_found(ratio: float, away: float) -> None:
    rng = np.random.default_rng(5)
    geometry = spm.Geometry(ratio * R, PAPER.platform_radius, D)
    for _ in range(2):
        family = np.full(3, 1.2) if ratio == 0.5 else R * np.array([3 * ratio, *np.sqrt([3 - 3 * ratio**2] * 2)])
        legs = np.roll(family * (1.0 + away * rng.normal(size=3)), rng.integers(3))
        solutions = spm.forward_displacement(geometry, [*legs, *REGULAR])
        assert lower_count(solutions) == certified_modes(legs, geometry.base_radius, D)
        assert np.nanmax(np.abs(solutions.leg_lengths[..., :3] - legs)) < 1e-14
        assert np.nanmax(solutions.residual) < 1e-14


def test_the_papers_upper_stage_beside_its_family() -> None:
    """It has four real modes; a scan of equal steps finds eight, for another leg is free where the first is level."""
    legs = [1.0392304745246594, 0.529150245775729, 0.5291502561685462]
    solutions = spm.forward_displacement(PAPER, [*REGULAR, *legs])
    upper = int(solutions.exists.reshape(16, 16).any(axis=0).sum())
    assert upper == certified_modes(legs, PAPER.platform_radius, D) == 4
    for first in range(3):
        assert scanned_modes(np.roll(legs, -first), PAPER.platform_radius, D) == 4
    assert scanned_modes(REGULAR, PAPER.base_radius, D) == certified_modes(REGULAR, PAPER.base_radius, D) == 12


@pytest.mark.parametrize("size", [1e-4, 1e-6, 1e-8])
def test_very_short_legs_are_kept(size: float) -> None:
    """Hips as far out as the corners: no spurious modes, and lengths to rounding of the coordinates."""
    geometry = spm.Geometry(R, PAPER.platform_radius, D)
    rng = np.random.default_rng(6)
    for _ in range(2):
        legs = size * rng.uniform(1.0, 1.3, 3)
        solutions = spm.forward_displacement(geometry, [*legs, *REGULAR])
        assert lower_count(solutions) == certified_modes(legs, geometry.base_radius, D)
        assert np.nanmax(np.abs(solutions.leg_lengths[..., :3] - legs)) < 1e-15
