"""Tolerances from conditioning and rounding: how far two correct answers may differ.

A method states the closure residual δ its arithmetic may leave. The error this causes in an answer depends on the
configuration, not on the method. The nine loop equations F(b) are quadratic, with |Q(h)| <= q |h|², q = 3/(2d), and
their Jacobian F_b has the smallest singular value s; then

- a point with |F| <= δ has a true branch within e = 2δ/(s + √(s² - 4qδ)), if s² > 4qδ (Kantorovich); otherwise
  two branches cannot be resolved, and they are √(δ/q) away at most;
- J_f = l_x - l_b F_b⁻¹ F_x, so entries wrong by ε = δ/l, l the shortest length in them, make it wrong by
  ε (1 + |l_b|/s)(1 + |F_b⁻¹ F_x|) to first order, each norm over nine rows or columns;
- forces f = -J_f⁻ᵀ w are then wrong by |J_f⁻¹| |ΔJ_f| |f|.

Lengths stand for angles times d, so that norms mean something.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.configuration import Configuration

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
    side: float
    """d [m]."""

    @classmethod
    def of(cls, configuration: Configuration) -> Conditioning:
        """Return the conditioning of states (N,); NaN for a member that does not exist."""
        side = configuration.geometry.middle_side
        exists = configuration.exists[:, None, None]
        closure_b, closure_x, lengths_b, lengths_x = (
            np.where(exists, part, np.eye(*part.shape[-2:])) for part in _derivatives(configuration)
        )
        values = np.linalg.svd(closure_b, compute_uv=False)[..., -1]
        # Where the equations are singular to rounding, nothing bounds J_f.
        singular = values <= _SINGULAR
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            regular = np.where(singular[:, None, None], np.eye(9), closure_b)
            motion = np.linalg.solve(regular, closure_x)
            rates = lengths_x - lengths_b @ motion
            shortest = np.minimum(configuration.leg_lengths.min(axis=-1), side)
            legs = np.linalg.norm(lengths_b, axis=(-1, -2)) / values
            spread = ROWS * (1.0 + legs) * (1.0 + np.linalg.norm(motion, axis=(-1, -2))) / shortest
            spread = np.where(singular, np.inf, spread)
            inverse = 1.0 / np.linalg.svd(rates, compute_uv=False)[..., -1]
        absent = ~configuration.exists
        sigma, jacobian, norm = (np.where(absent, np.nan, array) for array in (values, spread, inverse))
        return cls(sigma, jacobian, norm, side)

    def resolves(self, rounding: FloatArray) -> BoolArray:
        """Return whether branches are isolated despite a closure residual [m] (N,)."""
        return np.asarray(self.sigma**2 > 6.0 / self.side * ROWS * rounding)

    def position(self, rounding: FloatArray) -> FloatArray:
        """Return the error of the b_i [m], (N,), for a closure residual [m] (N,)."""
        delta, q = ROWS * rounding, 1.5 / self.side
        margin = self.sigma**2 - 4.0 * q * delta
        isolated = 2.0 * delta / (self.sigma + np.sqrt(np.maximum(margin, 0.0)))
        return np.where(margin > 0.0, isolated, np.sqrt(delta / q))

    def rates(self, rounding: FloatArray) -> FloatArray:
        """Return the error of J_f in norm, angles times d, (N,), for a closure residual [m] (N,)."""
        return np.asarray(self.jacobian * rounding)

    def forces(self, rounding: FloatArray) -> FloatArray:
        """Return the error of forces relative to their norm, (N,), for a closure residual [m] (N,)."""
        return np.asarray(self.inverse * self.rates(rounding))


def _derivatives(configuration: Configuration) -> tuple[FloatArray, ...]:
    """Return F_b (N, 9, 9), F_x (N, 9, 6), l_b (N, 6, 9) and l_x (N, 6, 6), angles times d."""
    b, count, side = configuration.middle_joints, len(configuration), configuration.geometry.middle_side
    axes, platform_axes = configuration.geometry.revolute_axes, configuration.platform_axes
    arms = configuration.platform_joints - configuration.translation[:, None, :]
    directions = configuration.leg_vectors / configuration.leg_lengths[..., None]
    i, following = np.array([0, 1, 2]), np.array([1, 2, 0])
    between = (b - b[:, following]) / side
    # For each kind of equation the three legs, and in the derivatives by b the three b_i.
    closure_b, closure_x = np.zeros((count, 3, 3, 3, 3)), np.zeros((count, 3, 3, 6))
    lengths_b, lengths_x = np.zeros((count, 2, 3, 3, 3)), np.zeros((count, 2, 3, 6))
    closure_b[:, 0, i, i], closure_b[:, 1, i, i] = axes, platform_axes
    closure_b[:, 2, i, i], closure_b[:, 2, i, following] = between, -between
    # n·(b - c) with n and c fixed to m changes by n x (b - o) · ω - n·v.
    closure_x[:, 1, :, :3] = -platform_axes
    closure_x[:, 1, :, 3:] = np.cross(platform_axes, b - configuration.translation[:, None, :]) / side
    lengths_b[:, 0, i, i], lengths_b[:, 1, i, i] = directions[:, :3], -directions[:, 3:]
    lengths_x[:, 1, :, :3] = directions[:, 3:]
    lengths_x[:, 1, :, 3:] = np.cross(arms, directions[:, 3:]) / side
    shapes = (9, 9), (9, 6), (6, 9), (6, 6)
    parts = (closure_b, closure_x, lengths_b, lengths_x)
    return tuple(part.reshape(count, *shape) for part, shape in zip(parts, shapes, strict=True))
