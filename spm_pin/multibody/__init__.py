"""The mechanism in Pinocchio, its loops closed by constraints: kinematics, dynamics, motion in time, mounting."""

from spm_pin.description.source_files import Closure
from spm_pin.loops.loop_state import Energy
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.chain_state import ChainState, ConstrainedState, NaturalFrequencies, PlatformDynamics
from spm_pin.multibody.constrained_model import SingularValues
from spm_pin.multibody.mounting import MountedChain
from spm_pin.multibody.read_stage import MeasuredStage, read_stage
from spm_pin.multibody.simulation import Simulation, SimulationEnd
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
