"""Masses, forces and accelerations of a spanning tree with closures.

With the tree's mass matrix M, its nonlinear effects h (Coriolis, centrifugal and gravity g), S, Jm and Jc as in the
module `velocity`, leg forces f, wrenches w_k at frames with Jacobians J_k and the forces λ in the cut balls,

    M a + h = Sᵀ f + Σ J_kᵀ w_k + Jcᵀ λ,    Jc a + J̇c v = 0.

- Forward: a from f, by `pinocchio.constraintDynamics`, regular wherever Jc has full rank.
- Inverse: τ = rnea(q, v, a) - Σ J_kᵀ w_k is what actuators in all joints would give; [Sᵀ Jcᵀ] (f, λ) = τ shares it out
  among legs and balls, regular wherever the legs hold the platform.
- At the platform: v = X t with X = K⁻¹ [I; 0], which projects all of it to six equations in the twist t,

      Λ ṫ + C t + G = J_fᵀ f + w,    Λ = Xᵀ M X,    C = Xᵀ (M Ẋ + C_tree X),    G = Xᵀ g,

  regular wherever the twist determines the leg rates. Λ̇ - 2 C is skew, because Ṁ - 2 C_tree is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.placement import AGREEMENT, Placement
from spm_pin.multibody.velocity import SINGULAR, Linearization

__all__ = [
    "Energy",
    "PlatformDynamics",
    "accelerations_for",
    "balanced_legs",
    "energy_of",
    "mass_matrix",
    "platform_dynamics",
    "require_closed",
    "require_closed_accelerations",
    "require_constrained",
    "tree_torques",
    "wrench_torques",
]

Wrenches = Iterable[tuple[int, FloatArray]]
"""Frames of a model, each with a wrench (6,) at its origin in the axes of the universe."""


class Energy(NamedTuple):
    """Energy of all moving bodies [J].

    Attributes
    ----------
    kinetic, potential : float or ndarray, shape (...)
        The potential of gravity is zero at the height of the universe's origin.
    """

    kinetic: Any
    potential: Any

    @property
    def total(self) -> Any:
        """Kinetic and potential energy together."""
        return self.kinetic + self.potential


@dataclass(frozen=True)
class PlatformDynamics:
    """The mechanism's equations of motion at its terminal platform, Λ ṫ + C t + G = J_fᵀ f + w.

    t = (v, ω) is the twist of m at o, ṫ its time derivative: the acceleration of the point o and the angular
    acceleration; f are the leg forces, w is the wrench applied onto m, all in {B}. The masses of all bodies are in it.

    Attributes
    ----------
    mass : ndarray, shape (..., 6, 6)
        Λ, reflected at o; symmetric and positive definite.
    coriolis : ndarray, shape (..., 6, 6)
        C, of the factorization for which Λ̇ - 2 C is skew.
    bias : ndarray, shape (..., 6)
        C t [N, N m].
    gravity : ndarray, shape (..., 6)
        G: minus the wrench that the weights of all bodies exert at o.
    """

    mass: FloatArray
    coriolis: FloatArray
    bias: FloatArray
    gravity: FloatArray


def wrench_torques(model: Any, wrenches: Wrenches, workspace: Workspace) -> FloatArray:
    """Return Σ J_kᵀ w_k (nv,); the joints' Jacobians must be in `workspace.data`."""
    total = np.zeros(model.nv)
    for frame, wrench in wrenches:
        pin.updateFramePlacement(model, workspace.data, frame)
        jacobian = pin.getFrameJacobian(model, workspace.data, frame, pin.LOCAL_WORLD_ALIGNED)
        total += jacobian.T @ wrench
    return total


def tree_torques(
    model: Any, q: FloatArray, v: FloatArray, a: FloatArray, wrenches: Wrenches, workspace: Workspace
) -> FloatArray:
    """Return the generalized forces (nv,) that move the tree without its closures; as `wrench_torques`."""
    external = wrench_torques(model, wrenches, workspace)
    return np.asarray(pin.rnea(model, workspace.data, q, v, a) - external)


def balanced_legs(linearization: Linearization, torques: FloatArray) -> FloatArray:
    """Return the leg forces (6,) that give, with those in the cut balls, the generalized forces (18,) of the tree.

    Raises `SingularConfigurationError` at a forward or constraint singularity.
    """
    inverse = linearization.regular_inverse(linearization.held(), "forward")
    # In the velocities u of the module `velocity`: Ŝᵀ f + (Jc C / d)ᵀ λ = Cᵀ τ / d.
    return np.asarray(inverse[:, :6].T @ (linearization.columns.T @ torques)) / linearization.side


def accelerations_for(
    linearization: Linearization, platform: FloatArray, drift: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Return the joint accelerations (18,) at which m has `acceleration` (6,), and the loops stay closed.

    `platform` (6,) and `drift` (12,) are the accelerations of m and of the gaps where no joint accelerates. Raises
    `SingularConfigurationError` at an inverse or constraint singularity.
    """
    inverse = linearization.regular_inverse(linearization.motion(), "inverse")
    wanted = np.concatenate([linearization.twist_scale * (acceleration - platform), -drift / linearization.side])
    return np.asarray(linearization.columns @ (inverse @ wanted))


def platform_dynamics(
    q: FloatArray, v: FloatArray, placement: Placement, constraints: ClosureConstraints, workspace: Workspace
) -> PlatformDynamics:
    """Return the equations of motion at the platform, of a closed q and v; see `ClosedChain.platform_dynamics`."""
    model, data = placement.model, workspace.data
    linearization = Linearization.at(q, placement, constraints, workspace)
    inverse = linearization.regular_inverse(linearization.motion(), "inverse")
    # Scaled as in the module `velocity`: X = C K̂⁻¹ [A; 0], and K Ẋ = -K̇ X.
    x = linearization.columns @ inverse[:, :6] * linearization.twist_scale
    closures = constraints.time_variation(q, v, workspace)
    turning = pin.getFrameJacobianTimeVariation(model, data, placement.platform, pin.LOCAL_WORLD_ALIGNED)
    scaled = np.concatenate([linearization.twist_scale[:, None] * turning, closures / linearization.side])
    x_rate = -linearization.columns @ (inverse @ (scaled @ x))
    mass = mass_matrix(model, q, workspace)
    coriolis = x.T @ (mass @ x_rate + pin.computeCoriolisMatrix(model, data, q, v) @ x)
    reflected = x.T @ mass @ x
    twist = linearization.platform @ v
    gravity = x.T @ pin.computeGeneralizedGravity(model, data, q)
    return PlatformDynamics(0.5 * (reflected + reflected.T), coriolis, coriolis @ twist, gravity)


def mass_matrix(model: Any, q: FloatArray, workspace: Workspace) -> FloatArray:
    """Return M (nv, nv); Pinocchio fills one triangle."""
    half = np.triu(pin.crba(model, workspace.data, q))
    return np.asarray(half + np.triu(half, 1).T)


def energy_of(model: Any, q: FloatArray, v: FloatArray, workspace: Workspace) -> Energy:
    """Return the energy of the tree's bodies."""
    kinetic = float(pin.computeKineticEnergy(model, workspace.data, q, v))
    return Energy(kinetic, float(pin.computePotentialEnergy(model, workspace.data, q)))


def require_closed(gap: FloatArray, jacobian: FloatArray, v: FloatArray, side: float, argument: str = "v") -> None:
    """Raise unless q is closed and v keeps it so, to `AGREEMENT`."""
    residual = float(np.linalg.norm(gap, axis=-1).max())
    if residual > AGREEMENT * side:
        raise ClosureError(residual, 0, "Rounded or guessed joint values? The method project closes the loops")
    opening = float(np.abs(jacobian @ v).max())
    if opening > AGREEMENT * float((np.abs(jacobian) @ np.abs(v)).max()):
        expected = "joint velocities that keep the loops closed"
        cause = "joint_velocities makes them from a twist, complete_rates from leg rates"
        raise ArgumentError(argument, expected, f"gaps that open at {opening:.1e} m/s", cause)


def require_closed_accelerations(
    jacobian: FloatArray, drift: FloatArray, v: FloatArray, a: FloatArray, side: float
) -> None:
    """Raise unless the closures allow the accelerations a at v, to `AGREEMENT`."""
    opening = float(np.abs(jacobian @ a + drift).max())
    speed = float((np.abs(jacobian) @ np.abs(v)).max())
    size = float((np.abs(jacobian) @ np.abs(a)).max()) + float(np.abs(drift).max()) + speed**2 / side
    if opening > AGREEMENT * size:
        expected = "joint accelerations that keep the loops closed"
        cause = "joint_accelerations makes them from the platform's, at the velocities v"
        raise ArgumentError("a", expected, f"gaps that open at {opening:.1e} m/s²", cause)


def require_constrained(closures: npt.NDArray[np.float64]) -> None:
    """Raise `SingularConfigurationError` where the scaled Jacobian of the closures loses rank."""
    values = np.linalg.svd(closures, compute_uv=False)
    if values[-1] <= SINGULAR * values[0]:
        raise SingularConfigurationError("constraint", float(values[-1]))
