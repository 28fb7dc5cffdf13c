"""`spm-pin demo`: a first look at the package, in one screen or two."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.crosscheck import compare_with_progress, print_report, verdict_line
from spm_pin.cli.reproduce import print_summary, summary_line
from spm_pin.crosscheck import reproduce
from spm_pin.display.plots import save_gallery
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.mechanism import Geometry, pose
from spm_pin.paper import published

_NEXT = (
    ("inverse --help", "all branches of a pose; the paper's as example"),
    ("forward --help", "the pose of six leg lengths"),
    ("view", 'drag the platform in a browser (extra "viewer")'),
    ("reproduce", "the cause of each difference from the paper"),
    ("--help", "all commands"),
)


def demo(
    out: Annotated[Path | None, outputs.picture_option("Picture of the example's branches: .png, .svg, .pdf.")] = None,
    poses: Annotated[int, typer.Option(min=1, help="Random poses of the comparison.")] = 100,
) -> None:
    """Reproduce the paper, compare all methods, and draw the example.

    Exits with 1 if a printed number is unexplained or the methods disagree. --out needs the extra "plots".
    """
    found = reproduce()
    report = compare_with_progress(Geometry.paper(), poses, 0, None)
    outputs.print_lines([f"The paper:   {summary_line(found)}"], "bold red" if found.unexplained else "bold green")
    outputs.print_lines([f"The methods: {verdict_line(report)}"], "bold green" if report.agrees else "bold red")
    outputs.stdout.print()
    print_summary(found)
    outputs.print_lines(["The cause of each difference is in the numbers: spm-pin reproduce names it."])
    outputs.stdout.print()
    print_report(report)
    if out is not None:
        example = pose(np.array(published.POSITION) / 100.0, xyx=np.deg2rad(published.XYX_DEGREES))
        solutions = inverse_displacement(Geometry.paper(), example)
        save_gallery(options.titled_branches(solutions, options.selected_labels(solutions, None)), out)
        outputs.stdout.print(f"Picture of the six real branches of the paper's pose: {out}", soft_wrap=True)
    outputs.stdout.print("Try next:")
    program = "spm-pin" if shutil.which("spm-pin") else sys.argv[0]
    width = max(len(arguments) for arguments, _ in _NEXT)
    for arguments, what in _NEXT:
        outputs.stdout.print(f"  {program} {arguments:{width}}  {what}", soft_wrap=True)
    if found.unexplained or not report.agrees:
        raise typer.Exit(1)
