"""Paths from one state to another in the physical mode: a straight line where it is safe, else a way around.

Leg lengths within limits are a box, and in the physical mode every point of it has one configuration. So a path is
planned in the six leg lengths: a straight line first; where that breaks a rule, two trees grow towards each other
(RRT-Connect), and what they find is shortened and made smooth. The rules are checked at samples: not farther apart than
`STEP` of d in leg lengths. A `Certificate` proves the rule about forward singularities in between as well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_physical
from spm_pin.closed_form.singularity_analysis import determinants
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import (
    FloatArray,
    as_array,
    choice,
    generator,
    instance,
    real_array,
    real_number,
    type_and_value,
    whole_number,
)
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import LEGS, Geometry, LegLimits
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.motion.leg_path import LegPath
from spm_pin.multibody.platform_path import PlatformPath
from spm_pin.proofs import Certificate
from spm_pin.workspace.reachability.joint_limits import JointLimits

__all__ = ["MotionPlan", "plan"]

STEP = 0.005
"""Largest distance of two samples of a path in the leg lengths, in units of d."""
_REACH = 0.25
"""Longest step of a tree, in units of d."""
_SHORTCUTS = 100

Place = Configuration | PoseLike | npt.ArrayLike


@dataclass(frozen=True)
class MotionPlan:
    """A path between two states, or the reason why there is none; made by `plan`.

    Attributes
    ----------
    geometry : Geometry
        The machine.
    path : LegPath, PlatformPath or None
        The path, over a parameter from 0 to 1 (a PlatformPath: in "seconds").
    method : str
        "straight in leg lengths", "straight in poses", "around", or "none".
    certified : bool
        True if a certificate covers every sample: no state of it is forward singular, between samples neither.
    reason : str
        Why there is no path, or what is wrong with the straight one.
    margin : float
        Least |det J_b| and |det J_c| over d³ along it; NaN without a path.
    """

    geometry: Geometry
    path: LegPath | PlatformPath | None
    method: str
    certified: bool
    reason: str
    margin: float

    def __repr__(self) -> str:
        if self.path is None:
            return f"<MotionPlan: none, {self.reason}>"
        proved = ", certified" if self.certified else ""
        return f"<MotionPlan: {self.method}{proved}, least determinant {self.margin:.3g} d³>"

    @property
    def exists(self) -> bool:
        """True if there is a path."""
        return self.path is not None

    def configurations(self, samples: int = 200) -> Configuration:
        """Return states along the path, shape (samples,), evenly spaced in its parameter.

        Raises
        ------
        ArgumentError
            If there is no path.
        """
        count = whole_number(samples, "samples", "at least two samples", least=2, most=10**8)
        if self.path is None:
            raise ArgumentError("plan", "a plan with a path", "one without", self.reason)
        return _states(self.geometry, self.path, np.linspace(0.0, 1.0, count))


@dataclass(frozen=True)
class _Rules:
    """The rules that every state of a path keeps."""

    limits: LegLimits | None
    joints: JointLimits
    margin: float

    def margins(self, states: Configuration) -> FloatArray:
        """Return how far states are inside: existence, legs [m], singularities, angles [rad], clearance [m], (..., 5).

        Where a state does not exist the first is -1 and the others are not numbers.
        """
        legs = np.full(states.shape, np.inf) if self.limits is None else self.limits.margin(states.leg_lengths)
        least = np.abs(determinants(states)[..., :2]).min(axis=-1) / states.geometry.middle_side**3 - self.margin
        angles, clearance = self.joints.angle_margin(states), self.joints.clearance_margin(states)
        rows = [np.where(states.exists, 1.0, -1.0), legs, least, angles, clearance]
        return np.stack(np.broadcast_arrays(*rows), axis=-1)

    def hold(self, states: Configuration) -> bool:
        """Return whether all states keep all rules, leg limits to rounding."""
        return bool((self.margins(states) >= -1e-9).all())

    def explain(self, state: Configuration) -> str:
        """Return which rule a state breaks, in words; empty if none."""
        exists, legs, least, angles, clearance = self.margins(state).tolist()
        if exists < 0.0:
            return "the physical mode cannot have these lengths"
        if legs < -1e-9:
            assert self.limits is not None
            lengths = state.leg_lengths
            beyond = np.maximum(self.limits.minimum - lengths, lengths - np.array(self.limits.maximum))
            leg = int(beyond.argmax())
            return (
                f"{LEGS[leg]} of {lengths[leg]:.4g} m is outside its limits, "
                f"{self.limits.minimum[leg]:g} to {self.limits.maximum[leg]:g} m"
            )
        if least < -1e-9:
            found = f"|det J| of {least + self.margin:.3g} d³"
            return f"a forward singularity is near: {found}, less than the margin of {self.margin:g}"
        if angles < -1e-9:
            return f"a passive joint is {-angles:.3g} rad beyond its limit"
        if clearance < -1e-9:
            return f"two legs are {-clearance * 1e3:.3g} mm too near to each other"
        return ""


@dataclass
class _Tree:
    """Leg lengths joined by straight lines that keep the rules."""

    points: list[FloatArray]
    parents: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, point: FloatArray) -> int:
        return int(np.linalg.norm(np.array(self.points) - point, axis=-1).argmin())

    def add(self, point: FloatArray, parent: int) -> int:
        self.points.append(point)
        self.parents.append(parent)
        return len(self.points) - 1

    def way(self, node: int) -> list[FloatArray]:
        """Return the points from the root to a node."""
        found = []
        while node >= 0:
            found.append(self.points[node])
            node = self.parents[node]
        return found[::-1]


def plan(
    geometry: Geometry,
    start: Place,
    goal: Place,
    limits: LegLimits | None = None,
    *,
    via: Sequence[Place] = (),
    joint_limits: JointLimits | None = None,
    margin: float = 0.05,
    line: str = "legs",
    certificate: Certificate | None = None,
    tries: int = 3000,
    rng: Any = 0,
    progress: Callable[[float], object] | None = None,
) -> MotionPlan:
    """Plan a path between two states of the machine in its physical mode.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    start, goal : Configuration, pose, or array_like of shape (6,)
        The states: a configuration in the physical mode, a pose of {m} in {B}, or leg lengths [m].
    limits : LegLimits, optional
        Of the leg lengths; by default those of `geometry`.
    via : sequence of the same
        States to pass on the way, in order.
    joint_limits : JointLimits, optional
        Of the passive joints, and the distance that legs keep.
    margin : float
        Distance to forward singularities: least |det J_b| and |det J_c| over d³.
    line : {"legs", "poses"}
        What is tried: a straight line in the leg lengths, and if that breaks a rule a way around; or one in the poses
        and no other, o on a line and the platform turning about one axis (with `via`, cubic splines through the poses).
        A line of poses does not pass inverse singularities, level poses for example; one of legs may.
    certificate : Certificate, optional
        Of `spm_pin.certify`: a plan within it is marked as certified.
    tries : int
        Steps of the search for a way around, between any two states.
    rng : int, Generator or None
        Seed of the search.
    progress : callable, optional
        Called with the share of the tries done, from 0 to 1, every 50 steps. If it returns False, the search ends.

    Returns
    -------
    MotionPlan
        With a path, or with the reason why there is none.

    Raises
    ------
    ArgumentError
        If an argument is malformed, or a given state is out of reach, in another mode or breaks a rule: with its name
        and which rule.

    Examples
    --------
    >>> import spm_pin as spm
    >>> spm.plan(spm.Geometry.paper(), [1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.4, 1.2, 1.2, 1.2, 1.5, 1.25])
    <MotionPlan: straight in leg lengths, least determinant 1.15 d³>
    """
    instance(geometry, Geometry, "geometry")
    allowed = geometry.limits if limits is None else instance(limits, LegLimits, "limits")
    joints = JointLimits() if joint_limits is None else instance(joint_limits, JointLimits, "joint_limits")
    rules = _Rules(allowed, joints, real_number(margin, "margin", "a number, not negative", least=0.0))
    choice(line, "line", ("legs", "poses"))
    most = whole_number(tries, "tries", "a number of steps", most=10**7)
    random = generator(rng)
    if progress is not None and not callable(progress):
        raise ArgumentError("progress", "a function of the share of the tries done", type_and_value(progress))
    if certificate is not None:
        instance(certificate, Certificate, "certificate")
        if dataclasses.replace(certificate.geometry, limits=None) != dataclasses.replace(geometry, limits=None):
            raise ArgumentError("certificate", "a certificate of `geometry`", "one of other dimensions")
    if not isinstance(via, Sequence | np.ndarray) or isinstance(via, str | bytes):
        raise ArgumentError("via", "a sequence of states to pass", type_and_value(via))
    names = ["start", *(f"via[{k}]" for k in range(len(via))), "goal"]
    states = [_state(geometry, place, name) for place, name in zip([start, *via, goal], names, strict=True)]
    for state, name in zip(states, names, strict=True):
        if broken := rules.explain(state):
            raise ArgumentError(name, "a state that keeps the rules of the plan", broken)
    for k in range(len(states) - 1):
        if np.linalg.norm(states[k + 1].leg_lengths - states[k].leg_lengths) <= 1e-12 * geometry.middle_side:
            raise ArgumentError(names[k + 1], f"another state than {names[k]}", "the same: a motion of no length")
    if line == "poses":
        return _along_poses(rules, states, certificate)
    places = [state.leg_lengths for state in states]
    if allowed is not None:
        # Not beyond the limits by rounding.
        places = [np.clip(lengths, allowed.minimum, allowed.maximum) for lengths in places]
    points, reason = places[:1], ""
    for place in places[1:]:
        part, why = _connect(geometry, rules, points[-1], place, most, random, progress)
        reason = reason or why
        if part is None:
            return MotionPlan(geometry, None, "none", False, why, float("nan"))
        points += part[1:]
    path = _smoothed(geometry, rules, points)
    if path is None:
        reason = "; ".join(filter(None, [reason, "there is a way with corners, but no smooth one was found"]))
        return MotionPlan(geometry, None, "none", False, reason, float("nan"))
    return _finished(
        geometry, path, "around" if len(points) > len(states) else "straight in leg lengths", reason, certificate
    )


def _state(geometry: Geometry, place: Place, name: str) -> Configuration:
    """Return the physical state of a configuration, a pose or leg lengths."""
    if isinstance(place, Configuration):
        check_configuration(place, name, single=True, existing=True)
        if place.geometry != geometry:
            raise ArgumentError(name, "a configuration of `geometry`", "one of other dimensions")
        physical = forward_physical(geometry, place.leg_lengths)
        apart = np.abs(physical.middle_joints - place.middle_joints).max() if physical.exists else np.inf
        if not apart <= 1e-6 * geometry.middle_side:
            cause = "Another branch or assembly mode: .physical() chooses the one a machine is in"
            raise ArgumentError(name, "a configuration in the physical mode", "one in another mode", cause)
        return physical
    array = as_array(place)
    if array is not None and array.shape == (6,):
        lengths = real_array(place, name, (6,), "leg lengths in metres")  # type: ignore[arg-type]
        found = forward_physical(geometry, lengths)
        if not found.exists:
            raise ArgumentError(name, "leg lengths of the physical mode", f"{lengths.tolist()}", found.absence)
        return found
    if array is not None and array.ndim < 2 and array.dtype.kind != "O":
        received = f"shape {array.shape}" if array.dtype.kind in "iuf" else type_and_value(place)
        cause = "via is a list of states" if name.startswith("via") else ""
        raise ArgumentError(name, "a Configuration, a pose or six leg lengths", received, cause)
    found = inverse_physical(geometry, as_rigid_transform(place, name))
    if found.shape:
        raise ArgumentError(name, "one state", f"a batch of shape {found.shape}")
    if not found.exists:
        cause = found.absence or "Level poses are singular for the inverse: give leg lengths instead"
        raise ArgumentError(name, "a pose with a physical branch", "one without", cause)
    return found


def _states(geometry: Geometry, path: LegPath | PlatformPath, parameters: FloatArray) -> Configuration:
    if isinstance(path, LegPath):
        return forward_physical(geometry, path(parameters).lengths)
    return inverse_physical(geometry, path(path.start + parameters * path.duration).pose)


def _samples(geometry: Geometry, lengths: FloatArray) -> FloatArray:
    """Return parameters from 0 to 1 for a path through leg lengths (n, 6), at most `STEP` apart."""
    distance = float(np.linalg.norm(np.diff(lengths, axis=0), axis=-1).sum())
    return np.linspace(0.0, 1.0, max(int(np.ceil(distance / (STEP * geometry.middle_side))), 2) + 1)


def _line(geometry: Geometry, start: FloatArray, end: FloatArray) -> Configuration:
    parameters = _samples(geometry, np.array([start, end]))[:, None]
    return forward_physical(geometry, start + parameters * (end - start))


def _first_broken(rules: _Rules, states: Configuration) -> str:
    """Return which rule breaks first along states, and where."""
    broken = np.flatnonzero((rules.margins(states) < -1e-9).any(axis=-1) | ~states.exists)
    if not len(broken):
        return ""
    where = broken[0] / (len(states) - 1)
    return f"the straight line breaks a rule at {100.0 * where:.0f} %: {rules.explain(states[int(broken[0])])}"


def _connect(
    geometry: Geometry,
    rules: _Rules,
    start: FloatArray,
    goal: FloatArray,
    tries: int,
    rng: np.random.Generator,
    progress: Callable[[float], object] | None,
) -> tuple[list[FloatArray] | None, str]:
    """Return the corners of a way from start to goal, None if none was found; and what is wrong with the line."""
    reason = _first_broken(rules, _line(geometry, start, goal))
    if not reason:
        return [start, goal], ""
    trees = [_Tree([start]), _Tree([goal])]
    low, high = _box(rules, start, goal)
    reach = _REACH * geometry.middle_side
    for k in range(tries):
        if progress is not None and k % 50 == 0 and progress(k / tries) is False:
            return None, f"{reason}; the search was stopped after {k} steps"
        new = _grow(geometry, rules, trees[0], rng.uniform(low, high), reach)
        if new is not None:
            target = trees[0].points[new]
            while (near := _grow(geometry, rules, trees[1], target, reach)) is not None:
                if np.array_equal(trees[1].points[near], target):
                    corners = trees[0].way(new) + trees[1].way(near)[-2::-1]
                    return _shortened(geometry, rules, corners if k % 2 == 0 else corners[::-1], rng), reason
        trees.reverse()
    return None, f"{reason}; no way around was found in {tries} steps"


def _box(rules: _Rules, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    if rules.limits is not None:
        return np.array(rules.limits.minimum), np.array(rules.limits.maximum)
    return 0.5 * np.minimum(start, goal), 1.5 * np.maximum(start, goal)


def _grow(geometry: Geometry, rules: _Rules, tree: _Tree, target: FloatArray, reach: float) -> int | None:
    """Add a step towards `target` to a tree; return the new node, None if the step breaks a rule."""
    parent = tree.nearest(target)
    origin = tree.points[parent]
    distance = float(np.linalg.norm(target - origin))
    if distance == 0.0:
        return parent
    point = target if distance <= reach else origin + (reach / distance) * (target - origin)
    return tree.add(point, parent) if rules.hold(_line(geometry, origin, point)) else None


def _shortened(
    geometry: Geometry, rules: _Rules, corners: list[FloatArray], rng: np.random.Generator
) -> list[FloatArray]:
    """Return a way with fewer corners."""
    for _ in range(_SHORTCUTS):
        if len(corners) <= 2:
            break
        i, j = sorted(rng.choice(len(corners), 2, replace=False).tolist())
        if j > i + 1 and rules.hold(_line(geometry, corners[i], corners[j])):
            corners = corners[: i + 1] + corners[j:]
    return corners


def _smoothed(geometry: Geometry, rules: _Rules, points: list[FloatArray]) -> LegPath | None:
    """Return a smooth path near straight lines; points are added in between until it keeps the rules as they do."""
    rows = np.array(points)
    for _ in range(7):
        path = LegPath(rows)
        if rules.hold(_states(geometry, path, _samples(geometry, rows))):
            return path
        middle = 0.5 * (rows[:-1] + rows[1:])
        rows = np.insert(rows, range(1, len(rows)), middle, axis=0)
    return None


def _along_poses(rules: _Rules, states: list[Configuration], certificate: Certificate | None) -> MotionPlan:
    """Return the plan straight in poses, or why it cannot be gone along."""
    geometry = states[0].geometry
    poses = np.array([state.pose.as_matrix() for state in states])
    path = PlatformPath(np.linspace(0.0, 1.0, len(poses)), poses)
    rough = _states(geometry, path, np.linspace(0.0, 1.0, 100 * len(poses)))
    if not rough.exists.all():
        reason = _first_broken(rules, rough) + ", or the line meets an inverse singularity"
        return MotionPlan(geometry, None, "none", False, reason, float("nan"))
    along = _states(geometry, path, _samples(geometry, rough.leg_lengths))
    reason = _first_broken(rules, along)
    signs = np.sign(determinants(along)[..., 2])
    if not reason and (signs != signs[0]).any():
        where = int((signs != signs[0]).argmax()) / (len(signs) - 1)
        reason = f"the line of poses meets an inverse singularity at {100.0 * where:.0f} %"
    if reason:
        return MotionPlan(geometry, None, "none", False, reason, float("nan"))
    return _finished(geometry, path, "straight in poses", "", certificate)


def _finished(
    geometry: Geometry, path: LegPath | PlatformPath, method: str, reason: str, certificate: Certificate | None
) -> MotionPlan:
    rough = _states(geometry, path, np.linspace(0.0, 1.0, 200))
    parameters = _samples(geometry, rough.leg_lengths)
    states = _states(geometry, path, parameters)
    certified = False
    if certificate is not None and isinstance(path, LegPath):
        # Lengths within a certificate have one configuration, the physical one.
        certified = certificate.holds and bool(certificate.limits.contains(path(parameters).lengths).all())
    elif certificate is not None:
        certified = bool(certificate.covers(states).all())
    least = float(np.abs(determinants(states)[..., :2]).min()) / geometry.middle_side**3
    return MotionPlan(geometry, path, method, certified, reason, least)
