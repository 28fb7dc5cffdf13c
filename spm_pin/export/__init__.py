"""What leaves Python: C99 for controllers and microcontrollers, ROS 2 packages, configurations of LinuxCNC."""

from spm_pin.export.c_export import c_sources, write_c
from spm_pin.export.linuxcnc_export import linuxcnc_configuration, write_linuxcnc
from spm_pin.export.ros_export import ros_package, write_ros
from spm_pin.export.stage_export import stage_c_sources, write_stage_c

__all__ = [
    "c_sources",
    "linuxcnc_configuration",
    "ros_package",
    "stage_c_sources",
    "write_c",
    "write_linuxcnc",
    "write_ros",
    "write_stage_c",
]
