"""`spm-pin statics`: the leg forces that hold a wrench, and the leg rates of a twist."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, Triple
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import leg_forces, leg_rates
from spm_pin.mechanism import LEGS, Configuration

_NONE = (0.0, 0.0, 0.0)


def _vector(help_text: str) -> Any:
    return typer.Option(metavar="X Y Z", help=help_text)


@outputs.name_options(wrench="--force, --moment", twist="--velocity, --angular-velocity")
def statics(
    translation: options.Translation,
    xyx: options.Xyx,
    force: Annotated[Triple, _vector("Force onto m at o, in {B}, in newtons.")] = _NONE,
    moment: Annotated[Triple, _vector("Moment onto m, in {B}, in newton metres.")] = _NONE,
    velocity: Annotated[Triple, _vector("Velocity of o in {B}, in --unit per second.")] = _NONE,
    angular_velocity: Annotated[Triple, _vector("Angular velocity of m in {B}, in degrees per second.")] = _NONE,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.AnyGeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Find the leg forces that hold a wrench on the platform, and the leg rates of its twist.

    A positive force pushes, to extend its leg. At an inverse singularity the forces are still there; the rates are not.
    """
    wrench = np.array([*force, *moment])
    twist = np.concatenate([np.array(velocity) / unit.per_metre, np.deg2rad(angular_velocity)])
    if not (json or wrench.any() or twist.any()):
        raise ArgumentError("--force", "a wrench or a twist that is not zero", "neither", "Nothing to hold or move")
    solutions, remarks = options.solve_pose(geometry, translation, xyx, unit)
    labels = options.selected_labels(solutions, branch)
    found = {label: _quantities(solutions[label], wrench, twist, unit) for label in labels}
    if json:
        outputs.write_json({"unit": unit, "status": str(solutions.status), "branches": found})
    elif found:
        if wrench.any():
            _print_quantities("Leg forces in N: positive extends the leg", found, "forces")
        if twist.any():
            _print_quantities(f"Leg rates in {unit}/s", found, "rates")
    options.end_command(solutions, remarks)


def _quantities(state: Configuration, wrench: np.ndarray, twist: np.ndarray, unit: LengthUnit) -> dict[str, Any]:
    quantities: dict[str, Any] = {"forces": None, "rates": None, "singular": []}
    for name, solve, vector, scale in (
        ("forces", leg_forces, wrench, 1.0),
        ("rates", leg_rates, twist, unit.per_metre),
    ):
        try:
            quantities[name] = solve(state, vector) * scale
        except SingularConfigurationError as error:
            quantities["singular"].append(error.kind)
    return quantities


def _print_quantities(title: str, found: dict[str, dict[str, Any]], what: str) -> None:
    rows = []
    for label, quantities in found.items():
        values = quantities[what]
        if values is None:
            rows.append([f"{label}: {quantities['singular'][0]} singularity", *[""] * len(LEGS)])
        else:
            rows.append([label, *(outputs.significant(value, np.abs(values).max()) for value in values)])
    outputs.print_table(title, ["branch", *LEGS], rows)
