"""Wrenches, twists and accelerations of the platform that limits of legs and bearings allow."""

from spm_pin.capability.polytopes import (
    Ellipsoid,
    HalfSpaces,
    JointReactions,
    Polytope,
    Section,
    acceleration_polytope,
    joint_reactions,
    velocity_polytope,
    wrench_polytope,
)

__all__ = [
    "Ellipsoid",
    "HalfSpaces",
    "JointReactions",
    "Polytope",
    "Section",
    "acceleration_polytope",
    "joint_reactions",
    "velocity_polytope",
    "wrench_polytope",
]
