"""The state of a session and how drags, leg lengths, branches and loads change it, without any page."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.display.viewer.readings import SINGULARITIES, Readings
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.path_following import last_on_line
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
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.branches import family, physical
from spm_pin.workspace.poses import nearest_reachable_pose, pose_distance

_UNLIMITED = LegLimits(0.0, np.inf)
_REACHED = 1e-6  # of d
_SAME = 1e-4  # of d: closer joints are one solution


class Drive(enum.StrEnum):
    """The quantity that the user moves, as the page names it."""

    POSE = "platform pose"
    LEGS = "leg lengths"


@dataclass(frozen=True)
class Notice:
    """A sentence for the user."""

    level: Literal["info", "warning"]
    """How urgent it is."""
    text: str
    """The sentence."""


@dataclass(frozen=True)
class State:
    """State of a session: the configuration shown and the pose requested, its branches, readings, load and notices."""

    drive: Drive
    """The quantity moved last."""
    target: RigidTransform
    """The requested pose of {m} in {B}; that of `shown` where legs were moved."""
    shown: Configuration
    """The state of the manipulator."""
    label: str
    """Branch of `shown`; empty where its pose has none, because its solutions form a continuous family."""
    solutions: SolutionSet
    """All branches of the pose of `shown`."""
    distance: float
    """Root mean square distance of the c_i from where they should be [m]; 0 where the pose is reached."""
    readings: Readings
    """Instruments of `shown`."""
    wrench: FloatArray
    """The load (f, m) on the platform at o in {B}, shape (6,) [N, N m]."""
    notices: tuple[Notice, ...]
    """Sentences for the user, most important first."""

    @property
    def labels(self) -> tuple[str, ...]:
        """The real branches of the pose of `shown`."""
        return tuple(str(label) for label in np.array(self.solutions.labels)[self.solutions.exists])


class StateMachine:
    """A session's state and its transitions, from a configuration that exists. Not for several threads at once."""

    state: State

    def __init__(self, start: Configuration) -> None:
        self.geometry = start.geometry
        self.hold_limits = True
        """True if a machine that is within its leg limits stays there."""
        self._show(Drive.POSE, start.pose, start)

    def drag(self, pose: PoseLike) -> State:
        """Move to a pose on the branch, or to the nearest reachable one."""
        target = as_rigid_transform(pose)
        here, label = self.state.shown, self.state.label
        label = label or FAMILIES[max(int(family(here)), 0)] + "+"
        solutions = inverse_displacement(self.geometry, target)
        wanted = solutions[label]
        held = self.hold_limits and self.geometry.limits is not None and self.within_limits(here)
        if wanted.exists and (not held or self.within_limits(wanted)):
            return self._show(Drive.POSE, target, wanted, solutions)
        if held:
            nearest = nearest_reachable_pose(self.geometry, target, near=here)
        else:
            nearest = nearest_reachable_pose(self.geometry, target, _UNLIMITED, branch=label, near=here)
        found, distance = nearest.configuration, nearest.distance
        if not found.exists:  # at the edge rounding may decide; what is shown is reachable in any case
            found, distance = here, pose_distance(self.geometry, here.pose, target)
        if distance <= _REACHED * self.geometry.middle_side:
            return self._show(Drive.POSE, target, found)
        notice = _out_of_reach(solutions, label, distance)
        return self._show(Drive.POSE, target, found, distance=distance, remarks=[notice])

    def set_legs(self, leg_lengths: npt.ArrayLike) -> State:
        """Move to leg lengths (6,) [m] in the assembly mode, as far as it lasts."""
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres")
        here = self.state.shown
        # The physical mode is solved for, without a path to follow.
        found = forward_physical(self.geometry, lengths, seed=None if physical(here) else here)
        remarks = []
        if not found.exists:
            found, share = last_on_line(here, lengths)
            if share < 1.0:
                text = "These leg lengths are not reached: a forward singularity is in the way."
                remarks = [Notice("warning", f"{text} Shown: the last on the way, at {100 * share:.0f} %.")]
        return self._show(Drive.LEGS, found.pose, found, remarks=remarks)

    def select(self, label: str) -> State:
        """Take another branch of the shown pose; raises `ArgumentError` if it has no such branch."""
        if label not in self.state.labels:
            raise ArgumentError("label", f"one of {', '.join(self.state.labels) or 'no branches'}", repr(label))
        before = self.state
        chosen = before.solutions[label]
        state = self._show(before.drive, chosen.pose, chosen, before.solutions, jump=True)
        return state if before.drive is Drive.LEGS else self.drag(before.target)

    def load(self, wrench: npt.ArrayLike) -> State:
        """Put a wrench (f, m) on the platform at o in {B} [N, N m]."""
        load = real_array(wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        self.state = replace(self.state, wrench=load, readings=Readings(self.state.shown, load))
        return self.state

    def place(self, configuration: Configuration) -> State:
        """Show a configuration, as it is."""
        return self._show(Drive.POSE, configuration.pose, configuration, jump=True)

    def within_limits(self, configuration: Configuration) -> bool:
        """Return whether a configuration respects its leg limits, up to rounding."""
        limits = self.geometry.limits
        return limits is None or bool(limits.margin(configuration.leg_lengths) >= -1e-9 * self.geometry.middle_side)

    def _show(
        self,
        drive: Drive,
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
        readings = Readings(shown, wrench)
        notices = list(remarks)
        if before is not None and not jump:
            notices += _crossings(before, readings, label)
        notices += _warnings(readings, label)
        self.state = State(drive, target, shown, label, solutions, distance, readings, wrench, tuple(notices))
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


def _crossings(before: State, after: Readings, label: str) -> list[Notice]:
    was, now = (readings.singularities.scaled_determinants for readings in (before.readings, after))
    crossed = np.sign(was) * np.sign(now) < 0.0
    renamed = f": {before.label} became {label}" if before.label and label and label != before.label else ""
    names = [name for hit, name in zip(crossed, SINGULARITIES, strict=True) if hit]
    return [Notice("warning", f"A singularity was crossed ({name}){renamed}.") for name in names]


def _warnings(readings: Readings, label: str) -> list[Notice]:
    notices = []
    for near, name, travel in zip(readings.near, SINGULARITIES, readings.travel, strict=True):
        if near:
            how = f"{1e3 * travel:.1f} mm of leg travel away" if np.isfinite(travel) else "at hand"
            notices.append(Notice("warning", f"Singularity ahead ({name}): about {how}."))
    over = [f"{leg} by {1e3 * abs(x):.1f} mm" for leg, x in zip(LEGS, readings.beyond, strict=True) if x]
    if over:
        notices.append(Notice("warning", f"Beyond the leg limits: {', '.join(over)}."))
    if readings.forces is None:
        notices.append(Notice("warning", "The legs cannot hold every load here."))
    if not label:
        notices.append(Notice("info", "The branches of this pose form a continuous family; none is picked."))
    if not readings.physical:
        notices.append(
            Notice("info", "Not physical: the machine cannot get here from its home without a forward singularity.")
        )
    return notices
