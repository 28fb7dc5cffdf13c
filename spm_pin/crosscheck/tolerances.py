"""Tolerances from conditioning and rounding: how far two correct answers may differ.

A method states the closure residual δ its arithmetic may leave. The error this causes in an answer depends on the
configuration, not on the method. The nine loop equations F(b) are quadratic, with |Q(h)| <= q |h|², q = 3/(2d), and
their Jacobian F_b has the smallest singular value s; for a stage three of them are its request, and J_f is for its
motion (v_z, ω_x, ω_y), with other equations and another F_b for the last point but one: see `nlp.leg_jacobian`. Then

- a point with |F| <= δ has a true branch within e = 2δ/(s + √(s² - 4qδ)), if s² > 4qδ (Kantorovich); otherwise
  two branches cannot be resolved, and they are √(δ/q) away at most;
- J_f = q_x - q_b F_b⁻¹ F_x with the readings q, in lengths, times the largest slopes of the legs, so entries wrong by
  ε = δ/l, l the shortest length in them, make it wrong by ε (|q_b|² + |q_b|/s)(1 + |F_b⁻¹ F_x|) to first order, each
  norm over nine rows or columns, but for the first |q_b|, the largest of its rows: one over the slope κ, which is wrong
  by ε itself, and 1 of RPS legs;
- forces f = -J_f⁻ᵀ w are then wrong by |J_f⁻¹| |ΔJ_f| |f|; those of a stage f = -J_f⁻ᵀ Pᵀ w by |J_f⁻¹| |ΔJ_f|
  (|f| + |w|), as the twist P of unit motions, parasitic motion included, is as wrong as J_f.

In a calibrated machine the upper legs' balls are u_i = b_i + α p + β q + γ p x q with p = b_2 - b_1, q = b_3 - b_1 and
fixed α, β, γ: the equations stay quadratic, and q grows by (3/2) Σ|γ|.

Lengths stand for angles times d, so that norms mean something.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from spm_pin.crosscheck.ball_states import freedoms
from spm_pin.machine.machine import Machine
from spm_pin.support.arguments import BoolArray, FloatArray

ROWS = 3.0
"""√9: from the largest of nine equations to their norm."""
_SINGULAR = 16.0 * float(np.finfo(np.float64).eps)
"""Smallest singular value of the loop equations' Jacobian, dimensionless, that counts as zero."""


@dataclass(frozen=True)
class Conditioning:
    """Condition numbers of states (N,), from which errors follow."""

    sigma: FloatArray
    """Smallest singular value of the loop equations' Jacobian, dimensionless, shape (N,)."""
    jacobian: FloatArray
    """Error of J_f, angles times d, per metre of closure residual [1/m], shape (N,)."""
    inverse: FloatArray
    """|J_f⁻¹|, angles times d, dimensionless, shape (N,)."""
    curvature: float
    """The bound q of the equations' quadratic part [1/m]."""

    @classmethod
    def from_configuration(cls, configuration: Any) -> Conditioning:
        """Return the conditioning of states (N,) of a machine; NaN for a member that does not exist."""
        machine = configuration.machine
        exists = configuration.exists[:, None, None]
        position_b, closure_b, closure_x, readings_b, readings_x = (
            np.where(exists, part, np.eye(*part.shape[-2:])) for part in _derivatives(configuration)
        )
        values = np.linalg.svd(closure_b, compute_uv=False)[..., -1]
        # Where the equations are singular to rounding, nothing bounds J_f.
        singular = values <= _SINGULAR
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            regular = np.where(singular[:, None, None], np.eye(9), closure_b)
            motion = np.linalg.solve(regular, closure_x)
            rates = readings_x - readings_b @ motion
            lengths = [
                np.linalg.norm(vectors, axis=-1).min(axis=-1)
                for vectors in (configuration.leg_vectors, configuration.places)
            ]
            shortest = np.minimum(np.minimum(*lengths), machine.legs.sides.min())
            own = (readings_b**2).sum(axis=-1).max(axis=-1)
            legs = np.linalg.norm(readings_b, axis=(-1, -2)) / values
            spread = ROWS * (own + legs) * (1.0 + np.linalg.norm(motion, axis=(-1, -2))) / shortest
            spread = np.where(singular, np.inf, spread)
            inverse = 1.0 / np.linalg.svd(rates, compute_uv=False)[..., -1]
        absent = ~configuration.exists
        sizes = np.linalg.svd(position_b, compute_uv=False)[..., -1]
        sigma, jacobian, norm = (np.where(absent, np.nan, array) for array in (sizes, spread, inverse))
        return cls(sigma, jacobian, norm, _functions(machine)[2])

    def resolves(self, rounding: FloatArray) -> BoolArray:
        """Return whether branches are isolated despite a closure residual [m] (N,)."""
        return np.asarray(self.sigma**2 > 4.0 * self.curvature * ROWS * rounding)

    def position(self, rounding: FloatArray) -> FloatArray:
        """Return the error of the b_i [m], (N,), for a closure residual [m] (N,)."""
        delta, q = ROWS * rounding, self.curvature
        margin = self.sigma**2 - 4.0 * q * delta
        isolated = 2.0 * delta / (self.sigma + np.sqrt(np.maximum(margin, 0.0)))
        return np.where(margin > 0.0, isolated, np.sqrt(delta / q))

    def rates(self, rounding: FloatArray) -> FloatArray:
        """Return the error of J_f in norm, angles times d, (N,), for a closure residual [m] (N,)."""
        return np.asarray(self.jacobian * rounding)

    def forces(self, rounding: FloatArray) -> FloatArray:
        """Return the error of forces relative to their norm, (N,), for a closure residual [m] (N,)."""
        return np.asarray(self.inverse * self.rates(rounding))


def _derivatives(configuration: Any) -> list[FloatArray]:
    """Return F_b (N, 9, 9) of positions; F_b, F_x (N, 9, n), q_b (N, n, 9), q_x (N, n, n), angles times d."""
    count, machine = len(configuration), configuration.machine
    places = configuration.balls[..., :3, :].reshape(count, 9), configuration.translation
    # CasADi is column-major.
    turns = np.swapaxes(configuration.rotation, -1, -2).reshape(3 * count, 3)
    closure, leg_jacobian, _ = _functions(machine)
    _, position_b = closure.map(count)(places[0].T, turns.T, places[1].T)
    results = position_b, *leg_jacobian.map(count)(places[0].T, turns.T, places[1].T)
    parts = (np.moveaxis(np.asarray(x).reshape(x.shape[0], count, -1), 1, 0) for x in results)
    position_b, closure_b, closure_x, readings_b, readings_x = parts
    per_angle = np.repeat([1.0, 1.0 / machine.ball_side], 3)[freedoms(machine)]
    slopes = machine.legs.largest_slopes[:, None]
    return [position_b, closure_b, closure_x * per_angle, readings_b * slopes, readings_x * per_angle * slopes]


@lru_cache(maxsize=4)
def _functions(machine: Machine) -> tuple[Any, Any, float]:
    """Return `nlp.closure`, `nlp.leg_jacobian` and the curvature of a machine."""
    from spm_pin.crosscheck import nlp
    from spm_pin.crosscheck.nlp.loop_equations import curvature

    return nlp.closure(machine), nlp.leg_jacobian(machine), curvature(machine)
