"""Regressions named after the paper's tables; misprints are found by computation."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields

import spm_pin as spm
from spm_pin.crosscheck import Reproduction, Verdict, reproduce
from spm_pin.crosscheck.paper import published, resultant
from spm_pin.crosscheck.paper_tables import matches

EXAMPLE = spm.pose(np.array(published.POSITION) / 100, xyx=np.deg2rad(published.XYX_DEGREES))


@pytest.fixture(scope="module")
def found() -> Reproduction:
    return reproduce()


@pytest.mark.parametrize(("table", "cells", "wrong"), [(1, 24, 0), (2, 24, 0), (3, 24, 1), (4, 36, 2)])
def test_every_printed_digit(found: Reproduction, table: int, cells: int, wrong: int) -> None:
    assert len(found.table(table)) == cells
    assert sum(cell.verdict is not Verdict.SAME for cell in found.table(table)) == wrong
    assert not found.unexplained


def test_resultant_and_closed_form_find_the_same_eight_solutions(found: Reproduction) -> None:
    assert sorted(solution.label for solution in found.solutions) == sorted(spm.machine.BRANCHES)
    # cm; the octic of the paper's route costs it about five digits.
    assert max(solution.difference for solution in found.solutions) < 1e-9
    assert found.solutions[2].label == "TT+"


def test_equation_17_as_printed_has_no_real_root(found: Reproduction) -> None:
    assert found.equation_17 == {"printed": 0, "mended": 6, "true": 6}
    lines = resultant.Resultant.from_pose(spm.Manipulator.paper(), EXAMPLE)
    true = spm.inverse_displacement(spm.Manipulator.paper(), EXAMPLE).middle_joints[:, 1, 1]
    true = true[np.isfinite(true)]
    across = np.linspace(-0.9, 0.9, 50)
    scale = np.abs(lines.determinant(across)).max()
    assert np.abs(lines.determinant(true)).max() < 1e-12 * scale
    assert np.abs(lines.determinant(true, as_printed=True)).min() > 1e-8 * scale


@pytest.mark.parametrize(
    ("text", "value", "agrees"),
    [
        ("46.19", 46.1949, True),
        ("46.19", 46.1951, False),
        ("-90.26+167.89i", complex(-90.2597, 167.8887), True),
        ("-90.26+167.89i", complex(-90.2597, -167.8887), False),
        ("0", 1e-12, True),
        ("0", 0.2, False),
        ("46.19", complex(46.19, 0.2), False),
    ],
)
def test_digits_are_compared_as_printed(text: str, value: complex, agrees: bool) -> None:
    assert matches(text, complex(value)) is agrees


def test_only_tables_that_can_be_reproduced() -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="tables")):
        reproduce([6])
