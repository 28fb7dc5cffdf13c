"""Workspace of the terminal platform: the paper's 24 surfaces as one shell, and the reachable set itself."""

from spm_pin.workspace.closed_mesh import Convergence
from spm_pin.workspace.paper_shell.shell import Patch, Shell
from spm_pin.workspace.paper_shell.shell import workspace_shell as shell
from spm_pin.workspace.paper_shell.sub_workspaces import Setting
from spm_pin.workspace.reachability.boundary import Boundary, BoundaryPoints, reachable_boundary
from spm_pin.workspace.reachability.confidence_intervals import Estimate
from spm_pin.workspace.reachability.joint_limits import JointLimits, leg_clearance
from spm_pin.workspace.reachability.nearest_pose import NearestPose, nearest_reachable_pose, pose_distance
from spm_pin.workspace.reachability.orientation import OrientationWorkspace, orientation_workspace
from spm_pin.workspace.reachability.reachable_poses import Reachability, reachable
from spm_pin.workspace.reachability.reachable_positions import PositionReach, reachable_position
from spm_pin.workspace.reachability.reachable_samples import sample_reachable
from spm_pin.workspace.reachability.volume import pose_volume, reachable_volume
from spm_pin.workspace.shell_comparison import ShellComparison, compare_with_shell

__all__ = [
    "Boundary",
    "BoundaryPoints",
    "Convergence",
    "Estimate",
    "JointLimits",
    "NearestPose",
    "OrientationWorkspace",
    "Patch",
    "PositionReach",
    "Reachability",
    "Setting",
    "Shell",
    "ShellComparison",
    "compare_with_shell",
    "leg_clearance",
    "nearest_reachable_pose",
    "orientation_workspace",
    "pose_distance",
    "pose_volume",
    "reachable",
    "reachable_boundary",
    "reachable_position",
    "reachable_volume",
    "sample_reachable",
    "shell",
]
