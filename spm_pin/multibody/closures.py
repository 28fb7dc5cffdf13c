"""The closures as Pinocchio's constraints, and the one place that evaluates them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
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
        for closure in closures:
            if closure.kind != "point":
                raise ArgumentError("closures", "closures of kind point", repr(closure.kind))
            a, b = (model.frames[model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b))
            ends = (a.parentJoint, a.placement, b.parentJoint, b.placement)
            self._constraints.append(pin.ConstraintModel(pin.PointAnchorConstraintModel(model, *ends)))
            self._joints.append(a.parentJoint)
        # References into the vector, which is slow to iterate over.
        self._each = list(self._constraints)

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
        gap = np.array([end.oMc2.translation - end.oMc1.translation for end in ends]).reshape(-1, 3)
        rotation = np.array([end.oMc1.rotation for end in ends]).reshape(-1, 3, 3)
        # Pinocchio differentiates the gap as a sees it; where a turns, an open gap turns with it.
        turning = [pin.getJointJacobian(self._model, data, a, pin.LOCAL_WORLD_ALIGNED)[3:] for a in self._joints]
        turned = np.array([pin.skew(g) @ w for g, w in zip(gap, turning, strict=True)]).reshape(relative.shape)
        return gap, (rotation @ relative.reshape(-1, 3, q.size)).reshape(relative.shape) - turned
