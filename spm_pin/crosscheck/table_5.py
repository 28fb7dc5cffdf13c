"""Table 5: the true rates and forces by three methods, and the mistakes that give the printed ones."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import product

import numpy as np

from spm_pin.crosscheck.cells import Cell, Verdict, matches
from spm_pin.kinematics.jacobians import leg_rates
from spm_pin.kinematics.leg_forces import leg_forces
from spm_pin.mechanism import LEGS, Configuration
from spm_pin.paper import published
from spm_pin.paper.driving_forces import load, table_5
from spm_pin.paper.jacobian import Table5Mistakes

_CM = 100.0
"""Centimetres per metre."""
_KILO = 1e3
"""Newtons per kilonewton."""
_ROWS = ("v", "f")
"""Names of the rows of Table 5: rates and forces."""


@dataclass(frozen=True)
class TrueValue:
    """One true number of Table 5 by three methods: cm/s or kN."""

    name: str
    """Name of the row and the leg, as `v_rb1` or `f_rc3`."""
    paper: float
    """By the paper's 9 × 9 Jacobian, corrected."""
    closed_form: float
    """By the wrench matrices of `spm_pin.kinematics`."""
    pinocchio: float
    """By the constrained multibody model of `spm_pin.multibody`."""


@dataclass(frozen=True)
class Diagnosis:
    """The fewest of `Table5Mistakes` that give a printed row of Table 5 to its four decimals."""

    row: str
    """Name of the row, v for the rates or f for the forces."""
    mistakes: Table5Mistakes
    """The mistakes that are made together."""
    values: tuple[float, ...]
    """All six values of the row, so that the empty cell is recovered too."""

    @property
    def names(self) -> tuple[str, ...]:
        """The switches of `Table5Mistakes` that are needed."""
        return tuple(field.name for field in fields(self.mistakes) if getattr(self.mistakes, field.name))


def diagnoses(third: Configuration) -> list[Diagnosis]:
    """Find the fewest mistakes that give each printed row of Table 5; none where no combination does."""
    combinations = [Table5Mistakes(*flags) for flags in sorted(product((False, True), repeat=3), key=sum)]
    found = []
    for row, (name, printed) in enumerate(zip(_ROWS, published.TABLE_5, strict=True)):
        for mistakes in combinations:
            values = table_5(third, mistakes)[row]
            if all(text is None or matches(text, complex(x)) for text, x in zip(printed, values, strict=True)):
                found.append(Diagnosis(name, mistakes, tuple(float(x) for x in values)))
                break
    return found


def true_values(third: Configuration) -> list[TrueValue]:
    """Find the true rates and forces by the paper's corrected 9 x 9, by the wrench form, and by Pinocchio."""
    from spm_pin.multibody.chain import ClosedChain

    twist = np.concatenate([np.array(published.VELOCITY[:3]) / _CM, np.deg2rad(published.VELOCITY[3:])])
    wrench = np.concatenate(load())
    chain = ClosedChain.from_urdf()
    q = chain.joint_values(third)
    paper = table_5(third)
    closed_form = leg_rates(third, twist) * _CM, leg_forces(third, wrench) / _KILO
    pinocchio = chain.inverse_jacobian(q) @ twist * _CM, chain.leg_forces(q, wrench) / _KILO
    rows = zip(paper, closed_form, pinocchio, strict=True)
    return [
        TrueValue(f"{name}_{leg.replace('_', '')}", *(float(x) for x in values))
        for name, row in zip(_ROWS, rows, strict=True)
        for leg, *values in zip(LEGS, *row, strict=True)
    ]


def rates_and_forces(true: list[TrueValue], found: list[Diagnosis]) -> list[Cell]:
    """Compare Table 5 with the true rates [cm/s] and forces [kN]."""
    explained = {diagnosis.row: diagnosis for diagnosis in found}
    cells = []
    for k, (text, value) in enumerate(zip((*published.TABLE_5[0], *published.TABLE_5[1]), true, strict=True)):
        diagnosis = explained.get(value.name[0])
        verdict, note = Verdict.SAME, ""
        if text is None:
            verdict, note = Verdict.NOT_PRINTED, "the cell is empty"
            if diagnosis is not None:
                note += f"; with the mistakes of its row it would read {diagnosis.values[k % 6]:.4f}"
        elif not matches(text, complex(value.closed_form)):
            verdict = Verdict.UNEXPLAINED if diagnosis is None or not diagnosis.names else Verdict.MISPRINT
        cells.append(Cell(5, value.name, "3", text, complex(value.closed_form), verdict, note))
    return cells
