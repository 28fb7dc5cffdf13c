"""Exports for use without Python: C99 for controllers and microcontrollers, ROS 2 packages, LinuxCNC configurations."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

# Imported on first use: the header of a stage is written without CasADi.
_HOMES = {
    "c_export": "c_sources write_c",
    "linuxcnc_export": "linuxcnc_configuration write_linuxcnc",
    "ros_export": "ros_package write_ros",
    "stage_export": "stage_c_sources write_stage_c",
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names.split():
            return getattr(import_module(f"spm_pin.export.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
