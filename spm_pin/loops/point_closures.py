"""Chains whose closures are all points, by Pinocchio's own constraints: equations and accelerations, no NumPy between.

`PointAnchorConstraintModel` has the equations of `constraint_rows`, exact off the closures too; for closures that fix
rotations it has none that are, so that those are computed there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.support.arguments import FloatArray


class PointRows:
    """Equations R1ᵀ (p2 - p1) = 0 of the closures of a `ConstraintRows`, at the configuration of a `pinocchio.Data`."""

    def __init__(self, rows: Any) -> None:
        self._model = rows.model
        self._constraints, self._states = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        for (first, second), (at_first, at_second) in zip(rows.joints, rows.placements, strict=True):
            anchor = pin.PointAnchorConstraintModel(self._model, first, at_first, second, at_second)
            self._constraints.append(pin.ConstraintModel(anchor))
        for constraint in self._constraints:
            self._states.append(constraint.createData())
        # References into the vectors, since looking them up takes longer than all else.
        self._pairs = list(zip(self._constraints, self._states, strict=True))
        self._results = [state.extract() for state in self._states]

    def update(self, data: Any) -> None:
        """Move to the joint placements in `data`, whatever is computed next: Pinocchio does not by itself."""
        for constraint, state in self._pairs:
            constraint.calc(self._model, data, state)

    def residual(self) -> FloatArray:
        """Return the left sides (m,) [m] after `update`."""
        return np.concatenate([result.constraint_position_error for result in self._results])

    def jacobian(self, data: Any) -> FloatArray:
        """Return their derivatives (m, nv) after `update`; `data` has the joint Jacobians."""
        return np.asarray(pin.getConstraintsJacobian(self._model, data, self._constraints, self._states))

    def bias(self, data: Any, q: FloatArray, v: FloatArray, zero: FloatArray) -> FloatArray:
        """Return their second derivatives (m,) where no joint accelerates; `zero` is of the size of v."""
        pin.forwardKinematics(self._model, data, q, v, zero)
        self.update(data)
        return np.concatenate([result.constraint_acceleration_error for result in self._results])


class PointDynamics:
    """Accelerations under forces of a tree whose loops are closed by points, by `constraintDynamics`, with its memory.

    At closed q any rank is right; at q with open loops, the closures have to be independent. Each motion of the tree
    has inertia.
    """

    def __init__(self, rows: Any) -> None:
        self._model, self._data = rows.model, rows.model.createData()
        self._constraints, self._states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for (first, second), (at_first, at_second) in zip(rows.joints, rows.placements, strict=True):
            places = first, at_first, second, at_second
            self._constraints.append(
                pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, self._model, *places, pin.LOCAL)
            )
        for constraint in self._constraints:
            self._states.append(constraint.createData())
        pin.initConstraintDynamics(self._model, self._data, self._constraints, self._states)
        # A direct solution is NaN where rows of the closures depend on each other; this one is as accurate elsewhere.
        self._settings = pin.ProximalSettings(0.0, 1e-12, 20)

    def accelerations(self, q: FloatArray, v: FloatArray, forces: FloatArray) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), gravity and the closures' forces."""
        constraints = self._constraints, self._states, self._settings
        return np.array(pin.constraintDynamics(self._model, self._data, q, v, forces, *constraints))
