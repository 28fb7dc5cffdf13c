"""Rates, joint loads and singularities of one stage: `docs/theory/stages.md`.

The platform has three degrees of freedom, its *motion* (v_z, ω_x, ω_y): the velocity of its origin along z of {B} and
the horizontal part of its angular velocity. The rest is parasitic motion. Each leg acts on it through its ball along
`leg_vectors` with its actuator's force, and along its revolute axis with its structure's force: six forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.formulas import stage_poses, wrenches
from spm_pin.formulas.operations import on_arrays, rows_of, vector_of
from spm_pin.kinematics.singularity_kinds import SINGULAR, SingularityKind, kinds_text
from spm_pin.machine.configuration import Configuration, check_configuration, masked
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import FloatArray, broadcastable, real_array

MOTION = slice(2, 5)
"""Rows of a twist (v, ω) that are the motion (v_z, ω_x, ω_y)."""

_stage_twists, _parasitic_rates = on_arrays(wrenches.stage_twists), on_arrays(stage_poses.parasitic_rates)


class JointLoads(NamedTuple):
    """Loads of the joints of a stage, for states and wrenches of shape (...); weights and friction are neglected."""

    efforts: FloatArray
    """Efforts of the actuators, positive if they increase the reading, shape (..., 3): [N], for RRS legs [N m]."""
    rods: FloatArray
    """Force of each leg along `leg_vectors`, positive if it pushes the platform [N], shape (..., 3)."""
    across: FloatArray
    """Force of each leg along its revolute axis, which its structure carries [N], shape (..., 3)."""
    balls: FloatArray
    """Forces of the legs onto the platform through the balls, as rows in {B} [N], shape (..., 3, 3)."""
    moments: FloatArray
    """Moments of these forces at the legs' pivots, as rows in {B} [N m], shape (..., 3, 3)."""


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


def platform_jacobian(configuration: Configuration) -> FloatArray:
    """Return the map (..., 6, 3) from rates of readings to the twist; see `rates_and_forces.platform_jacobian`."""
    return _columns(configuration, along_legs=True) * configuration.slopes[..., None, :]


def motion_rows(jacobian: FloatArray) -> FloatArray:
    """Return the rows of G (..., 6, legs) of a machine's freedoms: all for a manipulator, `MOTION` for a stage."""
    return jacobian if jacobian.shape[-1] == 6 else jacobian[..., MOTION, :]


def tilt_densities(state: Configuration, jacobian: FloatArray) -> FloatArray:
    """Return |det ∂(height, normal)/∂readings| of states (...) from their `platform_jacobian`, [m sr] per readings."""
    # Turns about the platform's own x and y move its normal, and one about the normal does not.
    turns = state.rotation[..., :2].mT @ jacobian[..., 3:, :]
    rates = np.concatenate([jacobian[..., 2:3, :], turns], axis=-2)
    return np.asarray(np.abs(np.linalg.det(rates)))


def parasitic_jacobian(configuration: Configuration) -> FloatArray:
    """Return the twist of the platform for its motion (v_z, ω_x, ω_y), with the parasitic v_x, v_y and ω_z.

    Returns
    -------
    ndarray, shape (..., 6, 3)
        Rows (v, ω) of the platform at its origin, in {B}; columns v_z [m/s], ω_x and ω_y [rad/s]. At an inverse
        singularity, where the motion does not determine the twist, a single state raises `SingularConfigurationError`,
        and a member of a batch is NaN.
    """
    state = _read(configuration)
    axes, balls, origin = rows_of(state.machine.legs.axes), rows_of(state.balls), vector_of(state.translation)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = [_parasitic_rates(axes, balls, origin, tuple(unit)) for unit in np.eye(3).tolist()]
    twists = _stacked(state, columns)
    return _without_singular(state, twists, "inverse", _inverse_matrices(state))


def inverse_jacobian(configuration: Configuration) -> FloatArray:
    """Return the map (..., 3, 3) from the motion to rates of readings; see `rates_and_forces.inverse_jacobian`."""
    twists = parasitic_jacobian(configuration)
    forces = _forces(configuration)[..., :3, :]
    return np.asarray(forces @ twists / regular_slopes(configuration)[..., None])


def regular_slopes(state: Configuration) -> FloatArray:
    """Return κ of the legs (..., legs), NaN if a leg is singular; a single singular state raises an error."""
    slopes = state.slopes
    singular = np.abs(slopes) <= SINGULAR * state.machine.legs.largest_slopes
    if singular.any() and not state.shape:
        raise SingularConfigurationError("leg", float(np.abs(slopes).min()))
    return np.where(singular, np.nan, slopes)


def joint_loads(configuration: Configuration, wrench: npt.ArrayLike) -> JointLoads:
    """Return what actuators, legs, balls and pivots carry under a wrench (..., 6), both as for `leg_forces`."""
    load = real_array(wrench, "wrench", (6,), "(f, m) at the platform's origin in {B} in N and N m")
    broadcastable("wrench", load.shape[:-1], "the configuration", _read(configuration).shape)
    rods, across = (
        -np.einsum("...ki,...k->...i", _columns(configuration, along_legs=along), load) for along in (True, False)
    )
    vectors = _forces(configuration)[..., :3]
    balls = rods[..., None] * vectors[..., :3, :] + across[..., None] * vectors[..., 3:, :]
    arms = configuration.balls - configuration.machine.legs.pivots
    return JointLoads(rods * configuration.slopes, rods, across, balls, np.cross(arms, balls))


def singularities(state: Configuration, least: float) -> StageSingularities:
    """Find which states are singular, of which kind, and how far the others are from it.

    `least` is the ratio of the smallest singular value to the largest, and of κ to its largest, of a singular state.
    """
    exists, scale = state.exists[..., None, None], state.machine.platform_radius
    # A leg whose length is zero has no direction and resists nothing: its row is zero, the state forward singular.
    six = np.nan_to_num(np.where(exists, _six_forces(state), np.eye(6)))
    three = np.where(exists, _inverse_matrices(state), np.eye(3))
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


def determinants(state: Configuration) -> FloatArray:
    """Return numbers that are zero at forward and at inverse singularities, dimensionless, (..., 2)."""
    with np.errstate(invalid="ignore"):  # missing states
        return np.stack([np.linalg.det(_six_forces(state)), np.linalg.det(_inverse_matrices(state))], axis=-1)


def stage_inverses(configuration: Configuration) -> FloatArray:
    """Return the twists (..., 1, 6, 6) of unit rates of the balls along legs and along axes; NaN where singular."""
    parts = [_columns(configuration, along_legs=along) for along in (True, False)]
    return np.concatenate(parts, axis=-1)[..., None, :, :]


def _read(configuration: Any) -> Configuration:
    state = check_configuration(configuration, of=Stage)
    return check_configuration(state, existing=not state.shape)


def _directions(state: Configuration) -> tuple[FloatArray, FloatArray]:
    """Return the unit vectors along legs and along axes, as rows (..., 3, 3)."""
    vectors = state.leg_vectors
    with np.errstate(invalid="ignore", divide="ignore"):
        along = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return along, np.broadcast_to(state.machine.legs.axes, along.shape)


def _forces(state: Configuration) -> FloatArray:
    """Return the six forces as rows (f, m) at the platform's origin, along the legs and along the axes, (..., 6, 6)."""
    arms = state.balls - state.translation[..., None, :]
    rows = [np.concatenate([f, np.cross(arms, f)], axis=-1) for f in _directions(state)]
    return np.concatenate(rows, axis=-2)


def _six_forces(state: Configuration) -> FloatArray:
    """Return `_forces` with lengths in units of the platform's radius."""
    return np.asarray(_forces(state) / np.repeat([1.0, state.machine.platform_radius], 3))


def _inverse_matrices(state: Configuration) -> FloatArray:
    """Return the matrix of v_x, v_y and ω_z in the planes' equations, in the same units, (..., 3, 3)."""
    return np.asarray(_six_forces(state)[..., 3:, [0, 1, 5]])


def _columns(configuration: Any, *, along_legs: bool) -> FloatArray:
    """Return the twists (..., 6, 3) for unit rates of the balls along the legs, or along the axes."""
    state = _read(configuration)
    legs, axes = map(rows_of, _directions(state))
    first, second = (legs, axes) if along_legs else (axes, legs)
    with np.errstate(invalid="ignore", divide="ignore"):
        columns = _stage_twists(rows_of(state.balls), first, second, vector_of(state.translation))
    return _without_singular(state, _stacked(state, columns), "forward", _six_forces(state))


def _stacked(state: Configuration, columns: Any) -> FloatArray:
    """Return twists (v, ω) from formulas as the columns of matrices (..., 6, 3)."""
    rows = [np.stack(np.broadcast_arrays(*v, *w, np.zeros(state.shape))[:6], axis=-1) for v, w in columns]
    return np.stack(rows, axis=-1)


def _without_singular(state: Configuration, values: FloatArray, kind: str, matrices: FloatArray) -> FloatArray:
    """Return values (..., m, n), NaN if a matrix is singular to rounding; a single singular state raises an error."""
    sizes = np.linalg.svd(np.nan_to_num(matrices), compute_uv=False)
    singular = state.exists & (sizes[..., -1] <= SINGULAR * sizes[..., 0])
    if singular.any() and not state.shape:
        raise SingularConfigurationError(kind, float(sizes[..., -1]))
    return np.where(singular[..., None, None], np.nan, values)
