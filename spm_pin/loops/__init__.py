"""Any closed chain on Pinocchio: read from MJCF, URDF or SDF, closed, moved, driven, and written again."""

from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription
from spm_pin.loops.forward_simulation import LoopMotion, SimulationEnd
from spm_pin.loops.loop_state import Energy, LoopState
from spm_pin.loops.mobility import Mobility
from spm_pin.loops.read_mjcf import read_mjcf
from spm_pin.loops.read_sdf import read_sdf
from spm_pin.loops.read_urdf import read_urdf
from spm_pin.loops.write_chain import mjcf_text, sdf_text, urdf_texts

__all__ = [
    "Anchor",
    "ClosedChain",
    "Closure",
    "Energy",
    "JointEquality",
    "LoopMotion",
    "LoopState",
    "Mobility",
    "RobotDescription",
    "SimulationEnd",
    "mjcf_text",
    "read_mjcf",
    "read_sdf",
    "read_urdf",
    "sdf_text",
    "urdf_texts",
]
