"""Leg rates from the platform's twist and vice versa, leg forces for a wrench, and the platform's stiffness.

A stage has three freedoms: its *motion* (v_z, ω_x, ω_y) stands where a manipulator has a twist (v, ω), see
`spm_pin.kinematics.stage_rates`. The wrench on its platform has six components all the same, of which the structure
holds a part.

Every leg acts on the middle platform through its ball along the leg, where its actuator holds, and along its revolute
axis, where its structure holds: six forces in each stage, the rows of J_b and of J_c; K are the six structural ones.
Both stages carry the whole load, so that their compliances add,

    C = J_b⁻¹ D_b J_b⁻ᵀ + J_c⁻¹ D_c J_c⁻ᵀ,    D = diag(1 / stiffness) of the six forces,

and a stage alone has the first term. With rigid structures that is C = G diag(1/k) Gᵀ, G = J_f⁻¹. Weights and other
loads are taken to be small: what a load itself adds by turning the legs is of the size load / (leg length · k) relative
to C⁻¹.

For rates and forces no 6 x 6 matrix is decomposed, see `spm_pin.formulas.wrenches`; singular values decide for the few
states that may be singular. A single state that is singular or missing raises `SingularConfigurationError` or
`ArgumentError`. In a batch its result is NaN, and the `kind` of `singularities` says which are singular. Derivation:
`docs/theory/rates_forces_singularities.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.kinematics import stage_rates
from spm_pin.kinematics.batches import run_on_states
from spm_pin.kinematics.singularity_kinds import SINGULAR
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.manipulator import Manipulator
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, broadcastable, leg_values, real_array

_STIFFEST = 1e100
"""Largest stiffness [N/m], for which products of two are still finite."""


def inverse_jacobian(configuration: Configuration) -> FloatArray:
    """Return J_f of states (...), which maps the platform's twist to the leg rates: the paper's Eq. (31).

    Returns
    -------
    ndarray, shape (..., 6, 6); for a stage (..., 3, 3)
        Rows the legs, r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; columns the twist (v, ω): velocity of o [m/s], angular
        velocity of m [rad/s], both in {B}; for a stage its motion (v_z, ω_x, ω_y).
        Singular, but right, at a forward singularity. A single state raises `SingularConfigurationError`, and a member
        of a batch is NaN, at an inverse or a constraint singularity, where a twist has no leg rates or no unique ones;
        as "forward", where a leg has no length, hence no direction; and as "leg", where an actuator does not move its
        ball.
    """
    if check_configuration(configuration).machine.is_stage:
        return stage_rates.inverse_jacobian(configuration)
    from spm_pin.kinematics.kernels.jacobian_kernels import inverse_jacobians

    return _matrices(configuration, inverse_jacobians, "inverse")


def platform_jacobian(configuration: Configuration) -> FloatArray:
    """Return G = J_f⁻¹ of states (...), which maps the leg rates to the platform's twist, without inverting J_f.

    Returns
    -------
    ndarray, shape (..., 6, 6); for a stage (..., 6, 3)
        Rows the twist (v, ω) of m at o, in {B} [m/s, rad/s]; columns the legs, as in `inverse_jacobian`. Singular, but
        right, at an inverse singularity. A single state raises `SingularConfigurationError`, and a member of a batch is
        NaN, at a forward or a constraint singularity, where the legs do not hold the platform. For a stage the
        parasitic motion is included; the rows `spm_pin.kinematics.MOTION` are the inverse of its `inverse_jacobian`.
    """
    if check_configuration(configuration).machine.is_stage:
        return stage_rates.platform_jacobian(configuration)
    from spm_pin.kinematics.kernels.jacobian_kernels import platform_jacobians

    return _matrices(configuration, platform_jacobians, "forward")


def leg_rates(configuration: Configuration, twist: npt.ArrayLike) -> FloatArray:
    """Return the rates of the legs' readings for a twist of the platform.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    twist : array_like, shape (..., 6); for a stage (..., 3)
        (v, ω) of m at o in {B} [m/s, rad/s]; for a stage its motion (v_z, ω_x, ω_y). Leading axes broadcast with those
        of `configuration`.

    Returns
    -------
    ndarray, shape (..., 6); for a stage (..., 3)
        Rates of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m/s] ([rad/s] for RRS legs); at singularities as
        `inverse_jacobian`.
    """
    count = len(check_configuration(configuration).machine.legs.names)
    meaning = f"{'(v, ω)' if count == 6 else '(v_z, ω_x, ω_y)'} at o in {{B}} in m/s and rad/s"
    value = _broadcast_argument(twist, "twist", meaning, configuration, count)
    return np.asarray((inverse_jacobian(configuration) @ value[..., None])[..., 0])


def leg_forces(configuration: Configuration, wrench: npt.ArrayLike) -> FloatArray:
    """Return the actuator forces that hold a wrench applied onto the terminal platform: the paper's Eq. (33).

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    wrench : array_like, shape (..., 6)
        (f, m): force [N] and moment [N m] at o, in {B}, applied onto m from outside. Leading axes broadcast with
        those of `configuration`.

    Returns
    -------
    ndarray, shape (..., 6); for a stage (..., 3)
        Efforts of the actuators of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [N] ([N m] for RRS legs); a positive effort
        increases the reading: an RPS leg pushes. Weights and friction are left out. At singularities as
        `platform_jacobian`. Other loads of the joints: `spm_pin.capability.joint_reactions`, and for a stage
        `spm_pin.kinematics.joint_loads`.
    """
    check_configuration(configuration)
    load = _broadcast_argument(wrench, "wrench", "(f, m) at o in {B} in N and N m", configuration, 6)
    if configuration.machine.is_stage:
        return np.asarray(-(platform_jacobian(configuration).mT @ load[..., None])[..., 0])
    from spm_pin.kinematics.kernels.jacobian_kernels import stage_forces

    forces, suspect = _run(stage_forces, configuration, (6,), load)
    if np.count_nonzero(suspect):
        # Whether a state is singular does not depend on the wrench.
        forces[np.broadcast_to(_without_hold(configuration), forces.shape[:-1])] = np.nan
    return forces if configuration.machine.legs.are_rps else forces * configuration.slopes


def _matrices(configuration: Configuration, kernel: Callable[..., object], kind: str) -> FloatArray:
    """Return the matrices of a kernel (..., 6, 6); NaN at a singularity of this kind, or an error for one state."""
    matrices, suspect = _run(kernel, configuration, (6, 6))
    if np.count_nonzero(suspect):
        singular = suspect.astype(bool)
        singular[singular] = _are_singular(configuration, np.argwhere(suspect), kind)
        matrices[singular] = np.nan
    if configuration.machine.legs.are_rps:
        return matrices
    if kind == "forward":
        return matrices * configuration.slopes[..., None, :]
    return matrices / stage_rates.regular_slopes(configuration)[..., None]


def _without_hold(configuration: Configuration) -> BoolArray:
    """Return which members of a batch are forward singular or missing; a single singular state raises an error."""
    return np.asarray(np.isnan(platform_jacobian(configuration)).any(axis=(-1, -2)))


def _run(
    kernel: Callable[..., object], configuration: Configuration, shape: tuple[int, ...], load: FloatArray | None = None
) -> tuple[FloatArray, IntArray]:
    """Return the result of a kernel, of this shape per state, and which states may be singular."""
    check_configuration(configuration, existing=not configuration.shape)
    constants = leg_constants(configuration.machine), configuration.machine.middle_side, SINGULAR
    results = (shape, np.float64), ((), np.uint8)
    values, suspect = run_on_states(kernel, configuration, constants, results, load=load)
    return values, suspect


def _broadcast_argument(
    value: npt.ArrayLike, argument: str, meaning: str, configuration: Configuration, count: int
) -> FloatArray:
    """Read a twist or a wrench (..., count) whose leading axes broadcast with those of `configuration`."""
    array = real_array(value, argument, (count,), meaning)
    broadcastable(argument, array.shape[:-1], "the configuration", configuration.shape)
    return array


def leg_constants(machine: Manipulator) -> FloatArray:
    """Return the axes of the six legs and `upper_ball_weights` (9, 3), as arguments of the kernels."""
    return np.concatenate([machine.legs.axes, machine.legs.upper_ball_weights])


def force_matrices(configuration: Configuration) -> FloatArray:
    """Return J_b, J_c and K (..., 3, 6, 6): rows (f, arm x f), arms from the lower balls' centre in units of d.

    NaN for a missing state, and in the row of a leg whose length is zero.
    """
    vectors, machine = configuration.leg_vectors, configuration.machine
    centre = configuration.middle_joints.mean(axis=-2)[..., None, :]
    arms = (configuration.balls - centre) / machine.middle_side
    with np.errstate(invalid="ignore"):
        directions = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    # The axes of the lower legs do not depend on the state, but must be NaN for a missing one.
    axes = np.where(configuration.exists[..., None, None], configuration.leg_axes, np.nan)
    legs, structure = (np.concatenate([f, np.cross(arms, f)], axis=-1) for f in (directions, axes))
    stages = [np.concatenate([legs[..., k, :], structure[..., k, :]], axis=-2) for k in (slice(3), slice(3, 6))]
    return np.stack([*stages, structure], axis=-3)


def stage_inverses(configuration: Configuration) -> FloatArray:
    """Return J_b⁻¹ and J_c⁻¹ (..., 2, 6, 6), J_b⁻¹ alone for a stage; rows are twists (v, ω) at o in {B} [m/s, rad/s].

    NaN where `platform_jacobian` is; a single singular state raises an error.
    """
    if check_configuration(configuration).machine.is_stage:
        return stage_rates.stage_inverses(configuration)
    inverses = _inverses(force_matrices(configuration)[..., :2, :, :], _without_hold(configuration)[..., None])
    lever = configuration.translation - configuration.middle_joints.mean(axis=-2)
    angular = inverses[..., 3:, :] / configuration.machine.middle_side
    linear = inverses[..., :3, :] + np.cross(angular, lever[..., None, :, None], axis=-2)
    return np.concatenate([linear, angular], axis=-2)


def _are_singular(configuration: Configuration, indices: IntArray, kind: str) -> BoolArray:
    """Return which states at these indices (n, axes) are singular to rounding, "forward" or "inverse".

    For a single singular configuration, raise an error.
    """
    some = configuration[tuple(indices.T)] if configuration.shape else configuration
    matrices = force_matrices(some).reshape(-1, 3, 6, 6)
    # An existing state has a row of NaN if the length of a leg is zero.
    is_short = np.asarray(np.isnan(matrices).any(axis=(-1, -2, -3)))
    values = np.linalg.svd(np.nan_to_num(matrices[:, :2] if kind == "forward" else matrices[:, 2:]), compute_uv=False)
    smallest = np.where(values[..., -1] <= SINGULAR * values[..., 0], values[..., -1], np.inf).min(axis=-1)
    singular = np.asarray(is_short | (smallest < np.inf))
    if configuration.shape or not singular.any():
        return singular
    if is_short.any():
        raise SingularConfigurationError("forward", 0.0)
    structure = np.linalg.svd(matrices[0, :2, 3:], compute_uv=False)
    if (structure[:, -1] <= SINGULAR * structure[:, 0]).any():
        raise SingularConfigurationError("constraint", float(structure[:, -1].min()))
    raise SingularConfigurationError(kind, float(smallest.min()))


class PrincipalStiffness(NamedTuple):
    """Stiffness in its principal directions, weakest first."""

    translational: FloatArray
    """Force per displacement of o with free rotation of the platform [N/m], shape (..., 3)."""
    translational_directions: FloatArray
    """Their unit vectors in {B}, as rows, shape (..., 3, 3)."""
    rotational: FloatArray
    """Moment per rotation with free translation of o [N m/rad], shape (..., 3)."""
    rotational_directions: FloatArray
    """Their unit vectors in {B}, as rows, shape (..., 3, 3)."""


def compliance(configuration: Configuration, legs: npt.ArrayLike, structure: npt.ArrayLike | None = None) -> FloatArray:
    """Return the displacement of the platform per unit wrench.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    legs : array_like, shape (..., 6); for a stage (..., 3), or ()
        Stiffness of each actuator with its leg, by the reading: [N/m] ([N m/rad] for RRS legs); one number for all.
    structure : array_like of such a shape, optional
        Stiffness of each leg and its joints along the axis of its revolute joint, at the ball joint [N/m]; rigid by
        default.

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Maps (f, m) at o in {B} [N, N m] to a displacement of o [m] and a small rotation [rad] in {B}; symmetric.
        With rigid structures its rank is 3 for a stage, and less than 6 at an inverse singularity; at other
        singularities as `platform_jacobian`.
    """
    check_configuration(configuration)
    along = _compliances(legs, "legs", configuration)
    across = np.zeros(along.shape[-1]) if structure is None else _compliances(structure, "structure", configuration)
    inverses = stage_inverses(configuration)
    if not configuration.machine.legs.are_rps:
        along = along * configuration.slopes**2
    stages = (x.reshape(*x.shape[:-1], -1, 3) for x in (along, across))
    shares = np.concatenate(np.broadcast_arrays(*stages), axis=-1)
    total = ((inverses * shares[..., None, :]) @ inverses.swapaxes(-1, -2)).sum(axis=-3)
    return np.asarray(0.5 * (total + total.swapaxes(-1, -2)))


def stiffness(configuration: Configuration, legs: npt.ArrayLike, structure: npt.ArrayLike | None = None) -> FloatArray:
    """Return the wrench per unit displacement of the platform: the inverse of `compliance`.

    Parameters
    ----------
    configuration, legs, structure
        As for `compliance`.

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Maps a displacement of o [m] and a small rotation [rad] to (f, m) at o [N, N m], all in {B}; symmetric and
        positive definite. For a stage with a rigid structure the shape is (..., 3, 3): it maps a displacement along z
        and rotations about x and y, with the parasitic motion that follows from them, to the f_z, m_x and m_y that hold
        it. At singularities as `compliance`; with a rigid structure it raises, or is NaN, at an inverse singularity as
        well, where some motion of the platform changes no leg length: its stiffness is infinite there.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Manipulator.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> spm.stiffness(state, legs=1e7)[2, 2].round(-5)
    np.float64(28900000.0)
    """
    if structure is not None:
        flexible = compliance(configuration, legs, structure)
        inverses = _inverses(flexible, np.asarray(np.isnan(flexible).any(axis=(-1, -2))))
        return 0.5 * (inverses + inverses.swapaxes(-1, -2))
    check_configuration(configuration)
    along = 1.0 / _compliances(legs, "legs", configuration)
    jacobian = inverse_jacobian(configuration)
    return np.asarray(jacobian.swapaxes(-1, -2) @ (along[..., None] * jacobian))


def principal_stiffness(
    configuration: Configuration, legs: npt.ArrayLike, structure: npt.ArrayLike | None = None
) -> PrincipalStiffness:
    """Return the stiffness against pure forces at o and against pure moments, in their principal directions.

    Parameters
    ----------
    configuration, legs, structure
        As for `compliance`.

    Returns
    -------
    PrincipalStiffness
        Infinite where a direction is rigid, as some of a stage are without `structure`; singularities as in
        `compliance`.
    """
    matrices = compliance(configuration, legs, structure)
    absent = np.asarray(np.isnan(matrices).any(axis=(-1, -2)))
    principal: list[FloatArray] = []
    for block in (matrices[..., :3, :3], matrices[..., 3:, 3:]):
        values, vectors = np.linalg.eigh(np.where(absent[..., None, None], np.eye(3), block))
        rigid = values <= 1e-14 * values[..., -1:]
        stiffnesses = np.where(rigid, np.inf, 1.0 / np.where(rigid, 1.0, values))[..., ::-1]
        directions = vectors.swapaxes(-1, -2)[..., ::-1, :]
        principal.append(np.where(absent[..., None], np.nan, stiffnesses))
        principal.append(np.where(absent[..., None, None], np.nan, directions))
    return PrincipalStiffness(*principal)


def _compliances(value: npt.ArrayLike, argument: str, configuration: Configuration) -> FloatArray:
    """Return 1 / stiffness of a force of each leg, shape (..., legs)."""
    names = configuration.machine.legs.names
    meaning = f"the stiffness of {names[0]} to {names[-1]} in N/m, for RRS legs in N m/rad, or one for all"
    cause = "A rigid leg has a large stiffness, not none"
    inverses = 1.0 / leg_values(value, argument, meaning, most=_STIFFEST, cause=cause, count=len(names))
    broadcastable(argument, inverses.shape[:-1], "configuration", configuration.shape)
    return np.asarray(inverses)


def _inverses(matrices: FloatArray, absent: BoolArray) -> FloatArray:
    """Return the inverses of matrices (..., n, n), NaN for those that are `absent` (...)."""
    absent = absent[..., None, None]
    return np.where(absent, np.nan, np.linalg.inv(np.where(absent, np.eye(matrices.shape[-1]), matrices)))
