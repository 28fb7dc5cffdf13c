"""`spm-pin crosscheck`, independent methods compared on random poses, and `demo`, a first look at the package."""

from __future__ import annotations

import shutil
import sys
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.reproduce import print_summary, summary_line
from spm_pin.crosscheck import METHODS, MethodScore, PairDifference, Report, compare_in_batches
from spm_pin.crosscheck import reproduce as recompute
from spm_pin.display.figures import agreement_figure
from spm_pin.display.plots import save_gallery
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.mechanism import Geometry, pose
from spm_pin.paper import published


@outputs.name_options(methods="--method")
def crosscheck(
    poses: Annotated[int, typer.Option(min=1, help="Random poses, four fifths of them in leg space.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the poses and of the wrenches.")] = 0,
    method: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help=f"{', '.join(METHODS)}; may be repeated. All if not given.")
    ] = None,
    pairs: Annotated[bool, typer.Option("--pairs", help="Show every pair of methods, not only the worst.")] = False,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
    out: Annotated[Path | None, outputs.file_option("Also write the report to a file, as JSON.")] = None,
    figure: Annotated[Path | None, outputs.picture_option("Also draw the differences of all pairs.")] = None,
    style: outputs.PictureStyle = None,
) -> None:
    """Solve random poses by independent methods and compare their answers.

    Branches, inverse Jacobians and leg forces are compared by pairs, with tolerances from conditioning and rounding.
    Exits with 1 if the methods disagree, and says which is wrong. Interrupted, it reports the poses done so far.
    --figure needs the extra "plots".
    """
    report = compare_with_progress(options.read_geometry(geometry), poses, seed, method)
    file = None if geometry is None else str(geometry)
    content = _content(report, file)
    if out is not None:
        outputs.write_json(content, out)
    outputs.write_figure(figure, style, agreement_figure, report)
    if json:
        outputs.write_json(content)
    else:
        print_verdict("", report)
        outputs.stdout.print()
        print_report(report, pairs=pairs)
        for line in _remarks(report, method is None, file):
            outputs.stdout.print(line, soft_wrap=True)
    _end(report)


def _end(report: Report, failed: bool = False) -> None:
    """Raise the exit code of a comparison, which Ctrl-C may have ended before its last pose."""
    if len(report.xyx) < report.requested:
        raise typer.Exit(130)
    if failed or not report.agrees:
        raise typer.Exit(1)


def compare_with_progress(geometry: Geometry, poses: int, seed: int, methods: list[str] | None) -> Report:
    """Run a comparison with a progress bar; on Ctrl-C return the report of the poses done so far, if there are any."""
    names = None if methods is None else list(dict.fromkeys(methods))
    report = None
    with outputs.progress_bar() as bar:
        try:
            for partial in compare_in_batches(geometry, poses=poses, seed=seed, methods=names, progress=bar):
                report = partial
        except KeyboardInterrupt:
            if report is None:
                raise
    assert report is not None
    return report


def print_verdict(heading: str, report: Report) -> None:
    """Print the outcome of a comparison in one sentence."""
    done = len(report.xyx)
    finished = done == report.requested
    count = f"{done} random poses" if finished else f"Interrupted after {done} of {report.requested} poses"
    names = ", ".join(_part(score, report) for score in report.scores)
    line = f"{heading}{count}, {report.states} configurations, by {names}. {report.verdict}"
    outputs.print_lines([line], "bold green" if report.agrees else "bold red")


def _part(score: MethodScore, report: Report) -> str:
    """Return the name of a method, with its part in the comparison where it did not solve every pose."""
    if score.solved == len(report.xyx):
        return score.name
    if score.solved:
        return f"{score.name} ({score.solved} of the poses)"
    quantities = [str(pair.quantity) for pair in report.differences if score.name in (pair.first, pair.second)]
    return f"{score.name} ({', '.join(dict.fromkeys(quantities))} only)"


def print_report(report: Report, *, pairs: bool = False) -> None:
    """Print the scores of the methods, and the differences between them."""
    counts = {"poses": "solved", "branches": "branches", "not closed": "invented", "poses lacking one": "missed"}
    columns: dict[str, Any] = {"method": lambda score: score.name}
    columns |= {
        heading: lambda score, name=name: str(getattr(score, name)) if score.solved else "-"
        for heading, name in counts.items()
    }
    columns["expected"] = lambda score: f"{100 * score.allowed:g} %" if score.solved else "-"
    faulty = {score.name: "red" for score in report.scores if score.invented or score.misses_too_often}
    title = "Inverse displacement by each method, and at how many poses it is known to lack a branch"
    outputs.print_table(title, columns, report.scores, style=lambda score: faulty.get(score.name))
    _print_differences(report, pairs=pairs)


def _print_differences(report: Report, *, pairs: bool = False) -> None:
    """Print the differences of all pairs of methods, or the largest of each quantity."""
    shown: list[PairDifference] = []
    for _, group in groupby(report.differences, key=lambda pair: pair.quantity):
        of_quantity = list(group)
        shown += of_quantity if pairs else [max(of_quantity, key=lambda pair: pair.ratio)]
    columns = {
        "quantity": lambda pair: str(pair.quantity),
        "methods": lambda pair: f"{pair.first} - {pair.second}",
        "states": lambda pair: str(pair.compared),
        "differ": lambda pair: str(pair.disagreements),
        "largest": lambda pair: f"{pair.worst:.0e} {pair.quantity.unit}".strip(),
        "share": lambda pair: f"{pair.ratio:.0e}",
    }
    which = "Differences of all pairs" if pairs else "Largest difference in each quantity"
    outputs.print_table(
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
        drawn = "" if report.geometry.is_nominal else "they know machines as drawn alone, or "
        lines.append(f"Left out, since {drawn}their packages are not installed: {', '.join(absent)}.")
    worst = report.worst
    if worst is not None:
        what = f"{worst.quantity}, {worst.first} and {worst.second}, branch {worst.branch}"
        which = "Largest difference" if worst.ratio > 1.0 else "Nearest to the tolerance"
        lines.append(f"{which}: {what}, {worst.ratio:.0e} of it, at the pose")
        lines.append(f"  {report.command(worst.pose, file)}")
    for score in report.scores:
        if score.pose >= 0:
            rate = f"{100 * score.allowed:g} %"
            rated = f"more often than the {rate} it states" if score.misses_too_often else f"within its {rate}"
            lost = f"branches lost at {score.missed} poses, {rated}"
            what = f"{score.invented} branches whose loops are not closed" if score.invented else lost
            lines.append(f"{score.name}: {what}. The first is at the pose")
            lines.append(f"  {report.command(score.pose, file)}")
    return lines


def _content(report: Report, file: str | None) -> dict[str, Any]:
    content = {name: getattr(report, name) for name in ("agrees", "verdict", "outliers", "seed", "requested")}
    sizes = {name: getattr(report.geometry, name) for name in ("base_radius", "platform_radius", "middle_side")}
    poses = zip(report.translation, report.xyx, strict=True)
    return content | {
        "geometry": sizes,
        "poses": [{"translation": translation, "xyx_degrees": xyx} for translation, xyx in poses],
        "reached": report.reached,
        "states": report.states,
        "methods": [vars(score) for score in report.scores],
        "differences": [
            vars(pair) | {"unit": pair.quantity.unit, "reproduce": report.command(pair.pose, file)}
            for pair in report.differences
        ],
    }


_NEXT = (
    ("inverse --help", "all branches of a pose; the paper's as example"),
    ("view", 'drag the platform in a browser (extra "viewer")'),
    ("reproduce", "the cause of each difference from the paper"),
)


@outputs.name_options()
def demo(
    out: Annotated[Path | None, outputs.picture_option("Picture of the example's branches: .png, .svg, .pdf.")] = None,
    poses: Annotated[int, typer.Option(min=1, help="Random poses of the comparison.")] = 50,
) -> None:
    """Reproduce the paper, compare all methods, and draw the example.

    Exits with 1 if a printed number is unexplained or the methods disagree. --out needs the extra "plots".
    """
    reproduction = recompute()
    report = compare_with_progress(Geometry.paper(), poses, 0, None)
    if out is not None:
        example = pose(np.array(published.POSITION) / 100.0, xyx=np.deg2rad(published.XYX_DEGREES))
        solutions = inverse_displacement(Geometry.paper(), example)
        save_gallery(options.titled_branches(solutions, options.selected_labels(solutions, None)), out)
    style = "bold red" if reproduction.unexplained else "bold green"
    outputs.print_lines([f"The paper:   {summary_line(reproduction)}"], style)
    print_verdict("The methods: ", report)
    print_summary(reproduction)
    _print_differences(report)
    if out is not None:
        outputs.stdout.print(f"Picture of the six real branches of the paper's pose: {out}", soft_wrap=True)
    outputs.stdout.print("Try next:")
    program = "spm-pin" if shutil.which("spm-pin") else sys.argv[0]
    width = max(len(arguments) for arguments, _ in _NEXT)
    for arguments, what in _NEXT:
        outputs.stdout.print(f"  {program} {arguments:{width}}  {what}", soft_wrap=True)
    _end(report, failed=bool(reproduction.unexplained))
