"""Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spm_pin.closed_form.forward import ASSEMBLY_MODES, STAGE_MODES, forward_displacement, forward_physical
from spm_pin.closed_form.inverse import branch_lengths, complex_middle_joints, inverse_displacement
from spm_pin.closed_form.paths import FollowedPath, follow
from spm_pin.closed_form.singularity import (
    Singularities,
    SingularityKind,
    determinant_gradients,
    determinants,
    singularities,
)
from spm_pin.closed_form.statics import leg_forces
from spm_pin.closed_form.threads import set_threads, threads
from spm_pin.closed_form.tracking import Event, EventKind
from spm_pin.closed_form.velocity import inverse_jacobian, leg_rates, platform_jacobian
from spm_pin.errors import (
    ArgumentError,
    ClosureError,
    DescriptionError,
    GeometryError,
    MissingExtraError,
    NotOneSolutionError,
    PoseError,
    SingularConfigurationError,
    SpmError,
)
from spm_pin.mechanism import (
    BRANCHES,
    FAMILIES,
    LEGS,
    Configuration,
    Degeneracy,
    Geometry,
    LegLimits,
    SolutionSet,
    Status,
    pose,
)
from spm_pin.workspace.reach.boundary import Boundary, BoundaryPoints, reachable_boundary
from spm_pin.workspace.reach.estimate import Estimate
from spm_pin.workspace.reach.joint_limits import JointAngles, JointLimits, joint_angles, leg_clearance
from spm_pin.workspace.reach.membership import (
    PositionReach,
    Reachability,
    reachable,
    reachable_position,
    sample_reachable,
)
from spm_pin.workspace.reach.orientation import OrientationWorkspace, orientation_workspace
from spm_pin.workspace.reach.volume import ShellComparison, compare_with_shell, pose_volume, reachable_volume
from spm_pin.workspace.shell.joined import Patch, Shell, workspace_shell
from spm_pin.workspace.sweep.grids import leg_grid, leg_sample, pose_grid, pose_sample
from spm_pin.workspace.sweep.index import Index
from spm_pin.workspace.sweep.indices import INDICES
from spm_pin.workspace.sweep.run import open_sweep, resume_sweep, sweep, sweep_status

if TYPE_CHECKING:
    from spm_pin import nlp
    from spm_pin.multibody.chain import ClosedChain
    from spm_pin.multibody.platform_path import PlatformPath

__version__ = "0.1.0"

__all__ = [
    "ASSEMBLY_MODES",
    "BRANCHES",
    "FAMILIES",
    "INDICES",
    "LEGS",
    "STAGE_MODES",
    "ArgumentError",
    "Boundary",
    "BoundaryPoints",
    "ClosedChain",
    "ClosureError",
    "Configuration",
    "Degeneracy",
    "DescriptionError",
    "Estimate",
    "Event",
    "EventKind",
    "FollowedPath",
    "Geometry",
    "GeometryError",
    "Index",
    "JointAngles",
    "JointLimits",
    "LegLimits",
    "MissingExtraError",
    "NotOneSolutionError",
    "OrientationWorkspace",
    "Patch",
    "PlatformPath",
    "PoseError",
    "PositionReach",
    "Reachability",
    "Shell",
    "ShellComparison",
    "SingularConfigurationError",
    "Singularities",
    "SingularityKind",
    "SolutionSet",
    "SpmError",
    "Status",
    "branch_lengths",
    "compare_with_shell",
    "complex_middle_joints",
    "determinant_gradients",
    "determinants",
    "follow",
    "forward_displacement",
    "forward_physical",
    "inverse_displacement",
    "inverse_jacobian",
    "joint_angles",
    "leg_clearance",
    "leg_forces",
    "leg_grid",
    "leg_rates",
    "leg_sample",
    "nlp",
    "open_sweep",
    "orientation_workspace",
    "platform_jacobian",
    "pose",
    "pose_grid",
    "pose_sample",
    "pose_volume",
    "reachable",
    "reachable_boundary",
    "reachable_position",
    "reachable_volume",
    "resume_sweep",
    "sample_reachable",
    "set_threads",
    "singularities",
    "sweep",
    "sweep_status",
    "threads",
    "workspace_shell",
]


def __getattr__(name: str) -> Any:
    # Imported when first asked for: Pinocchio and CasADi take longer to load than all the rest.
    if name == "nlp":
        return import_module("spm_pin.nlp")
    if name == "ClosedChain":
        return import_module("spm_pin.multibody.chain").ClosedChain
    if name == "PlatformPath":
        return import_module("spm_pin.multibody.platform_path").PlatformPath
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
