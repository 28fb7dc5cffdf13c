"""The kinematics on arrays of any library that follows the Array API standard, with derivatives where it has them.

NumPy, JAX, PyTorch, CuPy: the kind of array that comes in goes out, on its device and in its type of floats. Needs the
extra `arrays`, or `jax`; see `docs/howto/learning.md`.
"""

from spm_pin.arrays.displacement import (
    Branches,
    State,
    forward_physical,
    inverse_displacement,
    inverse_physical,
    stage_inverse,
)
from spm_pin.arrays.states import inverse_jacobian, joint_values, leg_forces, singularity_distance
from spm_pin.machine.joint_angles import JOINTS

__all__ = [
    "JOINTS",
    "Branches",
    "State",
    "forward_physical",
    "inverse_displacement",
    "inverse_jacobian",
    "inverse_physical",
    "joint_values",
    "leg_forces",
    "singularity_distance",
    "stage_inverse",
]
