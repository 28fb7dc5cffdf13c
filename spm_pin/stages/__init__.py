"""A `Stage` as a machine of its own: displacements, rates, forces, singularities and reach. No Pinocchio, no CasADi.

A stage has three readings, and its platform tilts and rises: what it does besides, a shift and a torsion, follows.
"""

from spm_pin.mechanism.stage_configuration import StageConfiguration, StageSolutions
from spm_pin.stages.displacement import (
    OPERATION_MODES,
    forward,
    forward_physical,
    inverse,
    inverse_physical,
)

__all__ = [
    "OPERATION_MODES",
    "StageConfiguration",
    "StageSolutions",
    "forward",
    "forward_physical",
    "inverse",
    "inverse_physical",
]
