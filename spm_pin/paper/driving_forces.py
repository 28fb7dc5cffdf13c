"""The paper's driving forces, Eqs. (32)-(33), and both rows of its Table 5.

Equation (33) inverts J_f, itself the result of a 9 x 9 solve; near an inverse singularity it loses digits that
the problem does not: see `spm_pin.kinematics.rates_and_forces`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray, broadcastable, real_array
from spm_pin.mechanism.configuration import Configuration
from spm_pin.paper import published
from spm_pin.paper.jacobian import CORRECT, J_f, Table5Mistakes, refuse_singular

KILO = 1e3
CENTI = 1e-2
# F [kN] and T [kN cm] that Table 5 was computed with; Section 5 prints others.
_OTHER_LOAD = ((-20.0, -30.0, 60.0), (-30.0, -30.0, -100.0))


def f_r(
    configuration: Configuration, F: npt.ArrayLike, T: npt.ArrayLike, mistakes: Table5Mistakes = CORRECT
) -> FloatArray:
    """Return the active forces f_r = -(J_f⁻¹)ᵀ [F; T] of Eq. (33), shape (..., 6) [N], positive where a leg pushes.

    F [N] and T [N m], of shape (..., 3), are applied onto m at o, in {B}; leading axes broadcast with those of the
    configuration. The `mistakes` are those in J_f. NaN for a member that does not exist.

    Raises
    ------
    ArgumentError
        If F or T has another shape or is not finite.
    SingularConfigurationError
        As for `J_f`, and as "forward" where J_f is singular to rounding.
    """
    force = real_array(F, "F", (3,), "the force at o in {B} in newtons")
    torque = real_array(T, "T", (3,), "the torque in {B} in newton metres")
    shape = broadcastable("F", force.shape[:-1], "the configuration", configuration.shape)
    shape = broadcastable("T", torque.shape[:-1], "F and the configuration", shape)
    matrix = J_f(configuration, mistakes)
    scaled = matrix.copy()
    scaled[..., 3:] /= configuration.geometry.middle_side
    refuse_singular(scaled, "forward", configuration)
    matrix = np.where(configuration.exists[..., None, None], matrix, np.eye(6))
    both = np.concatenate([np.broadcast_to(force, (*shape, 3)), np.broadcast_to(torque, (*shape, 3))], axis=-1)
    forces = -np.linalg.solve(np.swapaxes(matrix, -1, -2), both[..., None])[..., 0]  # Eq. (33)
    return np.where(configuration.exists[..., None], forces, np.nan)


def load(mistakes: Table5Mistakes = CORRECT) -> tuple[FloatArray, FloatArray]:
    """Return F [N] and T [N m] of the example in Section 5, or those Table 5 was computed with."""
    F, T = _OTHER_LOAD if mistakes.other_load else (published.FORCE, published.TORQUE)
    return KILO * np.array(F), KILO * CENTI * np.array(T)


def table_5(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> tuple[FloatArray, FloatArray]:
    """Return the rows of Table 5 for the example's twist and load: v_r [cm/s] and f_r [kN], (..., 6) each.

    Of solution 3 of the example with the mistakes `PUBLISHED` they are the numbers as printed, with `CORRECT` the true
    ones. Raises as `f_r`.
    """
    v, ω = CENTI * np.array(published.VELOCITY[:3]), np.deg2rad(published.VELOCITY[3:])
    v_r = J_f(configuration, mistakes) @ np.concatenate([v, ω])  # Eq. (31)
    return v_r / CENTI, f_r(configuration, *load(mistakes), mistakes) / KILO
