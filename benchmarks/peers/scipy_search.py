"""SciPy on the nine loop equations, from random starts."""

from __future__ import annotations

import numpy as np
from scipy.optimize import fsolve, least_squares
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.multistart import search
from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin import Manipulator


class LoopEquations:
    """The equations of one pose, with their Jacobian: six planes, and three sides as (|b_i - b_j|² - d²)/(2d)."""

    def __init__(self, machine: Manipulator, matrix: FloatArray) -> None:
        lower = machine.revolute_axes
        upper = lower @ matrix[:3, :3].T
        self._side = machine.middle_side
        self._jacobian = np.zeros((9, 9))
        for i in range(3):
            self._jacobian[i, 3 * i : 3 * i + 3] = lower[i]
            self._jacobian[3 + i, 3 * i : 3 * i + 3] = upper[i]
        self._offset = np.concatenate([np.zeros(3), upper @ matrix[:3, 3]])

    def value(self, b: FloatArray) -> FloatArray:
        """Return the residual (9,) [m]."""
        joints = b.reshape(3, 3)
        sides = joints - joints[[1, 2, 0]]
        squares = (sides * sides).sum(axis=1)
        return np.concatenate([self._jacobian[:6] @ b - self._offset, (squares / self._side - self._side) / 2.0])

    def slope(self, b: FloatArray) -> FloatArray:
        """Return the Jacobian (9, 9)."""
        joints = b.reshape(3, 3)
        sides = (joints - joints[[1, 2, 0]]) / self._side
        jacobian = self._jacobian
        for k in range(3):
            j = (k + 1) % 3
            jacobian[6 + k, 3 * k : 3 * k + 3] = sides[k]
            jacobian[6 + k, 3 * j : 3 * j + 3] = -sides[k]
        return jacobian


def by_fsolve(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare MINPACK's hybrid method."""
    machine, _ = problem

    def solve(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        equations = LoopEquations(machine, matrix)
        # With full_output it says nothing where it fails; what has not converged is sorted out by the residual.
        return np.array(
            [
                fsolve(equations.value, start, fprime=equations.slope, xtol=1e-14, full_output=True)[0]
                for start in starts
            ]
        )

    return search(problem, solve)


def by_least_squares(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare MINPACK's Levenberg-Marquardt method."""
    machine, _ = problem

    def solve(starts: FloatArray, matrix: FloatArray) -> FloatArray:
        equations = LoopEquations(machine, matrix)
        tolerances = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        return np.array(
            [
                least_squares(equations.value, start, lambda b: equations.slope(b).copy(), method="lm", **tolerances).x
                for start in starts
            ]
        )

    return search(problem, solve)
