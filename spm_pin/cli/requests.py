"""The request of a command: a pose of a manipulator, or a height and a tilt of a stage.

What else differs between the two kinds of machine on the command line is here too: the numbers that describe a state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from spm_pin.cli.units import MachineInUnits
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, sentence
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
_INSET = 2e-5
"""Distance of a nearest state from the limits, as a fraction of the strokes: what is printed is rounded."""


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
        "quat": (tuple[(float,) * 4], "X Y Z W", "In place of --xyx: unit quaternion, scalar last."),  # type: ignore[misc]
        "rotvec": (Triple, "X Y Z", "In place of --xyx: rotation vector, its length the angle in degrees."),
        "matrix": (tuple[(float,) * 9], "R11 ... R33", "In place of --xyx: matrix from {m} to {B}, row by row."),  # type: ignore[misc]
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
    def read(cls, options: Record, typed: MachineInUnits, prefix: str = "") -> Self:
        """Return the pose of `--translation` and one orientation; angles are in degrees."""
        position, *turns = (f"--{prefix}{name}" for name in cls.options)
        if len(options) != 2 or "translation" not in options:
            received = " and ".join(f"--{prefix}{name}" for name in options)
            raise ArgumentError(position, f"a position and one orientation, of {', '.join(turns)}", received)
        (_, translation), (name, numbers) = options.items()
        value = np.array(numbers)
        if name in ("xyx", "rpy"):
            value = np.fmod(value, 360.0)
        if name in ("xyx", "rpy", "rotvec"):
            value = np.deg2rad(value)
        request = cls(typed, {}, prefix)
        with request._named():
            place = pose(
                np.array(translation) / typed.unit.per_metre,
                **{name: value.reshape(3, 3) if name == "matrix" else value},
            )
        return replace(request, arguments={"pose": place})

    @classmethod
    def of_state(cls, state: Any, typed: MachineInUnits) -> Self:
        """Return the request of a state's pose."""
        return cls(typed, {"pose": state.pose})

    @staticmethod
    def start(machine: Any) -> Any:
        """Return a regular configuration near the home."""
        return starting_configuration(machine)

    @classmethod
    def content(cls, state: Any, typed: MachineInUnits) -> Record:
        """Return the pose, the middle joints and the leg lengths."""
        rotation, lengths = state.pose.rotation, ("translation", "middle_joints", "leg_lengths")
        return {
            **{name: getattr(state, name) * typed.unit.per_metre for name in lengths},
            "xyx": rotation.as_euler("XYX", degrees=True, suppress_warnings=True),
            "rpy": rotation.as_euler("xyz", degrees=True, suppress_warnings=True),
            "quat": rotation.as_quat(),
            "rotation": state.rotation,
        }

    @classmethod
    def options_of(cls, state: Any, typed: MachineInUnits) -> str:
        """Return the options of a state, to 0.1 µm and 1e-5 degrees."""
        numbers = cls.content(state, typed)
        position = " ".join(typed.unit.text(x, 2) for x in numbers["translation"])
        return f"--translation {position} --rpy {' '.join(fixed(x, 5) for x in numbers['rpy'])}{typed.unit.option}"

    def distance_text(self, distance: float) -> str:
        """Return the distance of a nearest pose [m] for a table."""
        return f"{self.typed.unit.text(distance * self.typed.unit.per_metre, 1)} {self.typed.unit}"

    def hint(self) -> str:
        """Return a hint on the unit of the position."""
        length = float(np.linalg.norm(self.arguments["pose"].translation)) * self.typed.unit.per_metre
        return self.typed.hint(f"--{self.prefix}translation", length)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Name options instead of arguments in errors."""
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

    def remarks(self, solutions: Any) -> list[str]:
        """Return sentences on a pose with no isolated branches, or a continuous family of them."""
        if hint := self.hint():
            return [hint]
        remarks = family_remarks(solutions)
        if solutions.status is Status.UNREACHABLE and not remarks:
            turn = np.rad2deg(self.arguments["pose"].rotation.magnitude())
            only = f" It is turned by {turn:.2g}° only: angles are in degrees." * bool(turn < _SMALL_TURN)
            remarks.append(f"No configuration holds this pose, whatever the readings.{only}")
        if solutions.ambiguous:
            either = "Two branches are physical, on either side of an inverse singularity; the straighter is likelier."
            remarks.append(either)
        return remarks

    def nearest(self) -> tuple[Any, float] | None:
        """Return the nearest state that is reached and its distance [m, rad]; None if none is, or without limits."""
        from spm_pin.workspace.poses import nearest_reachable_pose

        machine, state = self.typed.machine, self.physical()
        if machine.limits is None and not machine.is_stage:
            return None
        if state.exists and not state.limit_excess.any():
            return state, 0.0
        if machine.limits is not None:
            ends = machine.limits.ends
            inset = _INSET * np.where(np.isfinite(ends).all(axis=0), ends[1] - ends[0], machine.size)
            machine = replace(machine, limits=LegLimits(ends[0] + inset, ends[1] - inset))
        with self._named():
            found = nearest_reachable_pose(machine, **self.arguments)
        return (found.configuration, found.distance) if found.configuration.exists else None


class TiltRequest(Request):
    """A height and a tilt of a stage."""

    options: ClassVar[OptionTable] = {
        "height": (float, "LENGTH", "Height of the platform's centre above the pivots, in --unit; default: home."),
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
        place = dict(options)
        for name in place.keys() & {"azimuth", "roll", "pitch"}:
            place[name] = math.radians(math.remainder(place[name], 360.0))
        if "azimuth" in place and "tilt" not in place:
            raise ArgumentError(f"--{prefix}tilt", "a tilt together with --azimuth", "none")
        if "tilt" in place:
            place = {"azimuth": 0.0} | place
            if not 0.0 <= place["tilt"] < 180.0:
                cause = "For a tilt to the opposite side change the azimuth"
                expected = "an angle in degrees, from 0 to less than 180"
                raise ArgumentError(f"--{prefix}tilt", expected, f"{place['tilt']:g}", cause)
            place["tilt"] = math.radians(place["tilt"])
        if "height" in place:
            place["height"] /= typed.unit.per_metre
        else:
            from spm_pin.workspace import home_height

            place["height"] = home_height(typed.machine)
        return cls(typed, place, prefix)

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
        return TiltRequest.read({}, MachineInUnits(machine)).physical()

    @classmethod
    def options_of(cls, state: Any, typed: MachineInUnits) -> str:
        """Return the options of a state, with a slightly smaller tilt: rounding does not pass the end of the reach."""
        height, azimuth = state.height * typed.unit.per_metre, math.degrees(state.azimuth)
        tilt = (1.0 - 1e-6) * math.degrees(state.tilt)
        return f"--height {height:.10g} --tilt {tilt:.10g} --azimuth {azimuth:.10g}{typed.unit.option}"

    def distance_text(self, distance: float) -> str:
        """Return the angle between the normals [rad] for a table."""
        return f"{math.degrees(distance):.3f}°"

    def hint(self) -> str:
        """Return a hint on the unit of the height."""
        length = abs(self.arguments["height"]) * self.typed.unit.per_metre
        return self.typed.hint(f"--{self.prefix}height", length)

    def nearest(self) -> tuple[Any, float] | None:
        """Return the nearest state at this height, or inside the range of heights, and the angle of the normals."""
        reached, wanted = super().nearest(), self.arguments["height"]
        if reached is None or math.isclose(height := float(reached[0].height), wanted):
            return reached
        inside = height + math.copysign(1e-4 * height, height - wanted)
        return replace(self, arguments=self.arguments | {"height": inside}).nearest()

    def remarks(self, solutions: Any) -> list[str]:
        """Return the reason why there is no solution, and whether the height is below the pivots."""
        if hint := self.hint():
            return [hint]
        reason = solutions.configurations.missing_reason if not solutions.count else ""
        is_below = not (reason or solutions.is_physical.any()) and self.arguments["height"] < 0.0
        return [f"{sentence(reason)}."] * bool(reason) + [f"{BELOW}."] * is_below


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
    size = int(degeneracy.dimension)
    remarks = [f"The solutions of {families} form a continuous family of dimension {size} and are omitted."]
    if degeneracy.legs.all():
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
    return solutions, [] if state.exists else [readings_remark(typed, readings)]


def readings_remark(typed: MachineInUnits, readings: Any) -> str:
    """Return a sentence on why readings have no physical state."""
    hint = typed.readings_hint("--legs", readings * typed.scale)
    return hint or "A stage cannot be closed with these readings."


def selected_labels(solutions: Any, labels: Iterable[str] | None, *, required: bool = False) -> list[str]:
    """Return the branches of `--branch`, or all real ones.

    A named branch must be real if others are; if `required`, also if no branch is real.
    """
    real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
    chosen = {typed: typed.upper() for typed in labels or ()}
    absent = [typed for typed, label in chosen.items() if label not in real]
    if absent and (real or required):
        cause = "" if real else " ".join([*family_remarks(solutions)[:1], "Without --branch the state is shown"])
        expected = f"real branches, here {', '.join(real) or 'none'}"
        raise ArgumentError("--branch", expected, ", ".join(absent), cause)
    return list(chosen.values()) if chosen and real else real
