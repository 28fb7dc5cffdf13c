"""The closed form: branches, assembly modes, rates, forces and singularities, without iteration in the inverse."""

from spm_pin.kinematics.forward_displacement import (
    ASSEMBLY_MODES,
    STAGE_MODES,
    forward_displacement,
    forward_physical,
)
from spm_pin.kinematics.inverse_displacement import (
    branch_lengths,
    complex_middle_joints,
    inverse_displacement,
    inverse_physical,
)
from spm_pin.kinematics.jacobians import inverse_jacobian, leg_rates, platform_jacobian
from spm_pin.kinematics.leg_forces import leg_forces
from spm_pin.kinematics.path_events import Event, EventKind
from spm_pin.kinematics.path_following import CertifiedLimits, FollowedPath, follow
from spm_pin.kinematics.precompile import compile_kernels
from spm_pin.kinematics.singularity_analysis import (
    Singularities,
    SingularityKind,
    determinant_gradients,
    determinants,
    singular_values,
    singularities,
)
from spm_pin.kinematics.stiffness import PrincipalStiffness, compliance, principal_stiffness, stiffness
from spm_pin.kinematics.threads import set_threads, threads

__all__ = [
    "ASSEMBLY_MODES",
    "STAGE_MODES",
    "CertifiedLimits",
    "Event",
    "EventKind",
    "FollowedPath",
    "PrincipalStiffness",
    "Singularities",
    "SingularityKind",
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
    "leg_forces",
    "leg_rates",
    "platform_jacobian",
    "principal_stiffness",
    "set_threads",
    "singular_values",
    "singularities",
    "stiffness",
    "threads",
]
