"""`spm-pin inverse`, `nearest`, `forward`, `singularities` and `statics`: states of one pose or of six readings.

Each makes one record per state, which is the JSON content, and prints a table of columns of these records.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Annotated, Any, NoReturn

import numpy as np
import typer
from scipy.spatial.transform import RigidTransform

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, Readings, SixLegs, Triple, leg_option
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_physical
from spm_pin.kinematics.rates_and_forces import leg_forces, leg_rates
from spm_pin.kinematics.singularity_analysis import singularities as analyse
from spm_pin.kinematics.singularity_kinds import SingularityKind
from spm_pin.machine import LEGS, Configuration, LegLimits, Manipulator, SolutionSet, Status

Record = dict[str, Any]
_MATRICES = ("J_b", "J_c", "K")
_ZERO = (0.0, 0.0, 0.0)
_ORIENTATIONS = {
    "xyx": ("X-Y-X in degrees", ("alpha", "beta", "lambda"), 3),
    "rpy": ("roll, pitch, yaw in degrees", ("roll", "pitch", "yaw"), 3),
    "quat": ("unit quaternion", ("qx", "qy", "qz", "qw"), 6),
}
"""Orientations that `forward` prints: meaning, columns, and decimals."""


@outputs.name_options()
@options.takes_pose()
def inverse(
    pose: RigidTransform,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Find every configuration with a given pose of the platform.

    The paper's example: spm-pin inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm

    The exit code is 5 if no physical branch is within the leg limits.
    """
    solutions, remarks = options.solve_pose(options.read_machine(machine_file), pose, unit)
    shown = Readings(solutions.machine, unit)
    branches = _records(solutions, None, lambda state: _lengths(state, shown))
    physical = solutions.physical()
    code = options.exit_code(solutions.status, physical)
    reach = _nearest(solutions.machine, pose, unit) if code in (3, 5) else None
    if json:
        content = options.status_content(solutions, unit)
        outputs.write_json(content | {"discriminants": solutions.discriminants, "branches": branches, "nearest": reach})
        raise typer.Exit(code)
    columns: dict[str, Any] = {"branch": itemgetter("label"), **shown.columns()}
    columns[""] = lambda row: "physical" * row["physical"]
    outputs.print_table(f"Real branches: readings in {shown.heading}", columns, branches, left=[""])
    lines = [options.status_line(solutions, "branches", unit), *remarks]
    lines += options.state_remarks(branches, physical, "branch")
    if solutions.ambiguous:
        lines.append("Two branches are physical, on either side of an inverse singularity; the straighter is likelier.")
    outputs.print_lines(lines + _nearest_lines(reach, unit))
    raise typer.Exit(code)


@outputs.name_options()
@options.takes_pose()
def nearest(
    pose: RigidTransform,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Find the reachable pose nearest to a given one, within the leg limits and in the physical mode.

    Example: spm-pin nearest --translation 0.1 0 2.4 --rpy 5 0 0

    The distance is the root mean square displacement of the platform's three joints c_1, c_2, c_3: zero where the pose
    itself can be reached.
    """
    machine = options.read_machine(machine_file)
    reach = _nearest(machine, pose, unit)
    if reach is None:
        raise ArgumentError("--machine", "a machine with leg limits", "none", "Its file has them as leg_limits")
    if json:
        outputs.write_json({"unit": unit, "reading_units": Readings(machine, unit).units, **reach})
        return
    shown = Readings(machine, unit)
    columns = {name: lambda row, leg=leg: shown.text(row["readings"][leg], leg) for leg, name in enumerate(LEGS)}
    outputs.print_table(f"Readings in {shown.heading}", columns, [reach])
    hint = options.unit_hint("--translation", pose.translation * unit.per_metre, unit, machine)
    found = [f"distance: {unit.text(reach['distance'], 1)} {unit}", f"pose: {_pose_options(reach, unit)}"]
    outputs.print_lines([*found, *filter(None, [hint])])


_INSET = 1e-4
"""Distance of a nearest pose from the leg limits, as a fraction of the strokes."""


def _nearest(machine: Manipulator, pose: RigidTransform | None, unit: LengthUnit) -> Record | None:
    """Return the nearest reachable pose, its readings and its distance; None without leg limits or a pose."""
    if machine.limits is None or pose is None:
        return None
    from spm_pin.workspace.poses import nearest_reachable_pose

    state, distance = inverse_physical(machine, pose), 0.0
    if not state.exists or state.limit_excess.any():
        # Slightly within the limits, so that the pose is reached as it is printed.
        ends = machine.limits.ends
        inset = _INSET * np.where(np.isfinite(ends).all(axis=0), ends[1] - ends[0], machine.size)
        found = nearest_reachable_pose(machine, pose, LegLimits(ends[0] + inset, ends[1] - inset))
        state, distance = found.configuration, found.distance
    lengths: Record = {"translation": state.translation, "distance": distance}
    turn = {
        "rpy": state.pose.rotation.as_euler("xyz", degrees=True, suppress_warnings=True),
        "rotation": state.rotation,
    }
    readings = state.readings * Readings(machine, unit).scale
    return {name: x * unit.per_metre for name, x in lengths.items()} | {"readings": readings, **turn}


def _nearest_lines(reach: Record | None, unit: LengthUnit) -> list[str]:
    """Return lines on the nearest pose, if any, with the options to enter it."""
    if reach is None:
        return []
    distance = f"{unit.text(reach['distance'], 1)} {unit}"
    return [f"The nearest pose within the limits is {distance} away:", f"  {_pose_options(reach, unit)}"]


def _pose_options(reach: Record, unit: LengthUnit) -> str:
    """Return the options to enter a nearest pose, to a tenth of a micrometre and 1e-5 degrees."""
    translation = " ".join(unit.text(x, 2) for x in reach["translation"])
    named = "" if unit is LengthUnit.M else f" --unit {unit}"
    return f"--translation {translation} --rpy {' '.join(fixed(x, 5) for x in reach['rpy'])}{named}"


def _records(
    solutions: SolutionSet, labels: list[str] | None, compute: Callable[[Configuration], Record]
) -> list[Record]:
    """Return the marks of each branch of `--branch`, or of all real ones, and results for its state."""
    records, physical = [], solutions.is_physical
    for label in options.selected_labels(solutions, labels):
        state, is_physical = solutions[label], bool(physical[solutions.labels.index(label)])
        records.append({"label": label, **options.state_content(state, physical=is_physical), **compute(state)})
    return records


def _lengths(state: Configuration, shown: Readings) -> Record:
    lengths = {
        "leg_lengths": state.leg_lengths,
        "middle_joints": state.middle_joints,
        "residual": state.closure_residual,
    }
    scaled: Record = {name: x * shown.unit.per_metre for name, x in lengths.items()}
    return scaled | {"readings": state.readings * shown.scale}


@outputs.name_options(leg_lengths="--legs", readings="--legs")
def forward(
    legs: Annotated[
        SixLegs, leg_option("--legs", "Readings r_b1 to r_b3, r_c1 to r_c3 in --unit, for cranks in degrees.")
    ],
    every: Annotated[bool, typer.Option("--all", help="Show every assembly mode, not only the physical one.")] = False,
    xyx: Annotated[bool, typer.Option("--xyx", help="Print the paper's X-Y-X angles in degrees (default).")] = False,
    rpy: Annotated[bool, typer.Option("--rpy", help="Print roll, pitch and yaw in degrees, as in URDF.")] = False,
    quat: Annotated[bool, typer.Option("--quat", help="Print the unit quaternion, scalar last.")] = False,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Find the pose of the platform from the readings of the legs, lengths or angles.

    The paper's example: spm-pin forward --legs 120 120 140 125 120 150 --unit cm

    The exit code is 5 if a leg is beyond its limits.
    """
    chosen = [name for name, wanted in (("xyx", xyx), ("rpy", rpy), ("quat", quat)) if wanted] or ["xyx"]
    if len(chosen) > 1:
        raise ArgumentError(" and ".join(f"--{name}" for name in chosen), "one orientation", f"{len(chosen)} of them")
    dimensions = options.read_machine(machine_file)
    readings = Readings(dimensions, unit).read("--legs", legs)
    physical = forward_physical(dimensions, readings)
    modes = forward_displacement(dimensions, readings)
    home = modes.labels[int(modes.is_physical.argmax())] if physical.exists else ""
    shown = {home: physical} if home else {}
    if every:
        shown = {modes.labels[k]: modes.configurations[k] for k in np.flatnonzero(modes.exists)}
    states = [
        {
            "label": label,
            "translation": state.translation * unit.per_metre,
            "xyx": state.pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True),
            "rpy": state.pose.rotation.as_euler("xyz", degrees=True, suppress_warnings=True),
            "quat": state.pose.rotation.as_quat(),
            "rotation": state.rotation,
            "middle_joints": state.middle_joints * unit.per_metre,
            **options.state_content(state, physical=label == home),
            "residual": state.closure_residual * unit.per_metre,
        }
        for label, state in shown.items()
    ]
    code = options.exit_code(modes.status, physical)
    if json:
        outputs.write_json(options.status_content(modes, unit) | {"count": modes.count, "modes": states})
        raise typer.Exit(code)
    # One digit more where there is room for it in 80 columns.
    finer = int(len(states) == 1)
    columns: dict[str, Any] = {"mode": itemgetter("label")}
    columns |= {name: lambda mode, k=k: unit.text(mode["translation"][k], finer) for k, name in enumerate("XYZ")}
    (name,) = chosen
    orientation, headings, decimals = _ORIENTATIONS[name]
    columns |= {heading: lambda mode, k=k: fixed(mode[name][k], decimals + finer) for k, heading in enumerate(headings)}
    title = "Assembly modes" if every else "The physical configuration"
    columns[""] = options.state_mark
    outputs.print_table(f"{title}: o in {unit}, {orientation}", columns, states, left=[""])
    remarks = [options.status_line(modes, "assembly modes", unit)]
    if modes.status is Status.DEGENERATE:
        remarks += ["With these legs locked the platform can still move.", *options.pose_remarks(modes)]
    if modes.status is Status.UNREACHABLE:
        remarks += options.legs_remarks(dimensions, legs, unit)
    else:
        remarks += options.state_remarks(states, physical, "mode")
    outputs.print_lines(remarks)
    raise typer.Exit(code)


@outputs.name_options(readings="--legs")
@options.takes_pose(required=False)
def singularities(
    pose: RigidTransform | None = None,
    legs: options.AnyLegs = None,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Compute how close each branch of a pose, or the state of given readings, is to a singularity.

    Determinants are divided by d³, the distance is the smallest singular value; both are dimensionless and zero at a
    singularity, whose kind is named: forward for J_b and J_c, the lower and the upper stage, inverse for K.

    The exit code is 5 if no physical branch is within the leg limits.
    """
    solutions, remarks = options.solve_request(options.read_machine(machine_file), pose, legs, unit)
    branches = _records(solutions, branch, _singularity)
    if json:
        by_label = {record["label"]: record for record in branches}
        outputs.write_json({"status": str(solutions.status), "branches": by_label})
    else:
        numbers = {
            f"{symbol} {key}": lambda row, name=name, key=key: outputs.significant(row[name][key], 1.0, 4)
            for symbol, name in (("det", "scaled_determinants"), ("σ", "distance"))
            for key in _MATRICES
        }
        columns: dict[str, Any] = {"branch": itemgetter("label"), **numbers, "": _mark_and_kind}
        title = "Determinant over d³ and smallest singular value: J_b, J_c (forward), K (inverse)"
        outputs.print_table(title, columns, branches, left=[""])
    _end(solutions, branches, remarks, pose, unit, json)


def _mark_and_kind(record: Record) -> str:
    kind = record["kind"] if record["kind"] != "regular" else ""
    return ", ".join(filter(None, [kind, options.state_mark(record)]))


def _end(
    solutions: SolutionSet,
    branches: list[Record],
    remarks: list[str],
    pose: RigidTransform | None,
    unit: LengthUnit,
    json: bool,
) -> NoReturn:
    """End a command: print remarks and, if the pose of the table is out of reach, the nearest; set the exit code."""
    physical = solutions.physical()
    if not json:
        outputs.print_lines(options.state_remarks(branches, physical, "branch"))
    code = options.exit_code(solutions.status, physical)
    sought = code in (3, 5) and not json
    reach = _nearest_lines(_nearest(solutions.machine, pose, unit) if sought else None, unit)
    if not solutions.count:
        for remark in (f"status: {solutions.status}, no real branch", *remarks, *reach):
            outputs.note(remark)
    else:
        outputs.print_lines(reach)
    raise typer.Exit(code)


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


@outputs.name_options(readings="--legs", wrench="--force, --moment", twist="--velocity, --angular-velocity")
@options.takes_pose(required=False)
def statics(
    pose: RigidTransform | None = None,
    legs: options.AnyLegs = None,
    force: Annotated[Triple, _vector("Force onto m at o, in {B}, in newtons.")] = _ZERO,
    moment: Annotated[Triple, _vector("Moment onto m, in {B}, in newton metres.")] = _ZERO,
    velocity: Annotated[Triple, _vector("Velocity of o in {B}, in --unit per second.")] = _ZERO,
    angular_velocity: Annotated[Triple, _vector("Angular velocity of m in {B}, in degrees per second.")] = _ZERO,
    branch: options.Branches = None,
    unit: options.Unit = LengthUnit.M,
    machine_file: options.MachineFile = None,
    json: options.AsJson = False,
) -> None:
    """Compute the efforts of the actuators that balance a wrench on the platform, and the leg rates for its twist.

    Efforts are forces in N, or for cranks torques in N m; a positive one increases the reading: a cylinder pushes. At
    an inverse singularity the efforts exist, but the rates do not.

    The exit code is 5 if no physical branch is within the leg limits.
    """
    wrench = np.array([*force, *moment])
    twist = np.concatenate([np.array(velocity) / unit.per_metre, np.deg2rad(angular_velocity)])
    if not (json or wrench.any() or twist.any()):
        raise ArgumentError("--force", "a wrench or a twist that is not zero", "neither", "Nothing to hold or move")
    solutions, remarks = options.solve_request(options.read_machine(machine_file), pose, legs, unit)
    shown = Readings(solutions.machine, unit)
    branches = _records(solutions, branch, lambda state: _leg_loads(state, wrench, twist, shown))
    if json:
        by_label = {record["label"]: record for record in branches}
        outputs.write_json(
            {"unit": unit, "reading_units": shown.units, "status": str(solutions.status), "branches": by_label}
        )
    else:
        if wrench.any():
            efforts = shown.stages("N", "N m")
            _print_loads(f"Efforts in {efforts}: positive increases the reading", branches, "forces")
        if twist.any():
            _print_loads(f"Rates of the readings per second, in {shown.heading}", branches, "rates")
    _end(solutions, branches, remarks, pose, unit, json)


def _leg_loads(state: Configuration, wrench: np.ndarray, twist: np.ndarray, shown: Readings) -> Record:
    record: Record = {"forces": None, "rates": None, "singular": []}
    for name, solve, vector in (("forces", leg_forces, wrench), ("rates", leg_rates, twist)):
        try:
            record[name] = solve(state, vector) * (1.0 if name == "forces" else shown.scale)
        except SingularConfigurationError as error:
            record["singular"].append(error.kind)
    return record


def _print_loads(title: str, branches: list[Record], name: str) -> None:
    def branch(record: Record) -> str:
        label = str(record["label"])
        return label if record[name] is not None else f"{label}: {record['singular'][0]} singularity"

    def value(leg: int, values: np.ndarray | None) -> str:
        return "" if values is None else outputs.significant(values[leg], np.abs(values).max())

    legs = {text: lambda row, leg=leg: value(leg, row[name]) for leg, text in enumerate(LEGS)}
    outputs.print_table(title, {"branch": branch, **legs, "": options.state_mark}, branches, left=[""])
