"""Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator."""

from spm_pin.closed_form.inverse import complex_middle_joints, inverse_displacement
from spm_pin.errors import ArgumentError, GeometryError, NotOneSolutionError, PoseError, SpmError
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

__version__ = "0.1.0"

__all__ = [
    "BRANCHES",
    "FAMILIES",
    "LEGS",
    "ArgumentError",
    "Configuration",
    "Degeneracy",
    "Geometry",
    "GeometryError",
    "LegLimits",
    "NotOneSolutionError",
    "PoseError",
    "SolutionSet",
    "SpmError",
    "Status",
    "complex_middle_joints",
    "inverse_displacement",
    "pose",
]
