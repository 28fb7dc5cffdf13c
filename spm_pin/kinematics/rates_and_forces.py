"""Leg rates from the platform's twist and back, and leg forces that hold a wrench, from forces through the balls.

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

Cut at the balls, either platform of a stage is held by its six forces, which balance the load wherever it is cut, so
both stages carry the same: J_bᵀ (x_b, y_b) = -w and J_cᵀ (x_c, y_c) = -w with x along the legs, which is f = -Gᵀ w. K
is not in it: forces stay finite and accurate at an inverse singularity, where J_f is infinite and -J_f⁻ᵀ w loses its
digits.

Nothing of this takes a 6 x 6 decomposition: three equations in how far each ball moves along the one direction that
its two forces leave open are enough, with determinants instead of pivots, see `spm_pin.kinematics.formulas.wrenches`.
Singular values decide about the few states that may be singular.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics.batches import run_on_states
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, broadcastable, first_offender, real_array
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.legs import upper_ball_weights

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
        `spm_pin.kinematics.rates_and_forces.SINGULAR`. Also, as "forward", where a leg has no length, hence no
        direction.

    Notes
    -----
    Eq. (31) of the paper, which takes it from a 9 x 9 system; here J_f = [A_b X; A_c (I - X)], see the module.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import inverse_jacobians

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
        `spm_pin.kinematics.rates_and_forces.SINGULAR`.

    Notes
    -----
    G = [J_b⁻¹(:, 1:3), J_c⁻¹(:, 1:3)], see the module. It never inverts J_f, which grows without bound towards
    an inverse singularity.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import platform_jacobians

    return _matrices(configuration, platform_jacobians, "forward")


def _matrices(configuration: Configuration, kernel: Callable[..., object], kind: str) -> FloatArray:
    """Return the matrices of `kernel`, shape (..., 6, 6), or raise at a singularity of this kind."""
    geometry, results = check_configuration(configuration).geometry, (((6, 6), np.float64), ((), np.uint8))
    constants = leg_constants(geometry), geometry.middle_side, SINGULAR
    matrices, suspect = run_on_states(kernel, configuration, constants, results)
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
    SingularConfigurationError
        At a forward or a constraint singularity, where the legs cannot hold every wrench; see
        `spm_pin.kinematics.rates_and_forces.SINGULAR`.

    Notes
    -----
    Eq. (33) of the paper, without its inverse of J_f.
    """
    from spm_pin.kinematics.kernels.jacobian_kernels import stage_forces

    load = broadcast_argument(wrench, "wrench", "(f, m) at o in {B} in N and N m", configuration)
    geometry, results = configuration.geometry, (((6,), np.float64), ((), np.uint8))
    constants = leg_constants(geometry), geometry.middle_side, SINGULAR
    forces, doubtful = run_on_states(stage_forces, configuration, constants, results, load=load)
    if doubtful.any():
        # A state is as singular under any wrench: raises where one is.
        platform_jacobian(configuration)
    return np.asarray(forces)


@dataclass(frozen=True)
class StageWrenches:
    """The forces of the legs as rows (f, (b_i - p) x f / d) through their balls, in {B}.

    p is the centre of the lower balls, and d the drawn side. The rows of a state that does not exist are NaN.
    """

    legs: FloatArray
    """[A_b, A_c], shape (..., 2, 3, 6): the lower stage first."""
    constraints: FloatArray
    """[K_b, K_c], shape (..., 2, 3, 6)."""
    lever: FloatArray
    """o - p [m], shape (..., 3)."""
    side: float
    """d [m]."""
    exists: BoolArray

    @classmethod
    def from_configuration(cls, configuration: Configuration, *, short_legs: bool = False) -> StageWrenches:
        """Set up the rows.

        Raises
        ------
        SingularConfigurationError
            As "forward", where a leg has no length; unless `short_legs`, whose rows are NaN then.
        """
        vectors, shape = configuration.leg_vectors, configuration.shape
        lengths = np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
        short = (lengths == 0.0).any(axis=(-1, -2))
        if short.any() and not short_legs:
            raise SingularConfigurationError("forward", 0.0, first_offender(short))
        geometry, centre = configuration.geometry, configuration.middle_joints.mean(axis=-2)
        side = geometry.middle_side
        arms = (configuration.balls - centre[..., None, :]) / side

        def rows(forces: FloatArray) -> FloatArray:
            return np.concatenate([forces, np.cross(arms, forces)], axis=-1).reshape(*shape, 2, 3, 6)

        lever = configuration.translation - centre
        exists = configuration.exists
        # The axes of the lower legs do not depend on the state: one that does not exist has none of them either.
        axes = np.where(exists[..., None, None], configuration.leg_axes, np.nan)
        return cls(rows(vectors / lengths), rows(axes), lever, side, exists)

    def matrices(self, kind: str) -> FloatArray:
        """Return the matrices (..., n, 6, 6) of a kind of singularity: "forward", J_b and J_c, or "inverse", K."""
        if kind == "forward":
            return np.concatenate([self.legs, self.constraints], axis=-2)
        return self.constraints.reshape(*self.exists.shape, 1, 6, 6)


def leg_constants(geometry: Geometry) -> FloatArray:
    """Return axes and pivots of the six legs and `upper_ball_weights` (15, 3), as the kernels take a machine."""
    legs = geometry.legs
    return np.concatenate([legs.axes, legs.pivots, upper_ball_weights(legs.balls)])


def refuse_singular(configuration: Configuration, suspect: npt.NDArray[np.uint8], kind: str) -> None:
    """Raise if one of the states that a kernel suspects, of (S,) in their order, is singular to rounding.

    Raises
    ------
    SingularConfigurationError
        Of this `kind`, "forward" or "inverse", or "constraint".
    """
    at = np.flatnonzero(suspect)
    if not len(at):
        return
    shape = configuration.shape
    places = np.unravel_index(at, shape) if shape else ()
    some = configuration[places] if shape else configuration
    try:
        wrenches = StageWrenches.from_configuration(some)
    except SingularConfigurationError as short:
        first = short.index[0] if short.index else 0
        raise SingularConfigurationError(short.kind, short.sigma_min, _index(places, first)) from None
    values = np.linalg.svd(wrenches.matrices(kind), compute_uv=False).reshape(len(at), -1, 6)
    smallest = np.where(values[..., -1] <= SINGULAR * values[..., 0], values[..., -1], np.inf).min(axis=-1)
    if not (smallest < np.inf).any():
        return
    first = int((smallest < np.inf).argmax())
    structure = np.linalg.svd(wrenches.constraints.reshape(len(at), 2, 3, 6)[first], compute_uv=False)
    dependent = structure[:, -1] <= SINGULAR * structure[:, 0]
    if dependent.any():
        raise SingularConfigurationError("constraint", float(structure[:, -1].min()), _index(places, first))
    raise SingularConfigurationError(kind, float(smallest[first]), _index(places, first))


@np.errstate(invalid="ignore")  # states that do not exist are NaN throughout
def regular_wrenches(configuration: Configuration, kind: str) -> StageWrenches:
    """Return the wrenches of states that are not singular in this way, "forward" or "inverse"; raise if one is."""
    wrenches = StageWrenches.from_configuration(configuration)
    matrices = wrenches.matrices(kind)
    # No singular value is less than the determinant over the fifth power of the largest.
    bound = SINGULAR * (matrices**2).sum(axis=(-1, -2)) ** 3
    suspect = (np.abs(np.linalg.det(matrices)) <= bound).any(axis=-1)
    refuse_singular(configuration, suspect.reshape(-1).astype(np.uint8), kind)
    return wrenches


@np.errstate(invalid="ignore")
def stage_inverses(configuration: Configuration) -> FloatArray:
    """Return J_b⁻¹ and J_c⁻¹ (..., 2, 6, 6), with twists (v, ω) at o in {B} [m/s, rad/s] for rows.

    Raises
    ------
    SingularConfigurationError
        At a forward or a constraint singularity.
    """
    wrenches = regular_wrenches(configuration, "forward")
    inverses = np.linalg.inv(wrenches.matrices("forward"))
    angular = inverses[..., 3:, :] / wrenches.side
    lever = wrenches.lever[..., None, None, :]
    moved = np.swapaxes(np.cross(np.swapaxes(angular, -1, -2), lever), -1, -2)
    return np.concatenate([inverses[..., :3, :] + moved, angular], axis=-2)


def _index(places: tuple[IntArray, ...], which: int) -> tuple[int, ...]:
    return tuple(int(axis[which]) for axis in places)
