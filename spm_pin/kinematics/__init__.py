"""Kinematics of machines: branches, assembly modes, rates, forces, singularities and paths."""

from spm_pin.kinematics.batches import compile_kernels, set_threads, threads
from spm_pin.kinematics.forward_displacement import ASSEMBLY_MODES, forward_displacement, forward_physical
from spm_pin.kinematics.inverse_displacement import (
    BranchMemory,
    branch_lengths,
    complex_middle_joints,
    inverse_displacement,
    inverse_physical,
)
from spm_pin.kinematics.path_following import follow
from spm_pin.kinematics.rates_and_forces import (
    MOTION,
    JointLoads,
    PrincipalStiffness,
    compliance,
    inverse_jacobian,
    joint_loads,
    leg_forces,
    leg_rates,
    parasitic_jacobian,
    platform_jacobian,
    principal_stiffness,
    stiffness,
)
from spm_pin.kinematics.singularity_analysis import (
    Singularities,
    StageSingularities,
    determinant_gradients,
    determinants,
    singular_values,
    singularities,
)
from spm_pin.kinematics.singularity_kinds import SingularityKind
from spm_pin.kinematics.stage_balls import STAGE_MODES
from spm_pin.kinematics.tracking import CertifiedLimits, Event, EventKind, FollowedPath

__all__ = [
    "ASSEMBLY_MODES",
    "MOTION",
    "STAGE_MODES",
    "BranchMemory",
    "CertifiedLimits",
    "Event",
    "EventKind",
    "FollowedPath",
    "JointLoads",
    "PrincipalStiffness",
    "Singularities",
    "SingularityKind",
    "StageSingularities",
    "branch_lengths",
    "compile_kernels",
    "complex_middle_joints",
    "compliance",
    "determinant_gradients",
    "determinants",
    "follow",
    "forward_displacement",
    "forward_physical",
    "inverse_displacement",
    "inverse_jacobian",
    "inverse_physical",
    "joint_loads",
    "leg_forces",
    "leg_rates",
    "parasitic_jacobian",
    "platform_jacobian",
    "principal_stiffness",
    "set_threads",
    "singular_values",
    "singularities",
    "stiffness",
    "threads",
]
