"""A `Stage` as a machine of its own: displacements, rates, forces, singularities and reach. No Pinocchio, no CasADi.

A stage has three readings, and its platform tilts and rises: what it does besides, a shift and a torsion, follows.
"""

from spm_pin.kinematics import inverse_jacobian, leg_forces, leg_rates, platform_jacobian, singularities
from spm_pin.kinematics.stage_displacement import forward, forward_physical, inverse, inverse_physical
from spm_pin.kinematics.stage_paths import follow
from spm_pin.kinematics.stage_rates import MOTION, JointLoads, StageSingularities, joint_loads, parasitic_jacobian
from spm_pin.machine.stage_configuration import OPERATION_MODES, StageConfiguration, StageSolutions
from spm_pin.stages.gallery import RealMachine, gallery
from spm_pin.stages.reach import ReachEnd, StageReach, best_height, height_range, home_height, nearest_reachable, reach

__all__ = [
    "MOTION",
    "OPERATION_MODES",
    "JointLoads",
    "ReachEnd",
    "RealMachine",
    "StageConfiguration",
    "StageReach",
    "StageSingularities",
    "StageSolutions",
    "best_height",
    "follow",
    "forward",
    "forward_physical",
    "gallery",
    "height_range",
    "home_height",
    "inverse",
    "inverse_jacobian",
    "inverse_physical",
    "joint_loads",
    "leg_forces",
    "leg_rates",
    "nearest_reachable",
    "parasitic_jacobian",
    "platform_jacobian",
    "reach",
    "singularities",
]
