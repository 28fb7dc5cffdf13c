"""Accelerations of trees with point closures by Pinocchio's `constraintDynamics`: its own factorisation, no NumPy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.support.arguments import FloatArray


class PointDynamics:
    """Solver of accelerations under forces of a tree whose loops are closed by points, with its memory.

    `ends` are, for each closure, joint and placement of its first and of its second point. At closed q any rank is
    right; at q with open loops, the closures have to be independent.
    """

    def __init__(self, model: Any, ends: Iterable[tuple[int, Any, int, Any]]) -> None:
        self._model, self._data = model, model.createData()
        self._constraints, self._states = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for places in ends:
            self._constraints.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *places, pin.LOCAL))
        for constraint in self._constraints:
            self._states.append(constraint.createData())
        pin.initConstraintDynamics(model, self._data, self._constraints, self._states)
        # A direct solution is NaN where rows of the closures depend on each other; this one is as accurate elsewhere.
        self._settings = pin.ProximalSettings(0.0, 1e-12, 20)

    def accelerations(self, q: FloatArray, v: FloatArray, forces: FloatArray) -> FloatArray:
        """Return the joint accelerations (nv,) under generalized forces (nv,), gravity and the closures' forces."""
        constraints = self._constraints, self._states, self._settings
        return np.array(pin.constraintDynamics(self._model, self._data, q, v, forces, *constraints))
