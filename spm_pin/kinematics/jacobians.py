"""Leg rates from the platform's twist and back, from 6 x 6 matrices of forces through the ball joints.

Every leg acts on the middle platform through b_i along two directions: δ along the leg, which its actuator
holds, and its revolute axis R, which its structure holds. As rows (f, (b_i - o) x f), three legs to a matrix,

    J_b = [A_b; K_b] with δ_bi and R_i1,    J_c = [A_c; K_c] with δ_ci and R_i2,    K = [K_b; K_c].

Multiplied with the twist of a body at o, a row gives the velocity of that body's point at b_i along f. With t_L
the twist of the middle platform, t that of the terminal platform m, both seen from {B}, the two stages are

    J_b t_L = (rates of the lower legs, 0),    J_c (t - t_L) = (rates of the upper legs, 0),

because b_i moves in the plane of its lower leg, which {B} carries, and in that of its upper leg, which m
carries. Solving each stage for its twist and adding gives t = G · rates, G = [J_b⁻¹(:, 1:3), J_c⁻¹(:, 1:3)]. The
zeros alone read K t_L = (0, K_c t), thus t_L = X t with X = K⁻¹ [0; K_c], and J_f = [A_b X; A_c (I - X)] = G⁻¹.
Taking t_L out of the twelve equations by a Schur complement gives det J_f = det J_b det J_c / det K.

Nothing of this takes a 6 x 6 decomposition: three equations in how far each joint moves along the one direction that
its two forces leave open are enough, with determinants instead of pivots, see
`spm_pin.kinematics.kernels.wrench_vectors`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.as_built_jacobians import as_built_inverse_jacobian, as_built_platform_jacobian
from spm_pin.kinematics.batches import run_on_states
from spm_pin.kinematics.stage_wrenches import refuse_singular, singular_sizes
from spm_pin.mechanism.arguments import FloatArray, broadcastable, real_array
from spm_pin.mechanism.configuration import Configuration, check_configuration


def inverse_jacobian(configuration: Configuration) -> FloatArray:
    """Return J_f, which maps the platform's twist to the leg rates.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Rows r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; columns the twist (v, ω): velocity of o [m/s], angular velocity
        of m [rad/s], both in {B}. NaN for a member that does not exist. Singular, but right, at a forward
        singularity.

    Raises
    ------
    SingularConfigurationError
        At an inverse or a constraint singularity, where a twist has no leg rates or no unique ones; see
        `spm_pin.kinematics.stage_wrenches.SINGULAR`. Also, as "forward", where a leg has no length, hence no
        direction.

    Notes
    -----
    Eq. (31) of the paper, which takes it from a 9 x 9 system; here J_f = [A_b X; A_c (I - X)], see the module.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import inverse_jacobians

    if _is_as_built(configuration):
        return as_built_inverse_jacobian(configuration)
    return _matrices(configuration, inverse_jacobians, "inverse")


def platform_jacobian(configuration: Configuration) -> FloatArray:
    """Return G = J_f⁻¹, which maps the leg rates to the platform's twist.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Rows the twist (v, ω) of m at o, in {B} [m/s, rad/s]; columns r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m/s].
        NaN for a member that does not exist. Singular, but right, at an inverse singularity.

    Raises
    ------
    SingularConfigurationError
        At a forward or a constraint singularity, where the legs do not hold the platform; see
        `spm_pin.kinematics.stage_wrenches.SINGULAR`.

    Notes
    -----
    G = [J_b⁻¹(:, 1:3), J_c⁻¹(:, 1:3)], see the module. It never inverts J_f, which grows without bound towards
    an inverse singularity.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import platform_jacobians

    if _is_as_built(configuration):
        return as_built_platform_jacobian(configuration)
    return _matrices(configuration, platform_jacobians, "forward")


def _is_as_built(configuration: Configuration) -> bool:
    return not check_configuration(configuration).geometry.is_nominal


def _matrices(configuration: Configuration, kernel: Callable[..., object], kind: str) -> FloatArray:
    """Return the matrices of `kernel`, shape (..., 6, 6), or raise at a singularity of this kind."""
    results = ((6, 6), np.float64), ((), np.uint8)
    matrices, suspect = run_on_states(kernel, configuration, singular_sizes(configuration.geometry), results)
    refuse_singular(configuration, suspect.reshape(-1), kind)
    return np.asarray(matrices)


def leg_rates(configuration: Configuration, twist: npt.ArrayLike) -> FloatArray:
    """Return the rates of the leg lengths for a twist of the platform.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    twist : array_like, shape (..., 6)
        (v, ω) of m at o in {B} [m/s, rad/s]. Leading axes broadcast with those of `configuration`.

    Returns
    -------
    ndarray, shape (..., 6)
        Rates of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m/s]; NaN for a member that does not exist.

    Raises
    ------
    ArgumentError
        If `twist` has another shape or is not finite.
    SingularConfigurationError
        As for `inverse_jacobian`.
    """
    value = broadcast_argument(twist, "twist", "(v, ω) at o in {B} in m/s and rad/s", configuration)
    return np.asarray((inverse_jacobian(configuration) @ value[..., None])[..., 0])


def broadcast_argument(value: npt.ArrayLike, argument: str, meaning: str, configuration: Configuration) -> FloatArray:
    """Read a twist or a wrench (..., 6) whose leading axes broadcast with those of `configuration`."""
    check_configuration(configuration)
    array = real_array(value, argument, (6,), meaning)
    broadcastable(argument, array.shape[:-1], "the configuration", configuration.shape)
    return array
