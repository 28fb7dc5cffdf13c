"""Leg forces that hold a wrench on the platform: the equilibrium of each stage's six forces.

Cut at the ball joints, either platform of a stage is held by six forces through the b_i: three along the legs, x,
and three along the revolute axes, y. They balance the load wherever it is cut, so both stages carry the same:

    J_bᵀ (x_b, y_b) = -w,    J_cᵀ (x_c, y_c) = -w,

which is f = -Gᵀ w with G = [J_b⁻¹(:, 1:3), J_c⁻¹(:, 1:3)], see `spm_pin.kinematics.jacobians`. K is not in it:
forces stay finite and accurate at an inverse singularity, where J_f is infinite and -J_f⁻ᵀ w loses its digits.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.batches import run_on_states
from spm_pin.kinematics.jacobians import broadcast_argument, platform_jacobian
from spm_pin.kinematics.stage_wrenches import singular_sizes
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration


def leg_forces(configuration: Configuration, wrench: npt.ArrayLike) -> FloatArray:
    """Return the actuator forces that hold a wrench applied onto the terminal platform.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    wrench : array_like, shape (..., 6)
        (f, m): force [N] and moment [N m] at o, in {B}, applied onto m from outside. Leading axes broadcast with
        those of `configuration`.

    Returns
    -------
    ndarray, shape (..., 6)
        Forces of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [N]; positive pushes, to extend the leg. Weights and
        friction are left out. NaN for a member that does not exist.

    Raises
    ------
    ArgumentError
        If `wrench` has another shape or is not finite.
    SingularConfigurationError
        At a forward or a constraint singularity, where the legs cannot hold every wrench; see
        `spm_pin.kinematics.stage_wrenches.SINGULAR`.

    Notes
    -----
    Eq. (33) of the paper, without its inverse of J_f.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import stage_forces

    load = broadcast_argument(wrench, "wrench", "(f, m) at o in {B} in N and N m", configuration)
    if not configuration.geometry.is_nominal:
        jacobian = platform_jacobian(configuration)
        return np.asarray(-(np.swapaxes(jacobian, -1, -2) @ load[..., None])[..., 0])
    results = ((6,), np.float64), ((), np.uint8)
    sizes = singular_sizes(configuration.geometry)
    forces, doubtful = run_on_states(stage_forces, configuration, sizes, results, load=load)
    if doubtful.any():
        # A state is as singular under any wrench: raises where one is.
        platform_jacobian(configuration)
    return np.asarray(forces)
