"""Machines, `Stage` and `Manipulator` (two stages), their states and sets of states. No Pinocchio, CasADi or Numba.

`Machine` is their base class, with `Legs` of three or six; a `Configuration` is a state of either, a `SolutionSet` some
states.
"""

from spm_pin.machine.branch_of_state import BRANCHES, FAMILIES
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.gallery import RealMachine, gallery
from spm_pin.machine.joint_angles import JointAngles, home_readings, joint_angles
from spm_pin.machine.leg_kinds import PRS, RPS, RRS, LegKind
from spm_pin.machine.legs import LEGS, STAGE_LEGS, LegLimits, Legs, PlacedLegs
from spm_pin.machine.machine import Machine
from spm_pin.machine.manipulator import PARAMETERS, Manipulator
from spm_pin.machine.solutions import OPERATION_MODES, Degeneracy, SolutionSet, Status
from spm_pin.machine.stage import Stage
from spm_pin.support.pose import PoseLike, as_rigid_transform, pose

__all__ = [
    "BRANCHES",
    "FAMILIES",
    "LEGS",
    "OPERATION_MODES",
    "PARAMETERS",
    "PRS",
    "RPS",
    "RRS",
    "STAGE_LEGS",
    "Configuration",
    "Degeneracy",
    "JointAngles",
    "LegKind",
    "LegLimits",
    "Legs",
    "Machine",
    "Manipulator",
    "PlacedLegs",
    "PoseLike",
    "RealMachine",
    "SolutionSet",
    "Stage",
    "Status",
    "as_rigid_transform",
    "gallery",
    "home_readings",
    "joint_angles",
    "pose",
]
