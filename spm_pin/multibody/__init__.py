"""The mechanism in Pinocchio, its loops closed by constraints: kinematics, dynamics, motion in time, mounting.

Names are imported on first use: paths of the platform, and with them planning, load no Pinocchio.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spm_pin.description.source_files import Closure
    from spm_pin.loops.forward_simulation import SimulationEnd
    from spm_pin.loops.loop_state import Energy
    from spm_pin.multibody.chain import ClosedChain
    from spm_pin.multibody.chain_state import ChainState, ConstrainedState, NaturalFrequencies, PlatformDynamics
    from spm_pin.multibody.constrained_model import SingularValues
    from spm_pin.multibody.mounting import MountedChain
    from spm_pin.multibody.simulation import Simulation
    from spm_pin.multibody.stage_reader import MeasuredStage, read_stage
    from spm_pin.multibody.trajectory import JointTrajectory, PlatformMotion, PlatformPath

__all__ = [
    "ChainState",
    "ClosedChain",
    "Closure",
    "ConstrainedState",
    "Energy",
    "JointTrajectory",
    "MeasuredStage",
    "MountedChain",
    "NaturalFrequencies",
    "PlatformDynamics",
    "PlatformMotion",
    "PlatformPath",
    "Simulation",
    "SimulationEnd",
    "SingularValues",
    "read_stage",
]

_HOMES = {
    **dict.fromkeys(("JointTrajectory", "PlatformMotion", "PlatformPath"), "multibody.trajectory"),
    "Closure": "description.source_files",
    "Energy": "loops.loop_state",
    "Simulation": "multibody.simulation",
    "SimulationEnd": "loops.forward_simulation",
    "ClosedChain": "multibody.chain",
    **dict.fromkeys(("MeasuredStage", "read_stage"), "multibody.stage_reader"),
    "MountedChain": "multibody.mounting",
    "SingularValues": "multibody.constrained_model",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"spm_pin.{_HOMES.get(name, 'multibody.chain_state')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
