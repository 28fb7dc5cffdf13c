"""Descriptions of a manipulator or a stage: paths of the files, and their text in the formats of other programs.

The paths of the files are constants, named as the package robot_descriptions names them:

>>> from spm_pin.description import URDF_PATH
>>> import pinocchio
>>> model = pinocchio.buildModelFromUrdf(URDF_PATH)
"""

from __future__ import annotations

from spm_pin.description.masses import Masses, RigidBody
from spm_pin.description.source_files import (
    ENTRY,
    EXTENDED_URDF,
    MJCF,
    SDF,
    SRDF,
    URDF,
    Closure,
    description_directory,
    read_closures,
    urdf_text,
)
from spm_pin.description.tree import extended_urdf_text, joint_values, srdf_text
from spm_pin.description.write_xml import Ball, mjcf_text, sdf_text
from spm_pin.machine.joint_angles import JOINTS, actuated_joints, joint_names

__all__ = [
    "CLOSURES_PATH",
    "JOINTS",
    "MJCF_PATH",
    "PACKAGE_PATH",
    "SDF_PATH",
    "SRDF_PATH",
    "URDF_PATH",
    "XACRO_PATH",
    "Ball",
    "Closure",
    "Masses",
    "RigidBody",
    "actuated_joints",
    "extended_urdf_text",
    "joint_names",
    "joint_values",
    "mjcf_text",
    "read_closures",
    "sdf_text",
    "srdf_text",
    "urdf_text",
]

_folder = description_directory()

PACKAGE_PATH = str(_folder)
"""The folder of the description, also a ROS package, `spm_description`."""
URDF_PATH = str(_folder / URDF)
"""The spanning tree; its loops are closed by Drake's elements."""
XACRO_PATH = str(_folder / ENTRY)
"""The source of the URDF."""
SRDF_PATH = str(_folder / SRDF)
"""Named states, groups and passive joints."""
MJCF_PATH = str(_folder / MJCF)
"""The closed robot for MuJoCo, Drake and Pinocchio."""
SDF_PATH = str(_folder / SDF)
"""The closed robot in SDFormat."""
CLOSURES_PATH = str(_folder / EXTENDED_URDF)
"""The closures in the layout of Extended-URDF, beside the URDF."""
