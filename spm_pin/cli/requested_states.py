"""Configurations that a command is asked for: branches of a pose, or a state given by leg lengths."""

from __future__ import annotations

from dataclasses import dataclass
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
    degeneracy_remarks,
    exit_code,
    read_geometry,
    read_pose,
    selected_labels,
    unit_hint,
)
from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, Geometry, SolutionSet

__all__ = [
    "AnyLegs",
    "AnyTranslation",
    "AnyXyx",
    "NamedBranches",
    "named_branches",
    "requested_solutions",
    "select_branch",
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
    """Return the branches of the pose asked for, and the one to take if none is named.

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
            cause = unit_hint("--translation", translation, unit, geometry) or " ".join(degeneracy_remarks(solutions))
            raise ArgumentError("--translation", "a pose with a real branch", f"status {solutions.status}", cause)
        physical = solutions.physical()
        return solutions, physical if physical.exists else solutions[int(solutions.exists.argmax())]
    if legs is None:
        from spm_pin.display.viewer.state import starting_configuration

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


@dataclass(frozen=True)
class NamedBranches:
    """Branches of one pose by their labels, and what is to be said of the pose."""

    states: dict[str, Configuration]
    status: str
    remarks: tuple[str, ...]
    code: int

    def finish(self) -> NoReturn:
        """End the command: with remarks on stderr where there is no branch, and the pose's exit code."""
        for remark in self.remarks:
            note(remark)
        raise typer.Exit(self.code)


def named_branches(
    geometry: Path | None, translation: Triple, xyx: Triple, unit: LengthUnit, labels: list[str] | None
) -> NamedBranches:
    """Return the branches of `--branch` of a pose, or all real ones.

    Raises
    ------
    ArgumentError
        If a branch is not real, or an option is wrong.
    """
    dimensions = read_geometry(geometry)
    solutions = inverse_displacement(dimensions, read_pose(translation, xyx, unit))
    remarks = []
    if not solutions.count:
        hint = unit_hint("--translation", translation, unit, dimensions)
        remarks = [f"status: {solutions.status}, no real branch", *degeneracy_remarks(solutions), *filter(None, [hint])]
    states = {label: solutions[label] for label in selected_labels(solutions, labels if solutions.count else None)}
    return NamedBranches(states, str(solutions.status), tuple(remarks), exit_code(solutions))
