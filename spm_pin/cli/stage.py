"""`spm-pin stage`: a stage alone, of a file or of numbers that a ruler gives: displacements, reach, pictures."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Option

from spm_pin.cli import options, outputs
from spm_pin.cli.draw import Browser, Dark, Host, Port, serve
from spm_pin.cli.options import LengthUnit, Readings, Triple
from spm_pin.display import reach_figure, save_figure, stage_figure
from spm_pin.display.writing import FORMATS, fixed
from spm_pin.errors import ArgumentError, GeometryError, require_extra
from spm_pin.mechanism import PRS, RPS, RRS, LegKind, Stage, StageConfiguration, StageSolutions, Status
from spm_pin.mechanism.stage_configuration import BELOW
from spm_pin.stages import ReachEnd, forward_physical, height_range, home_height, inverse_physical, nearest_reachable
from spm_pin.stages import forward as all_modes
from spm_pin.stages import inverse as both_modes
from spm_pin.stages import reach as largest_tilts

Record = dict[str, Any]
_Number = float | None
_STAGE: dict[str, tuple[Any, str, str, str]] = {
    "file": (Path | None, "--stage", "FILE", "YAML file of a stage, in place of the numbers that follow."),
    "base": (_Number, "--base", "RADIUS", "From the centre of the base to the pivots, in --unit."),
    "platform": (_Number, "--platform", "RADIUS", "From the centre of the platform to the balls, in --unit."),
    "crank": (_Number, "--crank", "LENGTH", "Of servos' cranks, in --unit: with --rod, legs RRS."),
    "rod": (_Number, "--rod", "LENGTH", "From knee or carriage to ball, in --unit: alone, legs PRS; without, RPS."),
    "slide": (_Number, "--slide", "DEGREES", "Direction of PRS legs' slides: 0 outwards, 90 upwards, the default."),
    "sign": (int | None, "--sign", "±1", "Working mode: -1, knees outside and carriages below, the default, or 1."),
    "limits": (
        tuple[float, float] | None,
        "--limits",
        "MIN MAX",
        "Of the readings: in --unit, of servos in degrees.",
    ),
}
"""Options that describe a stage: what they take, what is typed, and the help."""
Height = Annotated[float, Option(metavar="LENGTH", help="Of the platform's centre above the pivots, in --unit.")]
AnyHeight = Annotated[float | None, Option(metavar="LENGTH", help="In --unit; the middle if not given.")]
Tilt = Annotated[float, Option(metavar="DEGREES", help="Of the platform.")]
Azimuth = Annotated[float, Option(metavar="DEGREES", help="Where it is lowest.")]


def _read_stage(typed: Record, unit: LengthUnit) -> Stage:
    given = [name for name, value in typed.items() if value is not None]
    if typed["file"] is not None:
        if len(given) > 1:
            beside = ", ".join(_STAGE[name][1] for name in given if name != "file")
            raise ArgumentError("--stage", "a file alone: its numbers are in metres and radians", f"also {beside}")
        return options.read_stage(typed["file"])
    for name in ("base", "platform"):
        if typed[name] is None:
            raise ArgumentError(_STAGE[name][1], "a radius, or --stage with a file", "neither")
    lengths = {name: None if typed[name] is None else typed[name] / unit.per_metre for name in list(_STAGE)[1:5]}
    names = {"base_radius": "--base", "platform_radius": "--platform", "legs": "--rod", "direction": "--slide"}
    try:
        kind = _read_kind(typed, lengths)
        stage = Stage(lengths["base"], lengths["platform"], kind)  # type: ignore[arg-type]
        readings = Readings(stage, unit)
        limits = None if typed["limits"] is None else readings.read_limits("--limits", *typed["limits"])
        return Stage(stage.base_radius, stage.platform_radius, kind, limits)
    except GeometryError as error:
        name = error.argument.partition(" of ")[0]
        option = names.get(name, f"--{name}")
        cause = (
            f"Read in {unit}; is it {LengthUnit.MM}? --unit says so" if "are in metres" in error.cause else error.cause
        )
        raise GeometryError(option, error.expected, error.received, cause) from error


def _read_kind(typed: Record, lengths: Record) -> LegKind:
    sign: Record = {} if typed["sign"] is None else {"sign": typed["sign"]}
    if lengths["crank"] is not None:
        if lengths["rod"] is None:
            raise ArgumentError("--rod", "the length of the rods beside --crank", "none")
        _refuse(typed, "slide", "--crank")
        return RRS(crank=lengths["crank"], rod=lengths["rod"], **sign)
    if lengths["rod"] is not None:
        slide: Record = {} if typed["slide"] is None else {"direction": math.radians(typed["slide"])}
        return PRS(rod=lengths["rod"], **slide, **sign)
    _refuse(typed, "slide", "legs without --rod")
    _refuse(typed, "sign", "legs without --rod")
    return RPS()


def _refuse(typed: Record, name: str, beside: str) -> None:
    if typed[name] is not None:
        raise ArgumentError(_STAGE[name][1], f"not to be given with {beside}", f"{typed[name]:g}")


def takes_stage(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command that has a `stage`, so that it takes the options of one instead; it has a `unit` too."""
    parameters = {
        name: inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[kind, Option(typed, metavar=metavar, help=text)],
        )
        for name, (kind, typed, metavar, text) in _STAGE.items()
    }
    return options.with_options(command, "stage", parameters, _read_stage)


@takes_stage
@outputs.name_options(**{name: f"--{name}" for name in ("height", "tilt", "azimuth", "roll", "pitch", "normal")})
def inverse(
    stage: Stage,
    height: Height,
    tilt: Annotated[float | None, Option(metavar="DEGREES", help="Of the platform, with --azimuth.")] = None,
    azimuth: Annotated[
        float | None, Option(metavar="DEGREES", help="Where it is lowest: 0 along x, legs at -30, 90 and 210.")
    ] = None,
    roll: Annotated[float | None, Option(metavar="DEGREES", help="Instead, with --pitch: about x.")] = None,
    pitch: Annotated[float | None, Option(metavar="DEGREES", help="About y.")] = None,
    normal: Annotated[Triple | None, Option(metavar="X Y Z", help="Instead: the unit normal.")] = None,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Find what the legs of a stage read for a tilt and a height of its platform, in both operation modes.

    Example: spm-pin stage inverse --base 80 --platform 90 --crank 50 --rod 110 --unit mm --height 120 --roll 8

    Where the platform does not get there, the nearest reachable tilt is named. The exit code is 3 if neither mode is
    real, 5 if none is physical and within the limits.
    """
    degrees = {"tilt": tilt, "azimuth": azimuth, "roll": roll, "pitch": pitch}
    request: dict[str, Any] = {name: None if x is None else _radians(f"--{name}", x) for name, x in degrees.items()}
    request |= {"normal": normal}
    metres = height / unit.per_metre
    solutions = both_modes(stage, metres, **request)
    physical, nearest = solutions.physical(), None
    code = options.exit_code(solutions.status, physical)
    if code:
        nearest = nearest_reachable(stage, metres, **request)
    records = _records(solutions, unit)
    if json:
        found = None if nearest is None or not nearest.exists else _record("nearest", nearest, unit)
        outputs.write_json({**_units(stage, unit), "status": str(solutions.status), "modes": records, "nearest": found})
        raise typer.Exit(code)
    _print_states(stage, records, unit)
    hint = options.unit_hint("--height", height, unit, stage)
    status = f"status: {solutions.status}{_why('' if hint else solutions.configurations.missing_reason)}"
    lines = [status, *filter(None, [hint]), *_remarks(stage, records, physical)]
    if nearest is not None and nearest.exists:
        lines += ["The nearest tilt that is reached:", f"  {_options_of(nearest, height, unit)}"]
    outputs.print_lines(lines)
    raise typer.Exit(code)


def _options_of(nearest: StageConfiguration, height: float, unit: LengthUnit) -> str:
    """Return the options that enter a nearest tilt, rounded towards less tilt, and heights towards those reached."""
    tilt = max(math.floor(1e3 * math.degrees(nearest.tilt) - 0.1) / 1e3, 0.0)
    level = float(nearest.height * unit.per_metre)
    if not math.isclose(level, height):
        level += math.copysign(1e-4 * level, level - height)
    azimuth = fixed(math.degrees(nearest.azimuth) if tilt else 0.0, 5)
    text = f"--height {unit.text(level, 1)} --tilt {fixed(tilt, 3)} --azimuth {azimuth}"
    return text if unit is LengthUnit.M else f"{text} --unit {unit}"


@takes_stage
@outputs.name_options()
def forward(
    stage: Stage,
    readings: Annotated[Triple, Option(metavar="R1 R2 R3", help="In --unit, of servos in degrees.")],
    every: Annotated[bool, Option("--all", help="All sixteen assembly modes, not the physical one alone.")] = False,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Find the tilt and the height of a stage's platform from what its legs read.

    Example: spm-pin stage forward --base 80 --platform 90 --crank 50 --rod 110 --unit mm --readings 20 33 6
    """
    own = Readings(stage, unit).read("--readings", readings)
    physical = forward_physical(stage, own)
    if every:
        solutions = all_modes(stage, own)
        records, status, reason = _records(solutions, unit), solutions.status, solutions.configurations.missing_reason
    else:
        records = [_record("", physical, unit) | {"physical": True}] if physical.exists else []
        status, reason = (Status.OK if physical.exists else Status.UNREACHABLE), physical.missing_reason
    code = options.exit_code(status, physical)
    if json:
        outputs.write_json({**_units(stage, unit), "status": str(status), "modes": records})
        raise typer.Exit(code)
    typed = ", ".join(Readings(stage, unit).text(x, leg) for leg, x in enumerate(readings))
    _print_states(stage, records, unit, at=typed)
    outputs.print_lines([f"status: {status}" + _why(reason), *_remarks(stage, records, physical)])
    raise typer.Exit(code)


@takes_stage
@outputs.name_options(heights="--height")
def reach(
    stage: Stage,
    height: Annotated[
        list[float] | None,
        Option(metavar="LENGTH", help="Of the platform's centre, in --unit; may be repeated; nine if not given."),
    ] = None,
    directions: Annotated[int, Option(metavar="N", help="In how many directions the largest tilt is sought.")] = 72,
    out: Annotated[Path | None, outputs.picture_option("Picture of the largest tilts to write.")] = None,
    unit: options.Unit = LengthUnit.M,
    json: options.AsJson = False,
) -> None:
    """Find how far a stage's platform tilts, by height and direction, and what ends it.

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
    if json:
        outputs.write_json({"unit": unit, "height_range": [low, high], "heights": records})
    else:
        columns: dict[str, Callable[[Record], str]] = {
            f"height [{unit}]": lambda row: unit.text(row["height"]),
            "all round [°]": lambda row: fixed(row["all_round"], 2),
            "largest [°]": lambda row: fixed(row["largest"], 2),
            "ends at": lambda row: ", ".join(row["ends"]),
        }
        outputs.print_table("Largest tilts, in every direction and in the best one", columns, records, left=["ends at"])
        outputs.print_lines([f"level from {unit.text(low)} to {unit.text(high)} {unit}"])
    outputs.write_figure(out, reach_figure, found)


@takes_stage
@outputs.name_options()
def write(
    stage: Stage,
    out: Annotated[Path, outputs.file_option("YAML file to write.", (".yaml", ".yml"))],
    unit: options.Unit = LengthUnit.M,
) -> None:
    """Write a stage into a file, for the --stage of other commands.

    Example: spm-pin stage write --base 80 --platform 90 --crank 50 --rod 110 --limits -35 70 --unit mm --out stage.yaml
    """
    stage.to_yaml(out)
    outputs.note(f"wrote {out}; spm-pin export c-stage --stage {out} writes its header for a microcontroller")


@takes_stage
@outputs.name_options()
def draw(
    stage: Stage,
    out: Annotated[Path, outputs.picture_option(f"Picture to write: {', '.join(FORMATS)}.")],
    height: AnyHeight = None,
    tilt: Tilt = 0.0,
    azimuth: Azimuth = 0.0,
    unit: options.Unit = LengthUnit.M,
) -> None:
    """Draw a stage with its platform at a height and a tilt.

    Example: spm-pin stage draw --base 80 --platform 90 --crank 50 --rod 110 --unit mm --tilt 12 --out stage.png
    """
    state = _state(stage, height, tilt, azimuth, unit)
    save_figure(stage_figure(state), out)
    for remark in _remarks(stage, [_record("", state, unit)], state):
        outputs.note(remark.removeprefix("* "), "yellow")
    outputs.note(f"wrote {out}")


@takes_stage
@outputs.name_options()
def view(
    stage: Stage,
    height: AnyHeight = None,
    tilt: Tilt = 0.0,
    azimuth: Azimuth = 0.0,
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
    start = _state(stage, height, tilt, azimuth, unit)
    serve(start, host=host, port=port, browser=browser, dark=dark)


def _state(stage: Stage, height: float | None, tilt: float, azimuth: float, unit: LengthUnit) -> StageConfiguration:
    metres = home_height(stage) if height is None else height / unit.per_metre
    state = inverse_physical(stage, metres, tilt=_radians("--tilt", tilt), azimuth=_radians("--azimuth", azimuth))
    if not state.exists:
        raise ArgumentError("--tilt", "a tilt and a height that the stage reaches", "none", state.missing_reason)
    return state


def _radians(option: str, degrees: float) -> float:
    if option == "--tilt" and not 0.0 <= degrees < 180.0:
        cause = "To the other side leans what has another azimuth"
        raise ArgumentError(option, "an angle in degrees, from 0 to less than 180", f"{degrees:g}", cause)
    if not abs(degrees) <= 360.0:
        raise ArgumentError(option, "an angle in degrees, of at most one turn", f"{degrees:g}")
    return math.radians(degrees)


def _scale(stage: Stage, unit: LengthUnit) -> float:
    """Return what a reading in metres or radians is multiplied by to be printed."""
    return float(Readings(stage, unit).scale[0])


def _units(stage: Stage, unit: LengthUnit) -> Record:
    return {"unit": unit, "readings": unit if stage.unit == "m" else "degrees"}


def _record(label: str, state: StageConfiguration, unit: LengthUnit) -> Record:
    angles = {name: np.degrees(getattr(state, name)) for name in ("tilt", "azimuth", "roll", "pitch", "torsion")}
    return {
        "label": label,
        **angles,
        "height": state.height * unit.per_metre,
        "shift": state.shift * unit.per_metre,
        "readings": state.readings * _scale(state.stage, unit),
        "beyond_limits": np.flatnonzero(state.limit_excess),
        "translation": state.translation * unit.per_metre,
        "rotation": state.rotation,
        "physical": bool(state.is_at_home),
    }


def _records(solutions: StageSolutions, unit: LengthUnit) -> list[Record]:
    return [_record(solutions.labels[k], solutions.configurations[k], unit) for k in np.flatnonzero(solutions.exists)]


def _print_states(stage: Stage, records: list[Record], unit: LengthUnit, *, at: str = "") -> None:
    """Print states by their readings, or, `at` readings that were typed, by their poses."""
    angle, readings = "°" if stage.unit == "rad" else str(unit), Readings(stage, unit)
    columns: dict[str, Any] = {"mode": lambda row: row["label"]} if len(records) > 1 or not at else {}
    if at:
        for name in ("tilt", "azimuth", "roll", "pitch"):
            columns[f"{name} [°]"] = lambda row, name=name: fixed(row[name], 3)
        columns[f"height [{unit}]"] = lambda row: unit.text(row["height"])
    else:
        for leg, name in enumerate(stage.legs.names):
            columns[f"{name} [{angle}] "] = lambda row, leg=leg: (
                readings.text(row["readings"][leg], leg) + " *"[leg in row["beyond_limits"]]
            )
    for k, axis in enumerate("xy"):
        columns[f"shift {axis} [{unit}]"] = lambda row, k=k: unit.text(row["shift"][k])
    columns["torsion [°]"] = lambda row: fixed(row["torsion"], 3)
    columns[""] = lambda row: "physical" * row["physical"] + "*" * (bool(at) and len(row["beyond_limits"]) > 0)
    title = f"Tilt and height of the platform at {at} {angle}" if at else f"Readings of the legs in {angle}"
    if records and not at:
        title += " for a tilt of {tilt:.2f}° towards {azimuth:.2f}°".format(**records[0])
    outputs.print_table(f"{title}, and its parasitic motion", columns, records, left=[""])


def _remarks(stage: Stage, records: list[Record], physical: StageConfiguration) -> list[str]:
    beyond = sorted({stage.legs.names[leg] for record in records for leg in record["beyond_limits"]})
    remarks = [f"* {', '.join(beyond)} beyond the limits"] if beyond else []
    if records and not physical.exists:
        remarks.append("Not physical: not reached from the level platform without a forward singularity.")
        if records[0]["height"] < 0.0:
            remarks.append(f"{BELOW}.")
    return remarks


def _why(reason: str) -> str:
    return f": {reason}" if reason else ""
