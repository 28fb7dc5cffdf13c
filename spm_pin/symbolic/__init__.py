"""The kinematics outside of Python: CasADi functions with derivatives of any order, C99, LinuxCNC, ROS 2."""

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
from spm_pin.symbolic.linuxcnc_export import linuxcnc_configuration, write_linuxcnc
from spm_pin.symbolic.ros_export import ros_package, write_ros
from spm_pin.symbolic.stage_export import stage_c_sources, write_stage_c
from spm_pin.symbolic.stage_in_casadi import stage_forward, stage_inverse

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
    "linuxcnc_configuration",
    "ros_package",
    "stage_c_sources",
    "stage_forward",
    "stage_inverse",
    "write_c",
    "write_linuxcnc",
    "write_ros",
    "write_stage_c",
]
