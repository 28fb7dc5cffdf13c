"""`spm-pin reproduce`: the paper's tables beside their recomputation."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from spm_pin.cli.console import new_table, stderr, stdout, write_json
from spm_pin.reproduction import tables_1_to_4 as reproduction
from spm_pin.reproduction.cells import Cell, Verdict
from spm_pin.reproduction.tables_1_to_4 import Reproduction

__all__ = ["reproduce"]

_TITLES = {
    reproduction.POSE: "The example's pose (cm, degrees) from the leg lengths 120, 120, 140, 125, 120, 150 cm",
    1: "Table 1: the coordinates of b_1 (cm)",
    2: "Table 2: the coordinates of b_2 (cm)",
    3: "Table 3: the coordinates of b_3 (cm)",
    4: "Table 4: leg lengths of the real solutions (cm)",
    5: "Table 5: leg rates (cm/s) and driving forces (kN) at solution 3",
}
_MISTAKES = {
    "printed_lever_arm": "the lever arm e_i - r_bi of Eq. (30a) instead of e_i - r_ci of Eq. (25b)",
    "missing_entry": "entry (9, 9) of J_α left zero",
    "other_load": "the load F = (-20, -30, 60) kN, T = (-30, -30, -100) kN cm, not the one printed",
}
_STYLES = {Verdict.SAME: "green", Verdict.MISPRINT: "yellow", Verdict.NOT_PRINTED: "yellow", Verdict.UNEXPLAINED: "red"}


def reproduce(
    table: Annotated[
        list[int] | None, typer.Option(help="Which table, 1 to 5; may be repeated. All if not given.")
    ] = None,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write everything as JSON.")] = None,
) -> None:
    """Recompute the paper's tables and compare every printed digit.

    Exits with 1 if a printed number differs and nothing in the numbers explains why.
    """
    found = reproduction.reproduce(reproduction.TABLES if table is None else table)
    for number, cells in groupby(found.cells, key=lambda cell: cell.table):
        stdout.print(_table(_TITLES[number], list(cells)))
    if any(cell.table < 5 for cell in found.cells):
        stdout.print(_witnesses(found))
    if found.true_values:
        stdout.print(_true_values(found))
    for line in _findings(found):
        stdout.print(line, highlight=False)
    if json is not None:
        write_json(_content(found), json)
    if found.unexplained:
        stderr.print(f"[bold red]{len(found.unexplained)} printed values differ without an explanation[/]")
        raise typer.Exit(1)


def _number(value: complex, like: str | None = None) -> str:
    """Format with one digit more than printed, so that the rounding can be followed."""
    text = like or "0.0000"
    digits = len(text.removesuffix("i").rpartition(".")[2]) if "." in text else 0
    digits = min(digits + 1, 5)
    real = f"{value.real:.{digits}f}"
    if abs(value.imag) < 1e-9:
        return real.replace("-0.0", "0.0") if float(real) == 0.0 else real
    return f"{real}{value.imag:+.{digits}f}i"


def _table(title: str, cells: list[Cell]) -> Table:
    table = new_table(title)
    table.add_column("")
    table.add_column("solution", justify="right")
    table.add_column("published", justify="right")
    table.add_column("recomputed", justify="right")
    table.add_column("difference", justify="right")
    table.add_column("verdict")
    for row, group in groupby(cells, key=lambda cell: cell.row):
        members = list(group)
        for cell in members:
            difference = "" if cell.difference is None else f"{cell.difference:.0e}"
            table.add_row(
                row,
                cell.column,
                cell.published or "",
                _number(cell.recomputed, cell.published),
                difference,
                f"[{_STYLES[cell.verdict]}]{cell.verdict}[/]",
            )
        if len(members) > 1:
            table.add_section()
    return table


def _witnesses(found: Reproduction) -> Table:
    table = new_table("The same solutions from two witnesses: b_2Y (cm), and the largest difference")
    for heading in ("solution", "branch", "paper: |U| = 0", "four quadratics", "difference"):
        table.add_column(heading, justify="left" if heading == "branch" else "right")
    for one in found.witnesses:
        paper, closed = _number(one.paper, "0.000"), _number(one.closed_form, "0.000")
        table.add_row(str(one.solution), one.label, paper, closed, f"{one.difference:.0e}")
    return table


def _true_values(found: Reproduction) -> Table:
    table = new_table("The true numbers of Table 5 from three witnesses")
    for heading in ("", "paper: 9 × 9", "wrench form", "Pinocchio", "difference"):
        table.add_column(heading, justify="right" if heading else "left")
    for one in found.true_values:
        values = (one.paper, one.closed_form, one.pinocchio)
        table.add_row(one.name, *(f"{x:.6f}" for x in values), f"{max(values) - min(values):.0e}")
    return table


def _findings(found: Reproduction) -> list[str]:
    same = sum(cell.verdict is Verdict.SAME for cell in found.cells)
    lines = [f"[bold]{same} of {len(found.cells)} cells agree in every printed digit.[/]"]
    for cell in found.cells:
        if cell.note:
            printed = "nothing" if cell.published is None else escape(cell.published)
            what = f"Table {cell.table}, {cell.row}, solution {cell.column}"
            lines.append(
                f"[yellow]•[/] {what}: printed {printed}, true {_number(cell.recomputed, cell.published)}; {cell.note}."
            )
    for diagnosis in found.diagnoses:
        what = {"v": "rates", "f": "forces"}[diagnosis.row]
        causes = "; ".join(_MISTAKES[name] for name in diagnosis.names)
        lines.append(
            f"[yellow]•[/] Table 5, {what}: the printed row comes out to its four decimals with "
            f"{len(diagnosis.names)} mistakes made together, and with no fewer: {causes}."
        )
    if all(cell.table == 5 for cell in found.cells):
        return lines
    equation = found.equation_17
    lines.append(
        f"[yellow]•[/] Eq. (17): with the signs as printed |U| = 0 has {equation.printed} real roots; with the product "
        f"of Eq. (16) moved across correctly it has {equation.mended}, and the example has {equation.true}."
    )
    return lines


def _content(found: Reproduction) -> dict[str, Any]:
    return {
        "unit": "cm",
        "cells": [
            {
                "table": cell.table,
                "row": cell.row,
                "column": cell.column,
                "published": cell.published,
                "recomputed": [cell.recomputed.real, cell.recomputed.imag],
                "difference": cell.difference,
                "verdict": str(cell.verdict),
                "note": cell.note,
            }
            for cell in found.cells
        ],
        "witnesses": [
            {
                "solution": one.solution,
                "branch": one.label,
                "b_2y_paper": [one.paper.real, one.paper.imag],
                "b_2y_closed_form": [one.closed_form.real, one.closed_form.imag],
                "largest_difference": one.difference,
            }
            for one in found.witnesses
        ],
        "true_values": [vars(one) for one in found.true_values],
        "diagnoses": [
            {"row": one.row, "mistakes": list(one.names), "values": list(one.values)} for one in found.diagnoses
        ],
        "equation_17_real_roots": {
            "as_printed": found.equation_17.printed,
            "mended": found.equation_17.mended,
            "true": found.equation_17.true,
        },
    }
