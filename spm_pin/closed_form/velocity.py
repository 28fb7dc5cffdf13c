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

The matrices are built at the middle platform's centre instead of o, with lengths in units of d: then all
entries are of order one wherever the robot stands, and singular values mean something.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, first_offender, real_array
from spm_pin.mechanism.branches import leg_plane_determinant
from spm_pin.mechanism.configuration import Configuration

__all__ = ["StageWrenches", "broadcast_argument", "inverse_jacobian", "leg_rates", "platform_jacobian"]

_EPS = float(np.finfo(np.float64).eps)
SINGULAR = 64.0 * _EPS
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

A unit vector computed from joint positions is off by a few eps, and so is an arm (b_i - p)/d. Six rows of two
such parts, of coordinates a few times d, make a matrix off by some 10 √12 eps < 64 eps in the Frobenius norm:
a smaller singular value may as well be zero.
"""


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
        `SINGULAR`. Also, as "forward", where a leg has no length, hence no direction.

    Notes
    -----
    Eq. (31) of the paper, which takes it from a 9 x 9 system; here J_f = [A_b X; A_c (I - X)], see the module.
    """
    wrenches = StageWrenches.of(configuration)
    matrix = wrenches.regular_constraints()
    right_side = np.zeros_like(matrix)
    right_side[..., 3:, :] = wrenches.constraints[..., 1, :, :]
    middle = np.linalg.solve(matrix, right_side)
    lower = wrenches.legs[..., 0, :, :] @ middle
    upper = wrenches.legs[..., 1, :, :] @ (np.eye(6) - middle)
    rates = np.concatenate([lower, upper], axis=-2)
    linear, angular = rates[..., :3], rates[..., 3:]
    # At the middle platform's centre v_p = v + (o - p) x ω, so a row's angular part at o is its moment about o.
    angular = wrenches.side * angular - np.cross(wrenches.lever[..., None, :], linear)
    return wrenches.masked(np.concatenate([linear, angular], axis=-1))


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
        At a forward or a constraint singularity, where the legs do not hold the platform; see `SINGULAR`.

    Notes
    -----
    G = [J_b⁻¹(:, 1:3), J_c⁻¹(:, 1:3)], see the module. It never inverts J_f, which grows without bound towards
    an inverse singularity.
    """
    wrenches = StageWrenches.of(configuration)
    stages = np.linalg.solve(wrenches.regular_stages(), np.eye(6)[:, :3])
    twists = np.concatenate([stages[..., 0, :, :], stages[..., 1, :, :]], axis=-1)
    angular = twists[..., 3:, :] / wrenches.side
    # v at o is v_p + ω x (o - p); the columns are crossed, one per leg.
    linear = twists[..., :3, :] + np.cross(angular, wrenches.lever[..., :, None], axis=-2)
    return wrenches.masked(np.concatenate([linear, angular], axis=-2))


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
    array = real_array(value, argument, (6,), meaning)
    try:
        np.broadcast_shapes(array.shape[:-1], configuration.shape)
    except ValueError:
        expected = f"leading axes that broadcast with those of the configuration, {configuration.shape}"
        raise ArgumentError(argument, expected, array.shape[:-1]) from None
    return array


@dataclass(frozen=True)
class StageWrenches:
    """The forces of the legs as rows (f, (b_i - p) x f / d) at the middle platform's centre p, in {B}.

    Attributes
    ----------
    legs, constraints : ndarray, shape (..., 2, 3, 6)
        [A_b, A_c] and [K_b, K_c]: the lower stage first.
    points : ndarray, shape (..., 3, 3)
        (b_i - p)/d as rows.
    lever : ndarray, shape (..., 3)
        o - p [m].
    side : float
        d [m].
    exists : ndarray of bool, shape (...)
        False for a member that does not exist; its rows are NaN.
    """

    legs: FloatArray
    constraints: FloatArray
    points: FloatArray
    lever: FloatArray
    side: float
    exists: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, configuration: Configuration) -> StageWrenches:
        """Set up the rows; raises `SingularConfigurationError` ("forward") where a leg has no length."""
        lengths = configuration.leg_lengths
        short = (lengths == 0.0).any(axis=-1)
        if short.any():
            raise SingularConfigurationError("forward", 0.0, first_offender(short))
        shape = configuration.shape
        side = configuration.geometry.middle_side
        b = configuration.middle_joints
        centre = b.mean(axis=-2)
        points = (b - centre[..., None, :]) / side
        axes = np.stack(
            [np.broadcast_to(configuration.geometry.revolute_axes, b.shape), configuration.platform_axes], axis=-3
        )
        directions = (configuration.leg_vectors / lengths[..., None]).reshape(*shape, 2, 3, 3)

        def rows(forces: FloatArray) -> FloatArray:
            return np.concatenate([forces, np.cross(points[..., None, :, :], forces)], axis=-1)

        lever = configuration.translation - centre
        return cls(rows(directions), rows(axes), points, lever, side, configuration.exists)

    def regular_stages(self) -> FloatArray:
        """Return J_b and J_c, shape (..., 2, 6, 6), or raise at a forward or constraint singularity."""
        return self._regular(np.concatenate([self.legs, self.constraints], axis=-2), "forward")

    def regular_constraints(self) -> FloatArray:
        """Return K, shape (..., 6, 6), or raise at an inverse or constraint singularity."""
        matrix = self.constraints.reshape(*self.exists.shape, 1, 6, 6)
        return np.asarray(self._regular(matrix, "inverse")[..., 0, :, :])

    def masked(self, matrix: FloatArray) -> FloatArray:
        """Put NaN into the members of `matrix` (..., 6, 6) that do not exist."""
        return np.where(self.exists[..., None, None], matrix, np.nan)

    def _regular(self, matrices: FloatArray, kind: str) -> FloatArray:
        """Return `matrices` (..., n, 6, 6), those of absent members made regular, or raise."""
        matrices = np.where(self.exists[..., None, None, None], matrices, np.eye(6))
        forces = matrices[..., :3]
        points = np.where(self.exists[..., None, None, None], self.points[..., None, :, :], 0.0)
        planes = np.cross(forces[..., :3, :], forces[..., 3:, :])
        # The five larger singular values multiply to at most (F²/5)^(5/2), F the Frobenius norm, so most
        # members are known to be regular without a decomposition. The factor covers the determinant's rounding.
        square = (matrices**2).sum(axis=(-1, -2))
        at_least = np.abs(leg_plane_determinant(points, planes)) * (5.0 / square) ** 2.5
        suspects = (at_least <= 1e3 * SINGULAR * np.sqrt(square)) & self.exists[..., None]
        if suspects.any():
            self._refuse_singular(matrices, suspects, kind)
        return matrices

    def _refuse_singular(self, matrices: FloatArray, suspects: npt.NDArray[np.bool_], kind: str) -> None:
        values = np.linalg.svd(matrices[suspects], compute_uv=False)
        smallest = np.full(suspects.shape, np.inf)
        smallest[suspects] = np.where(values[:, -1] <= SINGULAR * values[:, 0], values[:, -1], np.inf)
        singular = (smallest < np.inf).any(axis=-1)
        if not singular.any():
            return
        index = first_offender(singular)
        own = np.linalg.svd(self.constraints[index], compute_uv=False)
        dependent = own[:, -1] <= SINGULAR * own[:, 0]
        if dependent.any():
            raise SingularConfigurationError("constraint", float(own[:, -1].min()), index)
        raise SingularConfigurationError(kind, float(smallest[index].min()), index)
