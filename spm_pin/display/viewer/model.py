"""The state of a session, and how drags, readings, branches and loads change it; without any page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.path_following import last_on_line, physical_mode_share
from spm_pin.kinematics.rates_and_forces import leg_forces
from spm_pin.kinematics.singularity_analysis import (
    Singularities,
    SingularityKind,
    determinant_gradients,
    singularities,
)
from spm_pin.mechanism import (
    FAMILIES,
    LEGS,
    Configuration,
    Geometry,
    LegLimits,
    PoseLike,
    SolutionSet,
    Status,
    as_rigid_transform,
    pose,
)
from spm_pin.mechanism.arguments import BoolArray, FloatArray, real_array
from spm_pin.mechanism.branch_of_state import family, physical
from spm_pin.mechanism.joint_angles import home_lengths
from spm_pin.mechanism.pose import inverse_command
from spm_pin.multibody.chain import ClosedChain
from spm_pin.workspace.poses import nearest_reachable_pose, pose_distance

SINGULARITIES = ("forward, lower", "forward, upper", "inverse")
"""The singularities that J_b, J_c and K have, in this order."""
ANGLES: dict[str, Literal["XYX", "xyz"]] = {"X-Y-X": "XYX", "roll, pitch, yaw": "xyz"}
"""Conventions of a platform's three angles, and SciPy's names of them: the paper's, and the fixed axes of a URDF."""
NEAR = 0.02
"""A singularity is near where legs moved by this share of d could reach it."""

_UNLIMITED = LegLimits(0.0, np.inf)
_REACHED = 1e-6  # of d: distance at which a pose counts as reached
_SAME_BRANCH = 1e-4  # of d: closer joints are one solution
_ROUNDING = 1e-9  # of d: a reading that far beyond a limit is at it
_SAMPLES, _NEIGHBOURS = 4000, 400  # states drawn once, and how many of them span a slider of the pose
_STEPS = 48  # along a leg, to see how far the assembly mode lasts


class Notice(NamedTuple):
    """A sentence for the user."""

    is_warning: bool
    text: str


@dataclass(frozen=True)
class Measures:
    """Measures of a single configuration under a load; axes of length three count J_b, J_c, K."""

    singularities: Singularities
    is_physical: bool
    limit_excess: FloatArray  # of each reading above its largest (positive) or below its least (negative) [m], (6,)
    travel: FloatArray  # of the legs to each singularity to first order (3,) [m], NaN where that says nothing
    is_near: BoolArray  # which singularities are near, see `NEAR`
    forces: FloatArray | None  # of the legs (6,) [N]; None where they cannot hold every load


@dataclass(frozen=True)
class State:
    """The configuration shown and the pose requested, with branches, measures, load and notices."""

    target: RigidTransform  # the requested pose of {m} in {B}; that of `shown` where legs were moved
    shown: Configuration
    label: str  # branch of `shown`; empty where its pose has none, because its solutions form a continuous family
    solutions: SolutionSet  # all branches of the pose of `shown`
    distance: float  # root mean square distance of the c_i from where they should be [m]; 0 where the pose is reached
    measures: Measures
    wrench: FloatArray  # the load (f, m) on the platform at o in {B}, shape (6,) [N, N m]
    notices: tuple[Notice, ...]  # most important first

    @property
    def labels(self) -> tuple[str, ...]:
        """The real branches of the pose of `shown`."""
        return tuple(str(label) for label in np.array(self.solutions.labels)[self.solutions.exists])


class ViewerModel:
    """A session's state and its transitions, from a configuration that exists. Not for several threads at once."""

    state: State

    def __init__(self, start: Configuration) -> None:
        self.geometry = start.geometry
        self.hold_limits = True  # whether a machine that is within its leg limits stays there
        self._show(start.pose, start)

    def drag(self, pose: PoseLike) -> State:
        """Move to a pose on the branch, or to the nearest reachable one."""
        target = as_rigid_transform(pose)
        before, label = self.state.shown, self.state.label
        label = label or FAMILIES[max(int(family(before)), 0)] + "+"
        solutions = inverse_displacement(self.geometry, target)
        wanted = solutions[label]
        limited = self.hold_limits and self.geometry.limits is not None and self.within_limits(before)
        if wanted.exists and (not limited or self.within_limits(wanted)):
            return self._show(target, wanted, solutions)
        if limited:
            nearest = nearest_reachable_pose(self.geometry, target, near=before)
        else:
            nearest = nearest_reachable_pose(self.geometry, target, _UNLIMITED, branch=label, near=before)
        shown, distance = nearest.configuration, nearest.distance
        if not shown.exists:  # at the edge rounding may decide; what is shown is reachable in any case
            shown, distance = before, pose_distance(self.geometry, before.pose, target)
        if distance <= _REACHED * self.geometry.middle_side:
            return self._show(target, shown)
        notice = _out_of_reach(solutions, label, distance)
        return self._show(target, shown, distance=distance, remarks=[notice])

    def set_readings(self, readings: npt.ArrayLike) -> State:
        """Move to encoder readings (6,) [m] in the assembly mode, as far as it lasts."""
        target = real_array(readings, "readings", (6,), "readings of the encoders in metres")
        before = self.state.shown
        # The physical mode is solved for, without a path to follow.
        shown = forward_physical(self.geometry, target, near=None if physical(before) else before)
        remarks = []
        if not shown.exists:
            shown, share = last_on_line(before, target)
            if share < 1.0:
                text = "These leg lengths are not reached: a forward singularity is in the way."
                remarks = [Notice(True, f"{text} Shown: the last on the way, at {100 * share:.0f} %.")]
        return self._show(shown.pose, shown, remarks=remarks)

    def select(self, label: str) -> State:
        """Take another branch of the shown pose; raises `ArgumentError` if it has no such branch."""
        if label not in self.state.labels:
            raise ArgumentError("label", f"one of {', '.join(self.state.labels) or 'no branches'}", repr(label))
        before = self.state
        chosen = before.solutions[label]
        self._show(chosen.pose, chosen, before.solutions, jump=True)
        return self.drag(before.target)

    def load(self, wrench: npt.ArrayLike) -> State:
        """Put a wrench (f, m) on the platform at o in {B} [N, N m]."""
        load = real_array(wrench, "wrench", (6,), "(f, m) at o in {B} in N and N m")
        self.state = replace(self.state, wrench=load, measures=_measures(self.state.shown, load))
        return self.state

    def place(self, configuration: Configuration) -> State:
        """Show a configuration, as it is."""
        return self._show(configuration.pose, configuration, jump=True)

    def within_limits(self, configuration: Configuration) -> bool:
        """Return whether a configuration respects its leg limits, up to rounding."""
        return not _limit_excess(configuration).any()

    def _show(
        self,
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
        measures = _measures(shown, wrench)
        notices = list(remarks)
        if before is not None and not jump:
            notices += _crossings(before, measures, label)
        notices += _warnings(measures, label)
        self.state = State(target, shown, label, solutions, distance, measures, wrench, tuple(notices))
        return self.state


def _measures(state: Configuration, wrench: FloatArray) -> Measures:
    analysis, side = singularities(state), state.geometry.middle_side
    forces: FloatArray | None
    try:
        gradients = np.linalg.norm(determinant_gradients(state), axis=-1)
        travel = np.asarray(np.abs(analysis.determinants) / np.maximum(gradients, np.finfo(float).tiny))
        forces = leg_forces(state, wrench)
    except SingularConfigurationError:
        travel, forces = np.where(analysis.rank < 6, 0.0, np.nan), None
    is_near = np.asarray((travel < NEAR * side) | np.isnan(travel))
    return Measures(analysis, bool(physical(state)), _limit_excess(state), travel, is_near, forces)


def _limit_excess(state: Configuration) -> FloatArray:
    limits = state.geometry.limits
    excess = np.zeros(6) if limits is None else limits.excess(state.readings)
    return np.where(np.abs(excess) < _ROUNDING * state.geometry.middle_side, 0.0, excess)


def _out_of_reach(solutions: SolutionSet, label: str, distance: float) -> Notice:
    """Return why a pose with these solutions is not reached on a branch, and how far away the state shown is [m]."""
    others = [str(name) for name in np.array(solutions.labels)[solutions.exists] if name != label]
    is_real = bool(solutions[label].exists)
    why = "beyond the leg limits" if is_real else f"{label} does not reach it"
    if solutions.status is Status.DEGENERATE and not is_real:
        why = "its branches form a continuous family, of which none is picked"
    away = f"{1e3 * distance:.1f} mm" if distance > 1e-4 else "less than 0.1 mm"
    text = f"Pose out of reach: {why}. Shown: the nearest reachable one found, {away} away."
    if others and not is_real:
        text += f" Other branches there: {', '.join(others)}."
    return Notice(True, text)


def _label(solutions: SolutionSet, shown: Configuration, last: str) -> str:
    """Return which branch a configuration is; of two that coincide, the one it was."""
    gaps = np.linalg.norm(solutions.middle_joints - shown.middle_joints, axis=-1).max(axis=-1)
    gaps = np.where(solutions.exists, gaps, np.inf)
    same = gaps <= max(_SAME_BRANCH * shown.geometry.middle_side, 2.0 * float(gaps.min(initial=np.inf)))
    if not np.isfinite(gaps).any():
        return ""
    if last in solutions.labels and same[solutions.labels.index(last)]:
        return last
    return str(solutions.labels[int(gaps.argmin())])


def _crossings(before: State, after: Measures, label: str) -> list[Notice]:
    signs = [np.sign(measures.singularities.scaled_determinants) for measures in (before.measures, after)]
    renamed = f": {before.label} became {label}" if before.label and label and label != before.label else ""
    names = [name for product, name in zip(signs[0] * signs[1], SINGULARITIES, strict=True) if product < 0.0]
    return [Notice(True, f"A singularity was crossed ({name}){renamed}.") for name in names]


def _warnings(measures: Measures, label: str) -> list[Notice]:
    notices = []
    for near, name, travel in zip(measures.is_near, SINGULARITIES, measures.travel, strict=True):
        if near:
            how = f"{1e3 * travel:.1f} mm of leg travel away" if np.isfinite(travel) else "at hand"
            notices.append(Notice(True, f"Singularity ahead ({name}): about {how}."))
    over = [f"{leg} by {1e3 * abs(x):.1f} mm" for leg, x in zip(LEGS, measures.limit_excess, strict=True) if x]
    if over:
        notices.append(Notice(True, f"Beyond the leg limits: {', '.join(over)}."))
    if measures.forces is None:
        notices.append(Notice(True, "The legs cannot hold every load here."))
    if not label:
        notices.append(Notice(False, "The branches of this pose form a continuous family; none is picked."))
    if not measures.is_physical:
        text = "Not physical: the machine cannot get here from its home without a forward singularity."
        notices.append(Notice(False, text))
    return notices


@lru_cache(maxsize=4)
def sampled_states(geometry: Geometry) -> Configuration:
    """Return physical states (n,) of readings spread evenly over their limits, always the same.

    Without limits the readings are those at home, a third more or less.
    """
    home, limits = np.repeat(home_lengths(geometry), 3), geometry.limits
    low, high = home / 1.33, home * 1.33
    if limits is not None:
        low, high = np.maximum(limits.minimum, 0.3 * home), np.minimum(limits.maximum, 3.0 * home)
    readings = np.random.default_rng(0).uniform(low, np.maximum(low, high), (_SAMPLES, 6))
    states = forward_physical(geometry, readings)
    return states[states.exists]


def pose_ranges(target: RigidTransform, geometry: Geometry, angles: str = "X-Y-X") -> FloatArray:
    """Return the least and the largest coordinates (6, 2) of the sampled states that are nearest to a pose.

    x, y, z [m] and the angles [degrees], those around the pose's own.
    """
    states, now = sampled_states(geometry), pose_coordinates(target, angles)
    gaps = np.linalg.norm(states.platform_joints - target.apply(geometry.platform_joints), axis=-1).max(axis=-1)
    nearest = states.pose[np.argsort(gaps)[:_NEIGHBOURS]] if len(gaps) else target
    steps = np.atleast_2d(pose_coordinates(nearest, angles) - now)
    steps[:, 3:] = (steps[:, 3:] + 180.0) % 360.0 - 180.0
    ends = now + np.stack([steps.min(axis=0, initial=0.0), steps.max(axis=0, initial=0.0)])
    ends[:, 3:] = np.clip(ends[:, 3:], -180.0, 180.0)
    return np.asarray(ends.T)


def leg_ranges(configuration: Configuration) -> FloatArray:
    """Return the least and the largest reading of each leg (6, 2) [m]: its limits, or as far as the mode lasts."""
    geometry, now = configuration.geometry, np.array(configuration.readings)
    longest = 3.0 * (geometry.base_radius + geometry.platform_radius + geometry.middle_side)
    low, high = np.full(6, 0.05 * geometry.middle_side), np.full(6, longest)
    limits = geometry.limits
    if limits is not None:
        low, high = np.maximum(low, limits.minimum), np.minimum(high, limits.maximum)
    low, high = np.minimum(low, now), np.maximum(high, now)
    if physical(configuration) and (limits is None or not np.isfinite(limits.maximum).all()):
        for ends in (low, high):
            shares = physical_mode_share(geometry, now, now + np.diag(ends - now), parts=_STEPS, rounds=1)
            ends[:] = now + shares * (ends - now)
    return np.stack([low, high], axis=-1)


def pose_coordinates(pose: RigidTransform, angles: str = "X-Y-X") -> FloatArray:
    """Return x, y, z [m] and three angles [degrees] of poses, in a convention of `ANGLES`, shape (..., 6)."""
    turned = pose.rotation.as_euler(ANGLES[angles], degrees=True, suppress_warnings=True)
    return np.concatenate([pose.translation, turned], axis=-1) + 0.0


def pose_of_coordinates(coordinates: FloatArray, angles: str) -> RigidTransform:
    """Return the pose of coordinates (6,) as `pose_coordinates` returns them."""
    return pose(coordinates[:3], rotation=Rotation.from_euler(ANGLES[angles], coordinates[3:], degrees=True))


def command_line(configuration: Configuration, geometry_file: Path | None = None) -> str:
    """Return the `spm-pin inverse` that finds all branches of a single configuration's pose, to float64's digits."""
    values = pose_coordinates(configuration.pose)
    return inverse_command(values[:3], values[3:], None if geometry_file is None else str(geometry_file))


def state_data(state: State, chain: ClosedChain, geometry_file: Path | None = None) -> dict[str, Any]:
    """Return the state as data for JSON, in metres, radians and newtons."""
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
        "rpy": np.deg2rad(pose_coordinates(shown.pose, "roll, pitch, yaw")[3:]),
        "reached": state.distance == 0.0,
        "leg_lengths": dict(zip(LEGS, shown.leg_lengths, strict=True)),
        "readings": dict(zip(LEGS, shown.readings, strict=True)),
        "middle_joints": shown.middle_joints,
        "closure_residual": shown.closure_residual,
        "q": dict(zip(chain.joint_names, chain.joint_values(shown), strict=True)),
        "physical": measures.is_physical,
        "singularity": {
            "kind": str(SingularityKind(int(kind.kind))),
            **{name: dict(zip(("J_b", "J_c", "K"), numbers, strict=True)) for name, numbers in values.items()},
        },
        "wrench": state.wrench,
        "leg_forces": None if measures.forces is None else dict(zip(LEGS, measures.forces, strict=True)),
        "command": command_line(shown, geometry_file),
    }
