"""Workspace of a machine: the set of all poses, or tilts and heights, that its platform reaches within the limits."""

from spm_pin.workspace.boundary import Boundary, BoundaryPoints, reachable_boundary
from spm_pin.workspace.poses import (
    JointLimits,
    NearestPose,
    Reachability,
    leg_clearance,
    nearest_reachable_pose,
    pose_distance,
    reachable,
)
from spm_pin.workspace.positions import (
    Estimate,
    OrientationWorkspace,
    PositionReach,
    orientation_workspace,
    pose_volume,
    reachable_position,
    reachable_volume,
)
from spm_pin.workspace.stage_reach import ReachEnd, StageReach, best_height, height_range, home_height, reach
from spm_pin.workspace.state_set import sample_reachable

__all__ = [
    "Boundary",
    "BoundaryPoints",
    "Estimate",
    "JointLimits",
    "NearestPose",
    "OrientationWorkspace",
    "PositionReach",
    "ReachEnd",
    "Reachability",
    "StageReach",
    "best_height",
    "height_range",
    "home_height",
    "leg_clearance",
    "nearest_reachable_pose",
    "orientation_workspace",
    "pose_distance",
    "pose_volume",
    "reach",
    "reachable",
    "reachable_boundary",
    "reachable_position",
    "reachable_volume",
    "sample_reachable",
]
