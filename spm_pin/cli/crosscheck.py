"""`spm-pin crosscheck`: the witnesses asked about random poses, and every pair of answers compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from spm_pin.cli.console import new_table, stderr, stdout, write_json
from spm_pin.cli.options import GeometryFile, read_geometry
from spm_pin.crosscheck.methods import WITNESSES
from spm_pin.crosscheck.report import Report
from spm_pin.crosscheck.report import crosscheck as compare
from spm_pin.errors import ArgumentError

__all__ = ["crosscheck"]


def crosscheck(
    poses: Annotated[int, typer.Option(min=1, help="Random poses, four fifths of them in leg space.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of the poses and of the wrenches.")] = 0,
    witness: Annotated[
        list[str] | None,
        typer.Option(help="closed-form, paper, pinocchio, nlp or ipopt; may be repeated. All if not given."),
    ] = None,
    geometry: GeometryFile = None,
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write everything as JSON.")] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write a page for a browser.")] = None,
) -> None:
    """Ask independent witnesses the same questions, and see whether they agree.

    Branches, inverse Jacobians and leg forces are compared by pairs, with tolerances from conditioning and rounding.
    Exits with 1 if anybody is wrong, and says who.
    """
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=stderr, transient=True) as bar:
        task = bar.add_task("")

        def progress(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        report = compare(read_geometry(geometry), poses=poses, seed=seed, witnesses=witness, progress=progress)
    stdout.print(_standings(report))
    stdout.print(_comparisons(report))
    file = None if geometry is None else str(geometry)
    for line in _remarks(report, witness is None, file):
        stdout.print(line, highlight=False, soft_wrap=True)
    if json is not None:
        write_json(_content(report, file), json)
    if html is not None:
        _write_page(report, html, file)
    if not report.agrees:
        stderr.print(f"[bold red]{escape(report.verdict)}[/]", highlight=False)
        raise typer.Exit(1)


def _standings(report: Report) -> Table:
    table = new_table(f"{len(report.xyx)} poses, {report.reached} reached, {report.states} configurations")
    table.add_column("witness", style="bold")
    for heading in ("poses", "branches", "invented", "poses with one missed", "stated"):
        table.add_column(heading, justify="right")
    for one in report.standings:
        if not one.solved:
            table.add_row(one.name, "-", "-", "-", "-", "-")
            continue
        style = "red" if one.invented or one.misses_too_often else None
        counts = (one.solved, one.branches, one.invented, one.missed)
        table.add_row(one.name, *map(str, counts), f"{100 * one.allowed:g} %", style=style)
    return table


def _comparisons(report: Report) -> Table:
    table = new_table("Worst differences, in the last column as a share of the tolerance")
    table.add_column("quantity")
    table.add_column("witnesses")
    for heading in ("states", "differ", "worst", "share"):
        table.add_column(heading, justify="right")
    before = None
    for one in report.comparisons:
        if before is not None and one.quantity is not before:
            table.add_section()
        name = str(one.quantity) if one.quantity is not before else ""
        before = one.quantity
        worst = f"{one.worst:.0e} {one.quantity.unit}".strip()
        table.add_row(
            name,
            f"{one.first} - {one.second}",
            str(one.compared),
            str(one.disagreements),
            worst,
            f"{one.ratio:.0e}",
            style="red" if one.disagreements else None,
        )
    return table


def _remarks(report: Report, everybody: bool, file: str | None) -> list[str]:
    colour = "green" if report.agrees else "red"
    lines = [f"[bold {colour}]{escape(report.verdict)}[/]"]
    absent = [name for name in WITNESSES if name.replace("-", " ") not in {one.name for one in report.standings}]
    if everybody and absent:
        lines.append(f"Not asked, for their packages are not installed: {', '.join(absent)}.")
    worst = report.worst
    if worst is not None:
        what = f"{worst.quantity} of {worst.first} and {worst.second}, branch {worst.branch}"
        which = "Largest difference" if worst.ratio > 1.0 else "Nearest to a disagreement"
        lines.append(f"{which}: {what}, {worst.ratio:.0e} of the tolerance:")
        lines.append(f"  {report.command(worst.pose, file)}")
    for one in report.standings:
        if one.pose >= 0:
            what = f"invented {one.invented} branch(es)" if one.invented else f"missed branches at {one.missed} pose(s)"
            lines.append(f"{one.name} {what}, the first at:")
            lines.append(f"  {report.command(one.pose, file)}")
    return lines


def _content(report: Report, file: str | None) -> dict[str, Any]:
    geometry = report.geometry
    return {
        "agrees": report.agrees,
        "verdict": report.verdict,
        "culprits": list(report.culprits),
        "seed": report.seed,
        "geometry": {
            "base_radius": geometry.base_radius,
            "platform_radius": geometry.platform_radius,
            "middle_side": geometry.middle_side,
        },
        "poses": [
            {"translation": translation, "xyx_degrees": xyx}
            for translation, xyx in zip(report.translation.tolist(), report.xyx.tolist(), strict=True)
        ],
        "reached": report.reached,
        "states": report.states,
        "witnesses": [
            {
                "name": one.name,
                "poses": one.solved,
                "abstained": one.abstained,
                "branches": one.branches,
                "invented": one.invented,
                "missed": one.missed,
                "stated_miss_rate": one.allowed,
                "closure_residual_share": one.residual,
                "outvoted": one.blame,
            }
            for one in report.standings
        ],
        "comparisons": [
            {
                "quantity": str(one.quantity),
                "witnesses": [one.first, one.second],
                "states": one.compared,
                "disagreements": one.disagreements,
                "worst": one.worst,
                "tolerance": one.tolerance,
                "unit": one.quantity.unit,
                "branch": one.branch,
                "reproduce": report.command(one.pose, file),
            }
            for one in report.comparisons
        ],
    }


def _write_page(report: Report, path: Path, file: str | None) -> None:
    from spm_pin.crosscheck.html import page

    try:
        path.write_text(page(report, file), encoding="utf-8")
    except OSError as error:
        raise ArgumentError("--html", "a file that can be written", path, str(error.strerror)) from error
    stderr.print(f"wrote {escape(str(path))}")
