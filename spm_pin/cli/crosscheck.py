"""`spm-pin crosscheck` compares methods, `reproduce` recomputes the paper, and `demo` runs both."""

from __future__ import annotations

from collections import Counter
from dataclasses import astuple
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import outputs
from spm_pin.cli.draw import titled_branches
from spm_pin.cli.options import Picture, Seed
from spm_pin.cli.outputs import Part, Table
from spm_pin.cli.outputs import Report as Shown
from spm_pin.cli.requests import selected_labels
from spm_pin.cli.units import MachineInUnits
from spm_pin.crosscheck import METHODS, POSE, TABLES, PairDifference, Report, Reproduction, Verdict, compare_in_batches
from spm_pin.crosscheck import reproduce as recompute
from spm_pin.crosscheck.paper import published
from spm_pin.display.figures import agreement_figure
from spm_pin.display.plots import save_gallery
from spm_pin.display.writing import fixed
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.machine import Manipulator, pose
from spm_pin.machine.machine import Machine

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
_STYLES = {Verdict.MISPRINT: "yellow", Verdict.NOT_PRINTED: "yellow", Verdict.UNEXPLAINED: "red"}


def crosscheck(
    typed: MachineInUnits,
    poses: Annotated[int, Option(min=1, help="Random poses: a fifth anywhere, others within the limits.")] = 200,
    seed: Seed = 0,
    methods: Annotated[
        list[str] | None, Option("--method", metavar="NAME", help=f"{', '.join(METHODS)}; repeatable. Default: all.")
    ] = None,
    pairs: Annotated[bool, Option("--pairs", help="Show every pair of methods, not only the worst.")] = False,
    out: Annotated[Path | None, outputs.file_option("JSON file of the report to write.")] = None,
    figure: Picture = None,
) -> Shown:
    """Solve random poses, or tilts and heights of a stage, by independent methods and compare the results.

    Branches, inverse Jacobians and leg forces are compared in pairs, with tolerances from conditioning and rounding.
    Exits with 1 if the methods disagree; of three or more it names the one that does. If interrupted, it reports the
    poses done so far. --figure draws the differences of all pairs, and needs the extra "plots".
    """
    report = _compare(typed.machine, poses, seed, methods)
    file = None if typed.file is None else str(typed.file)
    content = _comparison_content(report, file)
    if out is not None:
        outputs.write_json(content, out)
    outputs.write_figure(figure, agreement_figure, report)
    tables = [_scores(report), _differences(report, pairs)]
    parts: list[Part] = [_verdict("", report), "", *tables, *_remarks(report, methods is None, file)]
    return Shown(content, parts, _exit_code(report))


def _compare(machine: Machine, poses: int, seed: int, methods: list[str] | None) -> Report:
    """Run a comparison with a progress bar; on Ctrl-C return the report of the poses compared so far, if any."""
    names = None if methods is None else list(dict.fromkeys(methods))
    report = None
    with outputs.progress_bar() as bar:
        try:
            for partial in compare_in_batches(machine, poses=poses, seed=seed, methods=names, progress=bar):
                report = partial
        except KeyboardInterrupt:
            if report is None:
                raise
    assert report is not None
    return report


def _exit_code(report: Report, failed: bool = False) -> int:
    return 130 if report.poses < report.requested else int(failed or not report.agrees)


def _verdict(heading: str, report: Report) -> tuple[str, str]:
    """Return the result of a comparison in one sentence, naming methods that did not solve every pose."""
    done, names = report.poses, []
    for score in report.scores:
        pairs = (pair for pair in report.differences if score.name in (pair.first, pair.second))
        part = f"{score.solved} of the poses"
        if not score.solved:
            part = ", ".join(dict.fromkeys(str(pair.quantity) for pair in pairs)) + " only"
        names.append(score.name if score.solved == done else f"{score.name} ({part})")
    count = f"{done} random poses"
    if done < report.requested:
        count = f"Interrupted after {done} of {report.requested} poses"
    line = f"{heading}{count}, {report.states} configurations, by {', '.join(names)}. {report.verdict}"
    return line, "bold green" if report.agrees else "bold red"


def _scores(report: Report) -> Table:
    counts = {"poses": "solved", "branches": "branches", "not closed": "invented", "poses lacking one": "missed"}
    columns: dict[str, Any] = {"method": lambda score: score.name}
    columns |= {
        heading: lambda score, name=name: str(getattr(score, name)) if score.solved else "-"
        for heading, name in counts.items()
    }
    columns["expected"] = lambda score: f"{100 * score.allowed:g} %" if score.solved else "-"
    faulty = {score.name: "red" for score in report.scores if score.invented or score.misses_too_often}
    title = "Inverse displacement by each method, and the number of poses at which it lacks a branch"
    return Table(title, columns, report.scores, style=lambda score: faulty.get(score.name))


def _differences(report: Report, pairs: bool) -> Table:
    """Return the differences of all pairs of methods, or the largest for each quantity."""
    shown: list[PairDifference] = []
    for _, group in groupby(report.differences, key=attrgetter("quantity")):
        of_quantity = list(group)
        shown += of_quantity if pairs else [max(of_quantity, key=attrgetter("ratio"))]
    columns = {
        "quantity": lambda pair: str(pair.quantity),
        "methods": lambda pair: f"{pair.first} - {pair.second}",
        "states": lambda pair: str(pair.compared),
        "differ": lambda pair: str(pair.disagreements),
        "largest": lambda pair: f"{pair.worst:.0e} {pair.quantity.unit}".strip(),
        "share": lambda pair: f"{pair.ratio:.0e}",
    }
    which = "Differences of all pairs" if pairs else "Largest difference in each quantity"
    return Table(
        f"{which}, and its share of the tolerance",
        columns,
        shown,
        left=["methods"],
        group=lambda pair: pair.quantity if pairs else None,
        style=lambda pair: "red" if pair.disagreements else None,
    )


def _remarks(report: Report, all_methods: bool, file: str | None) -> list[str]:
    lines = []
    absent = [name for name in METHODS if name.replace("-", " ") not in {score.name for score in report.scores}]
    if all_methods and absent:
        why = dict.fromkeys(absent, "its package is not installed") | {"paper": "nominal manipulators of RPS legs only"}
        lines.append(f"Left out: {', '.join(f'{name} ({why[name]})' for name in absent)}.")
    if (worst := report.worst) is not None:
        what = f"{worst.quantity}, {worst.first} and {worst.second}, branch {worst.branch}"
        ratio = f"{worst.ratio:.0e} times the tolerance, at the pose\n  {report.command(worst.pose, file)}"
        lines.append(f"{'Largest difference' if worst.ratio > 1.0 else 'Nearest to the tolerance'}: {what}, {ratio}")
    for score in report.scores:
        if score.pose >= 0:
            rate = "more often than" if score.misses_too_often else "within"
            what = f"branches lost at {score.missed} poses, {rate} the {100 * score.allowed:g} % that it states"
            if score.invented:
                what = f"{score.invented} branches whose loops are not closed"
            lines.append(f"{score.name}: {what}. The first is at the pose\n  {report.command(score.pose, file)}")
    return lines


def _comparison_content(report: Report, file: str | None) -> dict[str, Any]:
    content = {name: getattr(report, name) for name in ("agrees", "verdict", "outliers", "seed", "requested")}
    names = [f"{name}_degrees" if name in ("xyx", "roll", "pitch") else name for name in report.requests]
    return content | {
        "geometry": report.machine.as_data(),
        "poses": [dict(zip(names, numbers, strict=True)) for numbers in zip(*report.requests.values(), strict=True)],
        "reached": report.reached,
        "states": report.states,
        "methods": [vars(score) for score in report.scores],
        "differences": [
            vars(pair) | {"unit": pair.quantity.unit, "reproduce": report.command(pair.pose, file)}
            for pair in report.differences
        ],
    }


_NEXT = """Try next:
  spm-pin inverse --help  all branches of a pose; the paper's as example
  spm-pin view            drag the platform in a browser (extra "viewer")
  spm-pin reproduce       the cause of each difference from the paper"""


def demo(
    out: Picture = None, poses: Annotated[int, Option(min=1, help="Random poses of the comparison.")] = 50
) -> None:
    """Reproduce the paper, compare all methods, and draw the branches of the paper's example.

    Exits with 1 if a printed number is unexplained or the methods disagree. --out needs the extra "plots".
    """
    reproduction = recompute()
    report = _compare(Manipulator.paper(), poses, 0, None)
    parts: list[Part] = [_summary("The paper:   ", reproduction), _verdict("The methods: ", report)]
    parts += [_tables_summary(reproduction), _differences(report, pairs=False)]
    if out is not None:
        example = pose(np.array(published.POSITION) / 100.0, xyx=np.deg2rad(published.XYX_DEGREES))
        solutions = inverse_displacement(Manipulator.paper(), example)
        save_gallery(titled_branches(solutions, selected_labels(solutions, None)), out)
        parts.append(f"  {out}: picture of the six real branches of the paper's pose")
    parts.append(_NEXT)
    Shown(None, parts, _exit_code(report, failed=bool(reproduction.unexplained))).show(json=False)


def reproduce(
    tables: Annotated[
        list[int] | None, Option("--table", metavar="NUMBER", help="Show every cell of a table, 1 to 5; repeatable.")
    ] = None,
    cells: Annotated[bool, Option("--cells", help="Show every cell of all tables.")] = False,
    out: Annotated[Path | None, outputs.file_option("JSON file of all results to write.")] = None,
) -> Shown:
    """Recompute the paper's tables and compare every printed digit.

    Exits with 1 if a printed number differs and no cause was found.
    """
    reproduction = recompute(TABLES if tables is None else tables)
    content = {
        "unit": "cm",
        "cells": [vars(cell) | {"difference": cell.difference} for cell in reproduction.cells],
        "solutions": [vars(each) for each in reproduction.solutions],
        "true_values": [vars(each) for each in reproduction.true_values],
        "diagnoses": [
            {"row": each.row, "mistakes": each.names, "values": each.values} for each in reproduction.diagnoses
        ],
        "equation_17_real_roots": reproduction.equation_17,
    }
    if out is not None:
        outputs.write_json(content, out)
    parts: list[Part] = [_summary("", reproduction), "", _tables_summary(reproduction)]
    parts += _cells(reproduction) if cells or tables is not None else []
    parts += [f"• {line}" for line in _findings(reproduction)]
    if reproduction.unexplained:
        outputs.note(f"{len(reproduction.unexplained)} printed values differ without an explanation", "bold red")
    return Shown(content, parts, int(bool(reproduction.unexplained)))


def _summary(heading: str, reproduction: Reproduction) -> tuple[str, str]:
    """Return the result in one sentence, with the counts of the tables, without the example's pose."""
    cells = reproduction.in_tables
    counts = Counter(cell.verdict for cell in cells)
    numbers = sorted({cell.table for cell in cells})
    tables = "Tables 1 to 5" if len(numbers) == len(TABLES) else f"Table {', '.join(map(str, numbers))}"
    line = f"{heading}{counts[Verdict.SAME]} of the {len(cells)} cells of {tables} agree in every printed digit"
    words = {Verdict.MISPRINT: "misprinted", Verdict.NOT_PRINTED: "left empty", Verdict.UNEXPLAINED: "unexplained"}
    others = ", ".join(f"{counts[verdict]} {word}" for verdict, word in words.items() if counts[verdict])
    if others:
        line += f", {'not all' if reproduction.unexplained else 'all'} others are explained: {others}"
    return f"{line}.", "bold red" if reproduction.unexplained else "bold green"


def _tables_summary(reproduction: Reproduction) -> Table:
    rows = {number: [cell.verdict for cell in reproduction.table(number)] for number in _TITLES}
    columns: dict[str, Any] = {"": lambda n: _TITLES[n].partition(" (")[0], "cells": lambda n: str(len(rows[n]))}
    columns |= {str(verdict): lambda n, verdict=verdict: str(rows[n].count(verdict)) for verdict in Verdict}
    red = {n: "red" for n in rows if Verdict.UNEXPLAINED in rows[n]}
    return Table("The paper's numbers, recomputed", columns, list(filter(rows.get, rows)), style=red.get)


def _number(value: complex, like: str = "0.0000") -> str:
    """Format with one digit more than printed, to show the rounding."""
    digits = len(like.removesuffix("i").rpartition(".")[2]) if "." in like else 0
    digits = min(digits + 1, 5)
    real = fixed(value.real, digits)
    return real if abs(value.imag) < 1e-9 else f"{real}{value.imag:+.{digits}f}i"


def _cells(reproduction: Reproduction) -> list[Table]:
    columns: dict[str, Any] = {
        "": lambda cell: cell.row,
        "solution": lambda cell: cell.column,
        "published": lambda cell: cell.published or "",
        "recomputed": lambda cell: _number(cell.recomputed, cell.published or "0.0000"),
        "difference": lambda cell: "" if cell.difference is None else f"{cell.difference:.0e}",
        "verdict": lambda cell: cell.verdict,
    }
    tables = [
        Table(
            _TITLES[number],
            columns,
            list(cells),
            left=["verdict"],
            group=lambda cell: cell.row if 0 < cell.table < 5 else None,
            style=lambda cell: _STYLES.get(cell.verdict),
        )
        for number, cells in groupby(reproduction.cells, key=attrgetter("table"))
    ]
    if any(cell.table < 5 for cell in reproduction.cells):
        columns = {
            "solution": lambda each: str(each.solution),
            "branch": lambda each: each.label,
            "paper: |U| = 0": lambda each: _number(each.paper, "0.000"),
            "four quadratics": lambda each: _number(each.closed_form, "0.000"),
            "difference": lambda each: f"{each.difference:.0e}",
        }
        title = "The same solutions by two methods: b_2Y (cm), and the largest difference"
        tables.append(Table(title, columns, reproduction.solutions, left=["branch"]))
    if reproduction.true_values:
        names = ("", "paper: 9 × 9", "wrench form", "Pinocchio")
        columns = {name: lambda row, k=k: fixed(row[k], 6) if k else row[k] for k, name in enumerate(names)}
        columns["difference"] = lambda row: f"{max(row[1:]) - min(row[1:]):.0e}"
        rows = [astuple(true) for true in reproduction.true_values]
        tables.append(Table("The true numbers of Table 5 by three methods", columns, rows))
    return tables


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
            f"Eq. (17): with the signs as printed |U| = 0 has {equation['printed']} real roots; with the product "
            f"of Eq. (16) moved across correctly it has {equation['mended']}, and the example has {equation['true']}."
        )
    return lines
