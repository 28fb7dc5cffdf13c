"""A `Stage` and a robot of two, a `Geometry`; their states and sets of states. No Pinocchio, CasADi or Numba.

What they share stands once: `Mechanism` is the base of both, with `Legs` of three or six; `Batched` of their states,
`StageConfiguration` and `Configuration`; `Solutions` of sets of these, `StageSolutions` and `SolutionSet`.
"""

from spm_pin.mechanism.branch_of_state import BRANCHES, FAMILIES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import PARAMETERS, Geometry
from spm_pin.mechanism.joint_angles import JointAngles, home_readings, joint_angles
from spm_pin.mechanism.leg_kinds import PRS, RPS, RRS, LegKind
from spm_pin.mechanism.legs import LEGS, STAGE_LEGS, LegLimits, Legs, PlacedLegs, StageLimits
from spm_pin.mechanism.mechanism import Mechanism
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform, pose
from spm_pin.mechanism.solution_axis import Status
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet
from spm_pin.mechanism.stage import Stage
from spm_pin.mechanism.stage_configuration import StageConfiguration, StageSolutions

__all__ = [
    "BRANCHES",
    "FAMILIES",
    "LEGS",
    "PARAMETERS",
    "PRS",
    "RPS",
    "RRS",
    "STAGE_LEGS",
    "Configuration",
    "Degeneracy",
    "Geometry",
    "JointAngles",
    "LegKind",
    "LegLimits",
    "Legs",
    "Mechanism",
    "PlacedLegs",
    "PoseLike",
    "SolutionSet",
    "Stage",
    "StageConfiguration",
    "StageLimits",
    "StageSolutions",
    "Status",
    "as_rigid_transform",
    "home_readings",
    "joint_angles",
    "pose",
]
