"""States of one 3RPS stage between limits of its leg lengths: lengths and determinant over boxes of states.

A state in mode T is the vector part (x, y) of the middle platform's quaternion (x0, x, y, 0), x0 = √(1 - x² - y²), and
the height Z of its centre. With r = d/√3, corner k has the radius ρ_k and the height z_k,

    ρ_1, ρ_3 = r (1 - 2y² ∓ 2√3 xy),   z_1, z_3 = Z - r x0 (x ± √3 y),
    ρ_2 = r (1 - 3x² + y²),             z_2 = Z + 2 r x0 x,

leg k the length √((ρ_k - ρ)² + z_k²), where ρ is the radius of the hips, and the stage is forward singular where

    D = m12 m23 m31 + m21 m32 m13 = 0,   m_ij = z_i (ρ + ρ_j / 2) + z_j (ρ_i - ρ).

Derivation: `docs/theory/proofs.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.closed_form.intervals import SQRT_3, Interval
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["StageRegion"]


@dataclass(frozen=True)
class StageRegion:
    """The states of a stage that are searched.

    Parameters
    ----------
    hips, side : Interval
        Radius of the hips and side of the middle platform's triangle [m].
    minimum, maximum : ndarray, shape (3,)
        Limits of the leg lengths [m].
    """

    hips: Interval
    side: Interval
    minimum: FloatArray
    maximum: FloatArray

    @property
    def height(self) -> float:
        """Bound of |Z| [m]: the mean of the z_k is Z, and none exceeds its leg."""
        return float(np.nextafter(self.maximum.max(), np.inf))

    def corners(self, x: Interval, y: Interval, z: Interval) -> tuple[list[Interval], list[Interval]]:
        """Return radii and heights of the triangle's corners [m]."""
        r = self.side * SQRT_3.reciprocal()
        x_2, y_2 = x.square(), y.square()
        mixed = 2.0 * SQRT_3 * (x * y)
        radii = [r * (1.0 - 2.0 * y_2 - mixed), r * (1.0 - 3.0 * x_2 + y_2), r * (1.0 - 2.0 * y_2 + mixed)]
        lever = r * (1.0 - (x_2 + y_2)).root()
        cross = SQRT_3 * y
        return radii, [z - lever * (x + cross), z + 2.0 * (lever * x), z - lever * (x - cross)]

    def evaluate(self, x: Interval, y: Interval, z: Interval) -> tuple[list[Interval], Interval]:
        """Return the squared leg lengths [m²] and D [m⁶]."""
        radii, heights = self.corners(x, y, z)
        slopes = [radius - self.hips for radius in radii]
        squares = [s.square() + h.square() for s, h in zip(slopes, heights, strict=True)]

        def m(i: int, j: int) -> Interval:
            return heights[i] * (self.hips + 0.5 * radii[j]) + heights[j] * slopes[i]

        return squares, m(0, 1) * m(1, 2) * m(2, 0) + m(1, 0) * m(2, 1) * m(0, 2)
