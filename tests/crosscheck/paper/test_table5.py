"""Table 5: the true values at solution 3, and the three mistakes that together give the printed ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.crosscheck.paper import published
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes, load, table_5

SWITCHES = ("printed_lever_arm", "missing_entry", "other_load")
NEEDED = ({"printed_lever_arm", "missing_entry"}, set(SWITCHES))  # by the row of rates, and by that of forces
# The upper legs' forces need less: lower legs that are locked do not turn, whatever the coefficients of ω_rb.
NEEDED_BY_UPPER_FORCES = {"printed_lever_arm", "other_load"}

POSE = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))


@pytest.fixture(scope="module")
def solution_3() -> spm.Configuration:
    """The branch whose leg lengths are the third column of Table 4."""
    branches = spm.inverse_displacement(spm.Manipulator.paper(), POSE)
    column = np.array([float(row[2]) for row in published.TABLE_4]) / 100
    distance = np.abs(branches.leg_lengths - column).max(axis=-1)
    chosen = int(np.nanargmin(distance))
    assert branches.labels[chosen] == "TT+"
    assert distance[chosen] <= 0.5e-6 * (1 + 1e-6)  # half a unit of the last printed digit
    return branches["TT+"]


def decimals(row: np.ndarray) -> list[str]:
    return [f"{value:.4f}" for value in row]


def agrees(row: np.ndarray, printed: tuple[str | None, ...]) -> list[bool]:
    return [ours == theirs for ours, theirs in zip(decimals(row), printed, strict=True) if theirs is not None]


def test_recomputed_values_of_table_5(solution_3):
    v_r, f_r = table_5(solution_3)
    assert decimals(v_r) == ["-0.2932", "8.7198", "48.2731", "4.3340", "-4.7388", "-38.7021"]
    assert decimals(f_r) == ["21.5520", "-14.8906", "23.8779", "30.7096", "-12.8889", "26.9840"]


def test_true_values_are_those_of_the_closed_form(solution_3):
    """Not of the paper's nine by nine system; rates in cm/s, forces in kN."""
    v_r, f_r = table_5(solution_3)
    twist = np.concatenate([1e-2 * np.array(published.VELOCITY[:3]), np.deg2rad(published.VELOCITY[3:])])
    np.testing.assert_allclose(v_r, 100 * spm.leg_rates(solution_3, twist), rtol=1e-11)
    np.testing.assert_allclose(1e3 * f_r, spm.leg_forces(solution_3, np.concatenate(load())), rtol=1e-11)


def test_printed_values_come_from_three_mistakes(solution_3):
    v_r, f_r = table_5(solution_3, Table5Mistakes(True, True, True))
    assert agrees(v_r, published.TABLE_5[0]) == agrees(f_r, published.TABLE_5[1]) == [True] * 5
    # The cells that the paper leaves empty.
    assert published.TABLE_5[0][5] is published.TABLE_5[1][5] is None
    assert (decimals(v_r)[5], decimals(f_r)[5]) == ("35.6654", "79.9695")


@pytest.mark.parametrize("row", [0, 1], ids=["rates", "forces"])
@pytest.mark.parametrize("made", list(itertools.product([False, True], repeat=3)))
def test_which_mistakes_a_row_needs(solution_3, row, made):
    mistakes = Table5Mistakes(*made)
    names = {name for name, active in zip(SWITCHES, made, strict=True) if active}
    hits = agrees(table_5(solution_3, mistakes)[row], published.TABLE_5[row])
    upper = NEEDED_BY_UPPER_FORCES if row == 1 else NEEDED[row]
    assert hits == [names >= NEEDED[row]] * 3 + [names >= upper] * 2
