"""The state of a session and how drags, leg readings, branches and loads change it, without any page."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.random_poses import command
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.path_following import last_on_line
from spm_pin.kinematics.platform_stiffness import compliance, principal_stiffness
from spm_pin.kinematics.rates_and_forces import leg_forces
from spm_pin.kinematics.singularity_analysis import SingularityKind, determinant_gradients, singularities
from spm_pin.mechanism import (
    FAMILIES,
    LEGS,
    Configuration,
    LegLimits,
    PoseLike,
    SolutionSet,
    Status,
    as_rigid_transform,
)
from spm_pin.mechanism.arguments import BoolArray, FloatArray, real_array
from spm_pin.mechanism.branches import family, physical
from spm_pin.multibody.chain import ClosedChain
from spm_pin.workspace.poses import nearest_reachable_pose, pose_distance

SINGULARITIES = ("forward, lower stage", "forward, upper stage", "inverse")
"""The singularities that J_b, J_c and K have, in this order."""

NEAR = 0.02
"""A singularity is near where legs moved by this share of d could reach it."""

_UNLIMITED = LegLimits(0.0, np.inf)
_REACHED = 1e-6  # of d
_SAME = 1e-4  # of d: closer joints are one solution
_LIMIT_ROUNDING = 1e-9  # relative to d


class Measures:
    """Measures of a single configuration that exists, under a wrench (6,) on the platform [N, N m].

    Axes of length three count J_b, J_c, K.
    """

    def __init__(self, state: Configuration, wrench: npt.ArrayLike) -> None:
        self._state = state
        self._wrench = wrench
        self.singularities = singularities(state)
        self.physical = bool(physical(state))
        """Whether the state is physical: reached from the symmetric home without a forward singularity."""

    @cached_property
    def limit_excess(self) -> FloatArray:
        """By how much the reading of each leg is above its largest (positive) or below its least (negative) [m]."""
        limits = self._state.geometry.limits
        excess = np.zeros(6) if limits is None else limits.excess(self._state.readings)
        return np.where(np.abs(excess) < _LIMIT_ROUNDING * self._state.geometry.middle_side, 0.0, excess)

    @cached_property
    def travel(self) -> FloatArray:
        """Leg travel to each singularity, shape (3,) [m], to first order; NaN where that says nothing.

        How far the leg lengths would have to move, in the Euclidean norm, to make the determinant zero: its absolute
        value over the norm of its gradient. The nearer, the more exact.
        """
        try:
            gradients = np.linalg.norm(determinant_gradients(self._state), axis=-1)
        except SingularConfigurationError:
            return np.where(self.singularities.rank < 6, 0.0, np.nan)
        return np.asarray(np.abs(self.singularities.determinants) / np.maximum(gradients, np.finfo(float).tiny))

    @property
    def near(self) -> BoolArray:
        """Which singularities are near, shape (3,); see `NEAR`."""
        return np.asarray((self.travel < NEAR * self._state.geometry.middle_side) | np.isnan(self.travel))

    @cached_property
    def forces(self) -> FloatArray | None:
        """Leg forces that hold the load (6,) [N]; None where the legs cannot hold every load."""
        try:
            return leg_forces(self._state, self._wrench) if self.min_stiffness else None
        except SingularConfigurationError:
            return None

    @cached_property
    def min_stiffness(self) -> float:
        """Translational stiffness at o where it is least, for legs of stiffness one; zero where they do not hold."""
        try:
            return float(principal_stiffness(compliance=compliance(self._state, 1.0)).translational[0])
        except SingularConfigurationError:
            return 0.0


class InputMode(enum.StrEnum):
    """What the user moves, as the page names it."""

    POSE = "platform pose"
    LEGS = "leg lengths"


@dataclass(frozen=True)
class Notice:
    """A sentence for the user."""

    level: Literal["info", "warning"]
    """How urgent it is."""
    text: str  # the sentence


@dataclass(frozen=True)
class State:
    """State of a session: the configuration shown and the pose requested, its branches, measures, load and notices."""

    mode: InputMode  # what was moved last
    target: RigidTransform  # the requested pose of {m} in {B}; that of `shown` where legs were moved
    shown: Configuration  # the state of the manipulator
    label: str  # branch of `shown`; empty where its pose has none, because its solutions form a continuous family
    solutions: SolutionSet  # all branches of the pose of `shown`
    distance: float  # root mean square distance of the c_i from where they should be [m]; 0 where the pose is reached
    measures: Measures  # instruments of `shown`
    wrench: FloatArray  # the load (f, m) on the platform at o in {B}, shape (6,) [N, N m]
    notices: tuple[Notice, ...]  # sentences for the user, most important first

    @property
    def labels(self) -> tuple[str, ...]:
        """The real branches of the pose of `shown`."""
        return tuple(str(label) for label in np.array(self.solutions.labels)[self.solutions.exists])


class ViewerModel:
    """A session's state and its transitions, from a configuration that exists. Not for several threads at once."""

    state: State

    def __init__(self, start: Configuration) -> None:
        self.geometry = start.geometry
        self.hold_limits = True
        """True if a machine that is within its leg limits stays there."""
        self._show(InputMode.POSE, start.pose, start)

    def drag(self, pose: PoseLike) -> State:
        """Move to a pose on the branch, or to the nearest reachable one."""
        target = as_rigid_transform(pose)
        here, label = self.state.shown, self.state.label
        label = label or FAMILIES[max(int(family(here)), 0)] + "+"
        solutions = inverse_displacement(self.geometry, target)
        wanted = solutions[label]
        held = self.hold_limits and self.geometry.limits is not None and self.within_limits(here)
        if wanted.exists and (not held or self.within_limits(wanted)):
            return self._show(InputMode.POSE, target, wanted, solutions)
        if held:
            nearest = nearest_reachable_pose(self.geometry, target, near=here)
        else:
            nearest = nearest_reachable_pose(self.geometry, target, _UNLIMITED, branch=label, near=here)
        shown, distance = nearest.configuration, nearest.distance
        if not shown.exists:  # at the edge rounding may decide; what is shown is reachable in any case
            shown, distance = here, pose_distance(self.geometry, here.pose, target)
        if distance <= _REACHED * self.geometry.middle_side:
            return self._show(InputMode.POSE, target, shown)
        notice = _out_of_reach(solutions, label, distance)
        return self._show(InputMode.POSE, target, shown, distance=distance, remarks=[notice])

    def set_readings(self, readings: npt.ArrayLike) -> State:
        """Move to encoder readings (6,) [m] in the assembly mode, as far as it lasts."""
        target = real_array(readings, "readings", (6,), "readings of the encoders in metres")
        here = self.state.shown
        # The physical mode is solved for, without a path to follow.
        shown = forward_physical(self.geometry, target, near=None if physical(here) else here)
        remarks = []
        if not shown.exists:
            shown, share = last_on_line(here, target)
            if share < 1.0:
                text = "These leg lengths are not reached: a forward singularity is in the way."
                remarks = [Notice("warning", f"{text} Shown: the last on the way, at {100 * share:.0f} %.")]
        return self._show(InputMode.LEGS, shown.pose, shown, remarks=remarks)

    def select(self, label: str) -> State:
        """Take another branch of the shown pose; raises `ArgumentError` if it has no such branch."""
        if label not in self.state.labels:
            raise ArgumentError("label", f"one of {', '.join(self.state.labels) or 'no branches'}", repr(label))
        before = self.state
        chosen = before.solutions[label]
        state = self._show(before.mode, chosen.pose, chosen, before.solutions, jump=True)
        return state if before.mode is InputMode.LEGS else self.drag(before.target)

    def load(self, wrench: npt.ArrayLike) -> State:
        """Put a wrench (f, m) on the platform at o in {B} [N, N m]."""
        load = real_array(wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        self.state = replace(self.state, wrench=load, measures=Measures(self.state.shown, load))
        return self.state

    def place(self, configuration: Configuration) -> State:
        """Show a configuration, as it is."""
        return self._show(InputMode.POSE, configuration.pose, configuration, jump=True)

    def within_limits(self, configuration: Configuration) -> bool:
        """Return whether a configuration respects its leg limits, up to rounding."""
        limits = self.geometry.limits
        return limits is None or bool(limits.margin(configuration.readings) >= -1e-9 * self.geometry.middle_side)

    def _show(
        self,
        mode: InputMode,
        target: RigidTransform,
        shown: Configuration,
        solutions: SolutionSet | None = None,
        *,
        distance: float = 0.0,
        remarks: Sequence[Notice] = (),
        jump: bool = False,
    ) -> State:
        """Replace the state; `solutions` are those of the pose of `shown`, solved here if not given."""
        if solutions is None:
            solutions = inverse_displacement(self.geometry, shown.pose)
        before: State | None = getattr(self, "state", None)
        label = _label(solutions, shown, before.label if before is not None else "")
        wrench = before.wrench if before is not None else np.zeros(6)
        measures = Measures(shown, wrench)
        notices = list(remarks)
        if before is not None and not jump:
            notices += _crossings(before, measures, label)
        notices += _warnings(measures, label)
        self.state = State(mode, target, shown, label, solutions, distance, measures, wrench, tuple(notices))
        return self.state


def _out_of_reach(solutions: SolutionSet, label: str, distance: float) -> Notice:
    """Return why a pose with these solutions is not reached on a branch, and how far away the state shown is [m]."""
    others = [str(name) for name in np.array(solutions.labels)[solutions.exists] if name != label]
    real = bool(solutions[label].exists)
    why = "beyond the leg limits" if real else f"{label} does not reach it"
    if solutions.status is Status.DEGENERATE and not real:
        why = "its branches form a continuous family, of which none is picked"
    away = f"{1e3 * distance:.1f} mm" if distance > 1e-4 else "less than 0.1 mm"
    text = f"Pose out of reach: {why}. Shown: the nearest reachable one found, {away} away."
    if others and not real:
        text += f" Other branches there: {', '.join(others)}."
    return Notice("warning", text)


def _label(solutions: SolutionSet, shown: Configuration, last: str) -> str:
    """Return which branch a configuration is; of two that coincide, the one it was."""
    gaps = np.linalg.norm(solutions.middle_joints - shown.middle_joints, axis=-1).max(axis=-1)
    gaps = np.where(solutions.exists, gaps, np.inf)
    same = gaps <= max(_SAME * shown.geometry.middle_side, 2.0 * float(gaps.min(initial=np.inf)))
    if not np.isfinite(gaps).any():
        return ""
    if last in solutions.labels and same[solutions.labels.index(last)]:
        return last
    return str(solutions.labels[int(gaps.argmin())])


def _crossings(before: State, after: Measures, label: str) -> list[Notice]:
    was, now = (measures.singularities.scaled_determinants for measures in (before.measures, after))
    crossed = np.sign(was) * np.sign(now) < 0.0
    renamed = f": {before.label} became {label}" if before.label and label and label != before.label else ""
    names = [name for hit, name in zip(crossed, SINGULARITIES, strict=True) if hit]
    return [Notice("warning", f"A singularity was crossed ({name}){renamed}.") for name in names]


def _warnings(measures: Measures, label: str) -> list[Notice]:
    notices = []
    for near, name, travel in zip(measures.near, SINGULARITIES, measures.travel, strict=True):
        if near:
            how = f"{1e3 * travel:.1f} mm of leg travel away" if np.isfinite(travel) else "at hand"
            notices.append(Notice("warning", f"Singularity ahead ({name}): about {how}."))
    over = [f"{leg} by {1e3 * abs(x):.1f} mm" for leg, x in zip(LEGS, measures.limit_excess, strict=True) if x]
    if over:
        notices.append(Notice("warning", f"Beyond the leg limits: {', '.join(over)}."))
    if measures.forces is None:
        notices.append(Notice("warning", "The legs cannot hold every load here."))
    if not label:
        notices.append(Notice("info", "The branches of this pose form a continuous family; none is picked."))
    if not measures.physical:
        notices.append(
            Notice("info", "Not physical: the machine cannot get here from its home without a forward singularity.")
        )
    return notices


def pose_coordinates(pose: RigidTransform) -> FloatArray:
    """Return x, y, z [m] and the X-Y-X angles [degrees] of poses (..., 6)."""
    angles = pose.rotation.as_euler("XYX", degrees=True, suppress_warnings=True)
    return np.concatenate([pose.translation, angles], axis=-1) + 0.0


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    values = pose_coordinates(configuration.pose)
    return command(values[:3], values[3:], None if geometry_file is None else str(geometry_file))


def state_data(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> dict[str, Any]:
    """Return the state as data for `spm_pin.display.output_files.to_json`, in metres, radians and newtons."""
    shown, measures = state.shown, state.measures
    kind = measures.singularities
    values = {name: getattr(kind, name) for name in ("sigma", "condition", "scaled_determinants")}
    values["leg_travel"] = measures.travel
    return {
        "geometry": {"leg_limits": None, **shown.geometry.as_data()},
        "branch": state.label or None,
        "pose": shown.pose.as_matrix(),
        "translation": shown.translation,
        "xyx": np.deg2rad(pose_coordinates(shown.pose)[3:]),
        "reached": state.distance == 0.0,
        "leg_lengths": dict(zip(LEGS, shown.leg_lengths, strict=True)),
        "readings": dict(zip(LEGS, shown.readings, strict=True)),
        "middle_joints": shown.middle_joints,
        "closure_residual": shown.closure_residual,
        "q": dict(zip(chain.joint_names, chain.joint_values(shown), strict=True)),
        "physical": measures.physical,
        "singularity": {
            "kind": str(SingularityKind(int(kind.kind))),
            **{name: dict(zip(("J_b", "J_c", "K"), numbers, strict=True)) for name, numbers in values.items()},
        },
        "wrench": state.wrench,
        "leg_forces": None if measures.forces is None else dict(zip(LEGS, measures.forces, strict=True)),
        "command": command_line(shown, geometry_file),
    }
