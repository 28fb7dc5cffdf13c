"""The kinematics outside of Python: CasADi functions with derivatives of any order, and C99 for controllers."""

from spm_pin.symbolic.c_export import c_sources, write_c
from spm_pin.symbolic.functions import (
    bodies,
    closure_residual,
    forward_physical,
    gravity,
    inverse_branch,
    inverse_jacobian,
    inverse_physical,
    joint_values,
    leg_forces,
    leg_rates,
)

__all__ = [
    "bodies",
    "c_sources",
    "closure_residual",
    "forward_physical",
    "gravity",
    "inverse_branch",
    "inverse_jacobian",
    "inverse_physical",
    "joint_values",
    "leg_forces",
    "leg_rates",
    "write_c",
]
