"""Which poses are reachable: their branches, and by how much each respects the limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.mechanism import BRANCHES, Configuration, Geometry, LegLimits, PoseLike, SolutionSet, Status
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, check_instance, choice
from spm_pin.mechanism.branches import physical, tilt_cosine_sum
from spm_pin.workspace.reachability.joint_limits import JointLimits


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
    def branch(self) -> IntArray:
        """Place in `BRANCHES` of the allowed branch whose stages tilt least, shape (...); -1 where there is none."""
        score = np.where(self.allowed, tilt_cosine_sum(self.branches.configurations), -np.inf)
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
    check_instance(geometry, Geometry, "geometry")
    choice(branch, "branch", ("physical", "any", *BRANCHES))
    limits = limits if limits is None else check_instance(limits, LegLimits, "limits")
    joints = JointLimits() if joints is None else check_instance(joints, JointLimits, "joints")
    branches = inverse_displacement(geometry, pose)
    states = branches.configurations
    limits = limits or geometry.limits
    leg_margin = np.where(states.exists, np.inf, np.nan) if limits is None else limits.margin(states.readings)
    angle_margin, clearance_margin = joints.angle_margin(states), joints.clearance_margin(states)
    with np.errstate(invalid="ignore"):
        allowed = (leg_margin >= 0.0) & (angle_margin >= 0.0) & (clearance_margin >= 0.0)
    if branch == "physical":
        allowed &= physical(states)
    elif branch != "any":
        allowed &= np.array([label == branch for label in BRANCHES])
    return Reachability(branches, allowed, leg_margin, angle_margin, clearance_margin)
