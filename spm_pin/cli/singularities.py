"""`spm-pin singularities`: how near each branch of a pose is to a singularity, and to which."""

from __future__ import annotations

from typing import Any

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
from spm_pin.closed_form.singularity_analysis import SingularityKind
from spm_pin.closed_form.singularity_analysis import singularities as describe
from spm_pin.mechanism import Configuration

__all__ = ["singularities"]

_MATRICES = ("J_b", "J_c", "K")


def singularities(
    translation: Translation,
    xyx: Xyx,
    branch: Branches = None,
    unit: Unit = LengthUnit.M,
    geometry: GeometryFile = None,
    json: AsJson = False,
) -> None:
    """Tell how near each branch of a pose is to a singularity.

    The index is the determinant over d³, the distance the smallest singular value; both are dimensionless and zero at a
    singularity: forward for J_b and J_c, the lower and the upper stage, inverse for K.
    """
    solutions = inverse_displacement(read_geometry(geometry), read_pose(translation, xyx, unit))
    found = {label: _quantities(solutions[label]) for label in chosen(solutions, branch)}
    if json:
        typer.echo(to_json({"status": str(solutions.status), "branches": found}))
    elif found:
        stdout.print(_table(found))
    else:
        stderr.print(f"status: {solutions.status}, no real branch", highlight=False)


def _quantities(state: Configuration) -> dict[str, Any]:
    one = describe(state)
    return {
        "kind": str(SingularityKind(int(one.kind))),
        "index": dict(zip(_MATRICES, one.index.tolist(), strict=True)),
        "distance": dict(zip(_MATRICES, one.sigma.tolist(), strict=True)),
        "condition": {
            name: x if np.isfinite(x) else None for name, x in zip(_MATRICES, one.condition.tolist(), strict=True)
        },
        "mobility": int(one.mobility),
        "lost_wrench": one.lost_wrench.tolist(),
        "gained_twist": one.gained_twist.tolist(),
    }


def _table(found: dict[str, dict[str, Any]]) -> Table:
    table = new_table("Determinant over d³ and smallest singular value: J_b, J_c (forward), K (inverse)")
    table.add_column("branch", style="bold")
    for name in ("det", "σ"):
        for matrix in _MATRICES:
            table.add_column(f"{name} {matrix}", justify="right")
    table.add_column("kind")
    for label, one in found.items():
        numbers = [one[name][matrix] for name in ("index", "distance") for matrix in _MATRICES]
        table.add_row(label, *(f"{x:.4f}" for x in numbers), "" if one["kind"] == "regular" else one["kind"])
    return table
