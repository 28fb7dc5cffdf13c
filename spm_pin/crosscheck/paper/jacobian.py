"""The paper's inverse Jacobian and driving forces, Eqs. (21)-(33), with its symbols and equation numbers, and Table 5.

The loop equation of each leg pair, Eq. (21), is differentiated and multiplied by R_i2, Eq. (25), and by δ_ci,
Eq. (26); the middle platform's sides give three more equations, Eq. (28). All nine are linear in the six leg
rates and the three angular velocities ω_rbi of the lower legs: J_α v_m = J_λ v_s, Eq. (30a). The stored text of
the paper lacks J_α; it is rebuilt here from Eq. (29).

Misprints corrected: the lever arm in J_λ is e_i - r_ci, as Eq. (25b) derives it, not e_i - r_bi as in Eq. (30a);
v_rib in (25b) is v_rbi, ä in (26a) is ω, e_i in (29f) is e_3, ω_r33 in (29i) is ω_rb3. `Table5Mistakes` puts back
those that the published numbers were computed with.

The functions take a `Configuration` of shape (...) and the `mistakes` to make, by default none. A member that does not
exist gives NaN. `SingularConfigurationError` is raised for a single state, and a member of a batch is NaN instead; all
functions do so, as "forward", where a leg has no length, hence no direction.

J_α is singular at an inverse singularity; J, and the forces, for which Eq. (33) inverts J_f, lose digits near it that
the problem does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.crosscheck.paper import published
from spm_pin.errors import SingularConfigurationError
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.manipulator import check_rps
from spm_pin.support.arguments import BoolArray, FloatArray, broadcastable, real_array

KILO = 1e3
CENTI = 1e-2
# F [kN] and T [kN cm] that Table 5 was computed with; Section 5 prints others.
_OTHER_LOAD = ((-20.0, -30.0, 60.0), (-30.0, -30.0, -100.0))
SINGULAR = 64.0 * float(np.finfo(np.float64).eps)
"""A matrix is singular where its smallest singular value is at most this times its largest: its entries, products
of unit vectors computed from joint positions, carry errors of this order."""


@dataclass(frozen=True)
class Table5Mistakes:
    """The mistakes that together give the numbers printed in Table 5; by default none is made.

    A diagnosis made here, not in the paper: at solution 3 of the example, the three together reproduce every printed
    number to its four decimals. The rates need the first two, the lower legs' forces all three, the upper legs'
    forces the first and the third: with the lower legs locked, all ω_rbi are zero whatever their coefficients.
    """

    printed_lever_arm: bool = False
    """The first three rows of J_λ have the lever arm e_i - r_bi, as Eq. (30a) prints them."""
    missing_entry: bool = False
    """Entry (9, 9) of J_α is zero: the coefficient of ω_rb3 in the third dimension constraint, Eq. (29i)."""
    other_load: bool = False
    """The load is F = (-20, -30, +60) kN, T = (-30, -30, -100) kN cm, not the F = (-20, -30, -30), T = (-30, -30, +100)
    of Section 5. It concerns the forces alone."""


CORRECT = Table5Mistakes()
"""The corrected equations."""


def J_alpha(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> FloatArray:
    """Return J_α of Eq. (30a), rebuilt from Eq. (29), shape (..., 9, 9); of the mistakes, `missing_entry` matters.

    Rows are Eqs. (29a)-(29i), the last three divided by d; columns v_rb1..v_rb3, v_rc1..v_rc3 [m/s] and ω_rb1..ω_rb3
    [rad/s].
    """
    r_b, _, δ_b, δ_c = _legs(configuration)
    R_1 = configuration.machine.revolute_axes
    R_2 = configuration.platform_axes
    ω_b = np.cross(R_1, r_b)  # the share of ω_rbi in the velocity of b_i, Eq. (27)
    b = configuration.middle_joints
    b_1, b_2, b_3 = (b[..., i, :] for i in range(3))
    J_α = np.zeros((*configuration.shape, 9, 9))
    for i in range(3):
        # Eqs. (29a)-(29c)
        J_α[..., i, i] = _dot(δ_b[..., i, :], R_2[..., i, :])
        J_α[..., i, 6 + i] = _dot(ω_b[..., i, :], R_2[..., i, :])
        # Eqs. (29d)-(29f)
        J_α[..., 3 + i, i] = _dot(δ_b[..., i, :], δ_c[..., i, :])
        J_α[..., 3 + i, 3 + i] = 1.0
        J_α[..., 3 + i, 6 + i] = _dot(ω_b[..., i, :], δ_c[..., i, :])
    # Eqs. (29g)-(29i): the velocity of b_j minus that of b_k, along δ_m from b_k to b_j
    for row, (j, k, side) in enumerate([(0, 1, b_1 - b_2), (2, 0, b_3 - b_1), (1, 2, b_2 - b_3)], start=6):
        δ_m = side / np.sqrt(_dot(side, side))[..., None]
        for i, sign in ((j, 1.0), (k, -1.0)):
            J_α[..., row, i] = sign * _dot(δ_b[..., i, :], δ_m)
            J_α[..., row, 6 + i] = sign * _dot(ω_b[..., i, :], δ_m)
    if mistakes.missing_entry:
        J_α[..., 8, 8] = np.where(configuration.exists, 0.0, np.nan)
    return np.where(configuration.exists[..., None, None], J_α, np.nan)


def J_lambda(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> FloatArray:
    """Return J_λ of Eq. (30a), shape (..., 9, 9); of the mistakes, `printed_lever_arm` matters.

    Columns are v [m/s], ω [rad/s] and three zeros.
    """
    r_b, r_c, _, δ_c = _legs(configuration)
    R_2 = configuration.platform_axes
    e = configuration.platform_joints - configuration.translation[..., None, :]
    arm = e - r_b if mistakes.printed_lever_arm else e - r_c  # Eq. (25b)
    J_λ = np.zeros((*configuration.shape, 9, 9))
    J_λ[..., 0:3, 0:3] = R_2
    J_λ[..., 0:3, 3:6] = np.cross(arm, R_2)
    J_λ[..., 3:6, 0:3] = δ_c
    J_λ[..., 3:6, 3:6] = np.cross(e, δ_c)
    return np.where(configuration.exists[..., None, None], J_λ, np.nan)


def J(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> FloatArray:
    """Return J = J_α⁻¹ J_λ of Eq. (30b), shape (..., 9, 9), from (v, ω, 0, 0, 0) to the leg rates and ω_rb1..ω_rb3, SI.

    `SingularConfigurationError` is also raised as "inverse", where J_α is singular to rounding.
    """
    J_α = J_alpha(configuration, mistakes)
    scaled = J_α.copy()
    scaled[..., 6:] /= configuration.machine.middle_side
    regular = _are_regular(scaled, "inverse", configuration)[..., None, None]
    solved = np.linalg.solve(np.where(regular, J_α, np.eye(9)), J_lambda(configuration, mistakes))  # Eq. (30b)
    return np.where(regular, solved, np.nan)


def J_f(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> FloatArray:
    """Return the inverse Jacobian J_f (..., 6, 6) of Eq. (31), the first six rows and columns of J, and raise as `J`.

    From (v, ω) [m/s, rad/s] of m at o in {B} to v_rb1..v_rb3, v_rc1..v_rc3 [m/s].
    """
    return J(configuration, mistakes)[..., :6, :6]


def f_r(
    configuration: Configuration, F: npt.ArrayLike, T: npt.ArrayLike, mistakes: Table5Mistakes = CORRECT
) -> FloatArray:
    """Return the active forces f_r = -(J_f⁻¹)ᵀ [F; T] of Eq. (33), shape (..., 6) [N], positive where a leg pushes.

    F [N] and T [N m], of shape (..., 3), are applied onto m at o, in {B}; leading axes broadcast with those of the
    configuration. The `mistakes` are those in J_f. NaN for a member that does not exist. It raises as `J_f`, and
    `SingularConfigurationError` as "forward" where J_f is singular to rounding.
    """
    force = real_array(F, "F", (3,), "the force at o in {B} in newtons")
    torque = real_array(T, "T", (3,), "the torque in {B} in newton metres")
    shape = broadcastable("F", force.shape[:-1], "the configuration", configuration.shape)
    shape = broadcastable("T", torque.shape[:-1], "F and the configuration", shape)
    matrix = J_f(configuration, mistakes)
    scaled = matrix.copy()
    scaled[..., 3:] /= configuration.machine.middle_side
    regular = _are_regular(scaled, "forward", configuration)[..., None]
    matrix = np.where(regular[..., None], matrix, np.eye(6))
    both = np.concatenate([np.broadcast_to(force, (*shape, 3)), np.broadcast_to(torque, (*shape, 3))], axis=-1)
    forces = -np.linalg.solve(np.swapaxes(matrix, -1, -2), both[..., None])[..., 0]  # Eq. (33)
    return np.where(regular, forces, np.nan)


def load(mistakes: Table5Mistakes = CORRECT) -> tuple[FloatArray, FloatArray]:
    """Return F [N] and T [N m] of the example in Section 5, or those Table 5 was computed with."""
    F, T = _OTHER_LOAD if mistakes.other_load else (published.FORCE, published.TORQUE)
    return KILO * np.array(F), KILO * CENTI * np.array(T)


def table_5(configuration: Configuration, mistakes: Table5Mistakes = CORRECT) -> tuple[FloatArray, FloatArray]:
    """Return the rows of Table 5 for the example's twist and load: v_r [cm/s] and f_r [kN], (..., 6) each.

    Of solution 3 of the example with all three mistakes they are the numbers as printed, with `CORRECT` the true ones.
    Raises as `f_r`.
    """
    v, ω = CENTI * np.array(published.VELOCITY[:3]), np.deg2rad(published.VELOCITY[3:])
    v_r = J_f(configuration, mistakes) @ np.concatenate([v, ω])  # Eq. (31)
    return v_r / CENTI, f_r(configuration, *load(mistakes), mistakes) / KILO


def _are_regular(scaled: FloatArray, kind: str, configuration: Configuration) -> BoolArray:
    """Return which matrices `scaled` (..., n, n), dimensionless, can be inverted; raise if that of one state cannot."""
    known = np.asarray(~np.isnan(scaled).any(axis=(-1, -2)))
    usable: FloatArray = np.where(known[..., None, None], scaled, np.eye(scaled.shape[-1]))
    values = np.asarray(np.linalg.svd(usable, compute_uv=False))
    singular = values[..., -1] <= SINGULAR * values[..., 0]
    if singular.any() and not configuration.shape:
        raise SingularConfigurationError(kind, float(values[-1]))
    return np.asarray(known & ~singular)


def _legs(configuration: Configuration) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the vectors r_b and r_c [m] and their unit vectors δ_b and δ_c, each (..., 3, 3), a row per leg."""
    check_rps(configuration.machine, "the paper's equations")
    lengths = configuration.leg_lengths
    short = (lengths == 0.0).any(axis=-1)
    if short.any() and not configuration.shape:
        raise SingularConfigurationError("forward", 0.0)
    r = np.where(short[..., None, None], np.nan, configuration.leg_vectors)
    δ = r / lengths[..., None]
    return r[..., :3, :], r[..., 3:, :], δ[..., :3, :], δ[..., 3:, :]


def _dot(u: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray((u * v).sum(axis=-1))
