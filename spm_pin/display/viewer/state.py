"""The state of a session and how drags, leg lengths, branches and loads change it, without any page."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.path_following import follow
from spm_pin.display.viewer.readings import SINGULARITIES, Readings
from spm_pin.errors import ArgumentError
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
from spm_pin.workspace.reachability.nearest_pose import nearest_reachable_pose, pose_distance

__all__ = ["Drive", "Model", "Notice", "State"]

_UNLIMITED = LegLimits(0.0, np.inf)
_REACHED = 1e-6  # of d
_SAME = 1e-4  # of d: closer joints are one solution
_PARTS = 16  # into which a way that cannot be gone to its end is divided


class Drive(enum.StrEnum):
    """The quantity that the user moves."""

    POSE = "pose"
    LEGS = "legs"


@dataclass(frozen=True)
class Notice:
    """A sentence for the user."""

    level: Literal["info", "warning"]
    text: str


@dataclass(frozen=True)
class State:
    """One moment of a session."""

    drive: Drive  # the quantity moved last
    target: RigidTransform  # the requested pose; that of `shown` where legs were moved
    shown: Configuration  # the state of the manipulator
    label: str  # its branch; empty where its pose has none, because its solutions form a continuous family
    solutions: SolutionSet  # all branches of the pose of `shown`
    distance: float  # root mean square distance of the c_i from where they should be [m]; 0 where the pose is reached
    readings: Readings  # instruments of `shown`
    wrench: FloatArray  # the load (f, m) on the platform at o in {B} (6,) [N, N m]
    notices: tuple[Notice, ...]  # sentences for the user, most important first

    @property
    def labels(self) -> tuple[str, ...]:
        """The real branches of the pose of `shown`."""
        return tuple(str(label) for label in np.array(self.solutions.labels)[self.solutions.exists])


class Model:
    """A session's state and its changes, from a single configuration that exists. Not for several threads at once."""

    state: State

    def __init__(self, start: Configuration) -> None:
        self.geometry = start.geometry
        self.hold_limits = True
        """True if a machine that is within its leg limits stays there."""
        self._become(Drive.POSE, start.pose, start)

    def drag(self, pose: PoseLike) -> State:
        """Move to a pose on the branch, or to the nearest reachable one."""
        target = as_rigid_transform(pose)
        return self._become(Drive.POSE, target, *self._nearest(target))

    def set_legs(self, leg_lengths: npt.ArrayLike) -> State:
        """Move to leg lengths (6,) [m] in the assembly mode, as far as it lasts."""
        lengths = real_array(leg_lengths, "leg_lengths", (6,), "leg lengths in metres")
        here = self.state.shown
        # In the home mode no path needs to be followed.
        found = forward_physical(self.geometry, lengths, seed=None if physical(here) else here)
        remarks = []
        if not found.exists:
            found, share = self._last_on_the_way(here, lengths)
            if share < 1.0:
                text = "These leg lengths are not reached: a forward singularity is in the way."
                remarks = [Notice("warning", f"{text} Shown: the last on the way, at {100 * share:.0f} %.")]
        return self._become(Drive.LEGS, found.pose, found, remarks)

    def select(self, label: str) -> State:
        """Take another branch of the shown pose; raises `ArgumentError` if it has no such branch."""
        if label not in self.state.labels:
            raise ArgumentError("label", f"one of {', '.join(self.state.labels) or 'no branches'}", repr(label))
        before = self.state
        chosen = before.solutions[label]
        state = self._become(before.drive, chosen.pose, chosen, jump=True)
        return state if before.drive is Drive.LEGS else self.drag(before.target)

    def load(self, wrench: npt.ArrayLike) -> State:
        """Put a wrench (f, m) on the platform at o in {B} [N, N m]."""
        load = real_array(wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        self.state = replace(self.state, wrench=load, readings=Readings(self.state.shown, load))
        return self.state

    def place(self, configuration: Configuration) -> State:
        """Show a configuration, as it is."""
        return self._become(Drive.POSE, configuration.pose, configuration, jump=True)

    def within_limits(self, configuration: Configuration) -> bool:
        """Return whether a configuration respects its leg limits, up to rounding."""
        limits = self.geometry.limits
        return limits is None or bool(limits.margin(configuration.leg_lengths) >= -1e-9 * self.geometry.middle_side)

    def _nearest(self, target: RigidTransform) -> tuple[Configuration, list[Notice]]:
        """Return the configuration for a pose, and notices about it."""
        here, label = self.state.shown, self.state.label
        label = label or FAMILIES[max(int(family(here)), 0)] + "+"
        solutions = inverse_displacement(self.geometry, target)
        wanted = solutions[label]
        held = self.hold_limits and self.geometry.limits is not None and self.within_limits(here)
        if wanted.exists and (not held or self.within_limits(wanted)):
            return wanted, []
        others = [str(name) for name in np.array(solutions.labels)[solutions.exists] if name != label]
        why = "beyond the leg limits" if wanted.exists else f"{label} does not reach it"
        if solutions.status is Status.DEGENERATE and not wanted.exists:
            why = "its branches form a continuous family, of which none is picked"
        if held:
            nearest = nearest_reachable_pose(self.geometry, target, near=here)
        else:
            nearest = nearest_reachable_pose(self.geometry, target, _UNLIMITED, branch=label, near=here)
        # At the edge rounding may decide; what is shown is reachable in any case.
        found = nearest.configuration if nearest.configuration.exists else here
        distance = pose_distance(self.geometry, found.pose, target)
        if distance <= _REACHED * self.geometry.middle_side:
            return found, []
        away = f"{1e3 * distance:.1f} mm" if distance > 1e-4 else "less than 0.1 mm"
        text = f"Pose out of reach: {why}. Shown: the nearest reachable one found, {away} away."
        if not wanted.exists and others:
            text += f" Other branches there: {', '.join(others)}."
        return found, [Notice("warning", text)]

    def _last_on_the_way(self, start: Configuration, lengths: FloatArray) -> tuple[Configuration, float]:
        """Return the last configuration found on the straight way to leg lengths, and its share of the way."""
        if not physical(start):
            way = follow(self.geometry, np.stack([start.leg_lengths, lengths]), start, samples=4)
            return way.configurations[-1], float(way.parameters[-1])
        low, high, found = 0.0, 1.0, start
        for _ in range(3):
            shares = np.linspace(low, high, _PARTS + 1)[1:]
            between = start.leg_lengths + shares[:, None] * (lengths - start.leg_lengths)
            states = forward_physical(self.geometry, between)
            count = int(states.exists.argmin()) if not states.exists.all() else _PARTS
            if count:
                found, low = states[count - 1], float(shares[count - 1])
            high = float(shares[min(count, _PARTS - 1)])
        return found, low

    def _become(
        self,
        drive: Drive,
        target: RigidTransform,
        shown: Configuration,
        remarks: Sequence[Notice] = (),
        *,
        jump: bool = False,
    ) -> State:
        solutions = inverse_displacement(self.geometry, shown.pose)
        before: State | None = getattr(self, "state", None)
        label = _label(solutions, shown, before.label if before is not None else "")
        wrench = before.wrench if before is not None else np.zeros(6)
        readings = Readings(shown, wrench)
        distance = pose_distance(self.geometry, shown.pose, target)
        distance = 0.0 if distance <= _REACHED * self.geometry.middle_side else distance
        notices = list(remarks)
        if before is not None and not jump:
            notices += _crossings(before, readings, label)
        notices += _warnings(readings, label)
        self.state = State(drive, target, shown, label, solutions, distance, readings, wrench, tuple(notices))
        return self.state


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
    crossed = (
        np.sign(before.readings.singularities.scaled_determinants) * np.sign(after.singularities.scaled_determinants)
        < 0.0
    )
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
        notices.append(Notice("info", "A real machine does not get here without a forward singularity."))
    return notices
