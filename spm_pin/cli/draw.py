"""`spm-pin draw`, a picture in a file, and `view`, the interactive page."""

from __future__ import annotations

import math
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import RigidTransform
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.display.plots import NARROWEST, save_gallery, save_picture
from spm_pin.display.writing import FORMATS
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import LEGS

Host = Annotated[str, Option(help="Address to listen at; only this machine reaches the default.")]
Port = Annotated[int, Option(help="First port to try; 0 lets the system choose.")]
Dark = Annotated[bool, Option("--dark", help="Begin with a dark page.")]
Browser = Annotated[bool, Option("--open/--no-open", help="Open the page in a browser.")]


@outputs.name_options(leg_lengths="--legs", readings="--legs")
@options.takes_pose(required=False)
def draw(
    out: Annotated[Path, outputs.picture_option(f"Picture to write: {', '.join(FORMATS)}.")],
    pose: RigidTransform | None = None,
    legs: options.AnyLegs = None,
    branch: options.Branches = None,
    every: Annotated[bool, Option("--all", help="All real branches, side by side.")] = False,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    view: Annotated[
        tuple[float, float], Option(metavar="AZIMUTH ELEVATION", help="Direction of the view, in degrees.")
    ] = (15.0, 25.0),
    width: Annotated[int | None, Option(help="Width of the picture in pixels.")] = None,
    names: Annotated[
        bool | None,
        Option("--names/--no-names", help="Names of joints, legs and axes; default: for a single branch."),
    ] = None,
    background: Annotated[str | None, Option(help="A colour, or none; default: white.")] = None,
) -> None:
    """Draw the manipulator: the physical branch of a pose, named branches, or all of them.

    Example: spm-pin draw --out branches.png --all

    Needs the extra "plots".
    """
    if every and branch is not None:
        raise ArgumentError("--all", "all branches or some", "both --all and --branch")
    if not (abs(view[0]) <= 360.0 and abs(view[1]) <= 90.0):
        expected = "azimuth and elevation in degrees, at most 360 and 90"
        raise ArgumentError("--view", expected, f"{view[0]:g} and {view[1]:g}")
    solutions, default = options.requested_solutions(options.read_machine(machine_file), pose, legs, unit)
    direction = math.radians(view[0]), math.radians(view[1])
    appearance: dict[str, Any] = {"view": direction, "background": background or "white"}
    named = branch is not None
    labels = options.selected_labels(solutions, branch, required=named) if every or named else []
    states = {"": solutions[labels[0]] if labels else default}
    if len(labels) > 1:
        states = options.titled_branches(solutions, labels)
        save_gallery(states, out, labels=bool(names), width=width or 1600, **appearance)
    else:
        width = width or 1000
        names = width >= NARROWEST[True] if names is None else names
        save_picture(states[""], out, labels=names, width=width, **appearance)
    outputs.note(f"wrote {out}")
    beyond = []
    for title, state in states.items():
        beyond_limits = ", ".join(LEGS[leg] for leg in np.flatnonzero(state.limit_excess))
        if beyond_limits:
            beyond.append(f"{title}: {beyond_limits}" if title else beyond_limits)
    if beyond:
        outputs.note(f"legs beyond their limits: {'; '.join(beyond)}", "yellow")


@outputs.name_options(leg_lengths="--legs", readings="--legs", points="--path")
@options.takes_pose(required=False)
def view(
    pose: RigidTransform | None = None,
    legs: options.AnyLegs = None,
    branch: Annotated[str | None, Option(metavar="LABEL", help="Branch to begin with, such as TT+.")] = None,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    path: Annotated[Path | None, Option(metavar="FILE", help="A recorded path to play, a CSV file.")] = None,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    demo: Annotated[
        bool | None, Option("--demo/--no-demo", help="Move until touched; default: if no pose is given.")
    ] = None,
    dark: Dark = False,
    browser: Browser = True,
) -> None:
    """Drag the platform and watch all branches, in a browser. Ends with Ctrl-C.

    Needs the extra "viewer".
    """
    require_extra("viewer")
    beside = {"--translation": pose, "--legs": legs, "--demo": demo, "--branch": branch}
    ignored = [option for option, value in beside.items() if value not in (None, False)]
    if path is not None and ignored:
        raise ArgumentError("--path", "to be given alone: it begins in the physical branch", ", ".join(ignored))
    if path is not None and unit is not LengthUnit.M:
        raise ArgumentError("--unit", "m beside --path, whose columns are in metres", unit)
    from spm_pin.display.viewer import read_recording

    dimensions = options.read_machine(machine_file)
    recording = read_recording(path) if path is not None else None
    if recording is not None:
        recording.check_unit(dimensions)
    solutions, start = options.requested_solutions(dimensions, pose, legs, unit)
    if branch is not None:
        (label,) = options.selected_labels(solutions, [branch], required=True)
        start = solutions[label]
    if demo is None:
        demo = all(option is None for option in (pose, legs, branch, path))
    page = {"recording": recording, "machine_file": machine_file, "demo": demo}
    serve(start, host=host, port=port, browser=browser, dark=dark, **page)


def serve(start: Any, *, host: str, port: int, browser: bool, **page: Any) -> None:
    """Serve the page of a machine until Ctrl-C."""
    from spm_pin.display.viewer import Viewer

    with outputs.progress_bar() as bar:
        viewer = Viewer(start, host=host, port=port, progress=bar, **page)
    with viewer:
        if port not in (0, viewer.port):
            outputs.note(f"port {port} is taken, this is on {viewer.port}")
        outputs.note(f"viewer at {viewer.url}, Ctrl-C ends it")
        if host not in ("127.0.0.1", "localhost", "::1"):
            outputs.note("there is no password: anyone who reaches this port can use the page", "yellow")
        # Without a screen, a text browser would take over the terminal.
        if browser and (sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(viewer.url)
        viewer.wait()
