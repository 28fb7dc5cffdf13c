"""Witness 4: the loop equations in CasADi, solved numerically without the mechanism's algebra.

The only floor that imports casadi. `loop_equations` holds symbolic functions for use in optimal control of one's
own, `search` and `inverse_displacement` find the branches of a pose, `track` follows a path within limits.
"""

from spm_pin.nlp.branch_search import SOLVERS, Interrupted, Search, inverse_displacement, search
from spm_pin.nlp.joint_space import Joint, forward_kinematics, joint_space_closure
from spm_pin.nlp.loop_equations import closure, leg_jacobian, leg_lengths
from spm_pin.nlp.track import JointRanges, Track, track

__all__ = [
    "SOLVERS",
    "Interrupted",
    "Joint",
    "JointRanges",
    "Search",
    "Track",
    "closure",
    "forward_kinematics",
    "inverse_displacement",
    "joint_space_closure",
    "leg_jacobian",
    "leg_lengths",
    "search",
    "track",
]
