"""`spm-pin forward`: the poses that six leg lengths allow."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

from spm_pin.cli.console import new_table, stdout, to_json
from spm_pin.cli.options import AsJson, GeometryFile, LengthUnit, Unit, read_geometry
from spm_pin.closed_form.forward_displacement import forward_displacement, forward_physical
from spm_pin.mechanism import Configuration, SolutionSet, Status

__all__ = ["forward"]

_DIGITS = {LengthUnit.M: 5, LengthUnit.CM: 3, LengthUnit.MM: 2}


def forward(
    legs: Annotated[
        tuple[float, float, float, float, float, float],
        typer.Option(metavar="B1 B2 B3 C1 C2 C3", help="Leg lengths r_b1 to r_b3 and r_c1 to r_c3, in --unit."),
    ],
    every: Annotated[
        bool, typer.Option("--all", help="Show every assembly mode, not only the one a real machine is in.")
    ] = False,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Find the pose of the platform from the leg lengths.

    Example, the paper's: spm-pin forward --legs 120 120 140 125 120 150 --unit cm
    """
    lengths = np.array(legs) / unit.per_metre
    dimensions = read_geometry(geometry)
    modes = forward_displacement(dimensions, lengths)
    physical = forward_physical(dimensions, lengths)
    if json:
        typer.echo(to_json(_content(modes, physical, every, unit)))
        return
    shown = _states(modes, physical, every)
    if shown:
        stdout.print(_table(shown, unit, "Assembly modes" if every else "The physical configuration"))
    for line in _remarks(modes, physical, unit):
        stdout.print(escape(line), highlight=False)


def _states(modes: SolutionSet, physical: Configuration, every: bool) -> list[tuple[str, Configuration, bool]]:
    """Return label, configuration and whether it is the physical one."""
    if not every:
        return [(modes.labels[0], physical, True)] if physical.exists else []
    real = np.flatnonzero(modes.exists)
    return [(modes.labels[k], modes.configurations[k], bool(k == 0 and physical.exists)) for k in real]


def _angles(state: Configuration) -> list[float]:
    return [float(angle) for angle in state.pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)]


def _table(states: list[tuple[str, Configuration, bool]], unit: LengthUnit, title: str) -> Table:
    table = new_table(f"{title}: o in {unit}, X-Y-X in degrees")
    table.add_column("mode", style="bold")
    for heading in ("X", "Y", "Z", "alpha", "beta", "lambda"):
        table.add_column(heading, justify="right")
    table.add_column("")
    # One digit more where there is room for it in 80 columns.
    finer = len(states) == 1
    for label, state, physical in states:
        position = [f"{x * unit.per_metre:.{_DIGITS[unit] + finer}f}" for x in state.translation]
        angles = [f"{angle:.{3 + finer}f}" for angle in _angles(state)]
        table.add_row(label, *position, *angles, "physical" if physical else "")
    return table


def _remarks(modes: SolutionSet, physical: Configuration, unit: LengthUnit) -> list[str]:
    remarks = [f"status: {modes.status}, {modes.count} of 256 assembly modes real"]
    if modes.count:
        remarks[0] += f", closure residual up to {np.nanmax(modes.residual):.0e} m"
    if modes.status is Status.DEGENERATE and modes.degeneracy is not None:
        families = [f for f, hit in zip(("TT", "TF", "FT", "FF"), modes.degeneracy.families, strict=True) if hit]
        remarks.append(
            f"With these legs locked the platform can still move: the solutions of {', '.join(families)} form a "
            f"continuous family of dimension {int(modes.degeneracy.dimension)}, of which none is picked."
        )
    if modes.status is Status.UNREACHABLE:
        remarks.append("A stage cannot be closed with these leg lengths.")
        if unit is LengthUnit.M:
            remarks.append("They were read in metres; see --unit.")
    elif not physical.exists:
        remarks.append("No mode is reached from the symmetric home without a forward singularity.")
    return remarks


def _content(modes: SolutionSet, physical: Configuration, every: bool, unit: LengthUnit) -> dict[str, Any]:
    degeneracy = modes.degeneracy
    assert degeneracy is not None
    return {
        "unit": str(unit),
        "status": str(modes.status),
        "count": int(modes.count),
        "degeneracy": {"dimension": int(degeneracy.dimension), "families": degeneracy.families.tolist()},
        "modes": [
            {
                "label": label,
                "translation": (state.translation * unit.per_metre).tolist(),
                "xyx": _angles(state),
                "rotation": state.rotation.tolist(),
                "middle_joints": (state.middle_joints * unit.per_metre).tolist(),
                "physical": is_physical,
                "residual": float(state.closure_residual) * unit.per_metre,
            }
            for label, state, is_physical in _states(modes, physical, every)
        ],
    }
