"""Options of a stage, and of the height and the tilt of its platform, common to several commands."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spm_pin.cli import options, outputs
from spm_pin.cli.options import LengthUnit, OptionTable, Readings, Triple
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.machine import PRS, RPS, RRS, LegKind, Stage
from spm_pin.workspace.stage_reach import home_height

Typed = dict[str, Any]
_STAGE: OptionTable = {
    "stage": (Path, "FILE", "YAML file of a stage, in place of the following dimensions."),
    "base": (float, "RADIUS", "Distance from the centre of the base to the pivots, in --unit."),
    "platform": (float, "RADIUS", "Distance from the centre of the platform to the balls, in --unit."),
    "crank": (float, "LENGTH", "Length of the servos' cranks, in --unit; with --rod: RRS legs."),
    "rod": (
        float,
        "LENGTH",
        "Distance from knee or carriage to ball, in --unit; alone: PRS legs, without: RPS. Unequal rods: --stage.",
    ),
    "slide": (float, "DEGREES", "Direction of the slides of PRS legs: 0 outwards, 90 upwards (default)."),
    "sign": (int, "±1", "Working mode: -1, knees outside and carriages below (default), or 1."),
    "limits": (tuple[float, float], "MIN MAX", "Limits of the readings: in --unit, for servos in degrees."),
}
_PLACE: OptionTable = {
    "height": (float, "LENGTH", "Height of the platform's centre above the pivots, in --unit; default: the middle."),
    "tilt": (float, "DEGREES", "Tilt of the platform; default: level."),
    "azimuth": (float, "DEGREES", "Direction in which it is lowest; default: 0, along x. Legs: -30, 90 and 210."),
    "roll": (float, "DEGREES", "In place of --tilt, with --pitch: angle about x."),
    "pitch": (float, "DEGREES", "Angle about y."),
    "normal": (Triple, "X Y Z", "In place of --tilt: the platform's normal, of any length."),
}
_WAYS: tuple[set[str], ...] = {"tilt", "azimuth"}, {"roll", "pitch"}, {"normal"}


def takes_stage(*, required: bool = True) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command with a `stage`, so that it takes the options of one instead; it also has a `unit`.

    If it is not `required`, it is None if no option is given.
    """
    return functools.partial(
        options.with_options, argument="stage", table=_STAGE, read=functools.partial(_read_stage, required=required)
    )


def as_command_of_stage(command: Callable[..., None]) -> Callable[[Callable[[], None]], Callable[..., None]]:
    """Decorate an empty function so that it is a robot's command for a stage, with the docstring of the function.

    It has the options of a stage in place of `machine_file`; --stage alone if the command has some of the others.
    """
    names = inspect.signature(command).parameters.keys()
    table = _STAGE | {"unit": (LengthUnit, "UNIT", "Unit of the lengths among these options; metres if not given.")}
    needed = ["stage"] if names & table.keys() else []
    if needed:
        table = {"stage": (Path, "FILE", "YAML file of a stage, see spm-pin stage write.")}

    def read(typed: Typed, _: Typed) -> Stage | None:
        unit = typed.pop("unit", None) or LengthUnit.M
        return _read_stage(dict.fromkeys(_STAGE) | typed, {"unit": unit}, required=True)

    def decorate(described: Callable[[], None]) -> Callable[..., None]:
        made = options.with_options(command, "machine_file", table, read, needed=needed)
        made.__doc__, made.__name__ = described.__doc__, described.__name__
        return made

    return decorate


def takes_place(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command with a `stage` and a `place`, arguments of `stages.inverse`, so that it takes options.

    Errors that name an argument of `stages.inverse` name the option.
    """
    named = outputs.name_options(**{name: f"--{name}" for name in _PLACE})(command)
    return options.with_options(named, "place", _PLACE, _read_place)


def _read_place(typed: Typed, arguments: Typed) -> Typed:
    height, place = typed["height"], {name: x for name, x in typed.items() if x is not None and name != "height"}
    if not any(place.keys() <= way for way in _WAYS):
        several = " and ".join(f"--{name}" for name in place)
        raise ArgumentError(several, "--tilt with --azimuth, or --roll with --pitch, or --normal", "a mixture")
    if not 0.0 <= place.get("tilt", 0.0) < 180.0:
        cause = "For a tilt to the opposite side change the azimuth"
        raise ArgumentError("--tilt", "an angle in degrees, from 0 to less than 180", f"{place['tilt']:g}", cause)
    for name in place.keys() - {"normal"}:
        if not abs(place[name]) <= 360.0:
            raise ArgumentError(f"--{name}", "an angle in degrees, of at most one turn", f"{place[name]:g}")
        place[name] = math.radians(math.remainder(place[name], 360.0))
    if "azimuth" in place and "tilt" not in place:
        raise ArgumentError("--tilt", "a tilt together with --azimuth", "none")
    if "tilt" in place:
        place.setdefault("azimuth", 0.0)
    metres = home_height(arguments["stage"]) if height is None else height / arguments["unit"].per_metre
    return {"height": metres, **place}


def _read_stage(typed: Typed, arguments: Typed, *, required: bool) -> Stage | None:
    unit: LengthUnit = arguments["unit"]
    given = [name for name, value in typed.items() if value is not None]
    if not (required or given):
        return None
    if typed["stage"] is not None:
        if len(given) > 1:
            beside = ", ".join(f"--{name}" for name in given if name != "stage")
            raise ArgumentError("--stage", "a file alone: its numbers are in metres and radians", f"also {beside}")
        try:
            with options.warnings_as_notes("--stage: "):
                return Stage.from_yaml(typed["stage"])
        except GeometryError as error:
            raise outputs.in_file_of("--stage", error) from error
    for name in ("base", "platform"):
        if typed[name] is None:
            raise ArgumentError(f"--{name}", "a radius, or --stage with a file", "neither")
    names = "base", "platform", "crank", "rod"
    lengths = {name: None if typed[name] is None else typed[name] / unit.per_metre for name in names}
    named = {"base_radius": "--base", "platform_radius": "--platform", "legs": "--rod", "direction": "--slide"}
    try:
        kind = _read_kind(typed, lengths)
        with options.warnings_as_notes("--unit: "):
            stage = Stage(lengths["base"], lengths["platform"], kind)  # type: ignore[arg-type]
        if typed["limits"] is None:
            return stage
        limits = Readings(stage, unit).read_limits("--limits", *typed["limits"])
        return Stage(stage.base_radius, stage.platform_radius, stage.legs, limits)
    except GeometryError as error:
        raise error.replaced(argument=named.get(error.argument, f"--{error.argument}")) from error


def _read_kind(typed: Typed, lengths: Typed) -> LegKind:
    sign: Typed = {} if typed["sign"] is None else {"sign": typed["sign"]}
    if lengths["crank"] is not None:
        if lengths["rod"] is None:
            raise ArgumentError("--rod", "the length of the rods together with --crank", "none")
        _refuse(typed, "slide", "--crank")
        return RRS(crank=lengths["crank"], rod=lengths["rod"], **sign)
    if lengths["rod"] is not None:
        slide: Typed = {} if typed["slide"] is None else {"direction": math.radians(typed["slide"])}
        return PRS(rod=lengths["rod"], **slide, **sign)
    _refuse(typed, "slide", "legs without --rod")
    _refuse(typed, "sign", "legs without --rod")
    return RPS()


def _refuse(typed: Typed, name: str, beside: str) -> None:
    if typed[name] is not None:
        raise ArgumentError(f"--{name}", f"no such option with {beside}", f"{typed[name]:g}")
