"""`spm-pin view`: the interactive page."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.errors import require_extra


@outputs.name_options(leg_lengths="--legs")
def view(
    translation: options.AnyTranslation = None,
    xyx: options.AnyXyx = None,
    legs: options.AnyLegs = None,
    branch: Annotated[str | None, typer.Option(metavar="LABEL", help="Branch to begin with, such as TT+.")] = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.AnyGeometryFile = None,
    path: Annotated[Path | None, typer.Option(metavar="FILE", help="A recorded path to play, a CSV file.")] = None,
    host: Annotated[str, typer.Option(help="Address to listen at; only this machine reaches the default.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(help="First port to try; 0 lets the system choose.")] = 8080,
    demo: Annotated[
        bool | None, typer.Option("--demo/--no-demo", help="Move until touched; by default if no pose is given.")
    ] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Begin with a dark page.")] = False,
    browser: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Drag the platform and watch all branches, in a browser. Ends with Ctrl-C.

    Needs the extra "viewer".
    """
    require_extra("viewer")
    dimensions = options.read_any_geometry(geometry)
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
