"""The mechanism in Pinocchio, its loops closed by constraints: kinematics, dynamics, motion in time, mounting."""

from spm_pin.description.tree import Closure
from spm_pin.multibody.chain import ClosedChain
from spm_pin.multibody.constrained_state import ChainState, ConstrainedState
from spm_pin.multibody.dynamics import Energy, NaturalFrequencies, PlatformDynamics
from spm_pin.multibody.integrator import SimulationEnd
from spm_pin.multibody.mounting import MountedChain
from spm_pin.multibody.platform_path import PlatformMotion, PlatformPath
from spm_pin.multibody.regularity import SingularValues
from spm_pin.multibody.simulation import Simulation
from spm_pin.multibody.trajectory import JointTrajectory

__all__ = [
    "ChainState",
    "ClosedChain",
    "Closure",
    "ConstrainedState",
    "Energy",
    "JointTrajectory",
    "MountedChain",
    "NaturalFrequencies",
    "PlatformDynamics",
    "PlatformMotion",
    "PlatformPath",
    "Simulation",
    "SimulationEnd",
    "SingularValues",
]
