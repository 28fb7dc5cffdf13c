"""The kinematics outside of Python: CasADi functions with derivatives of any order, C99, LinuxCNC, ROS 2."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

# Imported on first use: the header of a stage is written without CasADi.
_HOMES = {
    "c_export": "c_sources write_c",
    "functions": "bodies closure_residual forward_physical gravity inverse_branch inverse_jacobian inverse_physical "
    "joint_values leg_forces leg_rates",
    "linuxcnc_export": "linuxcnc_configuration write_linuxcnc",
    "ros_export": "ros_package write_ros",
    "stage_export": "stage_c_sources write_stage_c",
    "stage_in_casadi": "stage_forward stage_inverse",
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"spm_pin.symbolic.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
