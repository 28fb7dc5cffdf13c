"""`spm-pin reproduce`: the paper's tables recomputed and compared digit by digit."""

from __future__ import annotations

from dataclasses import astuple
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import typer

from spm_pin.cli import options, outputs
from spm_pin.crosscheck import POSE, TABLES, Reproduction, Verdict
from spm_pin.crosscheck import reproduce as recompute
from spm_pin.display.writing import fixed

_TITLES = {
    POSE: "The example's pose (cm, degrees) from the leg lengths 120, 120, 140, 125, 120, 150 cm",
    1: "Table 1: coordinates of b_1 (cm)",
    2: "Table 2: coordinates of b_2 (cm)",
    3: "Table 3: coordinates of b_3 (cm)",
    4: "Table 4: leg lengths (cm) of the real solutions",
    5: "Table 5: leg rates and forces (cm/s, kN) at solution 3",
}
_MISTAKES = {
    "printed_lever_arm": "the lever arm e_i - r_bi of Eq. (30a) instead of e_i - r_ci of Eq. (25b)",
    "missing_entry": "entry (9, 9) of J_α left zero",
    "other_load": "the load F = (-20, -30, 60) kN, T = (-30, -30, -100) kN cm, not the one printed",
}
_TABLE = attrgetter("table")
_STYLES = {Verdict.MISPRINT: "yellow", Verdict.NOT_PRINTED: "yellow", Verdict.UNEXPLAINED: "red"}


@outputs.name_options(tables="--table")
def reproduce(
    table: Annotated[
        list[int] | None,
        typer.Option(metavar="NUMBER", help="Show every cell of a table, 1 to 5; may be repeated. All if not given."),
    ] = None,
    cells: Annotated[bool, typer.Option("--cells", help="Show every cell of all tables.")] = False,
    json: options.AsJson = False,
    out: Annotated[Path | None, outputs.file_option("Also write everything to a file, as JSON.")] = None,
) -> None:
    """Recompute the paper's tables and compare every printed digit.

    Exits with 1 if a printed number differs and nothing in the numbers explains why.
    """
    reproduction = recompute(TABLES if table is None else table)
    content = {
        "unit": "cm",
        "cells": [vars(cell) | {"difference": cell.difference} for cell in reproduction.cells],
        "solutions": [vars(each) for each in reproduction.solutions],
        "true_values": [vars(each) for each in reproduction.true_values],
        "diagnoses": [
            {"row": each.row, "mistakes": each.names, "values": each.values} for each in reproduction.diagnoses
        ],
        "equation_17_real_roots": vars(reproduction.equation_17),
    }
    if out is not None:
        outputs.write_json(content, out)
    if json:
        outputs.write_json(content)
    else:
        outputs.print_lines([summary_line(reproduction)], "bold red" if reproduction.unexplained else "bold green")
        outputs.stdout.print()
        print_summary(reproduction)
        if cells or table is not None:
            _print_cells(reproduction)
        outputs.print_lines(f"• {line}" for line in _findings(reproduction))
    if reproduction.unexplained:
        outputs.note(f"{len(reproduction.unexplained)} printed values differ without an explanation", "bold red")
        raise typer.Exit(1)


def summary_line(reproduction: Reproduction) -> str:
    """Return the outcome in one sentence; the counts are those of the tables, without the example's pose."""
    cells = reproduction.in_tables
    counts = {verdict: sum(cell.verdict is verdict for cell in cells) for verdict in Verdict}
    numbers = sorted({cell.table for cell in cells})
    tables = "Tables 1 to 5" if len(numbers) == len(TABLES) else f"Table {', '.join(map(str, numbers))}"
    line = f"{counts[Verdict.SAME]} of the {len(cells)} cells of {tables} agree in every printed digit"
    words = {Verdict.MISPRINT: "misprinted", Verdict.NOT_PRINTED: "left empty", Verdict.UNEXPLAINED: "unexplained"}
    others = [f"{counts[verdict]} {word}" for verdict, word in words.items() if counts[verdict]]
    if not others:
        return f"{line}."
    return f"{line}, {'not all' if reproduction.unexplained else 'all'} others are explained: {', '.join(others)}."


def print_summary(reproduction: Reproduction) -> None:
    """Print how many cells of each table agree."""
    rows = {
        n: [cell.verdict for cell in group] for n, group in groupby(sorted(reproduction.cells, key=_TABLE), key=_TABLE)
    }
    columns: dict[str, Any] = {"": lambda n: _TITLES[n].partition(" (")[0], "cells": lambda n: str(len(rows[n]))}
    columns |= {str(verdict): lambda n, verdict=verdict: str(rows[n].count(verdict)) for verdict in Verdict}
    red = {n: "red" for n in rows if Verdict.UNEXPLAINED in rows[n]}
    outputs.print_table("The paper's numbers, recomputed", columns, rows, style=red.get)


def _number(value: complex, like: str = "0.0000") -> str:
    """Format with one digit more than printed, so that the rounding can be followed."""
    digits = len(like.removesuffix("i").rpartition(".")[2]) if "." in like else 0
    digits = min(digits + 1, 5)
    real = fixed(value.real, digits)
    return real if abs(value.imag) < 1e-9 else f"{real}{value.imag:+.{digits}f}i"


def _print_cells(reproduction: Reproduction) -> None:
    columns: dict[str, Any] = {
        "": lambda cell: cell.row,
        "solution": lambda cell: cell.column,
        "published": lambda cell: cell.published or "",
        "recomputed": lambda cell: _number(cell.recomputed, cell.published or "0.0000"),
        "difference": lambda cell: "" if cell.difference is None else f"{cell.difference:.0e}",
        "verdict": lambda cell: cell.verdict,
    }
    for number, cells in groupby(reproduction.cells, key=_TABLE):
        outputs.print_table(
            _TITLES[number],
            columns,
            cells,
            left=["verdict"],
            group=lambda cell: cell.row if 0 < cell.table < 5 else None,
            style=lambda cell: _STYLES.get(cell.verdict),
        )
    if any(cell.table < 5 for cell in reproduction.cells):
        columns = {
            "solution": lambda each: str(each.solution),
            "branch": lambda each: each.label,
            "paper: |U| = 0": lambda each: _number(each.paper, "0.000"),
            "four quadratics": lambda each: _number(each.closed_form, "0.000"),
            "difference": lambda each: f"{each.difference:.0e}",
        }
        title = "The same solutions by two methods: b_2Y (cm), and the largest difference"
        outputs.print_table(title, columns, reproduction.solutions, left=["branch"])
    if reproduction.true_values:
        names = ("", "paper: 9 × 9", "wrench form", "Pinocchio")
        columns = {name: lambda row, k=k: fixed(row[k], 6) if k else row[k] for k, name in enumerate(names)}
        columns["difference"] = lambda row: f"{max(row[1:]) - min(row[1:]):.0e}"
        rows = [astuple(true) for true in reproduction.true_values]
        outputs.print_table("The true numbers of Table 5 by three methods", columns, rows)


def _findings(reproduction: Reproduction) -> list[str]:
    lines = [
        f"Table {cell.table}, {cell.row}, solution {cell.column}: printed {cell.published or 'nothing'}, "
        f"true {_number(cell.recomputed, cell.published or '0.0000')}; {cell.note}."
        for cell in reproduction.cells
        if cell.note
    ]
    for diagnosis in reproduction.diagnoses:
        what = {"v": "rates", "f": "forces"}[diagnosis.row]
        causes = "; ".join(_MISTAKES[name] for name in diagnosis.names)
        lines.append(
            f"Table 5, {what}: the printed row comes out to its four decimals with "
            f"{len(diagnosis.names)} mistakes made together, and with no fewer: {causes}."
        )
    if any(cell.table < 5 for cell in reproduction.cells):
        equation = reproduction.equation_17
        lines.append(
            f"Eq. (17): with the signs as printed |U| = 0 has {equation.printed} real roots; with the product "
            f"of Eq. (16) moved across correctly it has {equation.mended}, and the example has {equation.true}."
        )
    return lines
