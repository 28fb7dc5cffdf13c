"""Leg rates from the platform's twist and vice versa, forces of legs and joints for a wrench, and stiffness.

A stage has three freedoms: its *motion* (v_z, ω_x, ω_y), the velocity of its origin along z of {B} and the horizontal
part of its angular velocity, stands where a manipulator has a twist (v, ω). The rest of its twist is parasitic motion,
see `docs/theory/stages.md`. The wrench on its platform has six components all the same, of which the structure holds a
part.

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
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.formulas import stage_poses, wrenches
from spm_pin.formulas.operations import on_arrays, rows_of, vector_of
from spm_pin.kinematics.batches import run_on_states
from spm_pin.kinematics.singularity_kinds import SINGULAR
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.manipulator import Manipulator
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, broadcastable, leg_values, real_array

MOTION = slice(2, 5)
"""Rows of a twist (v, ω) that are the motion (v_z, ω_x, ω_y)."""
_twists, _may_be_singular = on_arrays(wrenches.stage_twists), on_arrays(wrenches.may_be_singular)
_parasitic_rates = on_arrays(stage_poses.parasitic_rates)
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
        twists = parasitic_jacobian(configuration)
        matrices = stage_forces(configuration, configuration.translation)[..., 0, :3, :] @ twists
    else:
        from spm_pin.kinematics.kernels.jacobian_kernels import inverse_jacobians

        matrices = _matrices(configuration, inverse_jacobians, "inverse")
    if configuration.machine.legs.are_rps:
        return matrices
    slopes = configuration.slopes
    singular = np.abs(slopes) <= SINGULAR * configuration.machine.legs.largest_slopes
    if singular.any() and not configuration.shape:
        raise SingularConfigurationError("leg", float(np.abs(slopes).min()))
    return np.asarray(matrices / np.where(singular, np.nan, slopes)[..., None])


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
        matrices = _stage_twists(configuration, has_axes=False)[..., 0, :, :]
    else:
        from spm_pin.kinematics.kernels.jacobian_kernels import platform_jacobians

        matrices = _matrices(configuration, platform_jacobians, "forward")
    return matrices if configuration.machine.legs.are_rps else matrices * configuration.slopes[..., None, :]


def parasitic_jacobian(configuration: Configuration) -> FloatArray:
    """Return the twist of a stage's platform for its motion (v_z, ω_x, ω_y), with the parasitic v_x, v_y and ω_z.

    Returns
    -------
    ndarray, shape (..., 6, 3)
        Rows (v, ω) of the platform at its origin, in {B}; columns v_z [m/s], ω_x and ω_y [rad/s]. At an inverse
        singularity, where the motion does not determine the twist, a single state raises `SingularConfigurationError`,
        and a member of a batch is NaN.
    """
    state = check_configuration(configuration, of=Stage)
    check_configuration(state, existing=not state.shape)
    axes, balls, origin = rows_of(state.machine.legs.axes), rows_of(state.balls), vector_of(state.translation)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = [_parasitic_rates(axes, balls, origin, tuple(unit)) for unit in np.eye(3).tolist()]
    sizes = np.linalg.svd(np.nan_to_num(inverse_matrices(state)), compute_uv=False)
    singular = np.asarray(state.exists & (sizes[..., -1] <= SINGULAR * sizes[..., 0]))
    if singular.any() and not state.shape:
        raise SingularConfigurationError("inverse", float(sizes[..., -1]))
    return _regular(_columns(columns, state.shape), singular)


def motion_rows(jacobian: FloatArray) -> FloatArray:
    """Return the rows of G (..., 6, legs) of a machine's freedoms: all for a manipulator, `MOTION` for a stage."""
    return jacobian if jacobian.shape[-1] == 6 else jacobian[..., MOTION, :]


def tilt_densities(state: Configuration, jacobian: FloatArray) -> FloatArray:
    """Return |det ∂(height, normal)/∂readings| of states (...) from their `platform_jacobian`, [m sr] per readings."""
    # Turns about the platform's own x and y move its normal, and one about the normal does not.
    turns = state.rotation[..., :2].mT @ jacobian[..., 3:, :]
    rates = np.concatenate([jacobian[..., 2:3, :], turns], axis=-2)
    return np.asarray(np.abs(np.linalg.det(rates)))


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
        `platform_jacobian`. Other loads of the joints: `joint_loads`, `spm_pin.capability.joint_reactions`.
    """
    check_configuration(configuration)
    load = _broadcast_argument(wrench, "wrench", "(f, m) at o in {B} in N and N m", configuration, 6)
    if configuration.machine.is_stage:
        return np.asarray(-(platform_jacobian(configuration).mT @ load[..., None])[..., 0])
    from spm_pin.kinematics.kernels import jacobian_kernels

    forces, suspect = _run(jacobian_kernels.stage_forces, configuration, (6,), load)
    if np.count_nonzero(suspect):
        # Whether a state is singular does not depend on the wrench.
        without_hold = np.isnan(platform_jacobian(configuration)).any(axis=(-1, -2))
        forces[np.broadcast_to(without_hold, forces.shape[:-1])] = np.nan
    return forces if configuration.machine.legs.are_rps else forces * configuration.slopes


class JointLoads(NamedTuple):
    """Loads of the joints of a machine, for states and wrenches of shape (...); weights and friction are neglected."""

    efforts: FloatArray
    """Efforts of the actuators, positive if they increase the reading, shape (..., legs): [N], for RRS legs [N m]."""
    rods: FloatArray
    """Force of each leg along `leg_vectors`, positive if it pushes the platform [N], shape (..., legs)."""
    across: FloatArray
    """Force of each leg along its revolute axis, which its structure carries [N], shape (..., legs)."""
    balls: FloatArray
    """Forces of the legs towards the platform through the balls, as rows in {B} [N], shape (..., legs, 3)."""
    moments: FloatArray
    """Moments of these forces at the legs' pivots, as rows in {B} [N m], shape (..., legs, 3)."""


def joint_loads(configuration: Configuration, wrench: npt.ArrayLike) -> JointLoads:
    """Return what actuators, legs, balls and pivots carry under a wrench (..., 6), both as for `leg_forces`."""
    check_configuration(configuration)
    load = _broadcast_argument(wrench, "wrench", "(f, m) at o in {B} in N and N m", configuration, 6)
    carried = -(stage_inverses(configuration).mT @ load[..., None, :, None])[..., 0]
    along, axes = _directions(configuration)
    rods, across = (x.reshape(*x.shape[:-2], axes.shape[-2]) for x in (carried[..., :3], carried[..., 3:]))
    balls = rods[..., None] * along + across[..., None] * axes
    arms = configuration.balls - configuration.leg_bases
    return JointLoads(rods * configuration.slopes, rods, across, balls, np.cross(arms, balls))


def _matrices(configuration: Configuration, kernel: Callable[..., object], kind: str) -> FloatArray:
    """Return the matrices of a kernel (..., 6, 6); NaN at a singularity of this kind, or an error for one state."""
    matrices, suspect = _run(kernel, configuration, (6, 6))
    if np.count_nonzero(suspect):
        singular = suspect.astype(bool)
        singular[singular] = _are_singular(configuration, np.argwhere(suspect), kind)
        matrices[singular] = np.nan
    return matrices


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


def _directions(state: Configuration) -> tuple[FloatArray, FloatArray]:
    """Return the unit vectors along legs and along revolute axes, as rows in {B}, (..., legs, 3).

    NaN for a missing state, and along a leg whose length is zero.
    """
    vectors = state.leg_vectors
    with np.errstate(invalid="ignore", divide="ignore"):
        along = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    # The axes of lower legs do not depend on the state, but must be NaN for a missing one.
    return along, np.where(state.exists[..., None, None], state.leg_axes, np.nan)


def stage_forces(state: Configuration, centre: FloatArray, unit: float = 1.0) -> FloatArray:
    """Return the forces of each stage as rows (f, arm x f), along its legs and along their axes, (..., stages, 6, 6).

    Arms are from `centre` (..., 3), in units of `unit` [m].
    """
    arms = (state.balls - centre[..., None, :]) / unit
    rows = [np.concatenate([f, np.cross(arms, f)], axis=-1) for f in _directions(state)]
    count = len(state.machine.legs.kinds)
    return np.concatenate([x.reshape(*state.shape, count, 3, 6) for x in rows], axis=-2)


def force_matrices(configuration: Configuration) -> FloatArray:
    """Return J_b, J_c and K (..., 3, 6, 6): rows (f, arm x f), arms from the lower balls' centre in units of d.

    NaN for a missing state, and in the row of a leg whose length is zero.
    """
    centre = configuration.middle_joints.mean(axis=-2)
    stages = stage_forces(configuration, centre, configuration.machine.middle_side)
    return np.concatenate([stages, stages[..., 3:, :].reshape(*configuration.shape, 1, 6, 6)], axis=-3)


def six_forces(state: Configuration) -> FloatArray:
    """Return the six forces of a stage (..., 6, 6) at its origin, lengths in units of the platform's radius."""
    return stage_forces(state, state.translation, state.machine.platform_radius)[..., 0, :, :]


def inverse_matrices(state: Configuration) -> FloatArray:
    """Return the matrix of v_x, v_y and ω_z in the equations of a stage's planes, as `six_forces`, (..., 3, 3)."""
    return six_forces(state)[..., 3:, [0, 1, 5]]


def stage_inverses(configuration: Configuration) -> FloatArray:
    """Return J_b⁻¹ and J_c⁻¹ (..., 2, 6, 6), J_b⁻¹ alone for a stage; rows are twists (v, ω) at o in {B} [m/s, rad/s].

    NaN where `platform_jacobian` is; a single singular state raises an error.
    """
    return _stage_twists(configuration, has_axes=True)


def _stage_twists(configuration: Configuration, *, has_axes: bool) -> FloatArray:
    """Return the twists (..., stages, 6, 3) for unit rates of the balls along the legs, and (..., 6) along the axes."""
    state = check_configuration(configuration, existing=not configuration.shape)
    directions, origin, stages = _directions(state), vector_of(state.translation), []
    singular = np.asarray(state.exists & np.isnan(directions[0]).any(axis=(-1, -2)))
    # Components first: each operation of the formulas then runs along the states.
    rows = [np.ascontiguousarray(np.moveaxis(x, (-2, -1), (0, 1))) for x in (state.balls, *directions)]
    with np.errstate(invalid="ignore", divide="ignore"):
        for k in range(len(state.machine.legs.kinds)):
            b, f, a = (tuple(map(tuple, x[3 * k : 3 * k + 3])) for x in rows)
            twists = *_twists(b, f, a, origin), *(_twists(b, a, f, origin) if has_axes else ())
            stages.append(_columns(twists, state.shape))
            singular |= _may_be_singular(b, f, a, state.machine.ball_side, SINGULAR)
    if singular.any():
        singular[singular] = _are_singular(state, np.argwhere(singular), "forward")
    return _regular(np.stack(stages, axis=-3), singular[..., None])


def _columns(twists: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return twists (v, ω) from formulas as the columns of matrices (..., 6, n)."""
    matrices = np.empty((*shape, 6, len(twists)))
    for j, (v, w) in enumerate(twists):
        for i, x in enumerate((*v, *w)):
            matrices[..., i, j] = x
    return matrices


def _regular(matrices: FloatArray, singular: BoolArray) -> FloatArray:
    """Return matrices (..., m, n), NaN where they are singular (...)."""
    return np.where(singular[..., None, None], np.nan, matrices)


def _are_singular(configuration: Configuration, indices: IntArray, kind: str) -> BoolArray:
    """Return which states at these indices (n, axes) are singular to rounding, "forward" or "inverse".

    For a single singular configuration, raise an error.
    """
    some, machine = configuration[tuple(indices.T)] if configuration.shape else configuration, configuration.machine
    stages = stage_forces(some, some.middle_joints.mean(axis=-2), machine.ball_side)
    stages = stages.reshape(-1, len(machine.legs.kinds), 6, 6)
    # An existing state has a row of NaN if the length of a leg is zero.
    is_short = np.asarray(np.isnan(stages).any(axis=(-1, -2, -3)))
    matrices = stages if kind == "forward" else stages[..., 3:, :].reshape(-1, 1, 6, 6)
    values = np.linalg.svd(np.nan_to_num(matrices), compute_uv=False)
    smallest = np.where(values[..., -1] <= SINGULAR * values[..., 0], values[..., -1], np.inf).min(axis=-1)
    singular = np.asarray(is_short | (smallest < np.inf))
    if configuration.shape or not singular.any():
        return singular
    if is_short.any():
        raise SingularConfigurationError("forward", 0.0)
    structure = np.linalg.svd(stages[0, :, 3:], compute_uv=False)
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
    stages = (x.reshape(*x.shape[:-1], x.shape[-1] // 3, 3) for x in (along, across))
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
