"""Singularity analysis: kind, rank, distance, lost wrench and gained twist of configurations.

Three 6 x 6 matrices determine the kind, see `spm_pin.kinematics.rates_and_forces`, at the middle platform's centre and
with lengths in units of d, so that they are dimensionless and of order one:

- J_b and J_c, the six forces of the lower and of the upper stage. If one is singular, the platform of that stage can
  move with locked legs: a **forward** singularity (type 2, parallel).
- K, the structure's forces of both stages. If it is singular, the middle platform can move while the terminal
  platform is fixed, and the latter loses a direction of motion: an **inverse** singularity (type 1, serial).
- If the structure's three forces of one stage are dependent, both happen: a **constraint** singularity.
- If the slope κ of a PRS or RRS leg is zero, rod perpendicular to the slide or in line with the crank, the leg itself
  is singular: its actuator does not move the ball to first order, and any force along the rod is held without effort.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.formulas.operations import rows_of
from spm_pin.formulas.vectors import directions
from spm_pin.formulas.wrenches import determinant, structure_determinant
from spm_pin.kinematics.batches import run_kernel, run_on_states
from spm_pin.kinematics.rates_and_forces import (
    force_matrices,
    inverse_matrices,
    leg_constants,
    platform_jacobian,
    six_forces,
    stage_forces,
)
from spm_pin.kinematics.singularity_kinds import SINGULAR, SingularityKind, kinds_text
from spm_pin.machine.configuration import Configuration, check_configuration, masked
from spm_pin.machine.manipulator import Manipulator
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray, real_number, shaped_array

_MIN_BATCH_PER_THREAD = 1 << 11
_STEP = 1e-100
"""Imaginary step of derivatives, in metres of leg length: its square is negligible relative to one."""


@dataclass(frozen=True, repr=False)
class Singularities:
    """Singularities of states of shape (...), and distances to them; NaN and rank 0 for a missing state.

    The axis of length three counts the matrices J_b, J_c, K.
    """

    determinants: FloatArray
    """det J_b, det J_c, det K [m³], for forces of length one and moments about any point: signed, smooth; (..., 3)."""
    scaled_determinants: FloatArray
    """The determinants over d³, shape (..., 3): dimensionless, zero exactly at singularities; smooth, for a cost."""
    sigma: FloatArray
    """Smallest singular values, dimensionless, shape (..., 3).

    The change, in the Frobenius norm, of the forces' directions and arms over d that would make the matrix
    singular.
    """
    condition: FloatArray
    """Largest singular value over the smallest, shape (..., 3); infinite where that is zero."""
    rank: IntArray
    """Number of singular values above `tolerance` times the largest, shape (..., 3)."""
    kind: npt.NDArray[np.int8]
    """A combination of `SingularityKind`, at the same tolerance, shape (...)."""
    mobility: IntArray
    """Dimension of the twists that the six legs can give the platform, shape (...).

    The rank of J_f⁻¹; 6 where regular. Not defined at a forward singularity, -1 there.
    """
    gained_twist: FloatArray
    """Twist (v, ω) at o in {B} that each stage resists least with locked legs, shape (..., 2, 6).

    First for the lower stage, then for the upper: the right singular vector of J_b, or J_c. At a forward singularity
    the platform moves so. It is normalised so that (v, dω) at the middle platform's centre has length 1 m/s.
    """
    inner_twist: FloatArray
    """Twist (v, ω) at o in {B} of the middle platform with both ends fixed, shape (..., 6).

    The structure resists it least: the right singular vector of K. At an inverse singularity it is free,
    given the legs.
    """
    lost_wrench: FloatArray
    """Wrench (f, m) at o in {B} on the terminal platform that needs the smallest leg forces, shape (..., 6).

    The structure of both stages carries it. At an inverse singularity it needs no leg force, and no motion can do work
    on it: that is the lost degree of freedom. |f| = 1, or |m| = 1 for a couple.
    """

    def __repr__(self) -> str:
        exists = np.asarray(self.rank.any(axis=-1))
        smallest = np.where(exists[..., None], self.sigma, np.inf).reshape(-1, 3).min(axis=0, initial=np.inf)
        sigmas = ", ".join(f"{value:.2e}" for value in smallest)
        return f"<Singularities: {kinds_text(self.kind, exists)}; smallest singular values of J_b, J_c, K: {sigmas}>"


@dataclass(frozen=True, repr=False)
class StageSingularities:
    """Singularities of states of shape (...), and distances to them; NaN for missing states."""

    kind: npt.NDArray[np.int8]
    """A combination of `SingularityKind`, shape (...).

    `FORWARD` if the platform can move with locked actuators, `INVERSE` if tilt and height do not determine its
    motion, so that the modes T and F meet, with `CONSTRAINT` if the structure's own three forces are dependent, and
    `LEG` if an actuator does not move its ball.
    """
    forward: FloatArray
    """Smallest singular value of the six forces, arms in units of the platform's radius, shape (...)."""
    inverse: FloatArray
    """Smallest singular value of the equations for v_x, v_y and ω_z, in the same unit, shape (...)."""
    leg: FloatArray
    """κ of each leg over its largest, in its working mode positive, shape (..., 3)."""
    gained_twist: FloatArray
    """The twist (v, ω) at the platform's origin in {B} that locked actuators resist least, shape (..., 6).

    (v, r ω) has length 1 m/s, with r the platform's radius.
    """

    @property
    def sigma(self) -> FloatArray:
        """Smallest singular values `forward` and `inverse`, stacked, shape (..., 2)."""
        return np.stack([self.forward, self.inverse], axis=-1)

    def __repr__(self) -> str:
        exists = np.isfinite(self.forward)
        least = {"forward": self.forward, "inverse": self.inverse, "leg": self.leg}
        distances = ", ".join(f"{name} {x[exists].min(initial=np.inf):.3g}" for name, x in least.items())
        return f"<StageSingularities: {kinds_text(self.kind, exists)}; least distances: {distances}>"


def singularities(configuration: Configuration, *, tolerance: float = SINGULAR) -> Any:
    """Describe the singularities of a configuration, or how near they are.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    tolerance : float
        A matrix is singular if its smallest singular value is at most this times its largest; the default is the
        size of rounding. Raise it to include states that are merely close to a singularity.

    Returns
    -------
    Singularities, or StageSingularities for a stage
        Their kinds and distances.

    Notes
    -----
    If a leg has length zero, hence no direction, a single state raises `SingularConfigurationError`, and a member of a
    batch is NaN, of rank 0 and of the kind FORWARD. A missing state is NaN, of rank 0 and REGULAR.
    In the symmetric home K has rank 3: it is an inverse singularity that loses three degrees of freedom. The names of
    these singularities in the literature are in docs/theory/literature_checks.md.
    """
    from spm_pin.kinematics.kernels.singularity_kernels import describe_singularities

    tolerance = real_number(tolerance, "tolerance", "a number from 0 to below 1", least=0.0, below=1.0)
    if check_configuration(configuration).machine.is_stage:
        return _stage_singularities(configuration, tolerance)
    machine = configuration.machine
    exists, side = configuration.exists, machine.middle_side
    three, six = ((3,), np.float64), ((6,), np.float64)
    results = (three, three, three, ((3,), np.int8), ((), np.bool_), ((3, 6), np.float64), six)
    constants = leg_constants(machine), side, tolerance, SINGULAR
    described = run_on_states(
        describe_singularities, configuration, constants, results, min_batch=_MIN_BATCH_PER_THREAD
    )
    dets, largest, smallest, rank, short, twists, wrench = described
    if short.any():
        if not configuration.shape:
            raise SingularConfigurationError("forward", 0.0)
        rank[short] = 0
        for values in (dets, largest, smallest, twists, wrench):
            values[short] = np.nan
    kind = (
        np.where(rank[..., 2] < 6, SingularityKind.INVERSE, 0)
        | np.where((rank[..., :2] < 6).any(axis=-1), SingularityKind.FORWARD, 0)
        | np.where(_have_dependent_constraints(configuration, rank, tolerance), SingularityKind.CONSTRAINT, 0)
    )
    kind = np.where(short, SingularityKind.FORWARD, kind)
    if not machine.legs.are_rps:
        slopes = np.abs(configuration.slopes) / machine.legs.largest_slopes
        kind = kind | np.where((slopes <= max(tolerance, SINGULAR)).any(axis=-1), SingularityKind.LEG, 0)
    held = (rank[..., :2] == 6).all(axis=-1)
    with np.errstate(divide="ignore"):
        condition = largest / smallest
    return Singularities(
        determinants=dets,
        scaled_determinants=dets / side**3,
        sigma=smallest,
        condition=condition,
        rank=rank,
        kind=np.where(exists, kind, 0).astype(np.int8),
        mobility=np.where(exists, np.where(held, rank[..., 2], -1), 0),
        gained_twist=twists[..., :2, :],
        inner_twist=twists[..., 2, :],
        lost_wrench=wrench,
    )


def _stage_singularities(state: Configuration, least: float) -> StageSingularities:
    """Find which states are singular, of which kind, and how far the others are from it.

    `least` is the ratio of the smallest singular value to the largest, and of κ to its largest, of a singular state.
    """
    exists, scale = state.exists[..., None, None], state.machine.platform_radius
    # A leg whose length is zero has no direction and resists nothing: its row is zero, the state forward singular.
    six = np.nan_to_num(np.where(exists, six_forces(state), np.eye(6)))
    three = np.where(exists, inverse_matrices(state), np.eye(3))
    _, sizes, right = np.linalg.svd(six)
    own, structure = (np.linalg.svd(x, compute_uv=False) for x in (three, six[..., 3:, :]))
    leg = state.slopes * state.machine.legs.slope_signs / state.machine.legs.largest_slopes
    kinds = {
        SingularityKind.FORWARD: sizes[..., -1] <= least * sizes[..., 0],
        SingularityKind.INVERSE: own[..., -1] <= least * own[..., 0],
        SingularityKind.CONSTRAINT: structure[..., -1] <= least * structure[..., 0],
        SingularityKind.LEG: (leg <= least).any(axis=-1),
    }
    kind = np.asarray(sum((int(kind) * (flags & state.exists) for kind, flags in kinds.items()), np.zeros(state.shape)))
    twist = right[..., -1, :] / np.repeat([1.0, scale], 3)
    forward, inverse, gained = (
        masked(x, state.exists, x.ndim - len(state.shape)) for x in (sizes[..., -1], own[..., -1], twist)
    )
    return StageSingularities(kind.astype(np.int8), forward, inverse, leg, gained)


def _have_dependent_constraints(configuration: Configuration, rank: IntArray, tolerance: float) -> BoolArray:
    """Return the states (...) in which the constraints of a stage are dependent, which makes K singular."""
    dependent = np.asarray(configuration.exists & (rank[..., 2] < 6))
    if dependent.any():
        some = configuration[np.nonzero(dependent)] if configuration.shape else configuration
        values = singular_values(force_matrices(some)[..., :2, 3:, :])
        dependent[dependent] = (values[..., 2] <= tolerance * values[..., 0]).any(axis=-1)
    return dependent


def singular_values(matrices: npt.ArrayLike) -> FloatArray:
    """Return the singular values of many small matrices, without LAPACK's overhead for each.

    Parameters
    ----------
    matrices : array_like, shape (..., m, n)
        Matrices with at most six rows and columns, of finite numbers; NaN gives NaN.

    Returns
    -------
    ndarray, shape (..., min(m, n))
        Singular values from large to small, each accurate to rounding of the largest.
    """
    from spm_pin.kinematics.kernels import singularity_kernels as kernels

    expected = "matrices with at most six rows and columns"
    array = shaped_array(matrices, "matrices", (), expected)
    if array.ndim < 2 or max(array.shape[-2:]) > kernels.WIDTH:
        raise ArgumentError("matrices", expected, f"shape {array.shape}")
    if array.shape[-2] > array.shape[-1]:
        array = np.swapaxes(array, -1, -2)
    shape, (m, n) = array.shape[:-2], array.shape[-2:]
    results = [((m,), np.float64)]
    (values,) = run_kernel(kernels.singular_values, [array.reshape(-1, m, n)], (), results, _MIN_BATCH_PER_THREAD)
    return np.asarray(values.reshape(*shape, m))


def determinants(configuration: Configuration) -> FloatArray:
    """Return det J_b, det J_c and det K of states (...) alone [m³], (..., 3), as `Singularities.determinants`.

    For a stage the shape is (..., 2): det J of its six forces [m³], which is zero at forward singularities, and the
    determinant of v_x, v_y and ω_z in the equations of the legs' planes [m], which is zero at inverse ones. NaN for a
    member that does not exist, or for a leg without length.
    """
    if check_configuration(configuration).machine.is_stage:
        six = stage_forces(configuration, configuration.translation)[..., 0, :, :]
        with np.errstate(invalid="ignore"):  # missing states
            return np.stack([np.linalg.det(six), np.linalg.det(six[..., 3:, [0, 1, 5]])], axis=-1)
    from spm_pin.kinematics.kernels.jacobian_kernels import all_determinants

    machine = configuration.machine
    (dets,) = run_on_states(all_determinants, configuration, [leg_constants(machine)], [((3,), np.float64)])
    return np.asarray(dets)


def determinant_gradients(configuration: Configuration) -> FloatArray:
    """Return the derivatives of det J_b, det J_c and det K of states (...) with respect to the six readings.

    Returns
    -------
    ndarray, shape (..., 3, 6)
        Row per determinant, column per leg r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m²]; finite at an inverse
        singularity, at others as `platform_jacobian`. For the derivative along a motion of the platform multiply with
        `inverse_jacobian`.
    """
    check_configuration(configuration, of=Manipulator)
    # Twists (v, ω) of m at o per unit leg rate, (..., 6, 6); the middle platform moves with the lower legs only.
    twists = np.swapaxes(platform_jacobian(configuration), -1, -2)
    angular, origin = twists[..., 3:], configuration.translation[..., None, :]

    def moved(points: FloatArray, legs: slice) -> Any:
        """Return points (..., 3, 3) after an imaginary step of each leg, (..., 6, 3, 3), if it moves them."""
        arms = (points - origin)[..., None, :, :]
        rates = twists[..., None, :3] + np.cross(angular[..., None, :], arms)
        rates[..., legs, :, :] = 0.0
        return points[..., None, :, :] + 1j * _STEP * rates

    none, upper_legs = slice(0), slice(3, 6)
    axes, bases = configuration.leg_axes, configuration.circle_centres
    lower, upper = (moved(configuration.balls[..., k, :], upper_legs) for k in (slice(3), slice(3, 6)))
    # A centre moves with the plate that carries its leg, and in the leg's plane with its own reading.
    drift = 1j * _STEP * np.eye(6)[:, :, None] * configuration.centre_rates[..., None, :, :]
    below = lower - bases[..., None, :3, :] - drift[..., :3, :]
    above = moved(bases[..., 3:, :], none) + drift[..., 3:, :] - upper
    fixed = np.broadcast_to(axes[..., None, :3, :], lower.shape)
    turned = axes[..., None, 3:, :] + 1j * _STEP * np.cross(angular[..., None, :], axes[..., None, 3:, :])
    rows: list[Any] = [rows_of(x) for x in (lower, upper, below, above, fixed, turned)]
    b, c, first, second, a, a_m = rows
    with np.errstate(invalid="ignore", divide="ignore"):
        values = (
            determinant(b, directions(first), a),
            determinant(c, directions(second), a_m),
            structure_determinant(b, c, a, a_m),
        )
    # Without subtraction, a complex step loses no digits.
    known = np.asarray(~np.isnan(twists).any(axis=(-1, -2), keepdims=True))
    return np.where(known, np.stack(values, axis=-2).imag / _STEP, np.nan)
