"""The closures as Pinocchio's constraints, and the one place that evaluates them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.description.closures import Closure
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["ClosureConstraints", "Workspace"]


@dataclass(frozen=True, eq=False)
class Workspace:
    """Memory for the computations of one `ClosedChain`, made by its method `workspace`; for one thread at a time.

    Attributes
    ----------
    data : pinocchio.Data
        Of the chain's model. Whatever the last call left in it.
    constraints : pinocchio.StdVec_ConstraintData
        One per closure.
    each : tuple of pinocchio.ConstraintData
        References to its members.
    owner : object
        The constraints it was made for.
    """

    data: Any
    constraints: Any
    each: tuple[Any, ...]
    owner: ClosureConstraints

    @cached_property
    def accelerations(self) -> _Accelerations:
        """Memory for `ClosureConstraints.accelerations`, made when first asked for."""
        return self.owner.memory_for_accelerations()


@dataclass(frozen=True, eq=False)
class _Accelerations:
    """What `pinocchio.constraintDynamics` works in; the constraints hold the gains of the last call."""

    data: Any
    constraints: Any
    states: Any
    each: tuple[Any, ...]
    settings: Any


class ClosureConstraints:
    """The closures of a model.

    Parameters
    ----------
    model : pinocchio.Model
        A model with the frames that the closures name.
    closures : iterable of Closure
        Of kind "point".
    """

    def __init__(self, model: Any, closures: Iterable[Closure]) -> None:
        self._model = model
        self._constraints = pin.StdVec_ConstraintModel()
        self._joints: list[int] = []  # that carry frame_a
        self._frames: list[tuple[int, int]] = []
        self._ends: list[tuple[Any, ...]] = []
        for closure in closures:
            if closure.kind != "point":
                raise ArgumentError("closures", "closures of kind point", repr(closure.kind))
            frames = model.getFrameId(closure.frame_a), model.getFrameId(closure.frame_b)
            a, b = (model.frames[frame] for frame in frames)
            ends = (a.parentJoint, a.placement, b.parentJoint, b.placement)
            self._frames.append(frames)
            self._ends.append(ends)
            self._constraints.append(pin.ConstraintModel(pin.PointAnchorConstraintModel(model, *ends)))
            self._joints.append(a.parentJoint)
        # References into the vector, which is slow to iterate over.
        self._each = list(self._constraints)

    @property
    def count(self) -> int:
        """Number of closures."""
        return len(self._each)

    def workspace(self, given: Workspace | None = None) -> Workspace:
        """Return memory for `evaluate`: the one given, if it was made here, or new."""
        if given is not None:
            if not isinstance(given, Workspace):
                raise ArgumentError("workspace", "what this chain's method workspace returns", type(given).__name__)
            if given.owner is not self:
                raise ArgumentError("workspace", "what this chain's method workspace returns", "that of another chain")
            return given
        constraints = pin.StdVec_ConstraintData()
        for constraint in self._constraints:
            constraints.append(constraint.createData())
        return Workspace(self._model.createData(), constraints, tuple(constraints), self)

    def evaluate(self, q: FloatArray, workspace: Workspace) -> tuple[FloatArray, FloatArray]:
        """Return the closures' gaps and the derivative of the gaps, exact at any q, closed or not.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Joint values. Leaves their joint placements and Jacobians in `workspace.data`.
        workspace : Workspace
            Made by the method of that name.

        Returns
        -------
        gap : ndarray, shape (n, 3)
            From the origin of `frame_a` to that of `frame_b`, in {B} [m].
        jacobian : ndarray, shape (3 n, nv)
            Maps the joint velocities to the rates of the gaps: velocity of b's origin less that of a's, in {B}.
        """
        data = workspace.data
        pin.computeJointJacobians(self._model, data, q)
        for constraint, own in zip(self._each, workspace.each, strict=True):
            # Without it, the Jacobian below is that of an earlier q, and nobody says so.
            constraint.calc(self._model, data, own)
        relative = pin.getConstraintsJacobian(self._model, data, self._constraints, workspace.constraints)
        ends = [own.extract() for own in workspace.each]
        gap = self.gaps(workspace)
        rotation = np.array([end.oMc1.rotation for end in ends]).reshape(-1, 3, 3)
        # Pinocchio differentiates the gap as a sees it; where a turns, an open gap turns with it.
        turning = [pin.getJointJacobian(self._model, data, a, pin.LOCAL_WORLD_ALIGNED)[3:] for a in self._joints]
        turned = np.array([pin.skew(g) @ w for g, w in zip(gap, turning, strict=True)]).reshape(relative.shape)
        return gap, (rotation @ relative.reshape(-1, 3, self._model.nv)).reshape(relative.shape) - turned

    def gaps(self, workspace: Workspace) -> FloatArray:
        """Return the gaps (n, 3) that the last `evaluate` left in `workspace`."""
        ends = [own.extract() for own in workspace.each]
        return np.array([end.oMc2.translation - end.oMc1.translation for end in ends]).reshape(-1, 3)

    def drift(self, q: FloatArray, v: FloatArray, workspace: Workspace) -> FloatArray:
        """Return the accelerations of the gaps where no joint accelerates, J̇c v, shape (3 n,), in {B} [m/s²]."""
        model, data = self._model, workspace.data
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        rows = []
        for a, b in self._frames:
            at_b, at_a = (pin.getFrameClassicalAcceleration(model, data, i, pin.LOCAL_WORLD_ALIGNED) for i in (b, a))
            rows.append(at_b.linear - at_a.linear)
        return np.concatenate(rows)

    def time_variation(self, q: FloatArray, v: FloatArray, workspace: Workspace) -> FloatArray:
        """Return J̇c, the rate of the Jacobian of `evaluate` as q moves at v, shape (3 n, nv).

        Leaves the rates of all Jacobians, and the frames, in `workspace.data`.
        """
        model, data = self._model, workspace.data
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.updateFramePlacements(model, data)
        rows = []
        for a, b in self._frames:
            at_b, at_a = (
                pin.getFrameJacobianTimeVariation(model, data, i, pin.LOCAL_WORLD_ALIGNED)[:3] for i in (b, a)
            )
            rows.append(at_b - at_a)
        return np.concatenate(rows)

    def accelerations(
        self, q: FloatArray, v: FloatArray, torques: FloatArray, gains: tuple[float, float], workspace: Workspace
    ) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), the closures' forces included.

        The gaps e obey ë + gains[1] ė + gains[0] e = 0 in {B}, at any q and v, closed or not.
        """
        own = workspace.accelerations
        for constraint in own.each:
            constraint.m_baumgarte_parameters.Kp, constraint.m_baumgarte_parameters.Kd = gains
        given = self._model, own.data, q, v, torques, own.constraints, own.states, own.settings
        return np.array(pin.constraintDynamics(*given))

    def memory_for_accelerations(self) -> _Accelerations:
        """Return memory for `accelerations`; `Workspace` asks for it."""
        # Of all constraints, constraintDynamics takes these alone; their Jacobian has the opposite sign.
        constraints, states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for ends in self._ends:
            model = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self._model, *ends, pin.LOCAL)
            constraints.append(model)
            states.append(model.createData())
        data = self._model.createData()
        pin.initConstraintDynamics(self._model, data, constraints, states)
        # No proximal term: one step is a direct solution.
        settings = pin.ProximalSettings(0.0, 0.0, 1)
        return _Accelerations(data, constraints, states, tuple(constraints), settings)
