"""Configurations requested by a command's options: branches of a pose, or a state given by leg lengths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer

from spm_pin.cli.console import note
from spm_pin.cli.options import (
    TRANSLATION,
    XYX,
    LengthUnit,
    SixLegs,
    Triple,
    exit_code,
    pose_remarks,
    read_any_geometry,
    read_pose,
    selected_labels,
    unit_hint,
)
from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.starting_configuration import starting_configuration
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, Geometry, SolutionSet, Status

__all__ = [
    "AnyLegs",
    "AnyTranslation",
    "AnyXyx",
    "end_command",
    "requested_solutions",
    "select_branch",
    "solve_pose",
    "titled_branches",
]

AnyTranslation = Annotated[Triple | None, TRANSLATION]
AnyXyx = Annotated[Triple | None, XYX]
AnyLegs = Annotated[
    SixLegs | None,
    typer.Option("--legs", metavar="B1 B2 B3 C1 C2 C3", help="Leg lengths in --unit, instead of a pose."),
]


def requested_solutions(
    geometry: Geometry, translation: Triple | None, xyx: Triple | None, legs: SixLegs | None, unit: LengthUnit
) -> tuple[SolutionSet, Configuration]:
    """Return the branches of the requested pose, and the one to take if none is named.

    That is the physical one, or else the first; with `legs` the one they determine; with no option at all, a regular
    configuration near the home.

    Raises
    ------
    ArgumentError
        If only half a pose is given, or a pose and legs; or nothing real is found.
    """
    if (translation is None) != (xyx is None):
        missing = "--translation" if translation is None else "--xyx"
        raise ArgumentError(missing, "a pose, of --translation and --xyx together", "only one of them")
    if legs is not None and translation is not None:
        raise ArgumentError("--legs", "leg lengths or a pose", "both")
    if translation is not None and xyx is not None:
        solutions = inverse_displacement(geometry, read_pose(translation, xyx, unit))
        if not solutions.count:
            cause = unit_hint("--translation", translation, unit, geometry) or " ".join(pose_remarks(solutions))
            raise ArgumentError("--translation", "a pose with a real branch", f"status {solutions.status}", cause)
        physical = solutions.physical()
        return solutions, physical if physical.exists else solutions[int(solutions.exists.argmax())]
    if legs is None:
        state = starting_configuration(geometry)
    else:
        state = forward_physical(geometry, np.array(legs) / unit.per_metre)
        if not state.exists:
            cause = unit_hint("--legs", legs, unit, geometry)
            raise ArgumentError("--legs", "lengths with which the machine can be assembled", "none such", cause)
    return inverse_displacement(geometry, state.pose), state


def select_branch(solutions: SolutionSet, default: Configuration, branch: str | None) -> Configuration:
    """Return the branch that is named, or the default; raises `ArgumentError` where it is not real."""
    if branch is None:
        return default
    state: Configuration = solutions[selected_labels(solutions, [branch])[0]]
    return state


def titled_branches(solutions: SolutionSet, labels: Sequence[str]) -> dict[str, Configuration]:
    """Return branches of a pose under the titles of their pictures."""
    physical = solutions.is_physical
    places = [solutions.labels.index(label) for label in labels]
    return {solutions.labels[k] + ", physical" * bool(physical[k]): solutions[k] for k in places}


def solve_pose(
    geometry: Path | None, translation: Triple, xyx: Triple, unit: LengthUnit
) -> tuple[SolutionSet, list[str]]:
    """Return the branches of `--translation` and `--xyx`, and remarks on a pose that has none or too many."""
    dimensions = read_any_geometry(geometry)
    solutions = inverse_displacement(dimensions, read_pose(translation, xyx, unit))
    hint = unit_hint("--translation", translation, unit, dimensions)
    remarks = [hint] if hint else pose_remarks(solutions)
    if solutions.status is Status.UNREACHABLE and not remarks:
        remarks.append("No configuration holds this pose, whatever the leg lengths.")
    return solutions, remarks


def end_command(solutions: SolutionSet, remarks: list[str]) -> NoReturn:
    """End a command with the exit code of its pose; where no branch is real, with the remarks on stderr."""
    if not solutions.count:
        for remark in (f"status: {solutions.status}, no real branch", *remarks):
            note(remark)
    raise typer.Exit(exit_code(solutions))
