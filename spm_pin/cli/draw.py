"""`spm-pin draw`, a picture in a file, and `view`, the interactive page."""

from __future__ import annotations

import math
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.display.figures import FORMATS
from spm_pin.display.plots import NARROWEST, save_gallery, save_picture
from spm_pin.errors import ArgumentError, require_extra


@outputs.name_options(path="--out", leg_lengths="--legs", readings="--legs")
def draw(
    out: Annotated[Path, outputs.picture_option(f"Picture to write: {', '.join(FORMATS)}.")],
    translation: options.AnyTranslation = None,
    xyx: options.AnyXyx = None,
    legs: options.AnyLegs = None,
    branch: options.Branches = None,
    every: Annotated[bool, Option("--all", help="All real branches, side by side.")] = False,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    view: Annotated[
        tuple[float, float], Option(metavar="AZIMUTH ELEVATION", help="Where to look from, in degrees.")
    ] = (15.0, 25.0),
    width: Annotated[int | None, Option(help="Width of the picture in pixels.")] = None,
    names: Annotated[
        bool | None,
        Option("--names/--no-names", help="Name joints, legs and axes; a branch alone has names."),
    ] = None,
    background: Annotated[str, Option(help="A colour, or none.")] = "white",
) -> None:
    """Draw the manipulator: the physical branch of a pose, branches by their names, or all of them.

    Example: spm-pin draw --out branches.png --all

    Needs the extra "plots".
    """
    if every and branch is not None:
        raise ArgumentError("--all", "all branches or some", "both --all and --branch")
    solutions, default = options.requested_solutions(options.read_geometry(geometry), translation, xyx, legs, unit)
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


@outputs.name_options(leg_lengths="--legs", readings="--legs")
def view(
    translation: options.AnyTranslation = None,
    xyx: options.AnyXyx = None,
    legs: options.AnyLegs = None,
    branch: Annotated[str | None, Option(metavar="LABEL", help="Branch to begin with, such as TT+.")] = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    path: Annotated[Path | None, Option(metavar="FILE", help="A recorded path to play, a CSV file.")] = None,
    host: Annotated[str, Option(help="Address to listen at; only this machine reaches the default.")] = ("127.0.0.1"),
    port: Annotated[int, Option(help="First port to try; 0 lets the system choose.")] = 8080,
    demo: Annotated[
        bool | None, Option("--demo/--no-demo", help="Move until touched; by default if no pose is given.")
    ] = None,
    dark: Annotated[bool, Option("--dark", help="Begin with a dark page.")] = False,
    browser: Annotated[bool, Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Drag the platform and watch all branches, in a browser. Ends with Ctrl-C.

    Needs the extra "viewer".
    """
    require_extra("viewer")
    dimensions = options.read_geometry(geometry)
    solutions, start = options.requested_solutions(dimensions, translation, xyx, legs, unit)
    if branch is not None:
        (label,) = options.selected_labels(solutions, [branch], required=True)
        start = solutions[label]
    from spm_pin.display.viewer import Viewer, read_recording

    recording = read_recording(path) if path is not None else None
    if demo is None:
        demo = all(option is None for option in (translation, xyx, legs, branch, path))
    page: dict[str, Any] = {"recording": recording, "dark": dark, "geometry_file": geometry, "demo": demo}
    with Viewer(start, host=host, port=port, **page) as viewer:
        if port not in (0, viewer.port):
            outputs.note(f"port {port} is taken, this is on {viewer.port}")
        outputs.note(f"viewer at {viewer.url}, Ctrl-C ends it")
        if host not in ("127.0.0.1", "localhost", "::1"):
            outputs.note("there is no password: whoever reaches this port can use the page", "yellow")
        if browser and _has_screen():
            webbrowser.open(viewer.url)
        viewer.wait()


def _has_screen() -> bool:
    """Return whether a browser has somewhere to appear; without one, text browsers would take the terminal."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
