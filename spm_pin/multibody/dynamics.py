"""Masses, forces and accelerations of a spanning tree with closures.

With the tree's mass matrix M, its nonlinear effects h (Coriolis, centrifugal and gravity g), S, Jm and Jc as in the
module `constrained_model`, leg forces f, wrenches w_k at frames with Jacobians J_k and the forces λ in the cut balls,

    M a + h = Sᵀ f + Σ J_kᵀ w_k + Jcᵀ λ,    Jc a + J̇c v = 0.

- Forward: a from f, by `pinocchio.constraintDynamics`, regular wherever Jc has full rank.
- Inverse: τ = rnea(q, v, a) - Σ J_kᵀ w_k is what actuators in all joints would give; [Sᵀ Jcᵀ] (f, λ) = τ distributes
  it over legs and balls, regular wherever the legs hold the platform. Statics are the case τ = -Jmᵀ w.
- At the platform: v = X t with X = K⁻¹ [I; 0], which projects all of it to six equations in the twist t,

      Λ ṫ + C t + G = J_fᵀ f + w,    Λ = Xᵀ M X,    C = Xᵀ (M Ẋ + C_tree X),    G = Xᵀ g,

  regular wherever the twist determines the leg rates. Λ̇ - 2 C is skew, because Ṁ - 2 C_tree is.

Here are the forward form and the energies; `constrained_state` has the others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.constrained_model import ConstrainedModel, TreeKinematics
from spm_pin.multibody.vector_arguments import Gains, Wrenches

NO_GAINS = Gains(0.0, 0.0)


class Energy(NamedTuple):
    """Energy of all moving bodies [J], floats or arrays (...)."""

    kinetic: Any
    """Kinetic energy [J]."""
    potential: Any
    """Potential energy of gravity [J], zero at the height of the universe's origin."""

    @property
    def total(self) -> Any:
        """Kinetic and potential energy together."""
        return self.kinetic + self.potential


class PlatformDynamics(NamedTuple):
    """The mechanism's equations of motion at its terminal platform, Λ ṫ + C t + G = J_fᵀ f + w.

    t = (v, ω) is the twist of m at o, ṫ its time derivative: the acceleration of the point o and the angular
    acceleration; f are the leg forces, w is the wrench applied onto m, all in {B}. The masses of all bodies are in it.
    """

    mass: FloatArray
    """Λ, reflected at o, shape (..., 6, 6); symmetric and positive definite."""
    coriolis: FloatArray
    """C, shape (..., 6, 6), of the factorization for which Λ̇ - 2 C is skew."""
    bias: FloatArray
    """C t [N, N m], shape (..., 6)."""
    gravity: FloatArray
    """G, shape (..., 6): minus the wrench that the weights of all bodies exert at o."""


class NaturalFrequencies(NamedTuple):
    """Vibrations of the platform on elastic legs, slowest first."""

    frequencies: FloatArray
    """[Hz], shape (..., 6)."""
    modes: FloatArray
    """Small displacements (of o [m], rotation [rad]) in {B} as rows, shape (..., 6, 6), in the order of the
    frequencies; Mᵀ Λ M = 1 of the columns."""


class AccelerationSolver:
    """Accelerations under forces, by `pinocchio.constraintDynamics`, and the memory it works in."""

    def __init__(self, constrained: ConstrainedModel) -> None:
        self._model, self._data = constrained.model, constrained.model.createData()
        self._constraints = constrained.rigid_constraints()
        self._states = pin.StdVec_RigidConstraintData()
        for constraint in self._constraints:
            self._states.append(constraint.createData())
        pin.initConstraintDynamics(self._model, self._data, self._constraints, self._states)
        # No proximal term: one step is a direct solution.
        self._settings = pin.ProximalSettings(0.0, 0.0, 1)
        # References into the vector, which is slow to iterate over.
        self._each = list(self._constraints)
        self._gains = NO_GAINS

    def accelerations(
        self, q: FloatArray, v: FloatArray, torques: FloatArray, gains: Gains | None = None
    ) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), the closures' forces included.

        The gaps e obey ë + kd ė + kp e = 0 in the universe's axes, at any q and v, closed or not; without gains, ë = 0.
        """
        gains = gains or NO_GAINS
        if gains != self._gains:
            for constraint in self._each:
                constraint.m_baumgarte_parameters.Kp, constraint.m_baumgarte_parameters.Kd = gains
            self._gains = gains
        constraints = self._constraints, self._states, self._settings
        return np.asarray(pin.constraintDynamics(self._model, self._data, q, v, torques, *constraints).copy())


def wrench_torques(kinematics: TreeKinematics, wrenches: Wrenches) -> FloatArray:
    """Return Σ J_kᵀ w_k (nv,) of wrenches (6 n,) at the origins of n frames, in the axes of the universe."""
    total = np.zeros(kinematics.model.nv)
    if not wrenches.frames:
        return total
    for frame, wrench in zip(wrenches.frames, wrenches.vectors.reshape(-1, 6), strict=True):
        jacobian = pin.getFrameJacobian(kinematics.model, kinematics.data, frame, pin.LOCAL_WORLD_ALIGNED)
        total += jacobian.T @ wrench
    return total


def mass_matrix(kinematics: TreeKinematics) -> FloatArray:
    """Return M (nv, nv); Pinocchio fills one triangle."""
    half = np.triu(pin.crba(kinematics.model, kinematics.data, kinematics.q))
    return np.asarray(half + np.triu(half, 1).T)


def energy_of(kinematics: TreeKinematics, v: FloatArray) -> Energy:
    """Return the energy of the tree's bodies."""
    kinetic = float(pin.computeKineticEnergy(kinematics.model, kinematics.data, kinematics.q, v))
    return Energy(kinetic, float(pin.computePotentialEnergy(kinematics.model, kinematics.data, kinematics.q)))
