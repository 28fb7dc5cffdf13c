"""`spm-pin draw`: a picture in a file, without a screen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from spm_pin.cli.console import stderr
from spm_pin.cli.options import Branches, GeometryFile, LengthUnit, Unit, chosen, read_geometry
from spm_pin.cli.pose_options import AnyLegs, AnyTranslation, AnyXyx, asked_solutions, one_of
from spm_pin.errors import ArgumentError

__all__ = ["draw"]


def draw(
    out: Annotated[Path, typer.Option(metavar="FILE", help="PNG or SVG to write.")],
    translation: AnyTranslation = None,
    xyx: AnyXyx = None,
    legs: AnyLegs = None,
    branch: Branches = None,
    every: Annotated[bool, typer.Option("--all", help="All real branches, side by side.")] = False,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    view: Annotated[
        tuple[float, float], typer.Option(metavar="AZIMUTH ELEVATION", help="Where to look from, in degrees.")
    ] = (15.0, 25.0),
    width: Annotated[int | None, typer.Option(help="Width of the picture in pixels.")] = None,
    names: Annotated[
        bool | None, typer.Option("--names/--no-names", help="Name joints, legs and axes; alone, a branch has names.")
    ] = None,
    background: Annotated[str, typer.Option(help="A colour, or none.")] = "white",
) -> None:
    """Draw the manipulator: the physical branch of a pose, branches by their names, or all of them.

    Example: spm-pin draw --out branches.png --all
    """
    from spm_pin.display.gallery import save_gallery
    from spm_pin.display.plots import save_picture

    if every and branch is not None:
        raise ArgumentError("--all", "all branches or some", "both --all and --branch")
    solutions, default = asked_solutions(read_geometry(geometry), translation, xyx, legs, unit)
    azimuth, elevation = np.deg2rad(view)
    direction = float(azimuth), float(elevation)
    labels = chosen(solutions, branch) if every or branch is not None else []
    if len(labels) > 1:
        states = {
            label + ", physical" * bool(solutions.is_physical[solutions.labels.index(label)]): solutions[label]
            for label in labels
        }
        save_gallery(states, out, view=direction, labels=bool(names), width=width or 1600, background=background)
    else:
        state = one_of(solutions, default, labels[0] if labels else None)
        save_picture(state, out, view=direction, labels=names is not False, width=width or 1000, background=background)
    stderr.print(f"wrote {escape(str(out))}")
