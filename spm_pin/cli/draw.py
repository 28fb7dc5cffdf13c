"""`spm-pin draw`, a picture in a file, and `view`, the interactive page."""

from __future__ import annotations

import math
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import outputs
from spm_pin.cli.options import OF_MANIPULATOR, Branches, Readings
from spm_pin.cli.requests import Request, request_of, selected_labels, solve_request
from spm_pin.cli.units import LengthUnit, MachineInUnits
from spm_pin.display.plots import NARROWEST, save_gallery, save_picture
from spm_pin.display.writing import FORMATS
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.machine import Configuration, Status


def draw(
    out: Annotated[Path, outputs.file_option(f"Picture to write: {', '.join(FORMATS)}.", FORMATS, "plots")],
    typed: MachineInUnits,
    pose: Request | None = None,
    legs: Readings = None,
    branch: Branches = None,
    every: Annotated[bool, Option("--all", help="All real branches, side by side.")] = False,
    view: Annotated[
        tuple[float, float], Option(metavar="AZIMUTH ELEVATION", help="Direction of the view, in degrees.")
    ] = (15.0, 25.0),
    width: Annotated[int | None, Option(help="Width of the picture in pixels.")] = None,
) -> None:
    """Draw the machine: the physical branch of a pose, named branches, or all of them.

    Example: spm-pin draw --out branches.png --all

    Example: spm-pin stage draw --base 80 --platform 90 --crank 50 --rod 110 --unit mm --tilt 12 --out stage.png

    Needs the extra "plots".
    """
    if every and branch is not None:
        raise outputs.cannot_be_used("--all", "--branch")
    if not (abs(view[0]) <= 360.0 and abs(view[1]) <= 90.0):
        expected = "azimuth and elevation in degrees, at most 360 and 90"
        raise ArgumentError("--view", expected, f"{view[0]:g} and {view[1]:g}")
    solutions, default = _requested(typed, pose, legs)
    direction = math.radians(view[0]), math.radians(view[1])
    named = branch is not None
    labels = selected_labels(solutions, branch, required=named) if every or named else []
    states = titled_branches(solutions, labels) if labels else {"": default}
    if len(states) > 1:
        save_gallery(states, out, view=direction, labels=False, width=width or 1600)
    else:
        width = width or 1000
        save_picture(next(iter(states.values())), out, view=direction, labels=width >= NARROWEST[True], width=width)
    outputs.note(f"wrote {out}")
    beyond = {title: np.flatnonzero(state.limit_excess) for title, state in states.items()}
    texts = [
        f"{title}: " * bool(title) + ", ".join(typed.names[leg] for leg in legs)
        for title, legs in beyond.items()
        if legs.size
    ]
    if texts:
        outputs.note(f"legs beyond their limits: {'; '.join(texts)}", "yellow")


def titled_branches(solutions: Any, labels: list[str]) -> dict[str, Configuration]:
    """Return branches of a pose by the titles of their pictures."""
    titled, physical = {}, solutions.is_physical
    for k in map(solutions.labels.index, labels):
        state = solutions.configurations[k]
        marks = ", physical" * bool(physical[k]) + ", beyond limits" * bool(state.limit_excess.any())
        titled[solutions.labels[k] + marks] = state
    return titled


def _requested(typed: MachineInUnits, pose: Request | None, legs: Any) -> tuple[Any, Any]:
    """Return the branches of the requested pose, and the one to use if none is named: the physical or the first."""
    machine, kind = typed.machine, request_of(typed.machine)
    if pose is None and legs is None:
        state = kind.start(machine)
        return kind.of_state(state, typed).solve(), state
    solutions, remarks = solve_request(typed, pose, legs)
    state = solutions.physical()
    if not (state.exists if machine.is_stage else solutions.count):
        option, expected = "--legs", "readings with which the machine can be assembled"
        if pose is not None:
            option, expected = kind.named, kind.reached
            if (solutions.status is Status.UNREACHABLE or machine.is_stage) and (reached := pose.nearest()):
                remarks.append(f"The nearest: {kind.options_of(reached[0], typed)}")
        raise ArgumentError(option, expected, f"status {solutions.status}", " ".join(remarks))
    if not state.exists:
        outputs.note("no branch of this pose is physical", "yellow")
        state = solutions.configurations[int(solutions.exists.argmax())]
    return solutions if pose is not None else kind.of_state(state, typed).solve(), state


def view(
    typed: MachineInUnits,
    pose: Request | None = None,
    legs: Readings = None,
    branch: Annotated[str | None, Option(metavar="LABEL", help="Branch, such as TT+."), OF_MANIPULATOR] = None,
    recording: Annotated[
        Path | None, Option("--path", metavar="FILE", help="A recorded path to play, a CSV file."), OF_MANIPULATOR
    ] = None,
    host: Annotated[str, Option(help="Address to listen at; only this machine reaches the default.")] = "127.0.0.1",
    port: Annotated[int, Option(help="First port to try; 0 lets the system choose.")] = 8080,
    demo: Annotated[
        bool, Option("--demo/--no-demo", help="Move until touched, without a pose."), OF_MANIPULATOR
    ] = True,
    dark: Annotated[bool, Option("--dark", help="Begin with a dark page.")] = False,
    browser: Annotated[bool, Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Drag the platform, or its legs, and watch all branches, in a browser. Ends with Ctrl-C.

    Example: spm-pin stage view --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm

    Needs the extra "viewer".
    """
    require_extra("viewer")
    beside = {"--translation": pose, "--legs": legs, "--branch": branch}
    given = [option for option, value in beside.items() if value is not None]
    played = None
    if recording is not None:
        if given:
            raise outputs.cannot_be_used("--path", ", ".join(given), "The path begins in the physical branch")
        if typed.unit is not LengthUnit.M:
            raise ArgumentError("--unit", "m beside --path, whose columns are in metres", typed.unit)
        from spm_pin.display.viewer import read_recording

        played = read_recording(recording)
        played.check_unit(typed.machine)
    from spm_pin.display.viewer import Viewer

    solutions, start = _requested(typed, pose, legs)
    if branch is not None:
        (label,) = selected_labels(solutions, [branch], required=True)
        start = solutions[label]
    demo = demo and not given and played is None
    page: dict[str, Any] = {"recording": played, "machine_file": typed.file, "demo": demo, "dark": dark}
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
