"""The request of a command: a pose of a manipulator, or a height and a tilt of a stage.

What else differs between the two kinds of machine on the command line is here too: the numbers that describe a state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from spm_pin.cli.units import MachineInUnits
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, PoseError, sentence
from spm_pin.kinematics.forward_displacement import forward_physical, starting_configuration
from spm_pin.kinematics.inverse_displacement import inverse_displacement, inverse_physical
from spm_pin.machine import FAMILIES, LegLimits, SolutionSet, Status, pose
from spm_pin.machine.branch_of_state import branch_sign, family
from spm_pin.machine.solutions import BELOW

Record = dict[str, Any]
Triple = tuple[float, float, float]
OptionTable = dict[str, tuple[Any, str, str]]
"""Options by name: type, name of the value in the help, and help."""

_SMALL_TURN = 1.5
"""Turns of a pose smaller than this may have been typed in radians [degrees]."""
_INSET = 1e-4
"""Distance of a nearest pose from the leg limits, as a fraction of the strokes."""
_BESIDE = 1e-3 * np.array([0.0, -1.0, 1.0, -2.0, 2.0])
"""Changes of a rounded tilt and azimuth [°] that are tried until a reachable one is found."""
_PLURALS = {"branch": "branches", "mode": "modes", "assembly mode": "assembly modes"}
_WAYS: tuple[set[str], ...] = {"tilt", "azimuth"}, {"roll", "pitch"}, {"normal"}


@dataclass(frozen=True)
class Request:
    """A place of the platform, as it was typed: the pose of a manipulator."""

    typed: MachineInUnits
    arguments: Record
    """Arguments of `inverse_displacement`."""
    prefix: str = ""
    """Beginning of the options' names, such as from-."""

    options: ClassVar[OptionTable] = {
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
    needed: ClassVar[str] = "translation"
    """Option without which there is no request."""
    named: ClassVar[str] = "--translation"
    """Options that errors name."""
    reached: ClassVar[str] = "a pose with a real branch"
    """Description of a request that has a solution, for errors."""
    solution: ClassVar[str] = "branch"
    """Name of a solution of the inverse displacement."""

    @classmethod
    def of_state(cls, state: Any, typed: MachineInUnits) -> Self:
        """Return the request of a state's pose."""
        return cls(typed, {"pose": state.pose})

    @staticmethod
    def start(machine: Any) -> Any:
        """Return a regular configuration near the home."""
        return starting_configuration(machine)

    @classmethod
    def read(cls, options: Record, typed: MachineInUnits, prefix: str = "") -> Self:
        """Return the pose of `--translation` and one orientation; angles are in degrees."""
        translation, *_ = options.values()
        _, *orientations = options
        chosen = [name for name in orientations if options[name] is not None]
        if translation is None:
            received = f"--{prefix}{chosen[0]} alone"
            raise ArgumentError(f"--{prefix}translation", "a position with the orientation", received)
        if len(chosen) != 1:
            names = ", ".join(f"--{prefix}{name}" for name in orientations)
            argument = " and ".join(f"--{prefix}{name}" for name in chosen) or f"--{prefix}translation"
            received = f"{len(chosen)} orientations" if chosen else "none"
            raise ArgumentError(argument, f"one orientation, of {names}", received)
        (name,) = chosen
        value = np.array(options[name])
        if name in ("xyx", "rpy", "rotvec"):
            if not np.isfinite(value).all():
                raise PoseError(f"--{prefix}{name}", "finite angles in degrees", " ".join(f"{x:g}" for x in value))
            value = np.deg2rad(value if name == "rotvec" else np.fmod(value, 360.0))
        try:
            shaped = value.reshape(3, 3) if name == "matrix" else value
            return cls(typed, {"pose": pose(np.array(translation) / typed.unit.per_metre, **{name: shaped})}, prefix)
        except PoseError as error:
            raise error.replaced(argument=f"--{prefix}{error.argument}") from error

    @classmethod
    def content(cls, state: Any, typed: MachineInUnits) -> Record:
        """Return the pose, the middle joints and the leg lengths."""
        rotation = state.pose.rotation
        angles = {"xyx": "XYX", "rpy": "xyz"}
        return {
            "translation": state.translation * typed.unit.per_metre,
            **{name: rotation.as_euler(x, degrees=True, suppress_warnings=True) for name, x in angles.items()},
            "quat": rotation.as_quat(),
            "rotation": state.rotation,
            "middle_joints": state.middle_joints * typed.unit.per_metre,
            "leg_lengths": state.leg_lengths * typed.unit.per_metre,
        }

    def hint(self) -> str:
        """Return a hint on the unit of the position."""
        return self.typed.hint(f"--{self.prefix}translation", self._pose.translation * self.typed.unit.per_metre)

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except ArgumentError as error:
            if error.argument not in self.options:
                raise
            raise error.replaced(argument=f"--{self.prefix}{error.argument}") from error

    def solve(self) -> Any:
        """Return the solutions of the inverse displacement."""
        with self._named():
            return inverse_displacement(self.typed.machine, **self.arguments)

    def physical(self) -> Any:
        """Return the physical state."""
        with self._named():
            return inverse_physical(self.typed.machine, **self.arguments)

    @property
    def _pose(self) -> Any:
        return self.arguments["pose"]

    def remarks(self, solutions: Any) -> list[str]:
        """Return sentences on a pose with no isolated branches, or a continuous family of them."""
        if hint := self.hint():
            return [hint]
        remarks = family_remarks(solutions)
        if solutions.status is Status.UNREACHABLE and not remarks:
            turn = np.rad2deg(self._pose.rotation.magnitude())
            only = f" It is turned by {turn:.2g}° only: angles are in degrees." * bool(turn < _SMALL_TURN)
            remarks.append(f"No configuration holds this pose, whatever the readings.{only}")
        if solutions.ambiguous:
            either = "Two branches are physical, on either side of an inverse singularity; the straighter is likelier."
            remarks.append(either)
        return remarks

    def nearest(self) -> tuple[Any, str, float] | None:
        """Return the nearest reachable pose, to 0.1 µm and 1e-5 degrees, and its distance; None without leg limits."""
        machine, unit = self.typed.machine, self.typed.unit
        if machine.limits is None:
            return None
        from spm_pin.workspace.poses import nearest_reachable_pose

        state, distance = self.physical(), 0.0
        if not state.exists or state.limit_excess.any():
            # Inset the limits, so that the printed (rounded) pose is reachable.
            ends = machine.limits.ends
            inset = _INSET * np.where(np.isfinite(ends).all(axis=0), ends[1] - ends[0], machine.size)
            found = nearest_reachable_pose(machine, self._pose, LegLimits(ends[0] + inset, ends[1] - inset))
            state, distance = found.configuration, found.distance
        numbers = self.content(state, self.typed)
        position = " ".join(unit.text(x, 2) for x in numbers["translation"])
        angles = " ".join(fixed(x, 5) for x in numbers["rpy"])
        return state, f"--translation {position} --rpy {angles}{unit.option}", distance * unit.per_metre


class TiltRequest(Request):
    """A height and a tilt of a stage."""

    options: ClassVar[OptionTable] = {
        "height": (
            float,
            "LENGTH",
            "Height of the platform's centre above the pivots, in --unit; default: the middle.",
        ),
        "tilt": (float, "DEGREES", "Tilt of the platform; default: level."),
        "azimuth": (float, "DEGREES", "Direction in which it is lowest; default: 0, along x. Legs: -30, 90 and 210."),
        "roll": (float, "DEGREES", "In place of --tilt, with --pitch: angle about x."),
        "pitch": (float, "DEGREES", "Angle about y."),
        "normal": (Triple, "X Y Z", "In place of --tilt: the platform's normal, of any length."),
    }
    needed, named, solution = "", "--height, --tilt", "mode"
    reached = "a height and a tilt that the stage reaches"

    @classmethod
    def read(cls, options: Record, typed: MachineInUnits, prefix: str = "") -> Self:
        """Return the height and the tilt of options, by default the level platform in the middle of its heights."""
        height = options["height"]
        place = {name: x for name, x in options.items() if x is not None and name != "height"}
        if not any(place.keys() <= way for way in _WAYS):
            several = " and ".join(f"--{prefix}{name}" for name in place)
            raise ArgumentError(
                several, "only one of: --tilt and --azimuth; --roll and --pitch; --normal", "more than one"
            )
        if not 0.0 <= place.get("tilt", 0.0) < 180.0:
            cause = "For a tilt to the opposite side change the azimuth"
            expected = "an angle in degrees, from 0 to less than 180"
            raise ArgumentError(f"--{prefix}tilt", expected, f"{place['tilt']:g}", cause)
        for name in place.keys() - {"normal"}:
            if not abs(place[name]) <= 360.0:
                expected = "an angle in degrees, of at most one turn"
                raise ArgumentError(f"--{prefix}{name}", expected, f"{place[name]:g}")
            place[name] = math.radians(math.remainder(place[name], 360.0))
        if "azimuth" in place and "tilt" not in place:
            raise ArgumentError(f"--{prefix}tilt", "a tilt together with --azimuth", "none")
        if "tilt" in place:
            place.setdefault("azimuth", 0.0)
        if height is None:
            from spm_pin.workspace import home_height

            height = home_height(typed.machine) * typed.unit.per_metre
        return cls(typed, {"height": height / typed.unit.per_metre, **place}, prefix)

    @classmethod
    def content(cls, state: Any, typed: MachineInUnits) -> Record:
        """Return the tilt, the height and the parasitic motion."""
        angles = {name: np.degrees(getattr(state, name)) for name in ("tilt", "azimuth", "roll", "pitch", "torsion")}
        lengths = {name: getattr(state, name) * typed.unit.per_metre for name in ("height", "shift", "translation")}
        return {**angles, **lengths, "rotation": state.rotation}

    @classmethod
    def of_state(cls, state: Any, typed: MachineInUnits) -> Self:
        """Return the request of a state's height and normal."""
        return cls(typed, {"height": float(state.height), "normal": state.normal})

    @staticmethod
    def start(machine: Any) -> Any:
        """Return the level state in the middle of the heights."""
        return TiltRequest.read(dict.fromkeys(TiltRequest.options), MachineInUnits(machine)).physical()

    def hint(self) -> str:
        """Return a hint on the unit of the height."""
        return self.typed.hint(f"--{self.prefix}height", self.arguments["height"] * self.typed.unit.per_metre)

    def remarks(self, solutions: Any) -> list[str]:
        """Return the reason why there is no solution, and whether the height is below the pivots."""
        if hint := self.hint():
            return [hint]
        reason = solutions.configurations.missing_reason if not solutions.count else ""
        is_below = not (reason or solutions.is_physical.any()) and self.arguments["height"] < 0.0
        return [f"{sentence(reason)}."] * bool(reason) + [f"{BELOW}."] * is_below

    def nearest(self) -> tuple[Any, str, float] | None:
        """Return the nearest tilt, rounded to a reachable one, and its angle; of several, one with less tilt."""
        from spm_pin.workspace import nearest_reachable_pose

        unit = self.typed.unit
        with self._named():
            found = nearest_reachable_pose(self.typed.machine, **self.arguments)
        nearest: Any = found.configuration
        if not nearest.exists:
            return None
        tilt = max(math.floor(1e3 * math.degrees(nearest.tilt) - 0.1) / 1e3, 0.0)
        level, wanted = float(nearest.height * unit.per_metre), self.arguments["height"]
        if not math.isclose(nearest.height, wanted):
            level += math.copysign(1e-4 * level, nearest.height - wanted)
        azimuth = math.degrees(nearest.azimuth) if tilt else 0.0
        # If the level platform is beyond the limits, less tilt may be as well.
        tilts, azimuths = np.meshgrid(np.maximum(tilt + _BESIDE, 0.0), azimuth + _BESIDE, indexing="ij")
        places = {"tilt": np.radians(tilts), "azimuth": np.radians(azimuths)}
        states = inverse_physical(nearest.machine, level / unit.per_metre, **places)
        counts = states.exists & (states.limit_excess == 0.0).all(axis=-1)
        first = int(counts.argmax())
        text = f"--tilt {fixed(tilts.flat[first], 3)} --azimuth {fixed(azimuths.flat[first], 5)}"
        return nearest, f"--height {unit.text(level, 1)} {text}{unit.option}", math.degrees(found.distance)


def request_of(machine: Any) -> type[Request]:
    """Return the kind of request that a machine has."""
    return TiltRequest if machine.is_stage else Request


def family_remarks(solutions: Any) -> list[str]:
    """Return sentences on a level pose that is held nowhere, or on a continuous family of solutions."""
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


def solve_request(typed: MachineInUnits, request: Request | None, readings: Any) -> tuple[Any, list[str]]:
    """Return the solutions of a request, or the state of readings, and remarks if there is no solution."""
    if request is not None and readings is None:
        solutions = request.solve()
        return solutions, request.remarks(solutions)
    if request is not None or readings is None:
        raise ArgumentError("--legs", "readings or a pose", "neither" if readings is None else "both")
    state = forward_physical(typed.machine, readings)
    label = "T" if typed.machine.is_stage else FAMILIES[int(family(state))] + "+-"[int(branch_sign(state) < 0.0)]
    status = Status.OK if state.exists else Status.UNREACHABLE
    solutions = SolutionSet(state.transformed(lambda array, _: array[None]), (label,), status)
    return solutions, [] if state.exists else readings_remarks(typed, readings)


def readings_remarks(typed: MachineInUnits, readings: Any) -> list[str]:
    """Return a sentence on why readings have no physical state."""
    hint = typed.readings_hint("--legs", readings * typed.scale)
    return [hint or "A stage cannot be closed with these readings."]


def selected_labels(solutions: Any, labels: Iterable[str] | None, *, required: bool = False) -> list[str]:
    """Return the branches of `--branch`, or all real ones.

    A named branch must be real if others are; if `required`, also if no branch is real.
    """
    real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
    if required and labels is not None and not real:
        cause = " ".join([*family_remarks(solutions)[:1], "Without --branch the state requested is shown"])
        expected = "a branch that is real at the pose requested, which has none"
        raise ArgumentError("--branch", expected, ", ".join(labels), cause)
    if not real or labels is None:
        return real
    chosen = {typed: typed.upper() for typed in labels}
    absent = [typed for typed, label in chosen.items() if label not in real]
    if absent:
        raise ArgumentError("--branch", f"real branches, here {', '.join(real)}", ", ".join(absent))
    return list(chosen.values())


def exit_code(status: Any, physical: Any) -> int:
    """Return the exit code of a command whose displacement has a status and perhaps a `physical` solution.

    3 if it is unreachable, 4 if degenerate, 5 if there is no physical solution within the limits, otherwise 0.
    """
    held = bool(physical.exists) and not physical.limit_excess.any()
    codes = {Status.OK: 0 if held else 5, Status.UNREACHABLE: 3, Status.DEGENERATE: 4}
    return codes.get(Status(int(status)), 1)


def state_records(solutions: Any, labels: Iterable[str], compute: Any) -> list[Record]:
    """Return a record of each solution: its label, marks, and what `compute` returns for its state."""
    records, is_physical = [], solutions.is_physical
    for label in labels:
        state = solutions[label]
        beyond = np.flatnonzero(state.limit_excess)
        marks = {"physical": bool(is_physical[solutions.labels.index(label)]), "within_limits": not beyond.size}
        records.append({"label": label, **marks, "beyond_limits": beyond, **compute(state)})
    return records


def state_mark(record: Record) -> str:
    """Return the mark of a state in a table: a star for a leg beyond its limits."""
    return "physical" * bool(record["physical"]) + "*" * (not record["within_limits"])


def state_remarks(records: list[Record], physical: Any, what: str) -> list[str]:
    """Return sentences on the marks of the states shown, and on a missing physical state."""
    names, remarks = physical.machine.legs.names, []
    beyond = [", ".join(names[leg] for leg in record["beyond_limits"]) for record in records]
    if any(beyond):
        own = [legs for legs, record in zip(beyond, records, strict=True) if record["physical"] and len(beyond) > 1]
        of_physical = "".join(f"; of the physical {what}: {legs or 'none'}" for legs in own)
        remarks = [f"* {beyond[0] if len(beyond) == 1 else 'a leg'} beyond the limits{of_physical}"]
    if records and not physical.exists:
        home = "level platform" if physical.machine.is_stage else "home"
        remarks.append(f"No {what} is physical: none is reached from the {home} without a forward singularity.")
    return remarks


def status_line(solutions: Any, what: str, typed: MachineInUnits) -> str:
    """Return a sentence on the status of solutions, called `what`: how many are real, and their closure residual."""
    line = f"status: {solutions.status}"
    if len(solutions.labels) > 1:
        line += f", {solutions.count} of {len(solutions.labels)} {_PLURALS[what]} real"
    if not solutions.count:
        return line
    residual = np.nanmax(solutions.configurations.closure_residual) * typed.unit.per_metre
    return f"{line}, closure residual up to {residual:.0e} {typed.unit}"


def solutions_content(solutions: Any, typed: MachineInUnits) -> Record:
    """Return the JSON content common to all solutions: their units, the status, and any continuous family."""
    degeneracy = solutions.degeneracy
    family = degeneracy and {name: getattr(degeneracy, name) for name in ("dimension", "families", "legs")}
    return {**typed.content(), "status": str(solutions.status), "degeneracy": family}
