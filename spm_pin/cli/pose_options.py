"""The configurations that `view` and `draw` are asked for: by a pose, by leg lengths, or those of the start."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer

from spm_pin.cli.options import LengthUnit, chosen, read_pose
from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, Geometry, SolutionSet

__all__ = ["AnyLegs", "AnyTranslation", "AnyXyx", "asked_solutions", "one_of"]

Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
AnyTranslation = Annotated[
    Triple | None, typer.Option("--translation", metavar="X Y Z", help="Position of o in {B}, in --unit.")
]
AnyXyx = Annotated[
    Triple | None,
    typer.Option("--xyx", metavar="ALPHA BETA LAMBDA", help="The paper's X-Y-X Euler angles in degrees."),
]
AnyLegs = Annotated[
    Six | None,
    typer.Option("--legs", metavar="B1 B2 B3 C1 C2 C3", help="Leg lengths in --unit, instead of a pose."),
]


def asked_solutions(
    geometry: Geometry, translation: Triple | None, xyx: Triple | None, legs: Six | None, unit: LengthUnit
) -> tuple[SolutionSet, Configuration]:
    """Return the branches of the pose asked for, and the one to take if none is named.

    That is the physical one, or else the first; with `legs` the one they hold; with nothing at all, a regular
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
            raise ArgumentError("--translation", "a pose with a real branch", f"status {solutions.status}")
        physical = solutions.physical()
        return solutions, physical if physical.exists else solutions[int(solutions.exists.argmax())]
    if legs is None:
        from spm_pin.display.viewer.state import starting_configuration

        state = starting_configuration(geometry)
    else:
        state = forward_physical(geometry, np.array(legs) / unit.per_metre)
        if not state.exists:
            raise ArgumentError("--legs", "lengths with which the machine can be assembled", "none such")
    return inverse_displacement(geometry, state.pose), state


def one_of(solutions: SolutionSet, default: Configuration, branch: str | None) -> Configuration:
    """Return the branch that is named, or the default; raises `ArgumentError` where it is not real."""
    if branch is None:
        return default
    state: Configuration = solutions[chosen(solutions, [branch])[0]]
    return state
