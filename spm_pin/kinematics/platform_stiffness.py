"""Stiffness of the platform from that of the legs: along each leg, and across it where its structure gives way.

With the forces of a stage as rows of J_b = [A_b; K_b] and J_c = [A_c; K_c], see
`spm_pin.kinematics.rates_and_forces`, three along the legs and three along their revolute axes, both stages carry the
whole load (they are in series), so that their compliances add:

    C = J_b⁻¹ D_b J_b⁻ᵀ + J_c⁻¹ D_c J_c⁻ᵀ,    D = diag(1 / stiffness) of the six forces.

With rigid structures that is C = G diag(1/k) Gᵀ, G = J_f⁻¹. Weights and other loads are taken to be small: what a load
itself adds by turning the legs is of the size load / (leg length · k) relative to C⁻¹.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, stage_inverses
from spm_pin.mechanism.arguments import FloatArray, broadcastable, leg_values, symmetric_matrices
from spm_pin.mechanism.configuration import Configuration, check_configuration

_STIFFEST = 1e100
"""Largest stiffness [N/m]: products of two are still numbers."""


class PrincipalStiffness(NamedTuple):
    """Stiffness in its principal directions, weakest first."""

    translational: FloatArray
    """Force per displacement of o while the platform turns as it likes [N/m], shape (..., 3)."""
    translational_directions: FloatArray
    """Their unit vectors in {B}, as rows, shape (..., 3, 3)."""
    rotational: FloatArray
    """Moment per rotation while o moves as it likes [N m/rad], shape (..., 3)."""
    rotational_directions: FloatArray
    """Their unit vectors in {B}, as rows, shape (..., 3, 3)."""


def compliance(configuration: Configuration, legs: npt.ArrayLike, structure: npt.ArrayLike | None = None) -> FloatArray:
    """Return the displacement of the platform per unit wrench.

    Parameters
    ----------
    configuration : Configuration
        States of shape (...).
    legs : array_like, shape (..., 6) or ()
        Stiffness of each actuator with its leg, along the leg [N/m], one number for all.
    structure : array_like, shape (..., 6) or (), optional
        Stiffness of each leg and its joints along the axis of its revolute joint, at the ball joint [N/m]; rigid by
        default.

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Maps (f, m) at o in {B} [N, N m] to a displacement of o [m] and a small rotation [rad] in {B}; symmetric.
        Of rank less than 6 at an inverse singularity with rigid structures. NaN for a member of a batch that does not
        exist or is singular as below.

    Raises
    ------
    SingularConfigurationError
        For a single state at a forward or a constraint singularity, where the legs do not hold the platform.
    """
    check_configuration(configuration)
    along = _inverses(legs, "legs", configuration)
    across = np.zeros(6) if structure is None else _inverses(structure, "structure", configuration)
    inverses = stage_inverses(configuration)
    halves = (x.reshape(*x.shape[:-1], 2, 3) for x in (along, across))
    shares = np.concatenate(np.broadcast_arrays(*halves), axis=-1)
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
        positive definite. NaN for a member of a batch that does not exist or is singular as below.

    Raises
    ------
    SingularConfigurationError
        For a single state at a forward or a constraint singularity; with a rigid structure at an inverse one as well,
        where the legs' lengths do not show some motion of the platform: its stiffness is infinite there, `compliance`

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> spm.stiffness(state, legs=1e7)[2, 2].round(-5)
    np.float64(28900000.0)
    """
    if structure is not None:
        return _inverse(compliance(configuration, legs, structure))
    along = 1.0 / _inverses(legs, "legs", check_configuration(configuration))
    jacobian = inverse_jacobian(configuration)
    return np.asarray(jacobian.swapaxes(-1, -2) @ (along[..., None] * jacobian))


def principal_stiffness(compliance: npt.ArrayLike) -> PrincipalStiffness:
    """Return the stiffness against pure forces at o and against pure moments, in their principal directions.

    Parameters
    ----------
    compliance : array_like, shape (..., 6, 6)
        Displacement per wrench, as of the function `compliance`, positive semidefinite. NaN gives NaN.

    Returns
    -------
    PrincipalStiffness
        Infinite where a direction is rigid.
    """
    matrices = symmetric_matrices(compliance, "compliance", 6, "in m/N, rad/(N m)", allow_nan=True)
    # Scaled to a diagonal of ones, eigenvalues are free of their units.
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    absent = np.asarray(np.isnan(matrices).any(axis=(-1, -2)))
    smallest = np.linalg.eigvalsh(np.nan_to_num(matrices * scale[..., None, :] * scale[..., :, None], nan=1.0))[..., 0]
    wrong = (smallest < -1e-9) & ~absent
    if wrong.any():
        received = f"an eigenvalue of {smallest[wrong].flat[0]:.1e} of its diagonal"
        raise ArgumentError("compliance", "positive semidefinite matrices", received)
    principal: list[FloatArray] = []
    for block in (matrices[..., :3, :3], matrices[..., 3:, 3:]):
        values, vectors = np.linalg.eigh(np.where(absent[..., None, None], np.eye(3), block))
        rigid = values <= 1e-14 * values[..., -1:]
        stiffnesses = np.where(rigid, np.inf, 1.0 / np.where(rigid, 1.0, values))[..., ::-1]
        directions = vectors.swapaxes(-1, -2)[..., ::-1, :]
        principal.append(np.where(absent[..., None], np.nan, stiffnesses))
        principal.append(np.where(absent[..., None, None], np.nan, directions))
    return PrincipalStiffness(*principal)


def _inverses(value: npt.ArrayLike, argument: str, configuration: Configuration) -> FloatArray:
    """Return 1 / stiffness of six forces, shape (..., 6)."""
    meaning = "the stiffness of r_b1 to r_c3 in N/m, or one for all"
    cause = "A rigid leg has a large stiffness, not none"
    inverses = 1.0 / leg_values(value, argument, meaning, most=_STIFFEST, cause=cause)
    broadcastable(argument, inverses.shape[:-1], "configuration", configuration.shape)
    return np.asarray(inverses)


def _inverse(matrices: FloatArray) -> FloatArray:
    absent = np.isnan(matrices).any(axis=(-1, -2), keepdims=True)
    inverse = np.linalg.inv(np.where(absent, np.eye(6), matrices))
    return np.where(absent, np.nan, 0.5 * (inverse + inverse.swapaxes(-1, -2)))
