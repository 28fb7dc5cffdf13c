"""`spm-pin draw`: a picture in a file, without a screen."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.display.output_files import FORMATS
from spm_pin.display.plots import NARROWEST, save_gallery, save_picture
from spm_pin.errors import ArgumentError


@outputs.name_options(path="--out", leg_lengths="--legs")
def draw(
    out: Annotated[Path, outputs.picture_option(f"Picture to write: {', '.join(FORMATS)}.")],
    translation: options.AnyTranslation = None,
    xyx: options.AnyXyx = None,
    legs: options.AnyLegs = None,
    branch: options.Branches = None,
    every: Annotated[bool, typer.Option("--all", help="All real branches, side by side.")] = False,
    unit: options.Unit = LengthUnit.M,
    geometry: options.AnyGeometryFile = None,
    view: Annotated[
        tuple[float, float], typer.Option(metavar="AZIMUTH ELEVATION", help="Where to look from, in degrees.")
    ] = (15.0, 25.0),
    width: Annotated[int | None, typer.Option(help="Width of the picture in pixels.")] = None,
    names: Annotated[
        bool | None,
        typer.Option("--names/--no-names", help="Name joints, legs and axes; a branch alone has names."),
    ] = None,
    background: Annotated[str, typer.Option(help="A colour, or none.")] = "white",
) -> None:
    """Draw the manipulator: the physical branch of a pose, branches by their names, or all of them.

    Example: spm-pin draw --out branches.png --all

    Needs the extra "plots".
    """
    if every and branch is not None:
        raise ArgumentError("--all", "all branches or some", "both --all and --branch")
    solutions, default = options.requested_solutions(options.read_any_geometry(geometry), translation, xyx, legs, unit)
    direction = math.radians(view[0]), math.radians(view[1])
    named = branch is not None
    labels = options.selected_labels(solutions, branch, required=named) if every or named else []
    if len(labels) > 1:
        states = options.titled_branches(solutions, labels)
        save_gallery(states, out, view=direction, labels=bool(names), width=width or 1600, background=background)
    else:
        state = solutions[labels[0]] if labels else default
        width = width or 1000
        names = width >= NARROWEST[True] if names is None else names
        save_picture(state, out, view=direction, labels=names, width=width, background=background)
    outputs.note(f"wrote {out}")
