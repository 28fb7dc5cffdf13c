"""`spm-pin inverse`, `singularities` and `statics`: the branches of one pose, their singularities and leg forces.

Each builds one record per branch, which is the JSON, and prints a table of columns of these records.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, Triple
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.rates_and_forces import leg_forces, leg_rates
from spm_pin.kinematics.singularity_analysis import SingularityKind
from spm_pin.kinematics.singularity_analysis import singularities as analyse
from spm_pin.mechanism import LEGS, Configuration, SolutionSet

Record = dict[str, Any]
_MATRICES = ("J_b", "J_c", "K")
_ZERO = (0.0, 0.0, 0.0)


@outputs.name_options()
def inverse(
    translation: options.Translation,
    xyx: options.Xyx,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Find every configuration that holds the platform in a pose.

    Example, the paper's: spm-pin inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm
    """
    solutions, remarks = options.solve_pose(geometry, translation, xyx, unit)
    branches = [_branch(solutions, k, unit) for k in np.flatnonzero(solutions.exists).tolist()]
    if json:
        content = options.status_content(solutions, unit)
        outputs.write_json(content | {"discriminants": solutions.discriminants, "branches": branches})
        raise typer.Exit(options.exit_code(solutions))

    def length(leg: int, record: Record) -> str:
        # The space stands for the mark of a leg beyond its limits.
        return unit.text(record["readings"][leg] / unit.per_metre) + " *"[leg in record["beyond_limits"]]

    if branches:
        legs = {f"{name} ": lambda record, leg=leg: length(leg, record) for leg, name in enumerate(LEGS)}
        physical = {"": lambda record: "physical" if record["physical"] else ""}
        columns = {"branch": lambda record: record["label"], **legs, **physical}
        title = f"Real branches: leg lengths in {unit}, as the encoders show them"
        outputs.print_table(title, columns, branches, left=[""])
    lines = [options.status_line(solutions, "branches")]
    if not all(record["within_limits"] for record in branches):
        lines.append("* beyond the limits of this leg")
    lines += remarks
    if solutions.ambiguous:
        lines.append("Two branches are physical, on either side of an inverse singularity; the straighter is likelier.")
    outputs.print_lines(lines)
    raise typer.Exit(options.exit_code(solutions))


def _branch(solutions: SolutionSet, k: int, unit: LengthUnit) -> Record:
    state, limits = solutions[k], solutions.geometry.limits
    readings = state.readings
    beyond = np.zeros(6, bool) if limits is None else (readings < limits.minimum) | (readings > limits.maximum)
    return {
        "label": solutions.labels[k],
        "leg_lengths": state.leg_lengths * unit.per_metre,
        "readings": readings * unit.per_metre,
        "middle_joints": state.middle_joints * unit.per_metre,
        "within_limits": not beyond.any(),
        "beyond_limits": np.flatnonzero(beyond),
        "physical": bool(solutions.is_physical[k]),
        "residual": solutions.residual[k] * unit.per_metre,
    }


@outputs.name_options()
def singularities(
    translation: options.Translation,
    xyx: options.Xyx,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
    json: options.AsJson = False,
) -> None:
    """Compute how near each branch of a pose is to a singularity.

    Determinants are divided by d³, the distance is the smallest singular value; both are dimensionless and zero at a
    singularity: forward for J_b and J_c, the lower and the upper stage, inverse for K.
    """
    solutions, remarks = options.solve_pose(geometry, translation, xyx, unit)
    branches = {label: _singularity(solutions[label]) for label in options.selected_labels(solutions, branch)}
    if json:
        outputs.write_json({"status": str(solutions.status), "branches": branches})
    elif branches:
        numbers = {
            f"{symbol} {key}": lambda row, name=name, key=key: outputs.significant(row[1][name][key], 1.0, 4)
            for symbol, name in (("det", "scaled_determinants"), ("σ", "distance"))
            for key in _MATRICES
        }
        columns = {"branch": lambda row: row[0], **numbers, "kind": lambda row: row[1]["kind"]}
        title = "Determinant over d³ and smallest singular value: J_b, J_c (forward), K (inverse)"
        outputs.print_table(title, columns, branches.items(), left=["kind"])
    options.end_command(solutions, remarks)


def _singularity(state: Configuration) -> Record:
    analysis = analyse(state)
    values = {"scaled_determinants": analysis.scaled_determinants, "distance": analysis.sigma}
    values["condition"] = analysis.condition
    return {
        "kind": str(SingularityKind(int(analysis.kind))),
        **{name: dict(zip(_MATRICES, array.tolist(), strict=True)) for name, array in values.items()},
        **{name: getattr(analysis, name) for name in ("mobility", "lost_wrench", "gained_twist")},
    }


def _vector(help_text: str) -> Any:
    return typer.Option(metavar="X Y Z", help=help_text)


@outputs.name_options(wrench="--force, --moment", twist="--velocity, --angular-velocity")
def statics(
    translation: options.Translation,
    xyx: options.Xyx,
    force: Annotated[Triple, _vector("Force onto m at o, in {B}, in newtons.")] = _ZERO,
    moment: Annotated[Triple, _vector("Moment onto m, in {B}, in newton metres.")] = _ZERO,
    velocity: Annotated[Triple, _vector("Velocity of o in {B}, in --unit per second.")] = _ZERO,
    angular_velocity: Annotated[Triple, _vector("Angular velocity of m in {B}, in degrees per second.")] = _ZERO,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    geometry: options.GeometryFile = None,
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
    branches = {label: _leg_loads(solutions[label], wrench, twist, unit) for label in labels}
    if json:
        outputs.write_json({"unit": unit, "status": str(solutions.status), "branches": branches})
    elif branches and wrench.any():
        _print_loads("Leg forces in N: positive extends the leg", branches, "forces")
    if not json and branches and twist.any():
        _print_loads(f"Leg rates in {unit}/s", branches, "rates")
    options.end_command(solutions, remarks)


def _leg_loads(state: Configuration, wrench: np.ndarray, twist: np.ndarray, unit: LengthUnit) -> Record:
    record: Record = {"forces": None, "rates": None, "singular": []}
    for name, solve, vector in (("forces", leg_forces, wrench), ("rates", leg_rates, twist)):
        try:
            record[name] = solve(state, vector) * (1.0 if name == "forces" else unit.per_metre)
        except SingularConfigurationError as error:
            record["singular"].append(error.kind)
    return record


def _print_loads(title: str, branches: dict[str, Record], name: str) -> None:
    def first(row: tuple[str, Record]) -> str:
        label, record = row
        return label if record[name] is not None else f"{label}: {record['singular'][0]} singularity"

    def value(leg: int, values: np.ndarray | None) -> str:
        return "" if values is None else outputs.significant(values[leg], np.abs(values).max())

    legs = {text: lambda row, leg=leg: value(leg, row[1][name]) for leg, text in enumerate(LEGS)}
    outputs.print_table(title, {"branch": first, **legs}, branches.items())
