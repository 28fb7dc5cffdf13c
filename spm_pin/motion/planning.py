"""Paths from one state to another in the physical mode: a straight line where it is safe, otherwise a path around.

Readings within limits are a box, and a point of it has at most one configuration in the physical mode; that is proved
for nominal RPS legs, not for others. So a path is planned in the readings: a straight line first; where that
breaks a rule, two trees grow towards each other (RRT-Connect: Kuffner and LaValle, IEEE International Conference on
Robotics and Automation, 2000), and what they find is shortened and made smooth. The rules are checked at samples not
farther apart than `paths.STEP`. A `Certificate` proves the rule about forward singularities in between as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, UnreachableError, sentence
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_physical
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.machine import LegLimits, PoseLike, Stage, as_rigid_transform
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.machine import check_machine
from spm_pin.machine.manipulator import check_same_machine
from spm_pin.motion.paths import (
    ROUNDING,
    AnyMachine,
    LegPath,
    MotionPath,
    State,
    line_states,
    spaced_parameters,
    states_along,
)
from spm_pin.multibody.trajectory import PlatformPath
from spm_pin.proofs import Certificate
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    as_array,
    check_instance,
    choice,
    generator,
    real_array,
    real_number,
    type_and_value,
    whole_number,
)
from spm_pin.workspace.poses import JointLimits

Place = State | PoseLike | npt.ArrayLike

_REACH = 0.25
"""Longest step of a tree, in units of d."""
_SHORTCUTS = 100
"""Shortcuts between two corners that are tried."""


@dataclass(frozen=True)
class MotionPlan:
    """A path between two states, or the reason why no path was found; made by `plan`."""

    machine: AnyMachine
    """The machine."""
    path: MotionPath | None
    """The path, over a parameter from 0 to 1 (a PlatformPath: in "seconds")."""
    method: str
    """"straight in leg lengths", "straight in poses", "around", or "none"."""
    certified: bool
    """True if a certificate covers every sample: no state of it is forward singular, between samples neither."""
    reason: str
    """Reason why there is no path, or the rule that the straight one breaks."""
    margin: float
    """Least |det J| of a stage over d³ along it, d the side of the triangle of balls; NaN without a path."""

    def __repr__(self) -> str:
        if self.path is None:
            return f"<MotionPlan: none, {self.reason}>"
        proved = ", certified" if self.certified else ""
        return f"<MotionPlan: {self.method}{proved}, least determinant {self.margin:.3g} d³>"

    @property
    def exists(self) -> bool:
        """True if there is a path."""
        return self.path is not None

    def configurations(self, samples: int = 200) -> State:
        """Return states along the path, shape (samples,), evenly spaced in its parameter."""
        count = whole_number(samples, "samples", "at least two samples", least=2, most=10**8)
        if self.path is None:
            raise ArgumentError("plan", "a plan with a path", "a plan that failed", self.reason)
        return states_along(self.machine, self.path, np.linspace(0.0, 1.0, count))


def plan(
    machine: AnyMachine,
    start: Place,
    goal: Place,
    limits: LegLimits | Sequence[float] | None = None,
    *,
    via: Sequence[Place] = (),
    joint_limits: JointLimits | None = None,
    margin: float = 0.05,
    line: str = "legs",
    certificate: Certificate | None = None,
    tries: int = 3000,
    rng: Any = 0,
) -> MotionPlan:
    """Plan a path between two states of the machine in its physical mode.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    start, goal : Configuration, pose, or array_like of shape (6,); for a stage Configuration, or (3,)
        The states: a configuration in the physical mode, a pose of {m} in {B}, or readings [m] ([rad] for RRS legs).
        The state of a tilt and a height is ``spm.inverse_physical(stage, height, tilt=…)``.
    limits : LegLimits or (minimum, maximum), optional
        Limits of the readings; by default those of `machine`.
    via : sequence of the same
        States to pass on the way, in order.
    joint_limits : JointLimits, optional
        Limits of the passive joints, and the smallest distance of legs.
    margin : float
        Distance to forward singularities: least |det J| of a stage over d³.
    line : {"legs", "poses"}
        Kind of path: a straight line in the leg lengths, and if that breaks a rule a path around; or one in the poses
        and no other, o on a line and the platform turning about one axis (with `via`, cubic splines through the poses).
        A line of poses does not pass inverse singularities, level poses of a manipulator for example; one of legs may.
        For a stage, whose shift and torsion follow, the height is on a line and the normal turns about one axis.
    certificate : Certificate, optional
        Result of `spm_pin.certify`: a plan within it is marked as certified.
    tries : int
        Steps of the search for a way around, between any two states.
    rng : int, Generator or None
        Seed of the search.

    Returns
    -------
    MotionPlan
        A path, or the reason why no path was found.

    Examples
    --------
    >>> import spm_pin as spm
    >>> spm.plan(spm.Manipulator.paper(), [1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.4, 1.2, 1.2, 1.2, 1.5, 1.25])
    <MotionPlan: straight in leg lengths, least determinant 1.15 d³>
    """
    check_machine(machine)
    allowed = machine.limits if limits is None else machine.check_limits(limits)
    joints = JointLimits() if joint_limits is None else check_instance(joint_limits, JointLimits, "joint_limits")
    least = real_number(margin, "margin", "a number, not negative", least=0.0)
    rules = _PathRules(machine, allowed, joints, least)
    choice(line, "line", ("legs", "poses"))
    most = whole_number(tries, "tries", "a number of steps", most=10**7)
    random = generator(rng)
    if certificate is not None:
        check_instance(certificate, Certificate, "certificate")
        if not certificate.concerns(machine):
            raise ArgumentError("certificate", "a certificate of `machine`", "a certificate of another machine")
    if not isinstance(via, Sequence | np.ndarray) or isinstance(via, str | bytes):
        raise ArgumentError("via", "a sequence of states to pass", type_and_value(via))
    names = ["start", *(f"via[{k}]" for k in range(len(via))), "goal"]
    states = [_state(machine, place, name) for place, name in zip([start, *via, goal], names, strict=True)]
    for state, name in zip(states, names, strict=True):
        if broken := rules.explain(state):
            raise UnreachableError(name, "a state that the plan may pass", broken)
    for (before, first), (name, state) in pairwise(zip(names, states, strict=True)):
        if np.linalg.norm(state.readings - first.readings) <= 1e-12 * machine.ball_side:
            raise ArgumentError(name, f"a state different from {before}", "the same state")
    if line == "poses":
        return _along_poses(rules, states, certificate)
    places = [state.readings for state in states]
    if allowed is not None:  # not beyond them by rounding
        places = [np.clip(lengths, allowed.minimum, allowed.maximum) for lengths in places]
    points, reason = places[:1], ""
    for place in places[1:]:
        corners, why = _find_corners(rules, points[-1], place, most, random)
        reason = reason or why
        if corners is None:
            return _no_plan(machine, why)
        points += corners[1:]
    smooth = _smooth_path(rules, points)
    if smooth is None:
        smoothless = "there is a way with corners, but no smooth one was found"
        return _no_plan(machine, "; ".join(filter(None, [reason, smoothless])))
    method = "around" if len(points) > len(states) else "straight in leg lengths"
    return _finished(*smooth, method, reason, certificate)


def _state(machine: AnyMachine, place: Place, name: str) -> State:
    """Return the physical state of a configuration, a pose or leg lengths."""
    count, unit = len(machine.legs.names), machine.legs.unit_text()
    if isinstance(place, Configuration):
        check_configuration(place, name, single=True, existing=True)
        check_same_machine(place.machine, machine, name, "`machine`")
        physical = forward_physical(machine, place.readings)
        apart = np.abs(physical.balls - place.balls).max() if physical.exists else np.inf
        if not apart <= 1e-6 * machine.ball_side:
            cause = "Another branch or assembly mode: .physical() chooses the one a machine is in"
            raise ArgumentError(name, "a configuration in the physical mode", "a configuration in another mode", cause)
        return physical
    array = as_array(place)
    if array is not None and array.shape == (count,):
        lengths = real_array(place, name, (count,), f"readings in {unit}")  # type: ignore[arg-type]
        state = forward_physical(machine, lengths)
        if not state.exists:
            expected, cause = "readings of the physical mode", sentence(state.missing_reason)
            raise UnreachableError(name, expected, f"{lengths.tolist()}", cause)
        return state
    if isinstance(machine, Stage):
        cause = "spm.inverse_physical(stage, height, tilt=…, azimuth=…) is the state of a tilt and a height"
        raise ArgumentError(name, "a Configuration or three readings", type_and_value(place), cause)
    if array is not None and array.ndim < 2 and array.dtype.kind != "O":
        received = f"shape {array.shape}" if array.dtype.kind in "iuf" else type_and_value(place)
        cause = "via is a list of states" if name.startswith("via") else ""
        raise ArgumentError(name, f"a configuration, a pose or {count} readings", received, cause)
    state = inverse_physical(machine, as_rigid_transform(place, name))
    if state.shape:
        raise ArgumentError(name, "one state", f"a batch of shape {state.shape}")
    if not state.exists:
        cause = sentence(state.missing_reason) or "Level poses are singular for the inverse: give leg lengths instead"
        raise UnreachableError(name, "a pose with a physical branch", "a pose without one", cause)
    return state


def _along_poses(rules: _PathRules, states: list[State], certificate: Certificate | None) -> MotionPlan:
    """Return the plan straight in poses, or the reason why it does not exist."""
    machine = rules.machine
    poses = np.array([state.pose.as_matrix() for state in states])
    path = PlatformPath(np.linspace(0.0, 1.0, len(poses)), poses)
    rough = states_along(machine, path, np.linspace(0.0, 1.0, 100 * len(poses)))
    if not rough.exists.all():
        first = int(rules.broken(rough).argmax())
        share = 100.0 * first / (len(rough) - 1)
        missing = f"the line of poses meets an inverse singularity, or what is out of reach, at {share:.0f} %"
        return _no_plan(machine, rules.explain_line(rough) if rough.exists[first] else missing)
    along = states_along(machine, path, spaced_parameters(machine, rough.readings))
    reason = rules.explain_line(along)
    signs = np.sign(determinants(along)[..., -1])
    if not reason and (signs != signs[0]).any():
        where = int((signs != signs[0]).argmax()) / (len(signs) - 1)
        reason = f"the line of poses meets an inverse singularity at {100.0 * where:.0f} %"
    return _no_plan(machine, reason) if reason else _finished(path, along, "straight in poses", "", certificate)


def _no_plan(machine: AnyMachine, reason: str) -> MotionPlan:
    return MotionPlan(machine, None, "none", False, reason, float("nan"))


def _finished(path: MotionPath, states: State, method: str, reason: str, certificate: Certificate | None) -> MotionPlan:
    """Return the plan of a path whose states, evenly spaced in its parameter, keep the rules."""
    certified = False
    if certificate is not None and isinstance(path, LegPath):
        # Lengths within a certificate have one configuration, the physical one.
        lengths = path(np.linspace(0.0, 1.0, len(states))).lengths
        certified = certificate.holds and bool(certificate.limits.contains(lengths).all())
    elif certificate is not None:
        certified = bool(certificate.covers(states).all())
    least = float(_least_determinant(states).min())
    return MotionPlan(states.machine, path, method, certified, reason, least)


@dataclass(frozen=True)
class _PathRules:
    """The rules of a path; the leg limits of `machine` are not applied."""

    machine: AnyMachine
    limits: LegLimits | None
    joints: JointLimits
    margin: float  # least |det J| of a stage over d³

    def margins(self, states: State) -> FloatArray:
        """Return how far states are inside, (..., 5): existence, readings, singularities, angles [rad], clearance [m].

        Where a state does not exist, the first is -1 and the others are NaN.
        """
        legs = np.full(states.shape, np.inf) if self.limits is None else self.limits.margin(states.readings)
        angles, clearance = self.joints.angle_margin(states), self.joints.clearance_margin(states)
        rows = [np.where(states.exists, 1.0, -1.0), legs, _least_determinant(states) - self.margin, angles, clearance]
        return np.stack(np.broadcast_arrays(*rows), axis=-1)

    def broken(self, states: State) -> BoolArray:
        """Return which states do not exist or break a rule by more than `ROUNDING`, shape (...)."""
        return np.asarray(~(self.margins(states) >= -ROUNDING).all(axis=-1))

    def explain(self, state: State) -> str:
        """Return which rule a single state breaks, in words; empty if none."""
        exists, legs, least, angles, clearance = self.margins(state).tolist()
        if exists < 0.0:
            return "the physical mode cannot have these readings"
        if legs < -ROUNDING:
            assert self.limits is not None
            leg = int(np.abs(self.limits.excess(state.readings)).argmax())
            unit = self.machine.legs.units[leg]
            limits = f"{self.limits.minimum[leg]:g} to {self.limits.maximum[leg]:g} {unit}"
            return f"{self.machine.legs.names[leg]} of {state.readings[leg]:.4g} {unit} is outside its limits, {limits}"
        if least < -ROUNDING:
            determinant = f"|det J| of {least + self.margin:.3g} d³"
            return f"a forward singularity is near: {determinant}, less than the margin of {self.margin:g}"
        if angles < -ROUNDING:
            return f"a passive joint is {-angles:.3g} rad beyond its limit"
        if clearance < -ROUNDING:
            return f"two legs are {-clearance * 1e3:.3g} mm too near to each other"
        return ""

    def explain_line(self, states: State) -> str:
        """Return which rule the first of states (n,) that breaks one does, and where; empty if none."""
        broken = np.flatnonzero(self.broken(states))
        if not len(broken):
            return ""
        where = 100.0 * broken[0] / (len(states) - 1)
        return f"the straight line breaks a rule at {where:.0f} %: {self.explain(states[int(broken[0])])}"


def _least_determinant(states: State) -> FloatArray:
    """Return the least |det J| of a stage over d³, shape (...)."""
    return np.asarray(np.abs(determinants(states)[..., :-1]).min(axis=-1) / states.machine.ball_side**3)


class _Node(NamedTuple):
    """Readings in a tree, joined to those of its parent by a straight line that keeps the rules."""

    point: FloatArray
    parent: _Node | None

    def way(self) -> list[FloatArray]:
        """Return the points from here to the root."""
        node: _Node | None = self
        points = []
        while node is not None:
            points.append(node.point)
            node = node.parent
        return points


def _find_corners(
    rules: _PathRules, start: FloatArray, goal: FloatArray, tries: int, rng: np.random.Generator
) -> tuple[list[FloatArray] | None, str]:
    """Return the corners of a path from start to goal, None if not found; and the rule that the line breaks."""
    reason = rules.explain_line(line_states(rules.machine, start, goal))
    if not reason:
        return [start, goal], ""
    trees = [[_Node(start, None)], [_Node(goal, None)]]
    legs, low, high = rules.machine.legs, np.minimum(start, goal), np.maximum(start, goal)
    # Around both by half of what a leg or its rod is long.
    low, high = (x + way * legs.circles(x)[1] / legs.largest_slopes for x, way in ((low, -0.5), (high, 0.5)))
    most = np.where(np.array(legs.units) == "rad", MOST_TURNED, np.inf)
    low, high = np.maximum(low, legs.offsets - most), np.minimum(high, legs.offsets + most)
    if rules.limits is not None:
        low, high = rules.limits.ends
    for k in range(tries):
        new = _grow(rules, trees[0], rng.uniform(low, high))
        while new is not None and (near := _grow(rules, trees[1], new.point)) is not None:
            if np.array_equal(near.point, new.point):
                corners = new.way()[::-1] + near.way()[1:]
                return _shortened(rules, corners if k % 2 == 0 else corners[::-1], rng), reason
        trees.reverse()
    return None, f"{reason}; no way around was found in {tries} steps"


def _grow(rules: _PathRules, tree: list[_Node], target: FloatArray) -> _Node | None:
    """Add a step towards `target` to a tree; return the new node, None if the step breaks a rule."""
    reach, metres = _REACH * rules.machine.ball_side, rules.machine.legs.largest_slopes
    distances = np.linalg.norm(metres * (np.array([node.point for node in tree]) - target), axis=-1)
    parent, distance = tree[int(distances.argmin())], float(distances.min())
    if distance == 0.0:
        return parent
    point = target if distance <= reach else parent.point + (reach / distance) * (target - parent.point)
    if rules.broken(line_states(rules.machine, parent.point, point)).any():
        return None
    tree.append(_Node(point, parent))
    return tree[-1]


def _shortened(rules: _PathRules, corners: list[FloatArray], rng: np.random.Generator) -> list[FloatArray]:
    """Return a way with fewer corners."""
    for _ in range(_SHORTCUTS):
        if len(corners) <= 2:
            break
        i, j = sorted(rng.choice(len(corners), 2, replace=False).tolist())
        if j > i + 1 and not rules.broken(line_states(rules.machine, corners[i], corners[j])).any():
            corners = corners[: i + 1] + corners[j:]
    return corners


def _smooth_path(rules: _PathRules, points: list[FloatArray]) -> tuple[LegPath, State] | None:
    """Return a smooth path near the straight lines between points, and its states; None if it breaks a rule."""
    rows = np.array(points)
    for _ in range(7):
        path = LegPath(rows)
        states = states_along(rules.machine, path, spaced_parameters(rules.machine, rows))
        if not rules.broken(states).any():
            return path, states
        middle = 0.5 * (rows[:-1] + rows[1:])
        rows = np.insert(rows, range(1, len(rows)), middle, axis=0)
    return None
