"""Reachable poses by branches and limits, positions reachable in some orientation, and samples of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.closed_form.inverse_displacement import inverse_displacement
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import BRANCHES, Configuration, Geometry, LegLimits, PoseLike, SolutionSet, Status
from spm_pin.mechanism.arguments import BoolArray, FloatArray, choice, generator, instance, real_array, whole_number
from spm_pin.mechanism.branches import physical, straightness
from spm_pin.workspace.reachability.joint_limits import JointLimits
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox, leg_length_box
from spm_pin.workspace.reachability.nearest_points import nearest_in_box
from spm_pin.workspace.reachability.state_search import RESOLUTION, Progress

__all__ = [
    "PositionReach",
    "Reachability",
    "pose_multiplicity",
    "reachable",
    "reachable_position",
    "sample_reachable",
]


_OPTIMALITY_TOLERANCE = 1e-6
"""Violation of the conditions of a nearest point, dimensionless, above which the search has not converged."""
_PORTION = 20_000
"""States drawn together, at most."""
_MOST_PORTIONS = 1000
"""Portions that are drawn at most."""


@dataclass(frozen=True)
class Reachability:
    """Which poses of shape (...) can be reached, and by how much."""

    branches: SolutionSet
    """All eight branches of each pose, limits not applied, shape (...)."""
    allowed: BoolArray
    """Which of them count and respect all limits, shape (..., 8)."""
    leg_margin: FloatArray
    """How far the worst leg of a branch is inside its limits [m], shape (..., 8); negative outside, infinite without
    limits, NaN where the branch is not real."""
    angle_margin: FloatArray
    """How far the worst passive joint of a branch is inside its limits [rad], shape (..., 8)."""
    clearance_margin: FloatArray
    """By how much the nearest legs of a branch are farther apart than they must [m], shape (..., 8)."""

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
    def branch(self) -> npt.NDArray[np.intp]:
        """Place in `BRANCHES` of the allowed branch whose stages tilt least, shape (...); -1 where there is none."""
        score = np.where(self.allowed, straightness(self.branches.configurations), -np.inf)
        return np.where(self.allowed.any(axis=-1), score.argmax(axis=-1), -1).astype(np.intp)

    @property
    def configuration(self) -> Configuration:
        """The state of that branch, shape (...); NaN where there is none."""
        return self.branches.pick(np.maximum(self.branch, 0), np.asarray(self.allowed.any(axis=-1)))


def reachable(
    geometry: Geometry,
    pose: PoseLike,
    limits: LegLimits | None = None,
    *,
    joints: JointLimits | None = None,
    branch: str = "physical",
) -> Reachability:
    """Find which branches of poses respect limits, and by how much.

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
        Which branches count: "physical", those in the physical mode; "any"; or one of `BRANCHES`.

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
    instance(geometry, Geometry, "geometry")
    choice(branch, "branch", ("physical", "any", *BRANCHES))
    limits = limits if limits is None else instance(limits, LegLimits, "limits")
    joints = JointLimits() if joints is None else instance(joints, JointLimits, "joints")
    branches = inverse_displacement(geometry, pose)
    states = branches.configurations
    limits = limits or geometry.limits
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
    """Which positions of shape (...) can be reached in some orientation."""

    reachable: BoolArray
    """Whether o can be there, to within `tolerance`, shape (...)."""
    distance: FloatArray
    """Distance to the nearest reachable position that was found [m], shape (...); zero where reachable."""
    nearest: FloatArray
    """The nearest reachable position that was found, in {B} [m], shape (..., 3)."""
    leg_lengths: FloatArray
    """Leg lengths that put o there [m], shape (..., 6); there may be others."""
    optimality: FloatArray
    """How far `nearest` is from obeying the conditions of a nearest point, shape (...), see
    `spm_pin.workspace.reachability.nearest_points`; rounding, unless the search has not converged and `distance` is
    only an upper bound."""
    tolerance: float
    """Tolerance of the positions [m]: one nearer than this counts as reached."""

    @property
    def undecided(self) -> BoolArray:
        """Points where no state was found, and no nearest one either, shape (...)."""
        return np.asarray(~self.reachable & (self.optimality > _OPTIMALITY_TOLERANCE))


def reachable_position(geometry: Geometry, points: npt.ArrayLike, limits: LegLimits | None = None) -> PositionReach:
    """Find which positions o can reach in some orientation, in the physical mode, and the nearest it can.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    points : array_like, shape (..., 3)
        In {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.

    Raises
    ------
    ArgumentError
        If `points` are not finite numbers of that shape, or there are no limits, one is infinite, or no lengths within
        them belong to a configuration.

    Notes
    -----
    "Reachable" is proved: `leg_lengths` put o there. "Not reachable" is the outcome of a search: a coarse one through
    the states of both stages, then least squares from the best of them. Where the nearest position is not found either,
    `undecided` says so.
    """
    array = real_array(points, "points", (3,), "positions in metres")
    box = leg_length_box(geometry, limits)
    found = nearest_in_box(box, array.reshape(-1, 3))
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
    """Draw physical states.

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
    Both stages are drawn independently. For poses, their coordinates c are drawn uniformly, see
    `spm_pin.workspace.reachability.position_map`, and states kept in proportion to |det ∂(o, R)/∂c|, which is how much
    of pose space they stand for, divided by the number of states with the same pose. The largest value is taken from
    what has been drawn; all is drawn again whenever a larger one comes up.
    """
    count = whole_number(count, "count")
    choice(space, "space", ("legs", "poses"))
    box, rng = leg_length_box(geometry, limits), generator(rng)
    parts, largest, kept = [np.empty((0, 2, 3))], 0.0, 0
    for _ in range(_MOST_PORTIONS):
        if progress is not None:
            progress("reachable states", min(kept, count), count)
        if kept >= count:
            break
        number = min(max(4 * count, 64), _PORTION)
        if space == "legs":
            parts.append(_uniform_in_legs(box, number, rng))
        else:
            coordinates, _ = box.draw(number, rng)
            density = box.map.pose_densities(coordinates) / pose_multiplicity(box.map.states(coordinates), box.limits)
            if density.max() > largest:
                # A bound that a later sample will hardly exceed.
                parts, largest = [parts[0]], 1.2 * float(density.max())
            parts.append(coordinates[rng.uniform(size=number) * largest < density])
        kept = sum(len(part) for part in parts)
    else:
        raise ArgumentError("limits", "limits within which states are not too rare to be drawn", f"{kept} of {count}")
    return box.map.states(np.concatenate(parts)[:count])


def _uniform_in_legs(box: LegLengthBox, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw `count` sets of leg lengths uniformly; return the coordinates of the states among them, (n, 2, 3).

    The legs of one stage say nothing about the other stage's: each stage is drawn by itself.
    """
    lengths = rng.uniform(box.minimum, box.maximum, (count, 6))
    known = box.map.lengths(box.draw(1, np.random.default_rng(0))[0])[0]
    halves = []
    for k in range(2):
        legs = np.tile(known, (count, 1))
        legs[:, 3 * k : 3 * k + 3] = lengths[:, 3 * k : 3 * k + 3]
        states = forward_physical(box.geometry, legs)
        halves.append(box.map.coordinates(states[states.exists])[:, k])
    number = min(len(half) for half in halves)
    return np.stack([half[:number] for half in halves], axis=1)


def pose_multiplicity(states: Configuration, limits: LegLimits) -> npt.NDArray[np.intp]:
    """Return how many physical states within `limits` have the pose of each of `states` (N,), (N,)."""
    branches = inverse_displacement(states.geometry, states.pose).configurations
    # A state at a limit may miss it by rounding: it counts itself at least.
    same = (physical(branches) & limits.contains(branches.leg_lengths)).sum(axis=-1)
    return np.asarray(np.maximum(same, 1), dtype=np.intp)
