"""Common options of subcommands, and what they stand for in SI: machines, poses, states, branches."""

from __future__ import annotations

import contextlib
import enum
import functools
import inspect
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.spatial.transform import RigidTransform

from spm_pin.cli.outputs import note
from spm_pin.description.masses import Masses
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, PoseError
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.kinematics.forward_displacement import forward_physical, set_of_one, starting_configuration
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.machine import (
    FAMILIES,
    Configuration,
    Manipulator,
    SolutionSet,
    Stage,
    StageConfiguration,
    Status,
    pose,
)
from spm_pin.machine.branch_of_state import branch_sign, family
from spm_pin.machine.machine import PER_METRE, Machine, likely_unit
from spm_pin.machine.manipulator import machine_from_yaml
from spm_pin.support.arguments import BoolArray, FloatArray


class LengthUnit(enum.StrEnum):
    """Units of length on the command line."""

    M = "m"
    CM = "cm"
    MM = "mm"

    @property
    def per_metre(self) -> float:
        """Number of units in a metre."""
        return PER_METRE[self.value]

    def text(self, length: float, more: int = 0) -> str:
        """Return a length in this unit for a table, to hundredths of a millimetre, or with more decimals."""
        return fixed(length, {"m": 5, "cm": 3, "mm": 2}[self.value] + more)


@dataclass(frozen=True)
class Readings:
    """Units in which a command reads and prints readings: lengths in --unit, angles in degrees."""

    machine: Machine
    unit: LengthUnit

    @property
    def are_angles(self) -> BoolArray:
        """True for the legs whose readings are angles, shape (6,), or (3,) for a stage alone."""
        return np.asarray(np.array(self.machine.legs.units) == "rad")

    @property
    def scale(self) -> FloatArray:
        """Number of units in a metre, or in a radian, (6,)."""
        return np.where(self.are_angles, 180.0 / np.pi, self.unit.per_metre)

    @property
    def units(self) -> list[str]:
        """Units of the six readings, "deg" for degrees."""
        return ["deg" if is_angle else str(self.unit) for is_angle in self.are_angles]

    @property
    def heading(self) -> str:
        """Unit of all legs, or units of both stages."""
        return self.stages(str(self.unit), "degrees")

    def stages(self, length: str, angle: str) -> str:
        """Return `length` or `angle` if all legs have the same, otherwise one for each stage."""
        lower, upper = (angle if is_angle else length for is_angle in self.are_angles[::3])
        return lower if lower == upper else f"{lower} (r_b1 to r_b3) and {upper} (r_c1 to r_c3)"

    def read(self, option: str, typed: Any) -> FloatArray:
        """Return typed readings in [m, rad], one for all legs or one each; cranks turn by at most one turn."""
        angles = self._angles(typed)
        if (angles > 360.0).any():
            raise ArgumentError(option, "angles of cranks in degrees, of at most one turn", f"{angles.max():g}")
        return np.asarray(np.array(typed) / self.scale)

    def read_limits(self, option: str, minimum: Any, maximum: Any) -> list[list[float]]:
        """Return typed limits in [m, rad], with a note on their unit if another one is likely."""
        if hint := self.hint(option, maximum):
            note(hint, "yellow")
        if (wrong := np.ravel(np.greater_equal(minimum, maximum))).any():
            low, high = (np.ravel(x)[wrong][0] for x in np.broadcast_arrays(minimum, maximum))
            raise ArgumentError(option, "minimum < maximum", f"{low:g} {high:g}", "Minimum and maximum exchanged?")
        largest = max([0.0, *self._angles(minimum), *self._angles(maximum)])
        if 0.0 < largest <= MOST_TURNED:
            degrees = f"{np.degrees(largest):.0f}°"
            note(f"{option} was read in degrees: {largest:g}° at most. In radians {largest:g} are {degrees}", "yellow")
        return [self.read(option, np.broadcast_to(x, self.are_angles.shape)).tolist() for x in (minimum, maximum)]

    def _angles(self, typed: Any) -> FloatArray:
        """Return the finite magnitudes of typed angles [degrees]."""
        angles = np.abs(np.broadcast_to(typed, self.are_angles.shape)[self.are_angles])
        return np.asarray(angles[np.isfinite(angles)])

    def text(self, reading: float, leg: int) -> str:
        """Return a reading, in its unit, for a table."""
        return fixed(reading, 3) if self.are_angles[leg] else self.unit.text(reading)

    def columns(self, after: str = "") -> dict[str, Any]:
        """Return the columns of readings in a table, with a star after those beyond their limits."""
        # The space in the heading is for the star.
        return {
            f"{name}{after} ": lambda row, leg=leg: (
                self.text(row["readings"][leg], leg) + " *"[leg in row["beyond_limits"]]
            )
            for leg, name in enumerate(self.machine.legs.names)
        }

    def hint(self, option: str, typed: Any) -> str:
        """Return `unit_hint` for the lengths among typed readings."""
        lengths = np.abs(np.broadcast_to(typed, self.are_angles.shape)[~self.are_angles])
        return unit_hint(option, lengths.max(), self.unit, self.machine) if lengths.size else ""


Triple = tuple[float, float, float]
SixLegs = tuple[float, float, float, float, float, float]


def leg_option(name: str, help_text: str) -> Any:
    """Return an option for six readings."""
    return typer.Option(name, metavar="B1 B2 B3 C1 C2 C3", help=help_text)


AnyLegs = Annotated[
    SixLegs | None, leg_option("--legs", "Readings of the legs in --unit, for cranks in degrees, instead of a pose.")
]
Unit = Annotated[LengthUnit, typer.Option(help="Unit of lengths, typed and printed.")]
MachineFile = Annotated[
    Path | None,
    typer.Option("--machine", "--geometry", metavar="FILE", help="YAML file of a machine; default: the paper's."),
]
MassesFile = Annotated[
    Path | None,
    typer.Option("--masses", metavar="FILE", help="YAML file of masses and payload; default: assumed masses."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Limits = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--limits",
        metavar="MIN MAX",
        help="Limits of all six readings, in --unit or degrees; default: the machine's.",
    ),
]
PREFIX = typer.Option("--prefix", help="Prefix of all names, such as left_.")
Branches = Annotated[
    list[str] | None, typer.Option("--branch", metavar="LABEL", help="Branch, such as TT+; may be repeated.")
]


_SMALL_TURN = 1.5
"""Turns of a pose smaller than this may have been typed in radians [degrees]."""


def read_machine(path: Path | Manipulator | None) -> Manipulator:
    """Return the machine of `--machine`, by default the paper's; warnings about the file are notes on stderr.

    One that other options describe, such as those of a stage, is returned as it is.
    """
    if not isinstance(path, Path):
        return path or Manipulator.paper()
    with warnings_as_notes("--machine: "):
        return Manipulator.from_yaml(path)


def read_machine_or_stage(path: Path | None) -> Manipulator | Stage:
    """Return the machine of `--machine` as `read_machine`, which may be a stage."""
    if path is None:
        return Manipulator.paper()
    with warnings_as_notes("--machine: "):
        return machine_from_yaml(path)


@contextlib.contextmanager
def warnings_as_notes(before: str = "") -> Iterator[None]:
    """Print warnings of a block on stderr."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        note(f"{before}{warning.message}", "yellow")


OptionTable = dict[str, tuple[Any, str, str]]
"""Options by name: type, name of the value in the help, and help."""
_POSE: OptionTable = {
    "translation": (Triple, "X Y Z", "Position of o in {B}, in --unit."),
    "xyx": (Triple, "ALPHA BETA LAMBDA", "The paper's X-Y-X Euler angles in degrees."),
    "rpy": (Triple, "ROLL PITCH YAW", "In place of --xyx: angles about the fixed axes X, Y, Z, as in URDF."),
    "quat": (tuple[float, float, float, float], "X Y Z W", "In place of --xyx: unit quaternion, scalar last."),
    "rotvec": (Triple, "X Y Z", "In place of --xyx: rotation vector, its length the angle in degrees."),
    "matrix": (
        tuple[float, float, float, float, float, float, float, float, float],
        "R11 ... R33",
        "In place of --xyx: rotation matrix from {m} to {B}, row by row.",
    ),
}
"""Options of a pose: position, then orientations."""


def takes_pose(
    argument: str = "pose", prefix: str = "", *, required: bool = True
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command with a pose as `argument`, so that it takes --translation and one orientation instead.

    The option names begin with `prefix`. If the pose is not `required`, it is None if no option is given.
    The command has an argument `unit`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        def read(typed: dict[str, Any], arguments: dict[str, Any]) -> RigidTransform | None:
            return _read_pose(typed, prefix, arguments["unit"], required)

        return with_options(command, argument, _POSE, read, prefix, needed=["translation"] if required else [])

    return decorate


def with_options(
    command: Callable[..., None],
    argument: str,
    table: OptionTable,
    read: Callable[[dict[str, Any], dict[str, Any]], Any],
    prefix: str = "",
    needed: Sequence[str] = (),
) -> Callable[..., None]:
    """Return a command that takes options, whose names begin with a prefix, in place of one of its arguments.

    `read` makes the argument from the values of the options, by their names in the table, None if not
    `needed` and not given, and from the command's other arguments.
    """
    options = {}
    for name, (kind, metavar, text) in table.items():
        option = typer.Option(f"--{prefix}{name}", metavar=metavar, help=text)
        options[name] = inspect.Parameter(
            f"{prefix}{name}".replace("-", "_"),
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if name in needed else None,
            annotation=Annotated[kind if name in needed else kind | None, option],
        )

    @functools.wraps(command)
    def run(**arguments: Any) -> None:
        typed = {name: arguments.pop(parameter.name) for name, parameter in options.items()}
        command(**arguments, **{argument: read(typed, arguments)})

    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        whole = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        parameters += options.values() if parameter.name == argument else [whole]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def _read_pose(typed: dict[str, Any], prefix: str, unit: LengthUnit, required: bool) -> RigidTransform | None:
    """Return the pose of `--translation` and one orientation; angles are in degrees."""
    translation, *_ = typed.values()
    _, *orientations = typed
    chosen = [name for name in orientations if typed[name] is not None]
    if not (required or chosen or translation is not None):
        return None
    if translation is None:
        received = f"--{prefix}{chosen[0]} alone"
        raise ArgumentError(f"--{prefix}translation", "a position with the orientation", received)
    if len(chosen) != 1:
        names = ", ".join(f"--{prefix}{name}" for name in orientations)
        argument = " and ".join(f"--{prefix}{name}" for name in chosen) or f"--{prefix}translation"
        raise ArgumentError(argument, f"one orientation, of {names}", f"{len(chosen)} of them" if chosen else "none")
    (name,) = chosen
    value = np.array(typed[name])
    if name in ("xyx", "rpy", "rotvec"):
        if not np.isfinite(value).all():
            raise PoseError(f"--{prefix}{name}", "finite angles in degrees", " ".join(f"{x:g}" for x in value))
        value = np.deg2rad(value if name == "rotvec" else np.fmod(value, 360.0))
    try:
        shaped = value.reshape(3, 3) if name == "matrix" else value
        return pose(np.array(translation) / unit.per_metre, **{name: shaped})
    except PoseError as error:
        raise error.replaced(argument=f"--{prefix}{error.argument}") from error


def six_numbers(text: str, option: str, *, single: bool = False) -> FloatArray:
    """Read six numbers separated by commas, shape (6,), or if allowed a single one, shape ()."""
    try:
        numbers = np.array([] if "_" in text else [float(x) for x in text.split(",")])  # Python reads 1_2 as 12
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != 6 and not (single and numbers.size == 1):
        expected = "a number, or six separated by commas" if single else "six numbers separated by commas"
        raise ArgumentError(option, expected, repr(text))
    return numbers if numbers.size == 6 else numbers[0]


def read_masses(path: Path | None, what: str) -> Masses | None:
    """Return the masses of `--masses`; without it None, with a note that masses are assumed in `what`."""
    if path is not None:
        return Masses.from_yaml(path)
    note(f"{what} with assumed masses, in proportion to the machine's size; --masses FILE gives the machine's")
    return None


def unit_hint(option: str, typed: Any, unit: LengthUnit, machine: Machine) -> str:
    """Return a hint on the unit if a length, or three in norm, is out of proportion to the machine; else empty."""
    length = float(np.linalg.norm(typed))
    better = likely_unit(machine, length / unit.per_metre, unit)
    if better is None:
        return ""
    size = float(f"{machine.size * unit.per_metre:.3g}")
    return (
        f"{option} was read in {unit}: {length:g} {unit}, on a machine of {size:g} {unit}. "
        f"In {better} it would be in proportion: --unit {better}, for all lengths."
    )


def pose_remarks(solutions: SolutionSet) -> list[str]:
    """Return sentences on why a pose has no isolated branches and what to do; none for other poses."""
    if solutions.status is Status.UNREACHABLE and abs(solutions.rotation[..., 2, 2]).max() == 1.0:
        return ["A level platform is held only with its centre o on the Z axis of the base, and then in many ways."]
    degeneracy = solutions.degeneracy
    if solutions.status is not Status.DEGENERATE or degeneracy is None:
        return []
    families = ", ".join(f for f, hit in zip(FAMILIES, degeneracy.families, strict=True) if hit)
    legs = [str(i + 1) for i in np.flatnonzero(degeneracy.legs)]
    of = "legs" if len(legs) > 1 else "leg"
    remarks = [
        f"The solutions of {families} form a continuous family of dimension {int(degeneracy.dimension)} and are "
        "omitted." + (f" Both planes of {of} {', '.join(legs)} coincide." if legs else "")
    ]
    if len(legs) == 3:
        remarks.append(
            "The platform is level, as in the symmetric home, where the pose alone does not determine the middle "
            "platform. Give readings instead (spm-pin forward, or --legs of draw and view), or a tilted pose; "
            "nearly level ones have branches, but far beyond usual leg limits."
        )
    return remarks


def status_content(solutions: SolutionSet, unit: LengthUnit) -> dict[str, Any]:
    """Return the JSON content common to all solutions: their units, the status, and any continuous family."""
    degeneracy = solutions.degeneracy
    units = Readings(solutions.machine, unit).units
    family = degeneracy and {name: getattr(degeneracy, name) for name in ("dimension", "families", "legs")}
    return {"unit": unit, "reading_units": units, "status": str(solutions.status), "degeneracy": family}


def status_line(solutions: SolutionSet, what: str, unit: LengthUnit) -> str:
    """Return a sentence on the status of solutions, called `what`: how many are real, and their closure residual."""
    line = f"status: {solutions.status}"
    if len(solutions.labels) > 1:
        line += f", {solutions.count} of {len(solutions.labels)} {what} real"
    if not solutions.count:
        return line
    return f"{line}, closure residual up to {np.nanmax(solutions.residual) * unit.per_metre:.0e} {unit}"


def selected_labels(solutions: SolutionSet, labels: list[str] | None, *, required: bool = False) -> list[str]:
    """Return the branches of `--branch`, or all real ones.

    A named branch must be real if others are; if `required`, also if no branch is real.
    """
    real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
    if required and labels is not None and not real:
        cause = " ".join([*pose_remarks(solutions)[:1], "Without --branch the state requested is shown"])
        expected = "a branch that is real at the pose requested, which has none"
        raise ArgumentError("--branch", expected, ", ".join(labels), cause)
    if not real or labels is None:
        return real
    chosen = [label.upper() for label in labels]
    absent = [typed for typed, label in zip(labels, chosen, strict=True) if label not in real]
    if absent:
        raise ArgumentError("--branch", f"real branches, here {', '.join(real)}", ", ".join(absent))
    return chosen


def exit_code(status: Any, physical: Configuration | StageConfiguration) -> int:
    """Return the exit code of a command whose displacement has a status and perhaps a `physical` solution.

    3 if it is unreachable, 4 if degenerate, 5 if there is no physical solution within the limits, otherwise 0.
    """
    held = bool(physical.exists) and not physical.limit_excess.any()
    codes = {Status.OK: 0 if held else 5, Status.UNREACHABLE: 3, Status.DEGENERATE: 4}
    return codes.get(Status(int(status)), 1)


def solve_pose(machine: Manipulator, pose: RigidTransform, unit: LengthUnit) -> tuple[SolutionSet, list[str]]:
    """Return the branches of the typed pose, and remarks on a pose with none or too many."""
    solutions = inverse_displacement(machine, pose)
    hint = unit_hint("--translation", pose.translation * unit.per_metre, unit, machine)
    remarks = [hint] if hint else pose_remarks(solutions)
    if solutions.status is Status.UNREACHABLE and not remarks:
        turn = np.rad2deg(pose.rotation.magnitude())
        only = f" It is turned by {turn:.2g}° only: angles are in degrees." * bool(turn < _SMALL_TURN)
        remarks.append(f"No configuration holds this pose, whatever the readings.{only}")
    return solutions, remarks


def solve_request(
    machine: Manipulator, pose: RigidTransform | None, legs: SixLegs | None, unit: LengthUnit
) -> tuple[SolutionSet, list[str]]:
    """Return the branches of the typed pose, or the state of `--legs`, and remarks if there is no solution."""
    if pose is not None and legs is None:
        return solve_pose(machine, pose, unit)
    if legs is None or pose is not None:
        raise ArgumentError("--legs", "readings or a pose", "neither" if legs is None else "both")
    state = forward_physical(machine, Readings(machine, unit).read("--legs", legs))
    label = FAMILIES[int(family(state))] + "+-"[int(branch_sign(state) < 0.0)]
    return set_of_one(state, label), [] if state.exists else legs_remarks(machine, legs, unit)


def legs_remarks(machine: Manipulator, legs: SixLegs, unit: LengthUnit) -> list[str]:
    """Return a sentence on why readings have no physical state."""
    hint = Readings(machine, unit).hint("--legs", legs)
    return [hint or "A stage cannot be closed with these readings."]


def requested_solutions(
    machine: Manipulator, pose: RigidTransform | None, legs: SixLegs | None, unit: LengthUnit
) -> tuple[SolutionSet, Configuration]:
    """Return the branches of the requested pose, and the one to use if none is named.

    That is the physical one, or else the first; with `legs` the state of these; without options, a regular
    configuration near the home.
    """
    if pose is None and legs is None:
        state = starting_configuration(machine)
        return inverse_displacement(machine, state.pose), state
    solutions, remarks = solve_request(machine, pose, legs, unit)
    if not solutions.count:
        if legs is not None:
            raise ArgumentError(
                "--legs", "readings with which the machine can be assembled", "others", " ".join(remarks)
            )
        if solutions.status is Status.UNREACHABLE:
            remarks.append("spm-pin nearest finds the nearest pose that is reached.")
        received = f"status {solutions.status}"
        raise ArgumentError("--translation", "a pose with a real branch", received, " ".join(remarks))
    state = solutions.physical()
    if not state.exists:
        note("no branch of this pose is physical", "yellow")
        state = solutions.configurations[int(solutions.exists.argmax())]
    return solutions if legs is None else inverse_displacement(machine, state.pose), state


def titled_branches(solutions: SolutionSet, labels: Sequence[str]) -> dict[str, Configuration]:
    """Return branches of a pose by the titles of their pictures."""
    titled, physical = {}, solutions.is_physical
    for k in map(solutions.labels.index, labels):
        state = solutions.configurations[k]
        marks = ", physical" * bool(physical[k]) + ", beyond limits" * bool(state.limit_excess.any())
        titled[solutions.labels[k] + marks] = state
    return titled


def state_content(state: Configuration, *, physical: bool) -> dict[str, Any]:
    """Return the JSON content of each state: whether it is physical, and which legs are beyond their limits."""
    beyond = np.flatnonzero(state.limit_excess)
    return {"physical": physical, "within_limits": not beyond.size, "beyond_limits": beyond}


def state_mark(content: dict[str, Any]) -> str:
    """Return the mark of a `state_content` in a table: a star for a leg beyond its limits."""
    return "physical" * bool(content["physical"]) + "*" * (not content["within_limits"])


def state_remarks(
    contents: Sequence[dict[str, Any]], physical: Configuration | StageConfiguration, what: str
) -> list[str]:
    """Return sentences on the marks of the states shown, and on a missing physical state."""
    names, remarks = physical.machine.legs.names, []
    beyond = [", ".join(names[leg] for leg in content["beyond_limits"]) for content in contents]
    if any(beyond):
        own = [legs for legs, content in zip(beyond, contents, strict=True) if content["physical"] and len(beyond) > 1]
        of_physical = "".join(f"; of the physical {what}: {legs or 'none'}" for legs in own)
        remarks = [f"* {beyond[0] if len(beyond) == 1 else 'a leg'} beyond the limits{of_physical}"]
    if contents and not physical.exists:
        home = "level platform" if isinstance(physical, StageConfiguration) else "home"
        remarks.append(f"No {what} is physical: none is reached from the {home} without a forward singularity.")
    return remarks
