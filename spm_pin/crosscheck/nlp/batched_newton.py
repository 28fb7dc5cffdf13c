"""Newton's method on the loop equations from many starts at once, and certificates for its solutions.

Residuals and exact Jacobians come from one CasADi function mapped over all starts; the steps are NumPy's batched
solve. CasADi's own linear solvers end a whole mapped call where one matrix is singular, which at some poses one is.

The equations are quadratic, F(b + h) = F(b) + J h + Q(h) with |Q(h)| <= q |h|² and q = 3/2 (1/a + Σ|γ_i|), because
Σ|h_i - h_j|² <= 3 |h|². Here a is the shortest side of the triangle of the b_i, and γ_i (b_2 - b_1) x (b_3 - b_1) is
how far the ball of upper leg i, or the origin of a stage's platform, is out of its plane, zero in a nominal machine,
where q = 3/(2d). With s the smallest
singular value of J this gives, without any approximation:

- from |F| <= δ and s² > 4 q δ: a solution exists within 2δ/(s + √(s² - 4qδ)) (Kantorovich);
- two solutions are at least s/q apart, s taken at either: J h = -Q(h).

So a solution is certified by numbers, and points are known to be the same solution or different ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from spm_pin.crosscheck.nlp import loop_equations
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import BoolArray, FloatArray

_EPS = float(np.finfo(np.float64).eps)
ROUNDING = 16.0 * _EPS
"""Rounding of one loop equation relative to the robot's size: some ten products and sums."""
_LOST = 1e6
"""Distance of a point, over the side d and the platform's distance, at which Newton's method has diverged."""


class LoopEquations:
    """The loop equations of one machine, evaluated for many points at once without copies."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.curvature = loop_equations.curvature(machine)
        """The bound q of the equations' quadratic part [1/m]."""
        self._function = loop_equations.closure(machine)
        self._mapped: dict[int, ca.Function] = {}

    def __call__(self, b: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n, 9) [m] and Jacobians (n, 9, 9) at points b (n, 9) [m] for one pose (4, 4)."""
        # Maps are made for powers of two only, so that few are made.
        n = 1 << max(len(b) - 1, 0).bit_length()
        points = np.zeros((n, 9))
        points[: len(b)] = b
        residual, jacobian = np.empty((n, 9)), np.empty((n, 9, 9))
        # CasADi is column-major, so a matrix goes in and comes out transposed.
        rotations = np.ascontiguousarray(np.broadcast_to(matrix[:3, :3].T, (n, 3, 3)))
        translations = np.ascontiguousarray(np.broadcast_to(matrix[:3, 3], (n, 3)))
        if n not in self._mapped:
            self._mapped[n] = self._function if n == 1 else self._function.map(n)
        buffer: Any
        buffer, evaluate = self._mapped[n].buffer()
        for index, argument in enumerate((points, rotations, translations)):
            buffer.set_arg(index, argument.data)
        for index, result in enumerate((residual, jacobian)):
            buffer.set_res(index, result.data)
        evaluate()
        return residual[: len(b)], np.swapaxes(jacobian[: len(b)], -1, -2)

    def are_upright(self, b: FloatArray, matrix: FloatArray) -> BoolArray:
        """Return at which points b (n, 9) a stage's platform has the normal of a pose (4, 4), not the opposite one.

        Its mirror image solves the equations too; where all six legs are, orientation follows from them.
        """
        if not self.machine.is_stage:
            return np.ones(len(b), dtype=bool)
        with np.errstate(invalid="ignore", over="ignore"):
            normals = np.cross(b[:, 3:6] - b[:, :3], b[:, 6:] - b[:, :3])
            return np.asarray(normals @ matrix[:3, 2] > 0.0)

    def rounding(self, b: FloatArray, matrix: FloatArray) -> FloatArray:
        """Return the residual [m] that rounding alone leaves at points b (n, 9)."""
        reach = np.linalg.norm(matrix[:3, 3]) + self.machine.stage_radii[-1][0] + self.machine.ball_side
        return np.asarray(ROUNDING * (reach + np.abs(b).max(axis=-1)))


def newton(
    equations: LoopEquations, starts: FloatArray, matrix: FloatArray, iterations: int
) -> tuple[FloatArray, BoolArray]:
    """Return the ends (n, 9) [m] of Newton's method from starts for a pose (4, 4), and which are solutions."""
    b = starts.copy()
    converged = np.zeros(len(b), dtype=bool)
    active = np.arange(len(b))
    far = _LOST * (equations.machine.ball_side + float(np.linalg.norm(matrix[:3, 3])))
    for step in range(iterations + 1):
        residual, jacobian = equations(b[active], matrix)
        done = np.abs(residual).max(axis=-1) <= equations.rounding(b[active], matrix)
        converged[active[done]] = True
        if step == iterations or done.all():
            break
        active, residual, jacobian = active[~done], residual[~done], jacobian[~done]
        b[active] -= _solve(jacobian, residual)
        with np.errstate(invalid="ignore"):
            kept = np.abs(b[active]).max(axis=-1) < far
        active = active[kept]
        if not active.size:
            break
    return b, converged & equations.are_upright(b, matrix)


def _solve(jacobian: FloatArray, residual: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(jacobian, residual[..., None])[..., 0])
    except np.linalg.LinAlgError:
        # One is exactly singular: the shortest step for all.
        return np.asarray((np.linalg.pinv(jacobian) @ residual[..., None])[..., 0])


@dataclass(frozen=True)
class RootCertificate:
    """A bound on the distance from a point to a solution, proved up to the rounding of its own evaluation."""

    b: FloatArray  # the point (9,) after a last Newton step where that helps [m]
    sigma: float
    """Smallest singular value of the loop equations' Jacobian, dimensionless: zero at inverse singularities."""
    error: float  # largest distance to a solution [m], in the norm of all nine coordinates
    isolated: bool  # whether that bound is proved. If not, `error` is that of a double root
    apart: float  # points closer than this are the same solution [m]


def certify_root(equations: LoopEquations, b: FloatArray, matrix: FloatArray) -> RootCertificate:
    """Polish one converged point (9,) by a Newton step and certify it, as the module's docstring derives."""
    residual, jacobian = equations(b[None], matrix)
    better = b - _solve(jacobian, residual)[0]
    polished, derivative = equations(better[None], matrix)
    if np.abs(polished).max() < np.abs(residual).max():
        b, residual, jacobian = better, polished, derivative
    sigma = float(np.linalg.svd(jacobian[0], compute_uv=False)[-1])
    delta = float(np.linalg.norm(residual) + 3.0 * equations.rounding(b[None], matrix)[0])
    q = equations.curvature
    margin, double = sigma**2 - 4.0 * q * delta, (delta / q) ** 0.5
    if margin <= 0.0:
        return RootCertificate(b, sigma, double, False, 4.0 * double)
    return RootCertificate(b, sigma, 2.0 * delta / (sigma + margin**0.5), True, max(0.5 * sigma / q, 4.0 * double))
