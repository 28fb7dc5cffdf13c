"""The formulas in CasADi: functions with derivatives of any order, of the manipulator and of a stage."""

from spm_pin.casadi.functions import (
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
    stage_inverse,
)

__all__ = [
    "bodies",
    "closure_residual",
    "forward_physical",
    "gravity",
    "inverse_branch",
    "inverse_jacobian",
    "inverse_physical",
    "joint_values",
    "leg_forces",
    "leg_rates",
    "stage_inverse",
]
