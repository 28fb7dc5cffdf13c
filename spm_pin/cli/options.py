"""Options common to several commands, and the making of commands from functions that take what options stand for.

A parameter `typed: MachineInUnits` of such a function becomes the options of a machine, in a file or by numbers, one of
the type `Request` those of a pose, or for `spm-pin stage` of a height and a tilt, and `Legs` six numbers, or three.
Parameters have the names of the library's arguments, so that errors about these name the options.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import warnings
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np
from typer import Option
from typer.models import ArgumentInfo

from spm_pin.cli.outputs import Report, cannot_be_used, file_option, note
from spm_pin.cli.requests import OptionTable, Record, Request, TiltRequest
from spm_pin.cli.units import LengthUnit, MachineInUnits
from spm_pin.description.masses import Masses
from spm_pin.display.writing import FORMATS
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.machine import LEGS, PRS, RPS, RRS, STAGE_LEGS, Manipulator, Stage
from spm_pin.machine.manipulator import machine_from_yaml
from spm_pin.support.arguments import FloatArray

OF_MANIPULATOR = "of a manipulator"
"""Annotation of a parameter that commands for a stage do not have."""


class Legs(np.ndarray[Any, np.dtype[np.float64]]):
    """Annotation of readings of all legs, which a command gets as an array in [m, rad]; then help and names follow."""


Readings = Annotated[Legs | None, "Readings of the legs instead of a pose,", "--legs", "--readings"]
Masses_ = Annotated[
    Path | None, Option("--masses", metavar="FILE", help="YAML file of masses and payload; default: assumed masses.")
]
Prefix = Annotated[str | None, Option("--prefix", help="Prefix of all names, such as left_.")]
Branches = Annotated[list[str] | None, Option("--branch", metavar="LABEL", help="Branch, such as TT+; repeatable.")]
Seed = Annotated[int, Option("--seed", min=0, help="Seed of the random numbers.")]
Workers = Annotated[int | None, Option(min=1, help="Processes; default: one per processor, for design 1.")]
Scheduler = Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler: tcp://head:8786.")]
Picture = Annotated[Path | None, file_option(f"Picture to write: {', '.join(FORMATS)}.", FORMATS, "plots")]
MachineFile = Annotated[Path | None, file_option("YAML file of the machine to write.", (".yaml", ".yml"))]
AsJson = Annotated[bool, Option("--json", help="Print JSON instead of a table.")]

_MACHINE: OptionTable = {
    "machine": (Path, "FILE", "YAML file of a machine, in place of the dimensions"),
    "base": (float, "RADIUS", "Distance from the centre of the base to the pivots, in --unit."),
    "platform": (float, "RADIUS", "Distance from the centre of the platform to its joints, in --unit."),
    "middle": (float, "LENGTH", "Side of the middle platform's triangle of balls, in --unit; without: a stage."),
    "crank": (float, "LENGTH", "Length of the servos' cranks, in --unit; with --rod: RRS legs."),
    "rod": (float, "LENGTH", "Distance from knee or carriage to ball, in --unit; alone: PRS legs, without: RPS."),
    "slide": (float, "DEGREES", "Direction of the slides of PRS legs: 0 outwards, 90 upwards (default)."),
    "sign": (int, "±1", "Working mode: -1, knees outside and carriages below (default), or 1."),
    "limits": (
        tuple[str, str],
        "MIN MAX",
        "Limits of the readings, a number or one per leg with commas; in degrees for cranks.",
    ),
}
_MACHINE_NAMES = "--machine", "--stage", "--geometry"
_ARGUMENTS = {"base": "base_radius", "platform": "platform_radius", "middle": "middle_side", "slide": "direction"}
"""Arguments of machines and legs, where they have other names than the options."""
ARGUMENT_OPTIONS: dict[str, str] = {
    **dict.fromkeys(("readings", "leg_lengths", *LEGS, *STAGE_LEGS), "--legs"),
    **dict.fromkeys(("alpha", "beta", "lambda_"), "--xyx"),
    "wrench": "--force, --moment",
    "twist": "--velocity, --angular-velocity",
    "aims": "--maximise, --minimise",
    "directory": "--out",
    "points": "--path",
}
"""Options of arguments that are no parameters of a command of the same name."""


def make_command(function: Callable[..., Report | None], *, of_stage: bool) -> Callable[..., None]:
    """Return a function as typer takes it, with the options of a manipulator or of a stage; it prints its report.

    Errors name the options that were typed instead of the arguments of functions.
    """
    groups: dict[str, _Group] = {}
    parameters: list[inspect.Parameter] = []
    has_states = False
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        annotation = parameter.annotation
        kind, *extra = get_args(annotation) if hasattr(annotation, "__metadata__") else [annotation]
        if of_stage and OF_MANIPULATOR in extra:
            continue
        kinds, group = {kind, *get_args(kind)}, None
        is_optional = type(None) in kinds
        if MachineInUnits in kinds:
            # The machine is read first, since the units of other options depend on it.
            group = _machine_group(of_stage, inspect.signature(function).parameters)
            groups = {parameter.name: group, **groups}
        elif Request in kinds:
            group = _request_group(TiltRequest if of_stage else Request, *extra, is_optional=is_optional)
        elif Legs in kinds:
            group = _legs_group(parameter.name, *extra, of_stage=of_stage, is_optional=is_optional)
        if group is None:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
        else:
            groups[parameter.name], has_states = group, has_states or MachineInUnits not in kinds
            parameters += group.parameters
    shows = get_type_hints(function)["return"] is Report
    if shows:
        parameters.append(inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=AsJson))
    names = {parameter.name: _option_name(parameter) for parameter in parameters}

    def run(**values: Any) -> None:
        try:
            arguments = {name: value for name, value in values.items() if name != "json" or not shows}
            typed = None
            for name, (own, read) in groups.items():
                given = {parameter.name: arguments.pop(parameter.name) for parameter in own}
                arguments[name] = read(given, typed)
                typed = typed or arguments[name]
                if has_states and typed.machine.is_stage and not of_stage:
                    option = f"--machine {typed.file}" if typed.file else "--middle"
                    raise ArgumentError(option, "a manipulator", "a stage", "For a stage: spm-pin stage")
            report = function(**arguments)
        except ArgumentError as error:
            raise _by_option(error, names, values) from error
        if report is not None:
            report.show(json=values.get("json", False))

    run.__name__, run.__doc__ = function.__name__, function.__doc__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


class _Group(NamedTuple):
    """Options of a command, and the function of their values and of the machine that returns its argument."""

    parameters: list[inspect.Parameter]
    read: Callable[[Record, Any], Any]


def _option(name: str, kind: Any, option: Any, *, is_required: bool = False, default: Any = None) -> inspect.Parameter:
    return inspect.Parameter(
        name.replace("-", "_"),
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if is_required else default,
        annotation=Annotated[kind if is_required or default is not None else kind | None, option],
    )


def _machine_group(of_stage: bool, taken: Collection[str]) -> _Group:
    """Return the options of a machine and of the unit; a file alone if names of dimensions are taken."""
    left_out = {"middle"} if of_stage else set()
    if _MACHINE.keys() & taken:
        left_out = _MACHINE.keys() - {"machine", "limits"}
    parameters = []
    for name, (kind, metavar, text) in _MACHINE.items():
        if name in left_out:
            continue
        options = _MACHINE_NAMES if name == "machine" else (f"--{name}",)
        if name == "machine":
            text += "." if of_stage else "; default: the paper's."
        option = Option(*options, metavar=metavar, help=text, rich_help_panel="Machine")
        parameters.append(_option(name, kind, option))
    unit = Option(help="Unit of lengths, typed and printed, if no other is named.", rich_help_panel="Machine")
    parameters.append(_option("unit", LengthUnit, unit, default=LengthUnit.M))
    return _Group(parameters, lambda given, _: _read_machine(given, of_stage))


def _request_group(request: type[Request], prefix: str = "", *, is_optional: bool) -> _Group:
    """Return the options of a pose, or of a height and a tilt."""
    parameters = []
    for name, (kind, metavar, text) in request.options.items():
        option = Option(f"--{prefix}{name}", metavar=metavar, help=text, rich_help_panel="Pose")
        is_required = name == request.needed and not is_optional
        parameters.append(_option(f"{prefix}{name}", kind, option, is_required=is_required))

    def read(given: Record, typed: MachineInUnits) -> Request | None:
        if is_optional and all(value is None for value in given.values()):
            return None
        values = dict(zip(request.options, given.values(), strict=True))
        return request.read({name: value for name, value in values.items() if value is not None}, typed, prefix)

    return _Group(parameters, read)


def _legs_group(name: str, what: str, *names: str, of_stage: bool, is_optional: bool) -> _Group:
    """Return the option of six readings, or of three."""
    count, metavar = (3, "R1 R2 R3") if of_stage else (6, "B1 B2 B3 C1 C2 C3")
    own = Option(*names, metavar=metavar, help=f"{what} in --unit, for cranks in degrees.")
    parameter = _option(name, tuple[(float,) * count], own, is_required=not is_optional)  # type: ignore[misc]

    def read(given: Record, typed: MachineInUnits) -> FloatArray | None:
        (numbers,) = given.values()
        return None if numbers is None else typed.read(names[0], numbers)

    return _Group([parameter], read)


def _read_machine(given: Record, of_stage: bool) -> MachineInUnits:
    """Return the machine of a file, or of numbers; without either the paper's, and for `spm-pin stage` an error."""
    unit, file, limits = given["unit"], given["machine"], given["limits"]
    typed = {name: value for name, value in given.items() if value is not None and name != "unit"}
    numbers = {name: value for name, value in typed.items() if name not in ("machine", "limits")}
    machine: Any
    if file is not None:
        if numbers:
            raise cannot_be_used("--machine", ", ".join(f"--{name}" for name in numbers), "The file has these")
        try:
            with warnings_as_notes("--machine: "):
                machine = Stage.from_yaml(file) if of_stage else machine_from_yaml(file)
        except GeometryError as error:
            raise _in_file("--machine", error) from error
    elif numbers or of_stage:
        machine = _machine_of_numbers(numbers, unit)
    else:
        machine = Manipulator.paper()
    if limits is not None:
        ends = [leg_numbers(text, "--limits", len(machine.legs.names), single=True) for text in limits]
        machine = replace(machine, limits=MachineInUnits(machine, unit).read_limits("--limits", *ends))
    return MachineInUnits(machine, unit, tuple(typed), file)


def _machine_of_numbers(numbers: Record, unit: LengthUnit) -> Manipulator | Stage:
    """Return the machine of dimensions: a stage, or with --middle a manipulator whose stages have the same legs."""
    for name in ("base", "platform"):
        if name not in numbers:
            option = f"--{name}" if numbers else "--machine"
            raise ArgumentError(option, "a radius, or --machine with a file, which spm-pin write makes", "neither")
    scaled = {name: x if name in ("slide", "sign") else x / unit.per_metre for name, x in numbers.items()}
    base, platform, middle = (scaled.pop(name, None) for name in ("base", "platform", "middle"))
    kind: Any
    kind, by = (RRS, "--crank") if "crank" in scaled else (PRS, "--rod") if "rod" in scaled else (RPS, "")
    for name in scaled:
        if _ARGUMENTS.get(name, name) not in {field.name for field in fields(kind)}:
            raise cannot_be_used(f"--{name}", by or "legs without --rod")
    if kind is RRS and "rod" not in scaled:
        raise ArgumentError("--rod", "the length of the rods together with --crank", "none")
    if "slide" in scaled:
        scaled["slide"] = math.radians(scaled["slide"])
    try:
        legs = kind(**{_ARGUMENTS.get(name, name): value for name, value in scaled.items()})
        with warnings_as_notes("--unit: "):
            if middle is None:
                return Stage(base, platform, legs)
            return Manipulator(base, platform, middle, legs=(legs, legs))
    except GeometryError as error:
        options = {argument: name for name, argument in _ARGUMENTS.items()} | {"legs": "rod"}
        raise error.replaced(argument=f"--{options.get(error.argument, error.argument)}") from error


def _by_option(error: ArgumentError, names: dict[str, str], values: Record) -> ArgumentError:
    """Return an error about an argument as one about the option that was typed, or about its file."""
    argument = error.argument
    if argument.startswith("--"):
        return error
    for name, path in values.items():
        if isinstance(path, Path) and argument == "path" and error.received == path:
            return error.replaced(argument=names[name])
        if isinstance(path, Path) and error.file == str(path):
            return _in_file(names[name], error)
    if isinstance(path := values.get(argument), Path):
        return error.replaced(argument=f"{names[argument]} {path}")
    options = ARGUMENT_OPTIONS.get(argument, "")
    if argument in names or not set(options.split(", ")) <= set(names.values()):
        options = ", ".join(names.get(each, each) for each in argument.split(", "))
    return error.replaced(argument=options)


def _in_file(option: str, error: ArgumentError) -> ArgumentError:
    """Return an error in a file as one that also names the option of the file."""
    if error.argument:
        return error.replaced(argument=f"{option}: {error.argument}")
    return error.replaced(argument=f"{option}: {error.file}" + f":{error.line}" * bool(error.line), file="")


def _option_name(parameter: inspect.Parameter) -> str:
    """Return what a user types for a parameter of a command: its option, or the argument's name in the help."""
    for info in getattr(parameter.annotation, "__metadata__", ()):
        if isinstance(info, ArgumentInfo):
            return str(info.metavar)
        # If there are several names, typer takes the first for a default.
        for declared in (getattr(info, "default", None), *(getattr(info, "param_decls", None) or ())):
            if isinstance(declared, str) and declared.startswith("--"):
                return declared.partition("/")[0]
    return f"--{parameter.name.replace('_', '-')}"


@contextlib.contextmanager
def warnings_as_notes(before: str = "") -> Iterator[None]:
    """Print warnings of a block on stderr."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        note(f"{before}{warning.message}", "yellow")


def leg_numbers(text: str, option: str, count: int, *, single: bool = False) -> FloatArray:
    """Read six or three numbers separated by commas, shape (count,), or if allowed a single one, shape ()."""
    try:
        numbers = np.array([] if "_" in text else [float(x) for x in text.split(",")])  # Python reads 1_2 as 12
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != count and not (single and numbers.size == 1):
        several = f"{'six' if count == 6 else 'three'} numbers separated by commas"
        raise ArgumentError(option, f"a number, or {several}" if single else several, repr(text))
    return numbers if numbers.size == count else numbers[0]


def read_masses(path: Path | None, what: str) -> Masses | None:
    """Return the masses of `--masses`; without it None, with a note that masses are assumed in `what`."""
    if path is not None:
        return Masses.from_yaml(path)
    note(f"{what} with assumed masses, in proportion to the machine's size; --masses FILE gives the machine's")
    return None
