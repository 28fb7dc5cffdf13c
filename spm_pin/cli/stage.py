"""`spm-pin stage`: a stage alone, from a file or measured dimensions: displacements, reach, pictures."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.calibrate import calibrate as calibrate_machine
from spm_pin.cli.calibrate import tolerance as tolerance_of_machine
from spm_pin.cli.draw import Browser, Dark, Host, Port, serve
from spm_pin.cli.move import NAMES, AngleError, Boxes, LengthError, largest_of, move_machine, report_certificate
from spm_pin.cli.options import LengthUnit, Readings, Triple
from spm_pin.cli.stage_options import as_command_of_stage, takes_place, takes_stage
from spm_pin.display import reach_figure, save_figure, stage_figure
from spm_pin.display.writing import FORMATS, fixed
from spm_pin.errors import ArgumentError, require_extra
from spm_pin.kinematics import forward_displacement, forward_physical, inverse_displacement, inverse_physical
from spm_pin.machine import Stage, StageConfiguration, StageSolutions, Status
from spm_pin.machine.stage_configuration import BELOW
from spm_pin.proofs import certify as prove
from spm_pin.workspace import ReachEnd, best_height, height_range, nearest_reachable_pose
from spm_pin.workspace import reach as largest_tilts

Record = dict[str, Any]
_BESIDE = 1e-3 * np.array([0.0, -1.0, 1.0, -2.0, 2.0])
"""Changes of a rounded tilt and azimuth [°] that are tried until a reachable one is found."""
_NOT_PHYSICAL = "No mode there is reached from the level platform without a forward singularity"


@takes_stage()
@takes_place
def inverse(stage: Stage, place: Record, unit: options.Unit = LengthUnit.M, json: options.AsJson = False) -> None:
    """Compute the readings of a stage for a tilt and a height of its platform, in both operation modes.

    Example: spm-pin stage inverse --base 80 --platform 90 --crank 50 --rod 110 --unit mm --height 120 --roll 8

    If the tilt is out of reach, the nearest reachable tilt is printed. The exit code is 3 if neither mode is
    real, 5 if none is physical and within the limits.
    """
    solutions = inverse_displacement(stage, **place)
    physical, nearest = solutions.physical(), None
    code = options.exit_code(solutions.status, physical)
    if code:
        nearest = nearest_reachable_pose(stage, **place).configuration
    records = _records(solutions, unit)
    if json:
        found = None if nearest is None or not nearest.exists else _record("nearest", nearest, unit)
        outputs.write_json({**_units(stage, unit), "status": str(solutions.status), "modes": records, "nearest": found})
        raise typer.Exit(code)
    _print_states(stage, records, unit)
    hint = _height_hint(stage, place, unit)
    lines = _status_lines(solutions.status, solutions.configurations.missing_reason, hint)
    lines += _remarks(records, physical)
    if nearest is not None and nearest.exists:
        lines += ["The nearest tilt that is reached:", f"  {_options_of(nearest, place, unit)}"]
    outputs.print_lines(lines)
    raise typer.Exit(code)


def _options_of(nearest: StageConfiguration, place: Record, unit: LengthUnit) -> str:
    """Return the options to enter a nearest tilt, rounded to a reachable one: of several, one with less tilt."""
    tilt = max(math.floor(1e3 * math.degrees(nearest.tilt) - 0.1) / 1e3, 0.0)
    level = float(nearest.height * unit.per_metre)
    if not math.isclose(nearest.height, place["height"]):
        level += math.copysign(1e-4 * level, nearest.height - place["height"])
    azimuth = math.degrees(nearest.azimuth) if tilt else 0.0
    # If the level platform is beyond the limits, less tilt may be as well.
    tilts, azimuths = np.meshgrid(np.maximum(tilt + _BESIDE, 0.0), azimuth + _BESIDE, indexing="ij")
    places = {"tilt": np.radians(tilts), "azimuth": np.radians(azimuths)}
    states = inverse_physical(nearest.stage, level / unit.per_metre, **places)
    counts = states.exists & (states.limit_excess == 0.0).all(axis=-1)
    first = int(counts.argmax())
    tilt, azimuth = float(tilts.flat[first]), float(azimuths.flat[first])
    text = f"--height {unit.text(level, 1)} --tilt {fixed(tilt, 3)} --azimuth {fixed(azimuth, 5)}"
    return text if unit is LengthUnit.M else f"{text} --unit {unit}"


@takes_stage()
@outputs.name_options()
def forward(
    stage: Stage,
    readings: Annotated[Triple, Option(metavar="R1 R2 R3", help="Readings in --unit, for servos in degrees.")],
    every: Annotated[bool, Option("--all", help="All sixteen assembly modes, not only the physical one.")] = False,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Compute the tilt and the height of a stage's platform from the readings of its legs.

    Example: spm-pin stage forward --base 80 --platform 90 --crank 50 --rod 110 --unit mm --readings 20 33 6
    """
    typed = Readings(stage, unit)
    own = typed.read("--readings", readings)
    physical = forward_physical(stage, own)
    if every:
        solutions = forward_displacement(stage, own)
        records, status, reason = _records(solutions, unit), solutions.status, solutions.configurations.missing_reason
    else:
        records = [_record("", physical, unit) | {"physical": True}] if physical.exists else []
        status, reason = (Status.OK if physical.exists else Status.UNREACHABLE), physical.missing_reason
    code = options.exit_code(status, physical)
    if json:
        outputs.write_json({**_units(stage, unit), "status": str(status), "modes": records})
        raise typer.Exit(code)
    _print_states(stage, records, unit, at=", ".join(typed.text(x, leg) for leg, x in enumerate(readings)))
    hint = "" if records else typed.hint("--readings", readings)
    outputs.print_lines([*_status_lines(status, reason, hint), *_remarks(records, physical)])
    raise typer.Exit(code)


@takes_stage()
@outputs.name_options(heights="--height")
def reach(
    stage: Stage,
    height: Annotated[
        list[float] | None,
        Option(metavar="LENGTH", help="Height of the platform's centre, in --unit; may be repeated; default: nine."),
    ] = None,
    directions: Annotated[int, Option(metavar="N", help="Number of directions of the largest tilt.")] = 72,
    out: Annotated[Path | None, outputs.picture_option("Picture of the largest tilts to write.")] = None,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Compute how far a stage's platform tilts at each height and in each direction, and what limits the tilt.

    Example: spm-pin stage reach --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out reach.png
    """
    heights = None if height is None else np.array(height) / unit.per_metre
    found = largest_tilts(stage, heights, directions=directions)
    records = [
        {
            "height": level * unit.per_metre,
            "all_round": np.degrees(tilts.min()),
            "largest": np.degrees(tilts.max()),
            "ends": [str(ReachEnd(end)) for end in np.unique(ends)],
        }
        for level, tilts, ends in zip(found.heights, found.tilts, found.ends, strict=True)
    ]
    low, high = (x * unit.per_metre for x in height_range(stage))
    best, tilt = best_height(stage, directions=directions)
    best, tilt = best * unit.per_metre, math.degrees(tilt)
    if json:
        outputs.write_json(
            {"unit": unit, "height_range": [low, high], "best_height": best, "best_tilt": tilt, "heights": records}
        )
    else:
        columns: dict[str, Callable[[Record], str]] = {
            f"height [{unit}]": lambda row: unit.text(row["height"]),
            "all round [°]": lambda row: fixed(row["all_round"], 2).replace("nan", "–"),
            "largest [°]": lambda row: fixed(row["largest"], 2).replace("nan", "–"),
            "ends at": lambda row: ", ".join(row["ends"]),
        }
        outputs.print_table("Largest tilts, in every direction and in the best one", columns, records, left=["ends at"])
        level = f"level from {unit.text(low)} to {unit.text(high)} {unit}"
        at_best = f"best height: {unit.text(best)} {unit}, {fixed(tilt, 2)}° in every direction"
        outputs.print_lines([level, at_best] if math.isfinite(best) else ["level at no height"])
    outputs.write_figure(out, reach_figure, found)


@takes_stage()
@outputs.name_options(limits="--limits", boxes="--boxes", length_error="--length-error", angle_error="--angle-error")
def certify(
    stage: Stage,
    boxes: Boxes = 300_000,
    length_error: LengthError = 0.0,
    angle_error: AngleError = 0.0,
    out: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) of the boxes to write.")] = None,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Prove that the limits of a stage hold no forward singularity, so that three readings mean one configuration.

    Example: spm-pin stage certify --base 80 --platform 90 --crank 50 --rod 110 --limits 0 50 --unit mm

    The exit code is 0 if the proof succeeds, 1 if a singular configuration was found or boxes were left undecided.
    --out needs the extra "plots". For the file of a calibrated stage it is proved for all as near to the nominal one.
    """
    with outputs.stderr.status("dividing the states of the stage"):
        certificate = prove(stage, boxes=boxes, length_error=length_error / unit.per_metre, angle_error=angle_error)
    report_certificate(certificate, None, out, json=json)


@takes_stage()
@outputs.name_options(**NAMES)
def move(
    stage: Stage,
    start: Annotated[Triple, Option("--from", metavar="R1 R2 R3", help="Readings at the start, as of `forward`.")],
    goal: Annotated[Triple, Option("--to", metavar="R1 R2 R3", help="Readings at the end.")],
    via: Annotated[
        list[str] | None, Option(metavar="R1,R2,R3", help="Readings to pass on the way; may be repeated, in order.")
    ] = None,
    leg_rate: Annotated[str | None, largest_of("speed of a leg \\[m/s], of servos \\[rad/s].")] = None,
    leg_acceleration: Annotated[str | None, largest_of("acceleration of a leg \\[m/s²], \\[rad/s²].")] = None,
    leg_force: Annotated[str | None, largest_of("force \\[N] of a leg, or torque \\[N m] of a servo.")] = None,
    leg_jerk: Annotated[str | None, largest_of("jerk of a leg \\[m/s³], \\[rad/s³]: slower.")] = None,
    payload: Annotated[float, Option(help="Mass on the platform, at its centre \\[kg].")] = 0.0,
    margin: Annotated[float, Option(help="Least |det J| over d³ on the way.")] = 0.05,
    straight: Annotated[bool, Option("--straight", help="Lead the height and the normal directly.")] = False,
    period: Annotated[float, Option(help="Time between the rows \\[s].")] = 2e-3,
    out: Annotated[Path | None, outputs.file_option("CSV of the motion to write.", (".csv",))] = None,
    plot: Annotated[Path | None, outputs.picture_option("Picture (.png, .svg, .pdf) to write.")] = None,
    unit: options.Unit = LengthUnit.M,
    masses: options.MassesFile = None,
    json: options.AsJson = False,
) -> None:
    """Plan the fastest motion of a stage from one state to another, at rest at both ends.

    Example: spm-pin stage move --base 80 --platform 90 --crank 50 --rod 110 --limits 0 50 --unit mm --from 20 20 20
    --to 10 35 25 --leg-rate 8 --leg-acceleration 100 --out motion.csv

    `stage inverse` has the readings of a tilt and a height. A limit of force or of acceleration is needed, one number
    or three separated by commas. Exit code 3 if there is no path, or an end that the stage does not reach.
    """
    typed = Readings(stage, unit)
    ends = [typed.read(option, end) for option, end in (("--from", start), ("--to", goal))]
    largest = {"rate": leg_rate, "acceleration": leg_acceleration, "force": leg_force, "jerk": leg_jerk}
    ways = {"margin": margin, "line": "poses" if straight else "legs"}
    timing = {"twist": None, "period": period, "payload": payload}
    files: Record = {"masses": masses, "out": out, "plot": plot}
    move_machine(typed, ends, stage.limits, via or (), largest, ways=ways, timing=timing, **files, json=json)


@takes_stage()
@outputs.name_options()
def write(
    stage: Stage,
    out: Annotated[Path, outputs.file_option("YAML file to write.", (".yaml", ".yml"))],
    unit: options.Unit = LengthUnit.M,
) -> None:
    """Write a stage to a file, for the --stage of other commands.

    Example: spm-pin stage write --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out stage.yaml
    """
    stage.to_yaml(out)
    outputs.note(f"wrote {out}; spm-pin export c-stage --stage {out} writes its header for a microcontroller")


@as_command_of_stage(calibrate_machine)
def calibrate() -> None:
    """Calibrate a stage from what an IMU and a ruler show, or from measured poses, and leg readings.

    Example: spm-pin stage calibrate seen.csv --base 80 --platform 90 --crank 50 --rod 110 --unit mm --out built.yaml

    The file has columns roll and pitch as the IMU on the platform shows them, height of the platform's centre, or all
    three, and r_1 to r_3, in radians and metres; or poses, as for spm-pin calibrate. Cells of the three may be empty.
    The stage written can be given as --stage to other commands. Exit codes are those of spm-pin calibrate.
    """


@as_command_of_stage(tolerance_of_machine)
def tolerance() -> None:
    """Predict how far a stage's platform is off if its dimensions are, and which tolerance pays.

    Example: spm-pin stage tolerance --stage balancer.yaml --pivot 2e-4 --offset 2e-3

    States are drawn within the limits of the readings, which the file has to have.
    """


@takes_stage()
@takes_place
def draw(
    stage: Stage,
    out: Annotated[Path, outputs.picture_option(f"Picture to write: {', '.join(FORMATS)}.")],
    place: Record,
    unit: options.Unit = LengthUnit.M,
) -> None:
    """Draw a stage with its platform at a height and a tilt.

    Example: spm-pin stage draw --base 80 --platform 90 --crank 50 --rod 110 --unit mm --tilt 12 --out stage.png
    """
    state = _state(stage, place, unit)
    save_figure(stage_figure(state), out)
    for remark in _remarks([_record("", state, unit)], state):
        outputs.note(remark.removeprefix("* "), "yellow")
    outputs.note(f"wrote {out}")


@takes_stage()
@takes_place
def view(
    stage: Stage,
    place: Record,
    unit: options.Unit = LengthUnit.M,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    dark: Dark = False,
    browser: Browser = True,
) -> None:
    """Drag the platform of a stage, or its servos and cylinders, in a browser. Ends with Ctrl-C.

    Example: spm-pin stage view --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm

    Needs the extra "viewer".
    """
    require_extra("viewer")
    start = _state(stage, place, unit)
    serve(start, host=host, port=port, browser=browser, dark=dark)


def _height_hint(stage: Stage, place: Record, unit: LengthUnit) -> str:
    return options.unit_hint("--height", place["height"] * unit.per_metre, unit, stage)


def _state(stage: Stage, place: Record, unit: LengthUnit) -> StageConfiguration:
    solutions = inverse_displacement(stage, **place)
    state = solutions.physical()
    if not state.exists:
        cause = _height_hint(stage, place, unit) or solutions.configurations.missing_reason or _NOT_PHYSICAL
        if (nearest := nearest_reachable_pose(stage, **place).configuration).exists:
            cause += f". The nearest: {_options_of(nearest, place, unit)}"
        raise ArgumentError("--height, --tilt", "a height and a tilt that the stage reaches", "others", cause)
    return state


def _units(stage: Stage, unit: LengthUnit) -> Record:
    return {"unit": unit, "readings": unit if stage.unit == "m" else "degrees"}


def _record(label: str, state: StageConfiguration, unit: LengthUnit) -> Record:
    angles = {name: np.degrees(getattr(state, name)) for name in ("tilt", "azimuth", "roll", "pitch", "torsion")}
    return {
        "label": label,
        **angles,
        "height": state.height * unit.per_metre,
        "shift": state.shift * unit.per_metre,
        "readings": state.readings * Readings(state.stage, unit).scale,
        "beyond_limits": np.flatnonzero(state.limit_excess),
        "translation": state.translation * unit.per_metre,
        "rotation": state.rotation,
        "physical": bool(state.is_at_home),
    }


def _records(solutions: StageSolutions, unit: LengthUnit) -> list[Record]:
    return [_record(solutions.labels[k], solutions.configurations[k], unit) for k in np.flatnonzero(solutions.exists)]


def _print_states(stage: Stage, records: list[Record], unit: LengthUnit, *, at: str = "") -> None:
    """Print states by their readings, or for typed readings `at` by their poses."""
    angle = "°" if stage.unit == "rad" else str(unit)
    columns: dict[str, Any] = {"mode": lambda row: row["label"]} if len(records) > 1 or not at else {}
    if at:
        for name in ("tilt", "azimuth", "roll", "pitch"):
            columns[f"{name} [°]"] = lambda row, name=name: fixed(row[name], 3)
        columns[f"height [{unit}]"] = lambda row: unit.text(row["height"])
    else:
        columns |= Readings(stage, unit).columns(f" [{angle}]")
    for k, axis in enumerate("xy"):
        columns[f"shift {axis} [{unit}]"] = lambda row, k=k: unit.text(row["shift"][k])
    columns["torsion [°]"] = lambda row: fixed(row["torsion"], 3)
    columns[""] = lambda row: "physical" * row["physical"] + "*" * (bool(at) and len(row["beyond_limits"]) > 0)
    legs = f"{stage.kind.name} legs"
    title = f"Tilt and height of the platform on {legs} at {at} {angle}" if at else f"Readings of {legs} in {angle}"
    if records and not at:
        height, tilt, azimuth = (records[0][name] for name in ("height", "tilt", "azimuth"))
        title += f" at {unit.text(height)} {unit} for a tilt of {fixed(tilt, 2)}° towards {fixed(azimuth, 2)}°"
    outputs.print_table(f"{title}, and its parasitic motion", columns, records, left=[""])


def _remarks(records: list[Record], physical: StageConfiguration) -> list[str]:
    is_below = bool(records and not physical.exists and records[0]["height"] < 0.0)
    return options.state_remarks(records, physical, "mode") + [f"{BELOW}."] * is_below


def _status_lines(status: object, reason: str, hint: str) -> list[str]:
    """Return the status with its reason, or with a hint on the unit if there is one."""
    return [f"status: {status}", hint] if hint else [f"status: {status}" + f": {reason}" * bool(reason)]
