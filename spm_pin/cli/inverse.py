"""`spm-pin inverse`: all branches of one pose."""

from __future__ import annotations

from typing import Any

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.mechanism import LEGS, SolutionSet


@outputs.name_options()
def inverse(
    translation: options.Translation,
    xyx: options.Xyx,
    unit: options.Unit = LengthUnit.M,
    geometry: options.AnyGeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Find every configuration that holds the platform in a pose.

    Example, the paper's: spm-pin inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm
    """
    solutions, remarks = options.solve_pose(geometry, translation, xyx, unit)
    if json:
        outputs.write_json(_content(solutions, unit))
    else:
        if solutions.count:
            _print_branches(solutions, unit)
        outputs.print_lines(_remarks(solutions, remarks))
    raise typer.Exit(options.exit_code(solutions))


def _print_branches(solutions: SolutionSet, unit: LengthUnit) -> None:
    limits = solutions.geometry.limits
    rows = []
    for k in np.flatnonzero(solutions.exists):
        lengths = solutions.leg_lengths[k]
        beyond = np.zeros(6, bool) if limits is None else (lengths < limits.minimum) | (lengths > limits.maximum)
        texts = [unit.text(x) + ("*" if far else " ") for x, far in zip(lengths, beyond, strict=True)]
        rows.append([solutions.labels[k], *texts, "physical" if solutions.is_physical[k] else ""])
    # The space stands for the mark of a leg beyond its limits.
    headings = ["branch", *(f"{leg} " for leg in LEGS), ""]
    outputs.print_table(f"Real branches: leg lengths in {unit}", headings, rows, left=[""])


def _remarks(solutions: SolutionSet, on_the_pose: list[str]) -> list[str]:
    remarks = [options.status_line(solutions, "branches")]
    if not np.array_equal(solutions.within().exists, solutions.exists):
        remarks.append("* beyond the limits of this leg")
    remarks += on_the_pose
    if solutions.ambiguous:
        remarks.append(
            "Two branches are physical, on either side of an inverse singularity; the straighter is likelier."
        )
    return remarks


def _content(solutions: SolutionSet, unit: LengthUnit) -> dict[str, Any]:
    inside, physical = solutions.within().exists, solutions.is_physical
    degeneracy = solutions.degeneracy
    return {
        "unit": unit,
        "status": str(solutions.status),
        "degeneracy": degeneracy and {name: getattr(degeneracy, name) for name in ("dimension", "families", "legs")},
        "discriminants": solutions.discriminants,
        "branches": [
            {
                "label": solutions.labels[k],
                "leg_lengths": solutions.leg_lengths[k] * unit.per_metre,
                "middle_joints": solutions.middle_joints[k] * unit.per_metre,
                "within_limits": inside[k],
                "physical": physical[k],
                "residual": solutions.residual[k] * unit.per_metre,
            }
            for k in np.flatnonzero(solutions.exists)
        ],
    }
