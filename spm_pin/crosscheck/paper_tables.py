"""The paper's tables recomputed beside what the paper printed, every difference explained by what the code finds.

No misprint is listed here. A cell that differs in its printed digits is searched for a cause in the numbers
themselves: a sign, a shifted column, a cell left empty. What has no cause is `Verdict.UNEXPLAINED`.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
import numpy.typing as npt
import scipy

from spm_pin.crosscheck.paper import published, resultant
from spm_pin.crosscheck.paper.jacobian import Table5Mistakes, load, table_5
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import complex_middle_joints
from spm_pin.kinematics.rates_and_forces import leg_forces, leg_rates
from spm_pin.machine import BRANCHES, LEGS, Configuration, Manipulator, pose
from spm_pin.support.arguments import FloatArray, IntArray

TABLES = (1, 2, 3, 4, 5)
"""Numbers of the paper's tables that can be recomputed."""
POSE = 0
"""Number of the cells that compare the example's pose; the paper has no table of it."""
# The lengths of which the printed pose is the forward displacement, found there "by simulation", in cm.
_SIMULATED_LEGS = (120.0, 120.0, 140.0, 125.0, 120.0, 150.0)
_CM = 100.0
"""Centimetres per metre."""
_COORDINATES = {1: published.TABLE_1, 2: published.TABLE_2, 3: published.TABLE_3}
_KILO = 1e3
"""Newtons per kilonewton."""
_ROWS = ("v", "f")
"""Names of the rows of Table 5: rates and forces."""


class Verdict(enum.StrEnum):
    """Verdict on a printed cell."""

    SAME = "same"
    MISPRINT = "misprint"
    NOT_PRINTED = "not printed"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Cell:
    """One cell of a table in the paper's units: cm, cm/s, kN."""

    table: int
    """Number of the table, from 1 to 5; `POSE` for the pose of the example."""
    row: str
    """Name of the row, as `b_1 X` or `r_b1`."""
    column: str
    """Number of the solution, from 1 to 8, as the paper counts them."""
    published: str | None
    """The number as printed; None where the cell is empty."""
    recomputed: complex
    """The true number [cm, cm/s, kN, or degrees for the angles of the pose]; complex in Tables 1 to 3."""
    verdict: Verdict
    """Whether they agree, and if not, whether the cause is known."""
    note: str = ""
    """The cause of a difference, in words; empty where they agree."""

    @property
    def difference(self) -> float | None:
        """Modulus of recomputed minus printed; None where nothing is printed."""
        return None if self.published is None else abs(self.recomputed - number(self.published))


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


@dataclass(frozen=True)
class SolvedTwice:
    """One solution as the paper's route and the closed form find it, lengths in cm."""

    solution: int
    """Number of the solution, from 1 to 8, as the paper counts them."""
    label: str
    """Branch of the closed form, one of `BRANCHES`."""
    paper: complex
    """b_2y by the paper's route, a root of |U| = 0 [cm]."""
    closed_form: complex
    """b_2y by the closed form [cm]."""
    difference: float
    """Largest difference of the nine coordinates [cm]."""


@dataclass(frozen=True)
class Reproduction:
    """All recomputed cells, and the eight solutions by two methods."""

    cells: tuple[Cell, ...]
    """Cells of the tables that were asked for, in the order of print."""
    solutions: tuple[SolvedTwice, ...]
    """The eight solutions by the paper's route and by the closed form."""
    equation_17: dict[str, int]
    """Numbers of real roots: "printed", with Eq. (17) as printed; "mended", with its signs mended; "true", those of
    the closed form."""
    diagnoses: tuple[Diagnosis, ...] = ()
    """The mistakes behind the rows of Table 5; empty without that table."""
    true_values: tuple[TrueValue, ...] = ()
    """The true numbers of Table 5, rates before forces; empty without that table."""

    @property
    def in_tables(self) -> tuple[Cell, ...]:
        """Cells of Tables 1 to 5, without the numbers of the example's pose."""
        return tuple(cell for cell in self.cells if cell.table != POSE)

    def table(self, number: int) -> tuple[Cell, ...]:
        """Return the cells of one table; of the example's pose for `POSE`."""
        return tuple(cell for cell in self.cells if cell.table == number)

    @property
    def unexplained(self) -> tuple[Cell, ...]:
        """Cells that differ in their printed digits without a cause."""
        return tuple(cell for cell in self.cells if cell.verdict is Verdict.UNEXPLAINED)


def reproduce(tables: Sequence[int] = TABLES) -> Reproduction:
    """Recompute tables of the paper, by their numbers out of `TABLES`, from its example."""
    if isinstance(tables, str) or not isinstance(tables, Sequence) or any(table not in TABLES for table in tables):
        raise ArgumentError("tables", f"numbers out of {TABLES}", tables)
    machine = Manipulator.paper()
    example = pose(np.array(published.POSITION) / _CM, xyx=np.deg2rad(published.XYX_DEGREES))
    closed = complex_middle_joints(machine, example) * _CM
    printed = np.array([[[number(c) for c in row] for row in table] for table in _COORDINATES.values()])
    printed = np.moveaxis(printed, -1, 0)  # (solution, joint, coordinate)
    unordered = resultant.solve(machine, example) * _CM
    joints = unordered[_order(printed, unordered)]
    other = _order(joints, closed)
    solutions = tuple(
        SolvedTwice(
            n + 1,
            BRANCHES[other[n]],
            complex(joints[n, 1, 1]),
            complex(closed[other[n], 1, 1]),
            float(np.abs(joints[n] - closed[other[n]]).max()),
        )
        for n in range(8)
    )
    roots = resultant.Resultant.from_pose(machine, example)
    found = {"printed": roots.roots(as_printed=True), "mended": roots.roots(), "true": closed[:, 1, 1]}
    equation = {name: _count_real(each) for name, each in found.items()}
    cells: list[Cell] = []
    diagnoses: list[Diagnosis] = []
    true_values: list[TrueValue] = []
    for table in sorted(set(tables)):
        if table in _COORDINATES:
            cells += _coordinates(table, joints, printed, machine.middle_side * _CM)
        elif table == 4:
            cells += _leg_lengths(machine, example.as_matrix(), joints)
            cells += _simulated_pose(machine)
        else:
            third = Configuration(machine, example, joints[2].real / _CM)
            diagnoses = _diagnoses(third)
            true_values = _true_values(third)
            cells += _rates_and_forces(true_values, diagnoses)
    return Reproduction(tuple(cells), solutions, equation, tuple(diagnoses), tuple(true_values))


def _count_real(roots: npt.NDArray[np.complex128]) -> int:
    # The example's roots are well apart: complex ones are off the axis by 1e-5 and more, rounding is 1e-12.
    return int(np.count_nonzero(np.abs(roots.imag) < 1e-7 * np.abs(roots)))


def _order(first: npt.NDArray[np.complex128], second: npt.NDArray[np.complex128]) -> IntArray:
    """Return for each solution of `first` (8, 3, 3) its place in `second`, one to one, nearest overall."""
    cost = np.abs(first[:, None] - second[None]).max(axis=(-1, -2))
    return np.asarray(scipy.optimize.linear_sum_assignment(cost)[1])


def _coordinates(
    table: int, joints: npt.NDArray[np.complex128], printed: npt.NDArray[np.complex128], side: float
) -> list[Cell]:
    """Compare Table 1, 2 or 3: coordinates of b_1, b_2 or b_3."""
    cells = []
    for axis, row in enumerate(_COORDINATES[table]):
        for n, text in enumerate(row):
            assert text is not None
            value = complex(joints[n, table - 1, axis])
            verdict, note = Verdict.SAME, ""
            if not matches(text, value):
                verdict, note = _conjugated(text, value, printed[n], (table - 1, axis), side)
            cells.append(Cell(table, f"b_{table} {'XYZ'[axis]}", str(n + 1), text, value, verdict, note))
    return cells


def _conjugated(
    text: str, value: complex, printed: npt.NDArray[np.complex128], place: tuple[int, int], side: float
) -> tuple[Verdict, str]:
    """Look for a flipped sign of the imaginary part; the evidence is Eq. (12) of the printed triangle."""
    if not matches(text, value.conjugate()):
        return Verdict.UNEXPLAINED, ""
    mended = printed.copy()
    mended[place] = printed[place].conjugate()
    # Sums of squares, not of moduli: Eq. (12) holds over the complex numbers.
    edges = (triangle - np.roll(triangle, 1, axis=0) for triangle in (printed, mended))
    before, after = (np.abs((edge**2).sum(axis=-1) - side**2).max() for edge in edges)
    note = (
        f"sign of the imaginary part: as printed, Eq. (12) is off by {before:,.0f} cm²; "
        f"with the sign changed by {after:,.1f}, the rounding of five digits"
    )
    return Verdict.MISPRINT if after < 1e-2 * before else Verdict.UNEXPLAINED, note


def _leg_lengths(machine: Manipulator, matrix: FloatArray, joints: npt.NDArray[np.complex128]) -> list[Cell]:
    """Compare Table 4: leg lengths of the real solutions, in the order of Tables 1-3. Eq. (20)."""
    real = np.flatnonzero(np.abs(joints.imag).max(axis=(-1, -2)) < 1e-6)
    b = joints[real].real
    a = machine.base_joints * _CM
    c = (machine.platform_joints @ matrix[:3, :3].T + matrix[:3, 3]) * _CM
    lengths = np.concatenate([np.linalg.norm(b - a, axis=-1), np.linalg.norm(b - c, axis=-1)], axis=-1)
    cells = []
    for leg, row in enumerate(published.TABLE_4):
        for column, text in enumerate(row):
            value = float(lengths[column, leg])
            verdict, note = Verdict.SAME, ""
            if text is None:
                verdict, note = Verdict.NOT_PRINTED, f"solution {real[column] + 1}: the cell is empty"
            elif not matches(text, value):
                verdict, note = _shifted(text, column, lengths[column])
            cells.append(Cell(4, LEGS[leg], str(column + 1), text, complex(value), verdict, note))
    return cells


def _simulated_pose(machine: Manipulator) -> list[Cell]:
    """Compare the example's pose with the forward displacement of round leg lengths, which it was rounded from."""
    state = forward_physical(machine, np.array(_SIMULATED_LEGS) / _CM)
    values = [*(state.translation * _CM), *state.pose.rotation.as_euler("XYX", degrees=True)]
    names = ("X_o", "Y_o", "Z_o", "alpha", "beta", "lambda")
    return [
        Cell(POSE, name, "3", text, complex(x), Verdict.SAME if matches(text, complex(x)) else Verdict.UNEXPLAINED)
        for name, text, x in zip(names, published.POSE_AS_PRINTED, values, strict=True)
    ]


def _shifted(text: str, column: int, lengths: FloatArray) -> tuple[Verdict, str]:
    """Look for the printed number in a cell of the same column that was left empty."""
    for leg, value in enumerate(lengths):
        if published.TABLE_4[leg][column] is None and matches(text, complex(value)):
            return Verdict.MISPRINT, f"this is {LEGS[leg]} = {value:.4f}, whose own cell is empty: a shifted number"
    return Verdict.UNEXPLAINED, ""


def _diagnoses(third: Configuration) -> list[Diagnosis]:
    """Find the fewest mistakes that give each printed row of Table 5; none where no combination does."""
    combinations = [Table5Mistakes(*flags) for flags in sorted(product((False, True), repeat=3), key=sum)]
    diagnoses = []
    for row, (name, printed) in enumerate(zip(_ROWS, published.TABLE_5, strict=True)):
        for mistakes in combinations:
            values = table_5(third, mistakes)[row]
            if all(text is None or matches(text, complex(x)) for text, x in zip(printed, values, strict=True)):
                diagnoses.append(Diagnosis(name, mistakes, tuple(float(x) for x in values)))
                break
    return diagnoses


def _true_values(third: Configuration) -> list[TrueValue]:
    """Find the true rates and forces by the paper's corrected 9 x 9, by the wrench form, and by Pinocchio."""
    from spm_pin.multibody.chain import ClosedChain

    twist = np.concatenate([np.array(published.VELOCITY[:3]) / _CM, np.deg2rad(published.VELOCITY[3:])])
    wrench = np.concatenate(load())
    chain = ClosedChain.from_urdf()
    q = chain.joint_values(third)
    paper = table_5(third)
    closed_form = leg_rates(third, twist) * _CM, leg_forces(third, wrench) / _KILO
    at = chain.state(q)
    pinocchio = at.inverse_jacobian() @ twist * _CM, at.leg_forces(wrench) / _KILO
    rows = zip(paper, closed_form, pinocchio, strict=True)
    return [
        TrueValue(f"{name}_{leg.replace('_', '')}", *(float(x) for x in values))
        for name, row in zip(_ROWS, rows, strict=True)
        for leg, *values in zip(LEGS, *row, strict=True)
    ]


def _rates_and_forces(true: list[TrueValue], diagnoses: list[Diagnosis]) -> list[Cell]:
    """Compare Table 5 with the true rates [cm/s] and forces [kN]."""
    explained = {diagnosis.row: diagnosis for diagnosis in diagnoses}
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


def matches(printed: str, value: complex) -> bool:
    """Return whether a number, as 1.2 or 1.2+3.4i, rounds to the digits printed; a plain "0" stands for zero itself."""
    split = max(printed.rfind("+"), printed.rfind("-")) if printed.endswith("i") else len(printed)
    return _rounds_to(printed[:split], value.real) and _rounds_to(printed[split:].removesuffix("i") or "0", value.imag)


def _rounds_to(printed: str, value: float) -> bool:
    last_place = 10.0 ** -len(printed.partition(".")[2])
    tolerance = 1e-9 if printed == "0" else 0.5 * last_place * (1.0 + 1e-9)
    return abs(value - float(printed)) <= tolerance


def number(text: str | None) -> complex:
    """Return a printed number; NaN where nothing is printed."""
    return complex("nan" if text is None else text.replace("i", "j"))
