"""`spm-pin inverse`, `nearest`, `forward`, `singularities` and `statics`: states of one pose or of readings.

Each makes one record per state, which is the JSON content, and a table of columns of these records.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Annotated, Any

import numpy as np
from typer import Option

from spm_pin.cli import outputs, requests
from spm_pin.cli.options import OF_MANIPULATOR, Branches, Legs, Readings
from spm_pin.cli.outputs import Report, Table
from spm_pin.cli.requests import Record, Request, Triple
from spm_pin.cli.units import MachineInUnits
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, SingularConfigurationError, sentence
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.kinematics.rates_and_forces import leg_forces, leg_rates
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.kinematics.singularity_analysis import singularities as analyse
from spm_pin.kinematics.singularity_kinds import SingularityKind
from spm_pin.machine import Status

_ZERO = (0.0, 0.0, 0.0)
_ORIENTATIONS = {
    "xyx": ("X-Y-X in degrees", ("alpha", "beta", "lambda"), 3),
    "rpy": ("roll, pitch, yaw in degrees", ("roll", "pitch", "yaw"), 3),
    "quat": ("unit quaternion", ("qx", "qy", "qz", "qw"), 6),
}
"""Orientations that `forward` prints: meaning, columns, and decimals."""
_PLURALS = {"branch": "branches", "mode": "modes", "assembly mode": "assembly modes"}


def inverse(pose: Request, typed: MachineInUnits) -> Report:
    """Find every configuration with a given pose of the platform; for a stage, with a tilt and a height.

    The paper's Example: spm-pin inverse --translation 68.89 49.63 225.3 --xyx -11.08 32.97 -12.88 --unit cm

    Example: spm-pin stage inverse --base 80 --platform 90 --crank 50 --rod 110 --unit mm --height 120 --roll 8

    If no physical configuration is within the limits, the nearest pose that is reached is printed. The exit code is 3
    if there is no real configuration, 5 if none is physical and within the leg limits.
    """
    solutions, is_stage = pose.solve(), typed.machine.is_stage
    records = _records(solutions, requests.selected_labels(solutions, None), lambda state: _record(state, typed))
    lines, code = _summary(solutions, records, typed, pose.solution, pose.remarks(solutions))
    reached = pose.nearest() if code in (3, 5) else None
    content = {} if is_stage else {"discriminants": solutions.discriminants}
    content |= {**_content(solutions, typed), "branches": records, "nearest": _nearest_record(reached, pose)}
    columns = {pose.solution: itemgetter("label"), **typed.columns(), **(_parasitic(typed) if is_stage else {})}
    columns[""] = lambda row: "physical" * row["physical"]
    title = f"Real branches: readings in {typed.heading}"
    if is_stage and records:
        height, tilt, azimuth = (records[0][name] for name in ("height", "tilt", "azimuth"))
        tilted = f"for a tilt of {fixed(tilt, 2)}° towards {fixed(azimuth, 2)}°, and its parasitic motion"
        title = f"Readings in {typed.heading} at {typed.unit.text(height)} {typed.unit} {tilted}"
    return Report(content, [Table(title, columns, records, left=[""]), *lines, *_nearest_lines(reached, pose)], code)


def nearest(pose: Request, typed: MachineInUnits) -> Report:
    """Find the reachable pose nearest to a given one, within the leg limits and in the physical mode.

    Example: spm-pin nearest --translation 0.1 0 2.4 --rpy 5 0 0

    Example: spm-pin stage nearest --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --tilt 40

    The distance is the root mean square displacement of the platform's three joints c_1, c_2, c_3: zero where the pose
    itself can be reached. For a stage it is the angle between the normals, in degrees; a height that the stage does not
    reach is first replaced by the nearest one.
    """
    reached = pose.nearest()
    record = _nearest_record(reached, pose)
    if reached is None or record is None:
        cause = "Its file has them as leg_limits"
        raise ArgumentError("--machine", "a machine with leg limits", "a machine without limits", cause)
    columns = typed.columns()
    lines = [f"distance: {pose.distance_text(reached[1])}", f"pose: {record['options']}", pose.hint()]
    table = Table(f"Readings in {typed.heading}", columns, [record | {"beyond_limits": []}])
    return Report({**typed.content(), **record}, [table, *filter(None, lines)])


def _nearest_record(reached: tuple[Any, float] | None, pose: Request) -> Record | None:
    if reached is None:
        return None
    (state, distance), typed = reached, pose.typed
    scaled = np.degrees(distance) if typed.machine.is_stage else distance * typed.unit.per_metre
    return {**_record(state, typed), "distance": scaled, "options": pose.options_of(state, typed)}


def _nearest_lines(reached: tuple[Any, float] | None, pose: Request) -> list[str]:
    """Return lines on the nearest pose, if any, with the options to enter it."""
    if reached is None:
        return []
    what = "tilt that is reached" if pose.typed.machine.is_stage else "pose within the limits"
    away = f"The nearest {what} is {pose.distance_text(reached[1])} away:"
    return [away, f"  {pose.options_of(reached[0], pose.typed)}"]


def _record(state: Any, typed: MachineInUnits) -> Record:
    """Return the numbers of a state: its pose, readings and residual."""
    residual = {"residual": state.closure_residual * typed.unit.per_metre}
    return {
        "readings": state.readings * typed.scale,
        **requests.request_of(typed.machine).content(state, typed),
        **residual,
    }


def _parasitic(typed: MachineInUnits) -> Record:
    shifts = {
        f"shift {axis} [{typed.unit}]": lambda row, k=k: typed.unit.text(row["shift"][k]) for k, axis in enumerate("xy")
    }
    return {**shifts, "torsion [°]": lambda row: fixed(row["torsion"], 3)}


def forward(
    legs: Annotated[Legs, "Readings of the legs", "--legs", "--readings"],
    typed: MachineInUnits,
    every: Annotated[bool, Option("--all", help="Show every assembly mode, not only the physical one.")] = False,
    xyx: Annotated[bool, Option("--xyx", help="Print X-Y-X angles in degrees (default)."), OF_MANIPULATOR] = False,
    rpy: Annotated[bool, Option("--rpy", help="Print roll, pitch, yaw in degrees."), OF_MANIPULATOR] = False,
    quat: Annotated[bool, Option("--quat", help="Print the quaternion, scalar last."), OF_MANIPULATOR] = False,
) -> Report:
    """Find the pose of the platform from the readings of the legs, lengths or angles.

    The paper's Example: spm-pin forward --legs 120 120 140 125 120 150 --unit cm

    Example: spm-pin stage forward --base 80 --platform 90 --crank 50 --rod 110 --unit mm --legs 20 33 6

    The exit code is 3 if the legs cannot be assembled, 5 if there is no physical configuration within the limits.
    """
    chosen = [name for name, wanted in (("xyx", xyx), ("rpy", rpy), ("quat", quat)) if wanted] or ["xyx"]
    if len(chosen) > 1:
        several = " and ".join(f"--{name}" for name in chosen)
        raise ArgumentError(several, "one orientation", f"{len(chosen)} orientations")
    machine: Any = typed.machine
    physical, modes = forward_physical(machine, legs), forward_displacement(machine, legs)
    home = modes.labels[int(modes.is_physical.argmax())] if physical.exists else ""
    labels = requests.selected_labels(modes, None) if every else [home] * bool(home)
    records = _records(modes, labels, lambda state: _record(state, typed))
    if not every and records:
        # By another way to the same configuration, with as many digits as a pose has.
        records[0] |= _record(physical, typed)
    # One digit more where there is room for it in 80 columns.
    finer = int(len(records) == 1)
    columns: Record = {"mode": itemgetter("label")}
    if machine.is_stage:
        angles = {f"{x} [°]": lambda row, x=x: fixed(row[x], 3) for x in ("tilt", "azimuth", "roll", "pitch")}
        columns |= {**angles, f"height [{typed.unit}]": lambda row: typed.unit.text(row["height"]), **_parasitic(typed)}
        read = ", ".join(typed.text(x, leg) for leg, x in enumerate(legs * typed.scale))
        title = f"Tilt and height of the platform at {read} {typed.heading}"
    else:
        (name,) = chosen
        columns |= {x: lambda row, k=k: typed.unit.text(row["translation"][k], finer) for k, x in enumerate("XYZ")}
        orientation, headings, decimals = _ORIENTATIONS[name]
        columns |= {x: lambda row, k=k: fixed(row[name][k], decimals + finer) for k, x in enumerate(headings)}
        title = f"{'Assembly modes' if every else 'The physical configuration'}: o in {typed.unit}, {orientation}"
    columns[""] = _mark
    remarks = []
    if modes.status is Status.DEGENERATE:
        remarks = ["With these legs locked the platform can still move.", *requests.family_remarks(modes)]
    elif modes.status is Status.UNREACHABLE:
        remarks = [requests.readings_remark(typed, legs)]
    elif not records:
        remarks = [f"{sentence(physical.missing_reason)}. Assembly modes that are real are shown by --all."]
    lines, code = _summary(modes, records, typed, "assembly mode", remarks)
    content = _content(modes, typed) | {"count": modes.count, "modes": records}
    return Report(content, [Table(title, columns, records, left=[""]), *lines], code)


def singularities(
    typed: MachineInUnits, pose: Request | None = None, legs: Readings = None, branch: Branches = None
) -> Report:
    """Compute how close each branch of a pose, or the state of given readings, is to a singularity.

    Determinants and distances, the smallest singular values, are dimensionless and zero at a singularity, whose kind is
    named: forward for J_b and J_c, the lower and the upper stage, inverse for K. For a stage they are those of the
    forward and of the inverse problem; κ is the least slope of a leg over its largest.

    The exit code is 5 if no physical branch is within the leg limits.
    """

    def table(records: list[Record]) -> list[Table]:
        numbers = {
            f"{symbol} {key}": lambda row, name=name, key=key: outputs.significant(row[name][key], 1.0, 4)
            for symbol, name in (("det", "scaled_determinants"), ("σ", "distance"), ("κ", "slope"))
            for key in records[0].get(name, {})
        }
        columns: dict[str, Any] = {"branch": itemgetter("label"), **numbers, "": _kind_and_mark}
        title = "Determinant over d³ and smallest singular value: J_b, J_c (forward), K (inverse)"
        if typed.machine.is_stage:
            title = "Determinants, smallest singular values and least slope of a leg"
        return [Table(title, columns, records, left=[""])]

    return _of_branches(typed, pose, legs, branch, _singularity, table)


def _singularity(state: Any) -> Record:
    analysis: Any = analyse(state)
    record: Record = {"kind": str(SingularityKind(int(analysis.kind))), "gained_twist": analysis.gained_twist}
    is_stage = state.machine.is_stage
    sizes = {"scaled_determinants": determinants(state) if is_stage else analysis.scaled_determinants}
    sizes |= {"distance": analysis.sigma} | ({} if is_stage else {"condition": analysis.condition})
    matrices = ("forward", "inverse") if is_stage else ("J_b", "J_c", "K")
    record |= {name: dict(zip(matrices, x.tolist(), strict=True)) for name, x in sizes.items()}
    if is_stage:
        return record | {"slope": {"leg": float(analysis.leg.min())}}
    return record | {name: getattr(analysis, name) for name in ("mobility", "lost_wrench")}


def _kind_and_mark(record: Record) -> str:
    return ", ".join(filter(None, [record["kind"].replace("regular", ""), _mark(record)]))


def _vector(help_text: str) -> Any:
    return Option(metavar="X Y Z", help=help_text)


def statics(
    typed: MachineInUnits,
    pose: Request | None = None,
    legs: Readings = None,
    force: Annotated[Triple, _vector("Force onto m at o, in {B}, in newtons.")] = _ZERO,
    moment: Annotated[Triple, _vector("Moment onto m, in {B}, in newton metres.")] = _ZERO,
    velocity: Annotated[Triple, _vector("Velocity of o in {B}, in --unit per second; for a stage along Z.")] = _ZERO,
    angular_velocity: Annotated[Triple, _vector("Turning of m in {B}, in degrees/s; for a stage about X, Y.")] = _ZERO,
    branch: Branches = None,
) -> Report:
    """Compute the efforts of the actuators that balance a wrench on the platform, and the leg rates for its twist.

    Example: spm-pin statics --legs 1.2 1.2 1.4 1.25 1.2 1.5 --force 0 0 -500

    Example: spm-pin stage statics --base 80 --platform 90 --crank 50 --rod 110 --unit mm --tilt 10 --force 0 0 -5

    Efforts are forces in N, or for cranks torques in N m; a positive one increases the reading: a cylinder pushes. At
    an inverse singularity the efforts exist, but the rates do not.

    The exit code is 5 if no physical branch is within the leg limits.
    """
    wrench = np.array([*force, *moment])
    twist = np.concatenate([np.array(velocity) / typed.unit.per_metre, np.deg2rad(angular_velocity)])
    if not (wrench.any() or twist.any()):
        raise ArgumentError("--force", "a wrench or a twist that is not zero", "none")
    if typed.machine.is_stage:
        if twist[[0, 1, 5]].any():
            expected = "a velocity along Z and turns about X and Y: those of a stage"
            raise ArgumentError("--velocity, --angular-velocity", expected, "others", "Shift and torsion follow")
        twist = twist[2:5]

    def loads(state: Any) -> Record:
        record: Record = {"forces": None, "rates": None, "singular": []}
        for name, solve, vector in (("forces", leg_forces, wrench), ("rates", leg_rates, twist)):
            try:
                record[name] = solve(state, vector) * (1.0 if name == "forces" else typed.scale)
            except SingularConfigurationError as error:
                record["singular"].append(error.kind)
        return record

    def tables(records: list[Record]) -> list[Table]:
        efforts = f"Efforts in {typed.stages('N', 'N m')}: positive increases the reading"
        rates = f"Rates of the readings per second, in {typed.heading}"
        shown = {"forces": efforts} if wrench.any() else {}
        shown |= {"rates": rates} if twist.any() else {}
        return [_load_table(title, typed.names, records, name) for name, title in shown.items()]

    return _of_branches(typed, pose, legs, branch, loads, tables)


def _load_table(title: str, names: tuple[str, ...], records: list[Record], quantity: str) -> Table:
    def branch(record: Record) -> str:
        label = str(record["label"])
        return label if record[quantity] is not None else f"{label}: {record['singular'][0]} singularity"

    def value(leg: int, values: Any) -> str:
        return "" if values is None else outputs.significant(values[leg], np.abs(values).max())

    columns = {name: lambda row, leg=leg: value(leg, row[quantity]) for leg, name in enumerate(names)}
    return Table(title, {"branch": branch, **columns, "": _mark}, records, left=[""])


def _of_branches(
    typed: MachineInUnits,
    pose: Request | None,
    legs: Any,
    branch: list[str] | None,
    compute: Callable[[Any], Record],
    tables: Callable[[list[Record]], list[Table]],
) -> Report:
    """Return a report of each branch of a pose, or of the state of readings; out of reach, of the nearest pose."""
    solutions, remarks = requests.solve_request(typed, pose, legs)
    records = _records(solutions, requests.selected_labels(solutions, branch), compute)
    lines, code = _summary(solutions, records, typed, "branch", remarks)
    if pose is not None and code in (3, 5):
        lines += _nearest_lines(pose.nearest(), pose)
    content = _content(solutions, typed) | {"branches": {record["label"]: record for record in records}}
    return Report(content, [*(tables(records) if records else []), *lines], code)


def _records(solutions: Any, labels: list[str], compute: Callable[[Any], Record]) -> list[Record]:
    """Return a record of each solution: its label, marks, and what `compute` returns for its state."""
    records, is_physical = [], solutions.is_physical
    for label in labels:
        state = solutions[label]
        beyond = np.flatnonzero(state.limit_excess)
        marks = {"physical": bool(is_physical[solutions.labels.index(label)]), "within_limits": not beyond.size}
        records.append({"label": label, **marks, "beyond_limits": beyond, **compute(state)})
    return records


def _mark(record: Record) -> str:
    """Return the mark of a state in a table: a star for a leg beyond its limits."""
    return "physical" * bool(record["physical"]) + "*" * (not record["within_limits"])


def _content(solutions: Any, typed: MachineInUnits) -> Record:
    """Return the JSON content common to all solutions: their units, the status, and any continuous family."""
    degeneracy = solutions.degeneracy
    family = degeneracy and {name: getattr(degeneracy, name) for name in ("dimension", "families", "legs")}
    return {**typed.content(), "status": str(solutions.status), "degeneracy": family}


def _summary(
    solutions: Any, records: list[Record], typed: MachineInUnits, what: str, remarks: list[str]
) -> tuple[list[str], int]:
    """Return lines on solutions, called `what`, and on the marks of those shown, and the exit code.

    The code is 3 if the request is unreachable, 4 if degenerate, 5 if there is no physical solution within the limits.
    """
    line = f"status: {solutions.status}"
    if len(solutions.labels) > 1:
        line += f", {solutions.count} of {len(solutions.labels)} {_PLURALS[what]} real"
    if solutions.count:
        residual = np.nanmax(solutions.configurations.closure_residual) * typed.unit.per_metre
        line += f", closure residual up to {residual:.0e} {typed.unit}"
    lines, physical = [line, *remarks], solutions.physical()
    beyond = [", ".join(typed.names[leg] for leg in record["beyond_limits"]) for record in records]
    if any(beyond):
        own = [legs for legs, record in zip(beyond, records, strict=True) if record["physical"] and len(beyond) > 1]
        of_physical = "".join(f"; of the physical {what}: {legs or 'none'}" for legs in own)
        lines.append(f"* {beyond[0] if len(beyond) == 1 else 'a leg'} beyond the limits{of_physical}")
    if records and not physical.exists:
        home = "level platform" if typed.machine.is_stage else "home"
        lines.append(f"No {what} is physical: none is reached from the {home} without a forward singularity.")
    is_held = bool(physical.exists) and not physical.limit_excess.any()
    codes = {Status.OK: 0 if is_held else 5, Status.UNREACHABLE: 3, Status.DEGENERATE: 4}
    return lines, codes[Status(int(solutions.status))]
