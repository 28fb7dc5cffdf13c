"""Reachability of poses, within limits of passive joints too, and the nearest reachable poses.

Angles are those of `spm_pin.machine.joint_angles`: of the description's joints, and of the ball joints of every leg.
Distance is measured at the platform's joints: the root mean square displacement of c_1, c_2, c_3.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.formulas.stages import HOME_ASPECT
from spm_pin.kinematics import stage_displacement
from spm_pin.kinematics.either_machine import or_of_stage
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.stage_displacement import normals_of_request
from spm_pin.machine import (
    BRANCHES,
    FAMILIES,
    Configuration,
    LegLimits,
    Manipulator,
    PoseLike,
    SolutionSet,
    Stage,
    Status,
    as_rigid_transform,
    joint_angles,
)
from spm_pin.machine.branch_of_state import branch_sign, family
from spm_pin.machine.configuration import Condition, check_configuration
from spm_pin.machine.manipulator import check_manipulator, check_same_machine
from spm_pin.machine.solutions import least_tilted
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    check_instance,
    choice,
    number_pair,
    real_number,
)
from spm_pin.workspace.nearest_state import nearest_state
from spm_pin.workspace.search import nearest_states
from spm_pin.workspace.stage_reach import nearest_tilt
from spm_pin.workspace.state_set import free_states, given_limits, states_around, states_within

_PAIRS = {n: np.array([(i, j) for i in range(n) for j in range(i + 1, n) if j != i + 3]) for n in (3, 6)}
"""Pairs of the legs of a stage, or of a manipulator, that have no joint in common, by their indices."""
_ANGLES = {"hip": "passive"} | {name: name for name in ("ball_x", "ball_y", "ball_z")}
"""Names of the limits of angles, and of the angles."""
_STARTS, _STARTS_BESIDE = 32, 7
"""Number of start states: the one whose platform joints are nearest to the target's, and others far from it; and the
same beside a last state without leg limits."""
_MODE_TOLERANCE = 1e-7
"""Distance of balls, over d, from those of the readings in the mode of `near`, above which a search has left it."""
_FREE_FEW, _SEED = 22, 20_140_131
"""Number of states of each stage, of which all pairs are considered as starts without leg limits, and their seed."""
_STATE = "rotation", "translation", "middle_joints"
"""Arrays that make a configuration."""
_OFF_THE_EDGE = 1e-5
"""Step in the coordinates away from where two branches meet: there rounding decides whether they are real."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of passive joints; None if not given.

    Parameters
    ----------
    hip : pair of floats, optional
        Smallest and largest angle of the passive revolute joints, the hips of RPS legs and the knees of others, from
        the home's direction [rad].
    ball_x, ball_y, ball_z : pairs of floats, optional
        The same of each angle of the six ball joints [rad]: from the leg's rod to the middle platform about the leg's
        revolute axis, then about the middle one, then about the platform's normal.
    clearance : float, optional
        Least distance of the axes of two legs that have no joint in common [m]: the sum of their radii.
    """

    hip: tuple[float, float] | None = None
    ball_x: tuple[float, float] | None = None
    ball_y: tuple[float, float] | None = None
    ball_z: tuple[float, float] | None = None
    clearance: float | None = None

    def __post_init__(self) -> None:
        for name in _ANGLES:
            if (pair := getattr(self, name)) is not None:
                low, high = number_pair(pair, name, "radians")
                if not low < high:
                    cause = "Minimum and maximum exchanged?" if low > high else ""
                    raise ArgumentError(name, "a minimum below the maximum, in radians", f"({low:g}, {high:g})", cause)
                if max(x for x in (abs(low), abs(high), 0.0) if np.isfinite(x)) > 2.0 * np.pi:
                    raise ArgumentError(
                        name, "angles in radians, within one turn", f"({low:g}, {high:g})", "In degrees?"
                    )
                object.__setattr__(self, name, (low, high))
        if self.clearance is not None:
            clearance = real_number(self.clearance, "clearance", "a distance in metres, not negative", least=0.0)
            object.__setattr__(self, "clearance", clearance)

    def __call__(self, configuration: Configuration) -> BoolArray:
        """Return which states (...) keep all limits: a condition for `where` of `reach`, `pose_volume` and others."""
        with np.errstate(invalid="ignore"):
            return (self.angle_margin(configuration) >= 0.0) & (self.clearance_margin(configuration) >= 0.0)

    def angle_margin(self, configuration: Configuration) -> FloatArray:
        """Return the distance of the worst angle from its limits, shape (...) [rad].

        Negative outside, infinite without limits, NaN where a state does not exist.
        """
        margin = np.full(check_configuration(configuration).shape, np.inf)
        limited = [name for name in _ANGLES if getattr(self, name) is not None]
        angles = joint_angles(configuration) if limited else None
        for name in limited:
            (low, high), values = getattr(self, name), getattr(angles, _ANGLES[name])
            margin = np.minimum(margin, np.minimum(values - low, high - values).min(axis=-1))
        return np.where(configuration.exists, margin, np.nan)

    def clearance_margin(self, configuration: Configuration) -> FloatArray:
        """Return the distance of the nearest legs minus the clearance, shape (...) [m]; see `angle_margin`."""
        if self.clearance is None:
            return np.where(check_configuration(configuration).exists, np.inf, np.nan)
        return leg_clearance(configuration) - self.clearance


def leg_clearance(configuration: Configuration) -> FloatArray:
    """Return the least distance of the axes of two legs that have no joint in common, shape (...) [m].

    An axis goes from the pivot to the ball joint's centre, in PRS and RRS legs by way of the carriage or the knee. From
    the fifteen pairs of legs, the three that meet at a corner of the middle platform are left out. NaN where a state
    does not exist.
    """
    check_configuration(configuration)
    # For RPS legs the first segment has no length.
    points = [configuration.leg_bases, configuration.circle_centres, configuration.balls]
    points = [np.broadcast_to(each, configuration.balls.shape) for each in points]
    segments = [*pairwise(points[configuration.machine.legs.are_rps :])]
    i, j = _PAIRS[configuration.balls.shape[-2]].T
    squares = [
        _segment_distance2(p[..., i, :], (q - p)[..., i, :], r[..., j, :], (s - r)[..., j, :]).min(axis=-1)
        for (p, q), (r, s) in product(segments, repeat=2)
    ]
    return np.asarray(np.sqrt(np.minimum.reduce(squares)))


def _segment_distance2(p: FloatArray, u: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the squared distance of segments from p to p + u and from q to q + v, arrays (..., 3).

    C. Ericson, "Real-Time Collision Detection", 2005, section 5.1.9.
    """

    def share(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
        # For a segment of length zero, or two parallel ones, any point will do.
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.clip(np.nan_to_num(numerator / denominator, posinf=1.0, neginf=0.0), 0.0, 1.0)

    arm = p - q
    a, b, c, d, e = ((x * y).sum(axis=-1) for x, y in ((u, u), (u, v), (v, v), (u, arm), (v, arm)))
    s = share(b * e - c * d, a * c - b * b)
    t = share(b * s + e, c)
    s = share(b * t - d, a)
    gap = arm + s[..., None] * u - t[..., None] * v
    return np.asarray((gap * gap).sum(axis=-1))


@dataclass(frozen=True)
class Reachability:
    """Reachability of poses of shape (...), with margins."""

    branches: SolutionSet
    """All eight branches of each pose, limits not applied, shape (...); for a stage both modes of the tilt."""
    allowed: BoolArray
    """Mask of branches that count and keep all limits, shape (..., 8); for a stage (..., 2), as in all fields below."""
    leg_margin: FloatArray
    """Distance of the worst leg of a branch from its limits [m], for RRS legs at the knee, shape (..., 8); negative
    outside, infinite without limits, NaN where the branch is not real."""
    angle_margin: FloatArray
    """Distance of the worst passive joint of a branch from its limits [rad], shape (..., 8)."""
    clearance_margin: FloatArray
    """Distance of the closest legs of a branch minus the least allowed one [m], shape (..., 8)."""

    @property
    def reachable(self) -> Any:
        """True if a branch is allowed, shape (...); a bool for one pose."""
        any_branch = np.asarray(self.allowed.any(axis=-1))
        return any_branch if self.branches.shape else bool(any_branch)

    @property
    def undecided(self) -> Any:
        """True if no branch is allowed but a continuous family, which has no list of branches, may hold one."""
        undecided = ~self.allowed.any(axis=-1) & (np.asarray(self.branches.status) == Status.DEGENERATE)
        return undecided if self.branches.shape else bool(undecided)

    @property
    def branch(self) -> IntArray:
        """Index of the label of the allowed branch that tilts least, shape (...); -1 if no branch is allowed."""
        index = least_tilted(self.branches.configurations, self.allowed)
        return np.where(self.allowed.any(axis=-1), index, -1).astype(np.intp)

    @property
    def configuration(self) -> Configuration:
        """The state of that branch, shape (...); NaN if no branch is allowed."""
        return self.branches.pick(np.maximum(self.branch, 0), np.asarray(self.allowed.any(axis=-1)))


@dataclass(frozen=True)
class NearestPose:
    """A reachable state near an unreachable pose; arrays over the given poses, of shape (...)."""

    configuration: Configuration
    """The nearest state found."""
    distance: Any
    """Distance from the given pose, see `pose_distance` [m]; a float for one pose. For a stage the angle between the
    normals [rad]."""


def _reachable_by_stage(
    machine: Stage,
    height: npt.ArrayLike,
    limits: LegLimits | None = None,
    *,
    joints: JointLimits | None = None,
    branch: str = "physical",
    **place: Any,
) -> Reachability:
    """Find which modes of heights and tilts respect limits; `place` are further arguments of `inverse_displacement`."""
    limits = machine.limits if limits is None else machine.check_limits(limits)
    return _reachability(stage_displacement.inverse(machine, height, **place), limits, joints, branch)


def _reachability(
    branches: SolutionSet,
    limits: LegLimits | None,
    joints: JointLimits | None,
    branch: str,
) -> Reachability:
    choice(branch, "branch", ("physical", "any", *branches.labels))
    joints = JointLimits() if joints is None else check_instance(joints, JointLimits, "joints")
    states = branches.configurations
    leg_margin = np.where(states.exists, np.inf, np.nan)
    if limits is not None:
        leg_margin = limits.margin(states.readings, states.machine.legs.largest_slopes)
    angle_margin, clearance_margin = joints.angle_margin(states), joints.clearance_margin(states)
    with np.errstate(invalid="ignore"):
        allowed = (leg_margin >= 0.0) & (angle_margin >= 0.0) & (clearance_margin >= 0.0)
    if branch == "physical":
        allowed &= states.is_at_home
    elif branch != "any":
        allowed &= np.array([label == branch for label in branches.labels])
    return Reachability(branches, allowed, leg_margin, angle_margin, clearance_margin)


@or_of_stage(_reachable_by_stage)
def reachable(
    machine: Manipulator,
    pose: PoseLike,
    limits: LegLimits | None = None,
    *,
    joints: JointLimits | None = None,
    branch: str = "physical",
) -> Reachability:
    """Find which branches of poses respect limits, and by how much.

    For a stage the arguments are a height and a tilt instead of a pose, as for `spm_pin.inverse_displacement`; its
    branches are the modes T and F.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    pose : pose of shape (...)
        Of {m} in {B}, translation in metres.
    limits : LegLimits, optional
        Leg limits; the machine's own if not given; without either, legs are not limited.
    joints : JointLimits, optional
        Limits of the passive joints' angles, and of the distance between legs.
    branch : str
        Which branches count: "physical", those in the physical mode; "any"; or one of `BRANCHES`.

    Returns
    -------
    Reachability
        Result of shape (...), with all branches and their margins. A pose out of reach raises no error.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> pose = spm.pose([0.614, 0.451, 2.298], xyx=np.deg2rad([-9.72, 29.12, -11.76]))
    >>> answer = spm.workspace.reachable(spm.Manipulator.paper(), pose)
    >>> answer.reachable, spm.machine.BRANCHES[answer.branch], float(answer.leg_margin[answer.branch].round(2))
    (True, 'TT+', 0.05)
    """
    limits = given_limits(machine, limits)
    return _reachability(inverse_displacement(machine, pose), limits, joints, branch)


def pose_distance(machine: Manipulator, first: PoseLike, second: PoseLike) -> Any:
    """Return the root mean square displacement of c_1, c_2, c_3 between poses (...) of {m} in {B} [m], (...)."""
    check_manipulator(machine)
    matrices = [as_rigid_transform(pose, name).as_matrix() for pose, name in ((first, "first"), (second, "second"))]
    return _distance(machine, *matrices)


def _distance(machine: Manipulator, first: FloatArray, second: FloatArray) -> Any:
    """Return the root mean square displacement of the joints between poses (..., 4, 4), a float for one [m]."""
    moved = _joint_positions(machine, first - second)
    distance = np.asarray(np.sqrt((moved**2).sum(axis=-1) / 3.0))
    return distance if distance.shape else float(distance)


def _joint_positions(machine: Manipulator, matrices: FloatArray) -> FloatArray:
    """Return the positions of c_1, c_2, c_3 in poses (..., 4, 4), shape (..., 9) [m]; linear in the matrices."""
    moved = machine.platform_joints @ np.swapaxes(matrices[..., :3, :3], -1, -2)
    return (matrices[..., None, :3, 3] + moved).reshape(*matrices.shape[:-2], 9)


def _nearest_of_stage(
    machine: Stage,
    height: float,
    *,
    tilt: float | None = None,
    azimuth: float | None = None,
    roll: float | None = None,
    pitch: float | None = None,
    normal: npt.ArrayLike | None = None,
    where: Condition | None = None,
) -> NearestPose:
    target = normals_of_request(tilt, azimuth, roll, pitch, normal)
    state = nearest_tilt(machine, height, target, where)
    angle = np.arctan2(np.linalg.norm(np.cross(state.normal, target)), state.normal @ target)
    return NearestPose(state, float(angle))


@or_of_stage(_nearest_of_stage)
def nearest_reachable_pose(
    machine: Manipulator,
    pose: PoseLike,
    limits: LegLimits | None = None,
    *,
    branch: str | None = None,
    near: Configuration | None = None,
) -> NearestPose:
    """Find the reachable pose nearest to one that may be out of reach.

    For a stage the arguments are a height and a tilt instead of a pose, as for `inverse_displacement` but for one
    request, within the limits of the stage. ``where`` takes states (n,) and returns which of them count besides, (n,),
    as for `reach`.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    pose : pose of shape (...)
        Of {m} in {B}, translation in metres.
    limits : LegLimits, optional
        Leg limits; the machine's own if not given. With `LegLimits(0.0, inf)`, or without either, legs are not
        limited.
    branch : str, optional
        Without leg limits, the branch that has to be real, one of `BRANCHES`; if not given that of `near`, or "TT+".
        Within leg limits it must not be given: legs carry a configuration from one branch to another.
    near : Configuration, optional
        A single state to continue from, such as the last one while a platform is dragged. Within leg limits its
        assembly mode is kept, and the result is not farther from `pose` than `near`. Otherwise the mode is physical.

    Returns
    -------
    NearestPose
        The pose itself where it is reachable. A local minimum of the distance in any case.

        For a stage, of the states in `reach` at this height, the one whose normal has the smallest angle to the
        requested one, to 1e-6 rad. If the stage is not level at this height, it is of all states at this height that
        are found half a degree apart; without any, of `reach` at the nearest height of `height_range`; if that is
        empty, of all states at the height where the readings are in the middle of their limits. Otherwise it is
        missing.

    Raises
    ------
    ArgumentError
        If `near` does not exist, is outside the limits or of another machine, or no lengths within the limits belong
        to a configuration.

    Examples
    --------
    >>> import spm_pin as spm
    >>> machine = spm.Manipulator.paper()
    >>> nearest = spm.workspace.nearest_reachable_pose(machine, spm.pose([0.3, 0.1, 3.0], xyx=[0.1, 0.3, -0.1]))
    >>> bool(machine.limits.contains(nearest.configuration.readings)), round(nearest.distance, 3)
    (True, 0.141)
    """
    limits, target = given_limits(machine, limits), as_rigid_transform(pose)
    free = machine.legs.free_limits
    limits = limits or free
    limited = bool(np.greater(limits.minimum, free.minimum).any()) or min(limits.maximum) < np.inf
    if near is not None:
        _check_near(machine, near, limits)
    if branch is not None:
        if limited:
            raise ArgumentError("branch", "None where legs are limited", repr(branch))
        choice(branch, "branch", BRANCHES)
    matrices = target.as_matrix().reshape(-1, 4, 4)
    if limited:
        states = _nearest_within(machine, matrices, limits, near)
    else:
        own = "TT+" if near is None else FAMILIES[int(family(near))] + ("+" if branch_sign(near) >= 0.0 else "-")
        states = _nearest_real(machine, matrices, branch or own, near)
    states = states.transformed(lambda array, inner: array.reshape(*target.shape, *array.shape[array.ndim - inner :]))
    return NearestPose(states, _distance(machine, states.pose.as_matrix(), target.as_matrix()))


def _check_near(machine: Manipulator, near: Configuration, limits: LegLimits) -> None:
    if check_configuration(near, "near", of=Manipulator).shape or not near.exists:
        raise ArgumentError("near", "a single Configuration that exists", repr(near))
    check_same_machine(near.machine, machine, "near", "`machine`")
    if not limits.contains(near.readings):
        raise ArgumentError("near", "a configuration within the leg limits", repr(near))


def _nearest_within(
    machine: Manipulator, matrices: FloatArray, limits: LegLimits, near: Configuration | None
) -> Configuration:
    """Return the states (N,) within leg limits nearest to poses (N, 4, 4)."""
    joints, targets = machine.platform_joints, _joint_positions(machine, matrices)
    if near is None:
        states = states_within(machine, limits)
        solved = check_configuration(reachable(machine, as_rigid_transform(matrices), limits).configuration)
        left = np.flatnonzero(~solved.exists)
        if not len(left):
            return solved
        pairs, places = states.pairs(states.few, joints)
        ends = [nearest_state(states, target, _starts(pairs, places, target), joints) for target in targets[left]]
        found = states.states(np.array(ends))
        return _replaced(solved, left, *(getattr(found, name) for name in _STATE))
    states, start = states_around(near, limits)
    result = nearest_states(states, targets, np.broadcast_to(start, (len(targets), 1, 2, 3)), joints)
    if states.aspects == (HOME_ASPECT, HOME_ASPECT):
        return states.states(result.coordinates, result.readings)  # type: ignore[no-any-return]
    # Elsewhere the sign of a determinant does not distinguish aspects: the path from `near` does.
    followed = forward_physical(machine, result.readings, near=near)
    gap = np.abs(followed.middle_joints - states.states(result.coordinates).middle_joints).max(axis=(-1, -2))
    with np.errstate(invalid="ignore"):
        kept = gap <= _MODE_TOLERANCE * machine.middle_side
    return states.states(np.where(kept[:, None, None], result.coordinates, start))  # type: ignore[no-any-return]


def _starts(states: FloatArray, places: FloatArray, target: FloatArray, count: int = _STARTS) -> FloatArray:
    """Return the one of states (n, 2, 3) whose joints, `places` (n, 9), are nearest to the target's, and unlike ones.

    They are `count` in all, each the farthest from those before it.
    """
    chosen, nearest = [int(np.nanargmin(((places - target) ** 2).sum(axis=-1)))], np.full(len(states), np.inf)
    for _ in range(count - 1):
        nearest = np.minimum(nearest, ((states - states[chosen[-1]]) ** 2).sum(axis=(-1, -2)))
        chosen.append(int(nearest.argmax()))
    return states[chosen]


def _nearest_real(machine: Manipulator, matrices: FloatArray, branch: str, near: Configuration | None) -> Configuration:
    """Return the states (N,) nearest to poses (N, 4, 4) in which a branch is real, whatever the lengths of the legs."""
    solved = inverse_displacement(machine, as_rigid_transform(matrices))[branch]
    left = np.flatnonzero(~solved.exists)
    if not len(left):
        return solved
    states, joints = free_states(machine, branch[:2]), machine.platform_joints
    rng = np.random.default_rng(_SEED)
    tilts = rng.normal(size=(2, _FREE_FEW, 3))
    tilts *= np.sign(tilts[..., :1]) / np.linalg.norm(tilts, axis=-1, keepdims=True)
    heights = rng.uniform(-1.0, 1.0, tilts.shape[:2]) / states.radius
    last = np.empty((0, 2, 3))
    if near is not None and FAMILIES[int(family(near))] == branch[:2]:
        last = states.coordinates(Configuration(machine, near.pose.as_matrix()[None], near.middle_joints[None]))
    ends = []
    for target in _joint_positions(machine, matrices[left]):
        # Scalar part aside, the quaternion of a random tilt; and any height at which the target may be.
        lower, upper = np.dstack([tilts[..., 1:], heights * (np.abs(target).max() + machine.middle_side)])
        starts = _starts(*states.pairs((lower, upper), joints), target, _STARTS_BESIDE if len(last) else _STARTS)
        ends.append(nearest_state(states, target, np.concatenate([last, starts]), joints))
    coordinates = np.array(ends)
    # Where the branch becomes real it meets another: a step along the motion that keeps the pose separates them.
    step = _OFF_THE_EDGE * np.linalg.svd(states.jacobians(coordinates))[2][:, -1].reshape(-1, 2, 3)
    room = 0.5 * (1.0 - np.hypot(*np.moveaxis(coordinates[..., :2], -1, 0)).max(axis=-1))
    step *= np.minimum(room / _OFF_THE_EDGE, 1.0)[:, None, None]
    sides = [states.states(coordinates + sign * step) for sign in (1.0, -1.0)]
    with np.errstate(invalid="ignore"):  # a step off the edge that leads nowhere is NaN
        wanted = branch_sign(sides[0]) * (1.0 if branch[2] == "+" else -1.0) > 0.0
    both = ([getattr(side, name) for side in sides] for name in _STATE)
    return _replaced(solved, left, *(np.where(wanted.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in both))


def _replaced(states: Configuration, index: IntArray, *arrays: FloatArray) -> Configuration:
    """Return states (N,) of which those at `index` have these `arrays`, see `_STATE`."""
    whole = [np.array(getattr(states, name)) for name in _STATE]
    for array, values in zip(whole, arrays, strict=True):
        array[index] = values
    return Configuration.from_arrays(states.machine, *whole)
