"""`spm-pin singularities`: how near each branch of a pose is to a singularity, and to which."""

from __future__ import annotations

from typing import Any

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit
from spm_pin.kinematics.singularity_analysis import SingularityKind
from spm_pin.kinematics.singularity_analysis import singularities as analyse
from spm_pin.mechanism import Configuration

_MATRICES = ("J_b", "J_c", "K")


@outputs.name_options()
def singularities(
    translation: options.Translation,
    xyx: options.Xyx,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.AnyGeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Compute how near each branch of a pose is to a singularity.

    Determinants are divided by d³, the distance is the smallest singular value; both are dimensionless and zero at a
    singularity: forward for J_b and J_c, the lower and the upper stage, inverse for K.
    """
    solutions, remarks = options.solve_pose(geometry, translation, xyx, unit)
    found = {label: _quantities(solutions[label]) for label in options.selected_labels(solutions, branch)}
    if json:
        outputs.write_json({"status": str(solutions.status), "branches": found})
    elif found:
        _print_quantities(found)
    options.end_command(solutions, remarks)


def _quantities(state: Configuration) -> dict[str, Any]:
    analysis = analyse(state)
    return {
        "kind": str(SingularityKind(int(analysis.kind))),
        "scaled_determinants": dict(zip(_MATRICES, analysis.scaled_determinants.tolist(), strict=True)),
        "distance": dict(zip(_MATRICES, analysis.sigma.tolist(), strict=True)),
        "condition": dict(zip(_MATRICES, analysis.condition.tolist(), strict=True)),
        "mobility": analysis.mobility,
        "lost_wrench": analysis.lost_wrench,
        "gained_twist": analysis.gained_twist,
    }


def _print_quantities(found: dict[str, dict[str, Any]]) -> None:
    rows = []
    for label, quantities in found.items():
        numbers = [quantities[name][matrix] for name in ("scaled_determinants", "distance") for matrix in _MATRICES]
        rows.append([label, *(outputs.significant(x, 1.0, 4) for x in numbers), quantities["kind"]])
    headings = ["branch", *(f"{name} {matrix}" for name in ("det", "σ") for matrix in _MATRICES), "kind"]
    title = "Determinant over d³ and smallest singular value: J_b, J_c (forward), K (inverse)"
    outputs.print_table(title, headings, rows, left=["kind"])
