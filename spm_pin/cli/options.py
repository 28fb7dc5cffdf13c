"""Options that several subcommands take, and what they request: geometries, poses, states, branches, in SI."""

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
    StageConfiguration,
    Status,
    pose,
)
from spm_pin.machine.branch_of_state import branch_sign, family
from spm_pin.machine.machine import PER_METRE, Machine, likely_unit
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
    """Units in which a command reads and prints readings: lengths in --unit, angles in degrees as those of a pose."""

    machine: Machine
    unit: LengthUnit

    @property
    def are_angles(self) -> BoolArray:
        """True for the legs whose readings are angles, shape (6,), of a stage alone (3,)."""
        return np.asarray(np.array(self.machine.legs.units) == "rad")

    @property
    def scale(self) -> FloatArray:
        """Number of units in a metre, or in a radian, (6,)."""
        return np.where(self.are_angles, 180.0 / np.pi, self.unit.per_metre)

    @property
    def units(self) -> list[str]:
        """Units of the six, "deg" for degrees."""
        return ["deg" if is_angle else str(self.unit) for is_angle in self.are_angles]

    @property
    def heading(self) -> str:
        """The unit of all legs, or those of the stages."""
        return self.stages(str(self.unit), "degrees")

    def stages(self, length: str, angle: str) -> str:
        """Return `length` or `angle`, as all legs have it, or one for each stage where the stages differ."""
        units = [angle if is_angle else length for is_angle in self.are_angles[::3]]
        return units[0] if len(set(units)) == 1 else "{} (r_b1 to r_b3) and {} (r_c1 to r_c3)".format(*units)

    def read(self, option: str, typed: Any) -> FloatArray:
        """Return readings typed [m, rad], one for all legs or one each; cranks of at most one turn."""
        angles = self._angles(typed)
        if (angles > 360.0).any():
            raise ArgumentError(option, "angles of cranks in degrees, of at most one turn", f"{angles.max():g}")
        return np.asarray(np.array(typed) / self.scale)

    def read_limits(self, option: str, minimum: Any, maximum: Any) -> list[list[float]]:
        """Return limits typed [m, rad], with a note on their unit where another one is likely."""
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
        """Return the finite sizes of the angles among what was typed [degrees]."""
        angles = np.abs(np.broadcast_to(typed, self.are_angles.shape)[self.are_angles])
        return np.asarray(angles[np.isfinite(angles)])

    def text(self, reading: float, leg: int) -> str:
        """Return a reading, in its unit, for a table."""
        return fixed(reading, 3) if self.are_angles[leg] else self.unit.text(reading)

    def columns(self, after: str = "") -> dict[str, Any]:
        """Return the columns of the readings of states in a table, a star beside those beyond their limits."""
        # The space in the heading stands for the star.
        return {
            f"{name}{after} ": lambda row, leg=leg: (
                self.text(row["readings"][leg], leg) + " *"[leg in row["beyond_limits"]]
            )
            for leg, name in enumerate(self.machine.legs.names)
        }

    def hint(self, option: str, typed: Any) -> str:
        """Return `unit_hint` of the lengths among readings typed."""
        lengths = np.abs(np.broadcast_to(typed, self.are_angles.shape)[~self.are_angles])
        return unit_hint(option, lengths.max(), self.unit, self.machine) if lengths.size else ""


Triple = tuple[float, float, float]
SixLegs = tuple[float, float, float, float, float, float]


def leg_option(name: str, help_text: str) -> Any:
    """Return an option of six readings."""
    return typer.Option(name, metavar="B1 B2 B3 C1 C2 C3", help=help_text)


AnyLegs = Annotated[
    SixLegs | None, leg_option("--legs", "Readings of the legs in --unit, of cranks in degrees, instead of a pose.")
]
Unit = Annotated[LengthUnit, typer.Option(help="Unit of lengths, in and out.")]
MachineFile = Annotated[
    Path | None,
    typer.Option("--machine", "--geometry", metavar="FILE", help="YAML file of a machine; the paper's if not given."),
]
MassesFile = Annotated[
    Path | None,
    typer.Option("--masses", metavar="FILE", help="YAML file of masses and payload; assumed if not given."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Limits = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--limits",
        metavar="MIN MAX",
        help="Limits of all six readings, in --unit or degrees; the machine's if not given.",
    ),
]
PREFIX = typer.Option("--prefix", help="Put before every name, such as left_.")
Branches = Annotated[
    list[str] | None, typer.Option("--branch", metavar="LABEL", help="Branch, such as TT+; may be repeated.")
]


_SMALL_TURN = 1.5
"""A pose turned by less may have been typed in radians [degrees]."""


def read_machine(path: Path | None) -> Manipulator:
    """Return the machine of `--machine`, by default the paper's; warnings about the file are notes on stderr."""
    if path is None:
        return Manipulator.paper()
    with warnings_as_notes("--machine: "):
        return Manipulator.from_yaml(path)


@contextlib.contextmanager
def warnings_as_notes(before: str = "") -> Iterator[None]:
    """Print warnings of a block on stderr."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        note(f"{before}{warning.message}", "yellow")


OptionTable = dict[str, tuple[Any, str, str]]
"""Options by their names: what they take, its name in the help, and the help."""
_POSE: OptionTable = {
    "translation": (Triple, "X Y Z", "Position of o in {B}, in --unit."),
    "xyx": (Triple, "ALPHA BETA LAMBDA", "The paper's X-Y-X Euler angles in degrees."),
    "rpy": (Triple, "ROLL PITCH YAW", "Instead: about the fixed axes X, Y, Z in degrees, as in URDF."),
    "quat": (tuple[float, float, float, float], "X Y Z W", "Instead: unit quaternion, scalar last."),
    "rotvec": (Triple, "X Y Z", "Instead: rotation vector, its length the angle in degrees."),
    "matrix": (
        tuple[float, float, float, float, float, float, float, float, float],
        "R11 ... R33",
        "Instead: rotation matrix from {m} to {B}, row by row.",
    ),
}
"""Options of a pose, its position and then its orientations."""


def takes_pose(
    argument: str = "pose", prefix: str = "", *, required: bool = True
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that has a pose as `argument`, so that it takes --translation and one orientation instead.

    The options have `prefix` before their names. If the pose is not `required`, it is None where no option is given.
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
    """Return a command that takes options, with a prefix before their names, in place of one of its arguments.

    `read` makes the argument from the values of the options, by their names in the table, None where one is not
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
    """Return the pose of `--translation` and one orientation, in degrees where these are angles."""
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
        raise PoseError(f"--{prefix}{error.argument}", error.expected, error.received, error.cause) from error


def leg_numbers(text: str, option: str, count: int, *, single: bool = False) -> FloatArray:
    """Read six or three numbers separated by commas, shape (count,), or where allowed a single one, shape ()."""
    try:
        numbers = np.array([] if "_" in text else [float(x) for x in text.split(",")])  # Python takes 1_2 for 12
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != count and not (single and numbers.size == 1):
        several = {6: "six", 3: "three"}[count]
        expected = f"a number, or {several} separated by commas" if single else f"{several} numbers separated by commas"
        raise ArgumentError(option, expected, repr(text))
    return numbers if numbers.size == count else numbers[0]


def read_masses(path: Path | None, what: str) -> Masses | None:
    """Return the masses of `--masses`; without it None, and a note that they are assumed in `what`."""
    if path is not None:
        return Masses.from_yaml(path)
    note(f"{what} with assumed masses, in proportion to the machine's size; --masses FILE gives the machine's")
    return None


def unit_hint(option: str, typed: Any, unit: LengthUnit, machine: Machine) -> str:
    """Return a hint at the unit where a length, or three in norm, is out of proportion to the machine, else nothing."""
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
    """Return sentences on why one pose has no isolated branches, and on the way on; none for other poses."""
    if solutions.status is Status.UNREACHABLE and abs(solutions.rotation[..., 2, 2]).max() == 1.0:
        return ["A level platform is held only with its centre o on the Z axis of the base, and then in many ways."]
    degeneracy = solutions.degeneracy
    if solutions.status is not Status.DEGENERATE or degeneracy is None:
        return []
    families = ", ".join(f for f, hit in zip(FAMILIES, degeneracy.families, strict=True) if hit)
    legs = [str(i + 1) for i in np.flatnonzero(degeneracy.legs)]
    of = "legs" if len(legs) > 1 else "leg"
    remarks = [
        f"The solutions of {families} form a continuous family of dimension {int(degeneracy.dimension)}, of which none "
        "is picked." + (f" Both planes of {of} {', '.join(legs)} coincide." if legs else "")
    ]
    if len(legs) == 3:
        remarks.append(
            "The platform is level, as in the symmetric home, where the pose alone does not determine the middle "
            "platform. Give readings instead (spm-pin forward, or --legs of draw and view), or a tilted pose; "
            "nearly level ones have branches, but far beyond usual leg limits."
        )
    return remarks


def status_content(solutions: SolutionSet, unit: LengthUnit) -> dict[str, Any]:
    """Return what `--json` says of all solutions: their units, the status, and any continuous family."""
    degeneracy = solutions.degeneracy
    units = Readings(solutions.machine, unit).units
    family = degeneracy and {name: getattr(degeneracy, name) for name in ("dimension", "families", "legs")}
    return {"unit": unit, "reading_units": units, "status": str(solutions.status), "degeneracy": family}


def status_line(solutions: SolutionSet, what: str, unit: LengthUnit) -> str:
    """Return a sentence on the status of solutions, called `what`: how many are real, how well they close."""
    line = f"status: {solutions.status}"
    if len(solutions.labels) > 1:
        line += f", {solutions.count} of {len(solutions.labels)} {what} real"
    if not solutions.count:
        return line
    return f"{line}, closure residual up to {np.nanmax(solutions.residual) * unit.per_metre:.0e} {unit}"


def selected_labels(solutions: SolutionSet, labels: list[str] | None, *, required: bool = False) -> list[str]:
    """Return the branches of `--branch`, or all real ones.

    A branch named must be real where others are; if `required`, also where no branch is real.
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
    """Return the exit code of a command whose displacement has a status and a `physical` solution, if that exists.

    3 if it is unreachable, 4 if degenerate, 5 if there is no physical solution within the limits, and else 0.
    """
    held = bool(physical.exists) and not physical.limit_excess.any()
    codes = {Status.OK: 0 if held else 5, Status.UNREACHABLE: 3, Status.DEGENERATE: 4}
    return codes.get(Status(int(status)), 1)


def solve_pose(machine: Manipulator, pose: RigidTransform, unit: LengthUnit) -> tuple[SolutionSet, list[str]]:
    """Return the branches of the pose typed, and remarks on one that has none or too many."""
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
    """Return the branches of the pose typed, or the one that `--legs` determine, and remarks where there are none."""
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
    """Return the branches of the requested pose, and the one to take if none is named.

    That is the physical one, or else the first; with `legs` the one they determine; with no option at all, a regular
    configuration near the home.
    """
    if pose is None and legs is None:
        state = starting_configuration(machine)
        return inverse_displacement(machine, state.pose), state
    solutions, remarks = solve_request(machine, pose, legs, unit)
    if not solutions.count:
        if legs is not None:
            raise ArgumentError("--legs", "readings with which the machine can be assembled", "none such", *remarks)
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
    """Return branches of a pose under the titles of their pictures."""
    titled, physical = {}, solutions.is_physical
    for k in map(solutions.labels.index, labels):
        state = solutions.configurations[k]
        marks = ", physical" * bool(physical[k]) + ", beyond limits" * bool(state.limit_excess.any())
        titled[solutions.labels[k] + marks] = state
    return titled


def state_content(state: Configuration, *, physical: bool) -> dict[str, Any]:
    """Return what `--json` says of every state: whether it is physical, and which legs are beyond their limits."""
    beyond = np.flatnonzero(state.limit_excess)
    return {"physical": physical, "within_limits": not beyond.size, "beyond_limits": beyond}


def state_mark(content: dict[str, Any]) -> str:
    """Return the mark of a `state_content` in a table: a star stands for a leg beyond its limits."""
    return "physical" * bool(content["physical"]) + "*" * (not content["within_limits"])


def state_remarks(
    contents: Sequence[dict[str, Any]], physical: Configuration | StageConfiguration, what: str
) -> list[str]:
    """Return sentences on the marks of the states shown, and on there being no `physical` one."""
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
