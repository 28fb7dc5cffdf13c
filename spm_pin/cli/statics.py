"""`spm-pin statics`: the leg forces that hold a wrench, and the leg rates of a twist."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from spm_pin.cli.console import new_table, stderr, stdout, to_json
from spm_pin.cli.options import (
    AsJson,
    Branches,
    GeometryFile,
    LengthUnit,
    Translation,
    Unit,
    Xyx,
    chosen,
    read_geometry,
    read_pose,
)
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.jacobians import leg_rates
from spm_pin.closed_form.leg_forces import leg_forces
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism import LEGS, Configuration

__all__ = ["statics"]

Triple = tuple[float, float, float]


def statics(
    translation: Translation,
    xyx: Xyx,
    force: Annotated[Triple, typer.Option(metavar="X Y Z", help="Force onto m at o, in {B}, in newtons.")] = (0, 0, 0),
    moment: Annotated[Triple, typer.Option(metavar="X Y Z", help="Moment onto m, in {B}, in newton metres.")] = (
        0,
        0,
        0,
    ),
    velocity: Annotated[Triple, typer.Option(metavar="X Y Z", help="Velocity of o in {B}, in --unit per second.")] = (
        0,
        0,
        0,
    ),
    angular_velocity: Annotated[
        Triple, typer.Option(metavar="X Y Z", help="Angular velocity of m in {B}, in degrees per second.")
    ] = (0, 0, 0),
    branch: Branches = None,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Find the leg forces that hold a wrench on the platform, and the leg rates of its twist.

    A positive force pushes, to extend its leg. At an inverse singularity the forces are still there; the rates are not.
    """
    solutions = inverse_displacement(read_geometry(geometry), read_pose(translation, xyx, unit))
    wrench = np.array([*force, *moment])
    twist = np.concatenate([np.array(velocity) / unit.per_metre, np.deg2rad(angular_velocity)])
    found = {label: _quantities(solutions[label], wrench, twist, unit) for label in chosen(solutions, branch)}
    if json:
        typer.echo(to_json({"unit": str(unit), "status": str(solutions.status), "branches": found}))
        return
    if not found:
        stderr.print(f"status: {solutions.status}, no real branch", highlight=False)
        return
    if wrench.any():
        stdout.print(_table("Leg forces in N: positive extends the leg", found, "forces"))
    if twist.any():
        stdout.print(_table(f"Leg rates in {unit}/s", found, "rates"))
    if not (wrench.any() or twist.any()):
        raise ArgumentError("--force", "a wrench or a twist that is not zero", "neither", "Nothing to hold or move")


def _quantities(state: Configuration, wrench: np.ndarray, twist: np.ndarray, unit: LengthUnit) -> dict[str, Any]:
    quantities: dict[str, Any] = {"forces": None, "rates": None, "singular": []}
    try:
        quantities["forces"] = leg_forces(state, wrench).tolist()
    except SingularConfigurationError as error:
        quantities["singular"].append(error.kind)
    try:
        quantities["rates"] = (leg_rates(state, twist) * unit.per_metre).tolist()
    except SingularConfigurationError as error:
        quantities["singular"].append(error.kind)
    return quantities


def _table(title: str, found: dict[str, dict[str, Any]], what: str) -> Table:
    table = new_table(title)
    table.add_column("branch", style="bold")
    for leg in LEGS:
        table.add_column(leg, justify="right")
    for label, quantities in found.items():
        if quantities[what] is None:
            table.add_row(label, f"{quantities['singular'][0]} singularity", style="yellow")
        else:
            table.add_row(label, *(f"{value:.5g}" for value in quantities[what]))
    return table
