"""The state of a session, and its changes by drags, readings, branches and loads, without a page."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.description.robot import read_robot
from spm_pin.description.tree import joint_values
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics import (
    Singularities,
    SingularityKind,
    determinant_gradients,
    forward_physical,
    inverse_displacement,
    leg_forces,
    singularities,
)
from spm_pin.kinematics.path_following import existing_share, last_on_line
from spm_pin.kinematics.random_states import random_states
from spm_pin.kinematics.readings import read_readings
from spm_pin.machine import FAMILIES, LEGS, Configuration, Manipulator, SolutionSet, Stage, Status
from spm_pin.machine.branch_of_state import family
from spm_pin.support.arguments import BoolArray, FloatArray, real_array
from spm_pin.support.pose import inverse_command
from spm_pin.workspace.poses import nearest_reachable_pose, pose_distance

SINGULARITIES = ("forward, lower", "forward, upper", "inverse")
"""The singularities that J_b, J_c and K have, in this order."""
ANGLES: dict[str, Literal["XYX", "xyz"]] = {"X-Y-X": "XYX", "roll, pitch, yaw": "xyz"}
"""Conventions of a platform's three angles, and SciPy's names for them: the paper's, and the fixed axes of a URDF."""
NEAR = 0.02
"""A singularity is near if legs that move by this fraction of d could reach it."""

_REACHED = 1e-6  # of d: distance at which a pose counts as reached
_SAME_BRANCH = 1e-4  # of d: closer joints are one solution
_FEW, _NEIGHBOURS = 64, 400  # states of each stage, of which all pairs are sampled, and pairs that span a slider
_STEPS = 48  # along a leg, to see how far the assembly mode lasts


def pose_coordinates(pose: RigidTransform, angles: str = "X-Y-X") -> FloatArray:
    """Return x, y, z [m] and three angles [degrees] of poses, in a convention of `ANGLES`, shape (..., 6)."""
    turned = pose.rotation.as_euler(ANGLES[angles], degrees=True, suppress_warnings=True)
    return np.concatenate([pose.translation, turned], axis=-1) + 0.0


@dataclass(frozen=True)
class ShownState:
    """The state of either machine shown, the requested pose and the load; derived values are computed on first use."""

    target: RigidTransform  # the requested pose of the platform in {B}; that of `shown` if legs were moved
    shown: Any
    distance: float  # root mean square distance of the balls from their requested positions [m]; 0 if reached
    wrench: FloatArray  # the load (f, m) on the platform at its origin in {B}, shape (6,) [N, N m]
    remarks: tuple[str, ...] = ()  # warnings about the motion that led here

    @cached_property
    def forces(self) -> FloatArray | None:
        """Efforts of the actuators (legs,); None if there are loads that they cannot balance."""
        try:
            return leg_forces(self.shown, self.wrench)
        except SingularConfigurationError:
            return None


@dataclass(frozen=True, kw_only=True)
class SessionState(ShownState):
    """A state of a manipulator."""

    label: str  # branch of `shown`; empty if its pose has none, because its solutions form a continuous family
    solutions: SolutionSet  # all branches of the pose of `shown`
    origin: tuple[str, FloatArray] | None = None  # where it began: the branch, and the determinants of J_b, J_c, K

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The real branches of the pose of `shown`."""
        return _real_branches(self.solutions)

    @cached_property
    def is_physical(self) -> bool:
        """Whether the state is reached from the home without a forward singularity."""
        return bool(self.shown.is_at_home)

    @cached_property
    def singularities(self) -> Singularities:
        """The singular values and determinants of J_b, J_c and K."""
        found: Singularities = singularities(self.shown)
        return found

    @cached_property
    def travel(self) -> FloatArray:
        """Travel of the legs to each of `SINGULARITIES` to first order (3,) [m], NaN if it is not defined.

        For legs other than RPS it is the travel of the balls along their rods.
        """
        try:
            gradients = np.linalg.norm(determinant_gradients(self.shown) / self.shown.slopes, axis=-1)
        except SingularConfigurationError:
            return np.where(self.singularities.rank < 6, 0.0, np.nan)
        return np.asarray(np.abs(self.singularities.determinants) / np.maximum(gradients, np.finfo(float).tiny))

    @cached_property
    def is_near(self) -> BoolArray:
        """True for `SINGULARITIES` that are near (3,), see `NEAR`."""
        return np.asarray((self.travel < NEAR * self.shown.machine.middle_side) | np.isnan(self.travel))

    @property
    def measures(self) -> list[Measure]:
        """Distances of `SINGULARITIES`."""
        singular, measures = self.singularities, []
        rows = zip(SINGULARITIES, self.is_near, self.travel, singular.sigma, singular.condition, strict=True)
        for name, is_near, travel, *numbers in rows:
            far = 10.0 * NEAR * self.shown.machine.middle_side
            share, away = (min(travel / far, 1.0), length_text(travel)) if np.isfinite(travel) else (0.0, "–")
            measures.append(Measure(name, bool(is_near), share, away, *numbers))
        return measures

    @property
    def title(self) -> str:
        """Name of the branch."""
        return self.label or "no isolated branch"

    def pose_text(self, convention: str) -> str:
        """Return the position, and the angles in a convention."""
        values = pose_coordinates(self.shown.pose, convention)
        o, angles = (", ".join(fixed(x, n) for x in part) for part, n in ((values[:3], 3), (values[3:], 1)))
        return f"o = ({o}) m, {convention} = ({angles})\u2060°"

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings to the user, the most important first."""
        warnings = list(self.remarks)
        if self.origin is not None:
            label, determinants = self.origin
            renamed = f": {label} became {self.label}" if label and self.label and label != self.label else ""
            products = np.sign(determinants) * np.sign(self.singularities.scaled_determinants)
            crossed = [name for product, name in zip(products, SINGULARITIES, strict=True) if product < 0.0]
            warnings += [f"A singularity was crossed ({name}){renamed}." for name in crossed]
        for is_near, name, travel in zip(self.is_near, SINGULARITIES, self.travel, strict=True):
            if is_near:
                how = f"{1e3 * travel:.1f} mm of leg travel away" if np.isfinite(travel) else "at hand"
                warnings.append(f"Singularity ahead ({name}): about {how}.")
        warnings += excess_warnings(self.shown, self.forces)
        return warnings

    @cached_property
    def notes(self) -> list[str]:
        """Further remarks for the user."""
        notes = []
        if not self.label:
            notes.append("The branches of this pose form a continuous family; none is chosen.")
        if not self.is_physical:
            notes.append("Not physical: not reached from the home without a forward singularity.")
        return notes


class Model(ABC):
    """A session's state and its transitions; `file` is the file of the machine. Not thread-safe."""

    state: ShownState
    kind: ClassVar[type[ShownState]] = ShownState

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self.hold_limits = True  # whether a machine within its leg limits stays there

    def load(self, wrench: npt.ArrayLike) -> Any:
        """Apply a wrench (f, m) to the platform at its origin in {B} [N, N m]."""
        load = real_array(wrench, "wrench", (6,), "(f, m) at the platform's origin in {B} in N and N m")
        self.state = replace(self.state, wrench=load)
        return self.state

    def set_readings(self, readings: npt.ArrayLike) -> Any:
        """Move to readings of all encoders in the assembly mode, as far as it exists."""
        before = self.state.shown
        target = read_readings(before.machine, readings)
        # The physical mode is solved directly, without following a path.
        shown = forward_physical(before.machine, target, near=None if before.is_at_home else before)
        share, remarks = 1.0, []
        if not shown.exists:
            shown, share = last_on_line(before, target)
        if share < 1.0:
            text = f"a forward singularity is in the way. Shown: the last on the way, at {100 * share:.0f} %."
            remarks = [f"These readings are not reached: {text}"]
        return self._show(shown.pose, shown, remarks=remarks)

    def place(self, configuration: Configuration) -> Any:
        """Show a configuration."""
        return self._show(configuration.pose, configuration, jump=True)

    def _show(
        self,
        target: RigidTransform,
        shown: Configuration,
        *,
        distance: float = 0.0,
        remarks: Sequence[str] = (),
        jump: bool = False,
    ) -> Any:
        """Replace the state; after a `jump` no singularity counts as crossed."""
        self.state = self.kind(target, shown, distance, self.state.wrench, tuple(remarks))
        return self.state

    def reading_ranges(self) -> FloatArray:
        """Return the ends (legs, 2) of the legs' sliders, in the units of readings."""
        shown = self.state.shown
        machine, now = shown.machine, np.array(shown.readings)
        longest, legs, limits = 3.0 * machine.size, machine.legs, machine.limits
        are_lengths = np.array(legs.units) == "m"
        high, low = np.where(are_lengths, longest, 1.5 * np.pi), np.where(are_lengths, -longest, -0.5 * np.pi)
        low = np.maximum(low, legs.least_readings + 0.02 * machine.size)
        if limits is not None:
            low, high = np.maximum(low, limits.minimum), np.minimum(high, limits.maximum)
        low, high = np.minimum(low, now), np.maximum(high, now)
        if shown.is_at_home and (limits is None or not limits.are_finite):
            solve = partial(forward_physical, machine)
            for ends in (low, high):
                shares = existing_share(solve, now, now + np.diag(ends - now), parts=_STEPS, rounds=1)
                ends[:] = now + shares * (ends - now)
        return np.stack([low, high], axis=-1)

    @abstractmethod
    def command(self, digits: int | None = 7) -> str:
        """Return the `spm-pin inverse` command for the state shown, to a number of decimals, or to float64's digits."""

    def data(self) -> dict[str, Any]:
        """Return the state shown as data for JSON, in metres, radians and newtons."""
        state, shown = self.state, self.state.shown
        names = shown.machine.legs.names
        return {
            "geometry": {"leg_limits": None, **shown.machine.as_data()},
            "pose": shown.pose.as_matrix(),
            "reached": state.distance == 0.0,
            "readings": dict(zip(names, shown.readings, strict=True)),
            "closure_residual": shown.closure_residual,
            "wrench": state.wrench,
            "leg_forces": None if state.forces is None else dict(zip(names, state.forces, strict=True)),
            "command": self.command(digits=None),
        }


class ViewerModel(Model):
    """A manipulator's state and its transitions, from a configuration that exists."""

    state: SessionState

    conventions: ClassVar[dict[str, tuple[str, ...]]] = {
        "X-Y-X": ("x [m]", "y [m]", "z [m]", "α [°]", "β [°]", "λ [°]"),
        "roll, pitch, yaw": ("x [m]", "y [m]", "z [m]", "roll [°]", "pitch [°]", "yaw [°]"),
    }
    """Labels of the pose's sliders, by the convention of its angles."""
    coordinates = staticmethod(pose_coordinates)
    hint = "The paper's X-Y-X, or about the fixed axes X, Y, Z as in a URDF"
    values_name = "q"

    def __init__(self, start: Configuration, file: Path | None = None) -> None:
        super().__init__(file)
        self.joints = [joint.name for joint in read_robot(start.machine).moving]
        solutions = inverse_displacement(start.machine, start.pose)
        label = _label(solutions, start, "")
        self.state = SessionState(start.pose, start, 0.0, np.zeros(6), label=label, solutions=solutions)

    def drag(self, target: RigidTransform) -> SessionState:
        """Move to a pose on the branch, or to the nearest reachable one."""
        before, machine = self.state.shown, self.state.shown.machine
        label = self.state.label or FAMILIES[max(int(family(before)), 0)] + "+"
        solutions = inverse_displacement(machine, target)
        wanted = solutions[label]
        limited = self.hold_limits and machine.limits is not None and not before.limit_excess.any()
        if wanted.exists and not (limited and wanted.limit_excess.any()):
            return self._show(target, wanted, solutions)
        if limited:
            nearest = nearest_reachable_pose(machine, target, near=before)
        else:
            nearest = nearest_reachable_pose(machine, target, machine.legs.free_limits, branch=label, near=before)
        shown, distance = nearest.configuration, nearest.distance
        if not shown.exists:  # rounding may decide at the edge; the state shown is reachable in any case
            shown, distance = before, pose_distance(machine, before.pose, target)
        if distance <= _REACHED * machine.middle_side:
            return self._show(target, shown)
        return self._show(target, shown, distance=distance, remarks=[_out_of_reach(solutions, label, distance)])

    def select(self, label: str) -> SessionState:
        """Take another branch of the shown pose; raise `ArgumentError` if it does not exist."""
        before = self.state
        if label not in before.labels:
            raise ArgumentError("label", f"one of {', '.join(before.labels) or 'no branches'}", repr(label))
        self.place(before.solutions[label])
        return self.drag(before.target)

    def pose_of(self, coordinates: FloatArray, convention: str) -> RigidTransform:
        """Return the pose of coordinates (6,) as `coordinates` returns them."""
        turn = Rotation.from_euler(ANGLES[convention], coordinates[3:], degrees=True)
        return RigidTransform.from_components(coordinates[:3], turn)

    def pose_ranges(self, convention: str) -> FloatArray:
        """Return the ends (6, 2) [m, degrees] of the pose's sliders, those of the nearest sampled states."""
        shown = self.state.shown
        poses, tree = _sampled_poses(shown.machine)
        now = pose_coordinates(shown.pose, convention)
        nearest = poses[tree.query(shown.platform_joints.ravel(), _NEIGHBOURS)[1]]
        steps = np.atleast_2d(pose_coordinates(nearest, convention) - now)
        steps[:, 3:] = (steps[:, 3:] + 180.0) % 360.0 - 180.0
        ends = now + np.stack([steps.min(axis=0, initial=0.0), steps.max(axis=0, initial=0.0)])
        ends[:, 3:] = np.clip(ends[:, 3:], -180.0, 180.0)
        return np.asarray(ends.T)

    def command(self, digits: int | None = 7) -> str:
        """Return the `spm-pin inverse` command for the state shown, to a number of decimals, or to float64's digits."""
        values = pose_coordinates(self.state.shown.pose)
        values = values if digits is None else values.round(digits)
        is_paper = self.state.shown.machine == Manipulator.paper()
        file = "FILE" if self.file is None and not is_paper else self.file
        return inverse_command({"translation": values[:3], "xyx": values[3:]}, None if file is None else str(file))

    def values(self) -> FloatArray:
        """Return q of the state shown, in Pinocchio's order [rad, m]."""
        values = joint_values(self.state.shown)
        return np.array([values[joint] for joint in self.joints])

    def data(self) -> dict[str, Any]:
        """Return the state shown as data for JSON, in metres, radians and newtons."""
        state, shown, kind = self.state, self.state.shown, self.state.singularities
        numbers = {name: getattr(kind, name) for name in ("sigma", "condition", "scaled_determinants")}
        numbers["leg_travel"] = state.travel
        return super().data() | {
            "branch": state.label or None,
            "translation": shown.translation,
            "xyx": np.deg2rad(pose_coordinates(shown.pose)[3:]),
            "rpy": np.deg2rad(pose_coordinates(shown.pose, "roll, pitch, yaw")[3:]),
            "leg_lengths": dict(zip(LEGS, shown.leg_lengths, strict=True)),
            "middle_joints": shown.middle_joints,
            "q": dict(zip(self.joints, self.values(), strict=True)),
            "physical": state.is_physical,
            "singularity": {
                "kind": str(SingularityKind(int(kind.kind))),
                **{name: dict(zip(("J_b", "J_c", "K"), row, strict=True)) for name, row in numbers.items()},
            },
        }

    def _show(
        self,
        target: RigidTransform,
        shown: Configuration,
        solutions: SolutionSet | None = None,
        *,
        distance: float = 0.0,
        remarks: Sequence[str] = (),
        jump: bool = False,
    ) -> SessionState:
        """Replace the state; `solutions` are those of the pose of `shown`, solved here if not given."""
        if solutions is None:
            solutions = inverse_displacement(shown.machine, shown.pose)
        before = self.state
        label = _label(solutions, shown, before.label)
        origin = None if jump else (before.label, before.singularities.scaled_determinants)
        given = target, shown, distance, before.wrench, tuple(remarks)
        self.state = SessionState(*given, label=label, solutions=solutions, origin=origin)
        return self.state


class ReadingUnit(NamedTuple):
    """The unit in which a reading is shown."""

    name: str
    factor: float  # times a reading
    digits: int

    def text(self, reading: float) -> str:
        """Return a reading as it is shown."""
        return fixed(self.factor * reading, self.digits) + "°" * (self.name == "°")

    def difference(self, difference: float, digits: int) -> str:
        """Return a difference of readings as it is shown."""
        if self.name == "°":
            return f"{fixed(self.factor * difference, digits)}°"
        return length_text(difference, digits)


def reading_units(machine: Manipulator | Stage) -> list[ReadingUnit]:
    """Return the units of the readings shown: metres, for a stage millimetres, or degrees."""
    lengths = {"stage": ReadingUnit("mm", 1e3, 1), "spm": ReadingUnit("m", 1.0, 3)}
    units = {"m": lengths[machine.file_stem], "rad": ReadingUnit("°", math.degrees(1.0), 1)}
    return [units[unit] for unit in machine.legs.units]


class Measure(NamedTuple):
    """Distance of a singularity."""

    name: str
    is_near: bool
    share: float  # length of its bar, from 0 to 1
    away: str  # travel of the legs, if it is known
    sigma: float  # smallest singular value
    condition: float | None


def excess_warnings(shown: Configuration, forces: FloatArray | None) -> list[str]:
    """Return warnings if legs are beyond their limits, or cannot hold a load."""
    units = reading_units(shown.machine)
    excess = zip(shown.machine.legs.names, shown.limit_excess, units, strict=True)
    over = ", ".join(f"{leg} by {unit.difference(abs(x), 1)}" for leg, x, unit in excess if x)
    warnings = [f"Beyond the leg limits: {over}."] if over else []
    return warnings if forces is not None else [*warnings, "The legs cannot hold every load here."]


def length_text(value: float, digits: int = 0) -> str:
    """Return a length in millimetres, or a long one in metres."""
    return f"{fixed(1e3 * value, digits)} mm" if abs(value) < 9.9995 else f"{fixed(value, 1)} m"


def _real_branches(solutions: SolutionSet) -> tuple[str, ...]:
    return tuple(str(label) for label in np.array(solutions.labels)[solutions.exists])


def _out_of_reach(solutions: SolutionSet, label: str, distance: float) -> str:
    """Return why a pose with these solutions is not reached on a branch, and the distance of the state shown [m]."""
    real = _real_branches(solutions)
    why = "beyond the leg limits" if label in real else f"{label} does not reach it"
    if solutions.status is Status.DEGENERATE and label not in real:
        why = "its branches form a continuous family, of which none is chosen"
    away = f"{1e3 * distance:.1f} mm" if distance > 1e-4 else "less than 0.1 mm"
    text = f"Pose out of reach: {why}. Shown: the nearest reachable one found, {away} away."
    return text if label in real or not real else f"{text} Other branches there: {', '.join(real)}."


def _label(solutions: SolutionSet, shown: Configuration, last: str) -> str:
    """Return the branch of a configuration; if two coincide, the previous one."""
    gaps = np.linalg.norm(solutions.middle_joints - shown.middle_joints, axis=-1).max(axis=-1)
    gaps = np.where(solutions.exists, gaps, np.inf)
    if not np.isfinite(gaps).any():
        return ""
    same = gaps <= max(_SAME_BRANCH * shown.machine.middle_side, 2.0 * float(gaps.min()))
    if last in solutions.labels and same[solutions.labels.index(last)]:
        return last
    return str(solutions.labels[int(gaps.argmin())])


@lru_cache(maxsize=4)
def sampled_states(machine: Manipulator) -> Configuration:
    """Return physical states (n,) within the leg limits, always the same: all pairs of a few states of each stage."""
    few = random_states(machine, _FEW, np.random.default_rng(0))
    middle = few.middle_pose.as_matrix()
    matrices = (middle[:, None] @ np.linalg.inv(middle) @ few.pose.as_matrix()).reshape(-1, 4, 4)
    joints = np.repeat(few.middle_joints, _FEW, axis=0)
    return Configuration.from_arrays(machine, matrices[:, :3, :3], matrices[:, :3, 3], joints)


@lru_cache(maxsize=4)
def _sampled_poses(machine: Manipulator) -> tuple[RigidTransform, KDTree]:
    """Return the poses (n,) of `sampled_states`, and the search tree of the places of their platform joints."""
    states = sampled_states(machine)
    return states.pose, KDTree(states.platform_joints.reshape(-1, 9))
