"""Table 5: the true values at solution 3, and the three mistakes that together give the printed ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.paper import published
from spm_pin.paper.jacobian import J_alpha, J_f, J_lambda, Table5Mistakes, load, table_5

SWITCHES = ("printed_lever_arm", "missing_entry", "other_load")
NEEDED = ({"printed_lever_arm", "missing_entry"}, set(SWITCHES))  # by the row of rates, and by that of forces
# The upper legs' forces need less: lower legs that are locked do not turn, whatever the coefficients of ω_rb.
NEEDED_BY_UPPER_FORCES = {"printed_lever_arm", "other_load"}

POSE = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))


@pytest.fixture(scope="module")
def solution_3() -> spm.Configuration:
    """The branch whose leg lengths are the third column of Table 4."""
    branches = spm.inverse_displacement(spm.Geometry.paper(), POSE)
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


def test_true_rates_are_those_of_the_displacement(solution_3):
    """Moving the platform along the twist changes the lengths at the true rates, not at the printed ones."""
    v, omega = 1e-2 * np.array(published.VELOCITY[:3]), np.deg2rad(published.VELOCITY[3:])

    def lengths(t: float) -> np.ndarray:
        moved = spm.pose(POSE.translation + v * t, rotation=Rotation.from_rotvec(omega * t) * POSE.rotation)
        return spm.inverse_displacement(spm.Geometry.paper(), moved)["TT+"].leg_lengths

    def central(h: float) -> np.ndarray:
        return (lengths(h) - lengths(-h)) / (2 * h)

    # Richardson: the error of `fine` is about a fifteenth of its change; the lengths' rounding, 1e-13 m, over h.
    coarse, fine = ((4 * central(h / 2) - central(h)) / 3 for h in (4e-3, 2e-3))
    v_r, _ = table_5(solution_3)
    error = np.abs(100 * fine - v_r)
    tolerance = 100 * (np.abs(fine - coarse) + 1e-13 / 2e-3)
    assert (tolerance < 0.5e-4).all(), "too coarse to confirm four decimals"
    assert (error <= tolerance).all()


def test_true_forces_balance_the_true_rates(solution_3):
    """Virtual work, Eq. (32), with the twist that produced the rates."""
    v_r, f_r = table_5(solution_3)
    twist = np.concatenate([published.VELOCITY[:3], np.deg2rad(published.VELOCITY[3:])])
    powers = np.concatenate([f_r * v_r, np.concatenate([published.FORCE, published.TORQUE]) * twist])
    # The forces are off by the condition number of J_f with lengths in units of d, and a few tens of eps.
    scaled = J_f(solution_3) / [1, 1, 1, *[solution_3.geometry.middle_side] * 3]
    assert abs(powers.sum()) <= 64 * np.finfo(float).eps * np.linalg.cond(scaled) * np.abs(powers).sum()


def test_printed_values_come_from_three_mistakes(solution_3):
    v_r, f_r = table_5(solution_3, Table5Mistakes(True, True, True))
    assert agrees(v_r, published.TABLE_5[0]) == agrees(f_r, published.TABLE_5[1]) == [True] * 5
    # The cells that the paper leaves empty.
    assert published.TABLE_5[0][5] is published.TABLE_5[1][5] is None
    assert (decimals(v_r)[5], decimals(f_r)[5]) == ("35.6654", "79.9695")


@pytest.mark.parametrize("row", [0, 1], ids=["rates", "forces"])
@pytest.mark.parametrize("made", list(itertools.product([False, True], repeat=3)))
def test_which_mistakes_a_row_needs(solution_3, row, made):
    """A number comes out when all the mistakes it needs are made, and never without one of them."""
    mistakes = Table5Mistakes(*made)
    names = {name for name, active in zip(SWITCHES, made, strict=True) if active}
    hits = agrees(table_5(solution_3, mistakes)[row], published.TABLE_5[row])
    upper = NEEDED_BY_UPPER_FORCES if row == 1 else NEEDED[row]
    assert hits == [names >= NEEDED[row]] * 3 + [names >= upper] * 2


def test_printed_load_is_the_default():
    F, T = load()
    assert F.tolist() == [-20e3, -30e3, -30e3]
    assert T.tolist() == [-300.0, -300.0, 1000.0]
    assert [array.tolist() for array in load(Table5Mistakes(other_load=True))] != [
        F.tolist(),
        T.tolist(),
    ]


def test_switches_touch_what_they_name(solution_3):
    """One block of J_λ, one entry of J_α, and nothing else."""
    arm, entry = Table5Mistakes(printed_lever_arm=True), Table5Mistakes(missing_entry=True)
    changed = J_lambda(solution_3, arm) != J_lambda(solution_3)
    assert changed[:3, 3:6].all()
    changed[:3, 3:6] = False
    assert not changed.any()
    assert np.array_equal(J_alpha(solution_3, arm), J_alpha(solution_3))
    changed = J_alpha(solution_3, entry) != J_alpha(solution_3)
    assert np.argwhere(changed).tolist() == [[8, 8]]
    assert J_alpha(solution_3, entry)[8, 8] == 0.0
    assert np.array_equal(J_lambda(solution_3, entry), J_lambda(solution_3))
