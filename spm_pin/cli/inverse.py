"""`spm-pin inverse`: all branches of one pose."""

from __future__ import annotations

from typing import Any

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from spm_pin.cli.console import new_table, stdout, to_json
from spm_pin.cli.options import AsJson, GeometryFile, LengthUnit, Translation, Unit, Xyx, read_geometry, read_pose
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.mechanism import LEGS, SolutionSet, Status

__all__ = ["inverse"]


def inverse(
    translation: Translation,
    xyx: Xyx,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Find every configuration that holds the platform in a pose.

    Example, the paper's: spm-pin inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm
    """
    solutions = inverse_displacement(read_geometry(geometry), read_pose(translation, xyx, unit))
    if json:
        typer.echo(to_json(_content(solutions, unit)))
        return
    if solutions.count:
        stdout.print(_table(solutions, unit))
    for line in _remarks(solutions):
        stdout.print(escape(line), highlight=False)


def _table(solutions: SolutionSet, unit: LengthUnit) -> Table:
    table = new_table(f"Real branches: leg lengths in {unit}")
    table.add_column("branch", style="bold")
    for leg in LEGS:
        table.add_column(leg, justify="right")
    table.add_column("")
    limits = solutions.geometry.limits
    digits = {LengthUnit.M: 5, LengthUnit.CM: 3, LengthUnit.MM: 2}[unit]
    for k in np.flatnonzero(solutions.exists):
        lengths = solutions.leg_lengths[k]
        beyond = np.zeros(6, bool) if limits is None else (lengths < limits.minimum) | (lengths > limits.maximum)
        texts = [
            f"{x * unit.per_metre:.{digits}f}{'*' if far else ' '}" for x, far in zip(lengths, beyond, strict=True)
        ]
        table.add_row(solutions.labels[k], *texts, "physical" if solutions.is_physical[k] else "")
    return table


def _remarks(solutions: SolutionSet) -> list[str]:
    remarks = [f"status: {solutions.status}, {solutions.count} of 8 branches real"]
    if solutions.count:
        remarks[0] += f", closure residual up to {np.nanmax(solutions.residual):.0e} m"
    if not np.array_equal(solutions.within().exists, solutions.exists):
        remarks.append("* beyond the limits of this leg")
    if solutions.status is Status.DEGENERATE and solutions.degeneracy is not None:
        families = [f for f, hit in zip(("TT", "TF", "FT", "FF"), solutions.degeneracy.families, strict=True) if hit]
        legs = [str(i + 1) for i in np.flatnonzero(solutions.degeneracy.legs)]
        remarks.append(
            f"The solutions of {', '.join(families)} form a continuous family of dimension "
            f"{int(solutions.degeneracy.dimension)}, of which none is picked."
            + (f" Both planes of leg {', '.join(legs)} coincide." if legs else "")
        )
    if solutions.status is Status.UNREACHABLE:
        remarks.append("No configuration holds this pose, whatever the leg lengths.")
    if solutions.ambiguous:
        remarks.append(
            "Two branches are physical, on either side of an inverse singularity; the straighter is likelier."
        )
    return remarks


def _content(solutions: SolutionSet, unit: LengthUnit) -> dict[str, Any]:
    inside, physical = solutions.within().exists, solutions.is_physical
    degeneracy = solutions.degeneracy
    assert solutions.discriminants is not None
    assert degeneracy is not None
    return {
        "unit": str(unit),
        "status": str(solutions.status),
        "degeneracy": {
            "dimension": int(degeneracy.dimension),
            "families": degeneracy.families.tolist(),
            "legs": degeneracy.legs.tolist(),
        },
        "discriminants": [x if np.isfinite(x) else None for x in solutions.discriminants.tolist()],
        "branches": [
            {
                "label": label,
                "leg_lengths": (solutions.leg_lengths[k] * unit.per_metre).tolist(),
                "middle_joints": (solutions.middle_joints[k] * unit.per_metre).tolist(),
                "within_limits": bool(inside[k]),
                "physical": bool(physical[k]),
                "residual": float(solutions.residual[k]) * unit.per_metre,
            }
            for k, label in enumerate(solutions.labels)
            if solutions.exists[k]
        ],
    }
