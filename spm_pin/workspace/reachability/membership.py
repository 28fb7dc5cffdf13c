"""What the platform can reach: poses through their branches and the limits, positions in some orientation, samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.closed_form.jacobians import platform_jacobian
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, real_array
from spm_pin.mechanism.branches import BRANCHES, physical, straightness
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry, LegLimits
from spm_pin.mechanism.pose import PoseLike
from spm_pin.mechanism.solutions import SolutionSet, Status
from spm_pin.workspace.reachability.joint_limits import JointLimits
from spm_pin.workspace.reachability.leg_box import leg_box
from spm_pin.workspace.reachability.nearest import RESOLUTION, Progress, nearest_in_box

__all__ = [
    "PositionReach",
    "Reachability",
    "pose_density",
    "reachable",
    "reachable_position",
    "sample_reachable",
]

BoolArray = npt.NDArray[np.bool_]

_TRIES = 12
_PORTION = 20_000
_MOST_ROUNDS = 1000


@dataclass(frozen=True)
class Reachability:
    """Which poses of shape (...) can be reached, and by how much.

    Attributes
    ----------
    branches : SolutionSet, shape (...)
        All eight branches of each pose, limits not applied.
    allowed : ndarray of bool, shape (..., 8)
        Which of them count and respect all limits.
    leg_margin : ndarray, shape (..., 8)
        How far the worst leg of a branch is inside its limits [m]; negative outside, infinite without limits, NaN where
        the branch is not real.
    angle_margin : ndarray, shape (..., 8)
        The same of the passive joints' angles [rad].
    clearance_margin : ndarray, shape (..., 8)
        By how much the nearest legs of a branch are farther apart than they must [m]; as the others.
    """

    branches: SolutionSet
    allowed: BoolArray
    leg_margin: FloatArray
    angle_margin: FloatArray
    clearance_margin: FloatArray

    @property
    def reachable(self) -> Any:
        """Whether a branch is allowed, shape (...); a bool for one pose."""
        any_branch = np.asarray(self.allowed.any(axis=-1))
        return any_branch if self.branches.shape else bool(any_branch)

    @property
    def undecided(self) -> Any:
        """Whether no branch is allowed but a continuous family, which has no list of branches, may hold one."""
        undecided = ~self.allowed.any(axis=-1) & (np.asarray(self.branches.status) == Status.DEGENERATE)
        return undecided if self.branches.shape else bool(undecided)

    @property
    def branch(self) -> npt.NDArray[np.intp]:
        """Place in `BRANCHES` of the allowed branch whose stages tilt least, shape (...); -1 where there is none."""
        score = np.where(self.allowed, straightness(self.branches.configurations), -np.inf)
        return np.where(self.allowed.any(axis=-1), score.argmax(axis=-1), -1).astype(np.intp)

    @property
    def configuration(self) -> Configuration:
        """The state of that branch, shape (...); NaN where there is none."""
        chosen = self.branch[..., None] == np.arange(len(BRANCHES))
        state = self.branches.configurations

        def pick(array: FloatArray, inner: int) -> FloatArray:
            mask = chosen.reshape(*chosen.shape, *(1,) * inner)
            value = np.where(mask, array, 0.0).sum(axis=-inner - 1)
            return np.where(chosen.any(axis=-1).reshape(*chosen.shape[:-1], *(1,) * inner), value, np.nan)

        return Configuration.from_arrays(
            self.branches.geometry, pick(state.rotation, 2), pick(state.translation, 1), pick(state.middle_joints, 2)
        )


def reachable(
    geometry: Geometry,
    pose: PoseLike,
    limits: LegLimits | None = None,
    *,
    joints: JointLimits | None = None,
    branch: str = "physical",
) -> Reachability:
    """Tell whether poses can be reached within limits.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    pose : pose of shape (...)
        Of {m} in {B}, translation in metres.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given; without either, legs are not limited.
    joints : JointLimits, optional
        Limits of the passive joints' angles, and of the distance between legs.
    branch : str
        Which branches count: "physical", those a real machine can be in; "any"; or one of `BRANCHES`.

    Returns
    -------
    Reachability
        Of shape (...), with all branches and their margins. A pose out of reach is no error.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    ArgumentError
        If another argument is of the wrong kind.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> pose = spm.pose([0.614, 0.451, 2.298], xyx=np.deg2rad([-9.72, 29.12, -11.76]))
    >>> answer = spm.workspace.reachable(spm.Geometry.paper(), pose)
    >>> answer.reachable, spm.mechanism.BRANCHES[answer.branch], float(answer.leg_margin[answer.branch].round(2))
    (True, 'TT+', 0.05)
    """
    if not isinstance(geometry, Geometry):
        raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
    if branch not in ("physical", "any", *BRANCHES):
        raise ArgumentError("branch", f'"physical", "any", or one of {", ".join(BRANCHES)}', repr(branch))
    for name, value, kind in (("limits", limits, LegLimits), ("joints", joints, JointLimits)):
        if value is not None and not isinstance(value, kind):
            raise ArgumentError(name, f"{kind.__name__} or None", type(value).__name__)
    branches = inverse_displacement(geometry, pose)
    states = branches.configurations
    limits = limits or geometry.limits
    joints = joints or JointLimits()
    leg_margin = np.where(states.exists, np.inf, np.nan) if limits is None else limits.margin(states.leg_lengths)
    angle_margin, clearance_margin = joints.angle_margin(states), joints.clearance_margin(states)
    with np.errstate(invalid="ignore"):
        allowed = (leg_margin >= 0.0) & (angle_margin >= 0.0) & (clearance_margin >= 0.0)
    if branch == "physical":
        allowed &= physical(states)
    elif branch != "any":
        allowed &= np.array([label == branch for label in BRANCHES])
    return Reachability(branches, allowed, leg_margin, angle_margin, clearance_margin)


@dataclass(frozen=True)
class PositionReach:
    """Which positions of shape (...) can be reached in some orientation.

    Attributes
    ----------
    reachable : ndarray of bool, shape (...)
        Whether o can be there, to within `tolerance`.
    distance : ndarray, shape (...)
        From the nearest reachable position that was found [m]; zero where reachable.
    nearest : ndarray, shape (..., 3)
        That position, in {B} [m].
    leg_lengths : ndarray, shape (..., 6)
        Leg lengths that put o there [m]; there may be others.
    optimality : ndarray, shape (...)
        How far `nearest` is from obeying the conditions of a nearest point, see
        `spm_pin.workspace.reachability.nearest`;         rounding, unless the search has not arrived and
        `distance` is only an upper bound.
    tolerance : float
        [m].
    """

    reachable: BoolArray
    distance: FloatArray
    nearest: FloatArray
    leg_lengths: FloatArray
    optimality: FloatArray
    tolerance: float


def reachable_position(
    geometry: Geometry, points: npt.ArrayLike, limits: LegLimits | None = None, *, tries: int = _TRIES
) -> PositionReach:
    """Tell whether o can be at points in some orientation, in the mode of a real machine.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    points : array_like, shape (..., 3)
        In {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    tries : int
        Beginnings of the search; see Notes.

    Raises
    ------
    ArgumentError
        If `points` are not finite numbers of that shape, or there are no limits, one is infinite, or no lengths within
        them belong to a configuration.

    Notes
    -----
    "Reachable" is proved: `leg_lengths` put o there. "Not reachable" is the outcome of a local search from several
    states nearby, each of which ends at a nearest point of its surroundings. Of 10 000 points near the boundary of the
    paper's manipulator 2 were misjudged with 12 beginnings, 47 with one.
    """
    array = real_array(points, "points", (3,), "positions in metres")
    if isinstance(tries, bool) or not isinstance(tries, int | np.integer) or tries < 1:
        raise ArgumentError("tries", "a whole number of at least 1", repr(tries))
    box = leg_box(geometry, limits)
    found = nearest_in_box(box, array.reshape(-1, 3), tries=int(tries))
    tolerance = RESOLUTION * box.size
    shape = array.shape[:-1]
    reached = found.distance <= tolerance
    return PositionReach(
        reached.reshape(shape),
        np.where(reached, 0.0, found.distance).reshape(shape),
        found.position.reshape(*shape, 3),
        found.lengths.reshape(*shape, 6),
        found.optimality.reshape(shape),
        tolerance,
    )


def sample_reachable(
    geometry: Geometry,
    count: int,
    limits: LegLimits | None = None,
    *,
    space: Literal["legs", "poses"] = "legs",
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Configuration:
    """Draw states that a real machine can be in.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    count : int
        How many.
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.
    space : str
        "legs": uniform in the leg lengths that belong to a configuration. "poses": uniform in the reachable poses, with
        the volume of positions times the uniform measure of rotations.
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with what is being done, how many states are found, and of how many.

    Returns
    -------
    Configuration
        Of shape (count,).

    Raises
    ------
    ArgumentError
        As for `reachable_position`; or if `count` or `space` is none of the above.

    Notes
    -----
    For poses, lengths l are drawn uniformly and kept in proportion to |det ∂(o, R)/∂l|, which is how much of pose space
    they stand for, divided by the number of sets of lengths that lead to the same pose. The largest value is taken from
    what has been drawn; all is drawn again whenever a larger one comes up.
    """
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
        raise ArgumentError("count", "a whole number that is not negative", repr(count))
    if space not in ("legs", "poses"):
        raise ArgumentError("space", '"legs" or "poses"', repr(space))
    box = leg_box(geometry, limits)
    generator = np.random.default_rng(rng)
    parts = [_none(geometry)]
    largest = 0.0
    for _ in range(_MOST_ROUNDS):
        kept = sum(len(part) for part in parts)
        if progress is not None:
            progress("reachable states", min(kept, int(count)), int(count))
        if kept >= count:
            break
        lengths = generator.uniform(box.minimum, box.maximum, (min(max(4 * count, 64), _PORTION), 6))
        states = forward_physical(geometry, lengths)
        states = states[states.exists]
        if space == "poses" and len(states):
            density = pose_density(states, box.limits)
            if density.max() > largest:
                # A bound that a later sample will hardly exceed.
                parts, largest = [_none(geometry)], 1.2 * float(density.max())
            states = states[generator.uniform(size=len(density)) * largest < density]
        parts.append(states)
    else:
        raise ArgumentError("limits", "limits within which states are not too rare to be drawn", f"{kept} of {count}")
    rotation, translation, joints = (
        np.concatenate([getattr(part, name) for part in parts])[:count]
        for name in ("rotation", "translation", "middle_joints")
    )
    return Configuration.from_arrays(geometry, rotation, translation, joints)


def _none(geometry: Geometry) -> Configuration:
    return Configuration.from_arrays(geometry, np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))


def pose_density(states: Configuration, limits: LegLimits) -> FloatArray:
    """Return how much of pose space each of `states` (N,) stands for, per unit of the leg lengths [rad³/m³], (N,).

    |det ∂(o, R)/∂l| over how many states of a real machine within `limits` hold the same pose.
    """
    branches = inverse_displacement(states.geometry, states.pose).configurations
    # A state at a limit may miss it by rounding: it counts itself at least.
    same = np.maximum((physical(branches) & limits.contains(branches.leg_lengths)).sum(axis=-1), 1)
    return np.asarray(np.abs(np.linalg.det(platform_jacobian(states))) / same)
