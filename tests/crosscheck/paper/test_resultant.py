"""The paper's route against the closed form, and its losses of digits and of branches."""

from __future__ import annotations

import numpy as np
from oracle import certified_counts
from problems import EXAMPLE, MANIPULATORS, PAPER, Problem, in_leg_space, random_branches

import spm_pin as spm
from spm_pin.crosscheck.paper import resultant


def assert_agreement(problem: Problem, losses: float) -> None:
    """Same branches under the same labels; where not, an exact count sides with the closed form, always.

    `losses` bounds the share of poses where the paper's route finds another number of branches.
    """
    paper = resultant.inverse_displacement(problem.machine, problem.pose)
    closed = spm.inverse_displacement(problem.machine, problem.pose)
    differ = (paper.exists != closed.exists).any(axis=-1)
    assert differ.mean() < losses
    truth = certified_counts(problem.pose[differ], problem.machine.middle_side)
    np.testing.assert_array_equal(closed.count[differ], truth)
    assert (paper.count[differ] <= truth).all(), "the paper's route invents nothing"
    error = np.abs(paper.middle_joints - closed.middle_joints).max(axis=(-1, -2))
    error = error[paper.exists & closed.exists & ~differ[:, None]] / problem.machine.middle_side
    assert np.quantile(error, 0.5) < 1e-13
    assert np.quantile(error, 0.99) < 1e-9


def test_agreement_in_leg_space_and_over_all_rotations() -> None:
    assert_agreement(in_leg_space(PAPER, 2_000, 1), losses=0.015)
    for machine in MANIPULATORS.values():
        for family in spm.machine.FAMILIES:
            assert_agreement(random_branches(machine, family, 250, 2), losses=0.1)


def test_the_roots_are_those_of_the_determinant_which_is_an_octic() -> None:
    lines = resultant.Resultant.from_pose(PAPER, EXAMPLE)
    roots = lines.roots()
    real = np.sort(roots[0, np.abs(roots[0].imag) < 1e-9].real)
    assert len(real) == 6
    # The determinant changes sign at each real root and nowhere else on the interval.
    across = np.linspace(-0.92, 0.92, 20_001)
    values = lines.determinant(across)[0]
    changes = across[np.flatnonzero(np.diff(np.sign(values)))]
    np.testing.assert_allclose(changes, real, atol=1e-4)
    nodes = np.cos((np.arange(15) + 0.5) * np.pi / 15)
    series = np.polynomial.chebyshev.chebfit(nodes, lines.determinant(nodes)[0], 14)
    assert np.abs(series[9:]).max() < 1e-12 * np.abs(series).max()
    assert abs(series[8]) > 1e-6 * np.abs(series).max()


def test_pure_paper_without_refinement_reaches_eight_digits_at_the_example() -> None:
    roots = resultant.solve(PAPER, EXAMPLE)
    truth = spm.kinematics.complex_middle_joints(PAPER, EXAMPLE)
    gaps = np.abs(roots[:, None] - truth[None]).max(axis=(-1, -2))
    assert (gaps.min(axis=1) < 1e-8).all()
    assert sorted(gaps.argmin(axis=1)) == list(range(8))


def test_equations_13_are_the_sides_of_the_triangle() -> None:
    """Random points on the lines of Eq. (11): Eq. (13) is the squared side minus d², Eq. (12)."""
    lines = resultant.Resultant.from_pose(PAPER, EXAMPLE)
    unknowns = np.random.default_rng(0).normal(size=(1, 8, 3)) + 0j
    b = lines.middle_joints(unknowns)[0].real
    sides = [((b[:, i] - b[:, j]) ** 2).sum(axis=-1) - 0.64 for i, j in ((0, 1), (2, 1), (0, 2))]
    np.testing.assert_allclose(lines.equations(unknowns)[0][0].real, np.stack(sides, axis=-1), rtol=1e-12, atol=1e-12)
    configuration = spm.Configuration(PAPER, EXAMPLE, b)
    planes = (b - configuration.platform_joints) * configuration.platform_axes
    np.testing.assert_allclose(planes.sum(axis=-1), 0.0, atol=1e-13)


def test_a_vertical_line_is_unsolved_not_unreachable() -> None:
    pose = spm.pose([0.1, 0.05, 2.2], rotation=np.eye(3))
    assert resultant.inverse_displacement(PAPER, pose).status is spm.Status.UNSOLVED
    assert np.isnan(resultant.solve(PAPER, pose)).all()
