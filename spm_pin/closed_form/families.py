"""The four quadratics of a pose: what the families TT, TF, FT, FF have in common, and where they differ.

Notation and derivation: `spm_pin.closed_form.inverse` and `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry

__all__ = ["LOWER", "ROOT", "ROUNDING", "UPPER", "FamilyForms"]

ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]

# Families TT, TF, FT, FF along one axis: e = +1 for mode T, -1 for mode F, of the lower and the upper stage;
# the turn S'/S; and the root, in this order, of the branches + and - (by the sign of det K, see branches.py).
LOWER = np.array([1.0, 1.0, -1.0, -1.0])
UPPER = np.array([1.0, -1.0, 1.0, -1.0])
_TURN = np.array([1.0, 1.0j, -1.0j, 1.0])
ROOT = np.array([[1.0, -1.0], [-1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]])

ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Rounding of a pose relative to its size: what is smaller is taken for zero when a family is degenerate."""


@dataclass(frozen=True)
class FamilyForms:
    """What the N poses say about the four families, arrays of shape (N,) or, per family, (N, 4)."""

    vertical: BoolArray  # the two Z axes are parallel: no common normal
    cosine: FloatArray  # c, s: half the tilt of the platform
    sine: FloatArray
    normal: ComplexArray  # the common normal n of the two Z axes, seen from {B}
    normal_m: ComplexArray  # Rᵀn, seen from {m}
    distance: FloatArray  # h
    tilt_axis: ComplexArray  # W/|W|, (N, 4)
    f: ComplexArray  # u's and v's share in the quaternions of a and b, (N, 4)
    g: ComplexArray
    scale_u: FloatArray  # (P - Q)/u and (P + Q)/v, divided by 2 sin, (N, 4)
    scale_v: FloatArray
    form_uu: FloatArray  # the quadratic form, h subtracted, (N, 4) [m]
    form_uv: FloatArray
    form_vv: FloatArray

    @property
    def discriminant(self) -> FloatArray:
        """Discriminants of the four forms [m²]."""
        return self.form_uv**2 - self.form_uu * self.form_vv

    @classmethod
    def of(cls, geometry: Geometry, quaternion: FloatArray, position: FloatArray) -> FamilyForms:
        """Set up the four forms for quaternions (N, 4), scalar last, and positions (N, 3) [m]."""
        x1, x2, x3, x0 = quaternion.T
        torsion, tilt = x0 + 1j * x3, x1 + 1j * x2
        cosine, sine = np.abs(torsion), np.abs(tilt)
        vertical = cosine * sine <= ROUNDING
        with np.errstate(invalid="ignore", divide="ignore"):
            # The sign of the quaternion is free. Per family the one with κ >= 0 is taken: κ does not change
            # sign on any path along which the family stays real, so labels do not either.
            turned = torsion[:, None] * _TURN
            lift = np.where(turned.real < 0.0, -1.0, 1.0)
            turned = turned * lift
            kappa, mu = turned.real, turned.imag
            axis = (tilt / sine)[:, None] * lift
            twist = (torsion / cosine)[:, None] * lift
            # 1 - κ without cancellation, from |S'|² + |W|² = 1.
            one_minus = ((sine**2)[:, None] + mu**2) / (1.0 + kappa)
            scale_u, scale_v = np.sqrt(0.5 / (1.0 + kappa)), np.sqrt(0.5 / one_minus)
            f, g = (1.0 + turned) * scale_u, (one_minus - 1j * mu) * scale_v
            normal = (torsion / cosine) * (tilt / sine)
            normal_m = np.conj(torsion / cosine) * (tilt / sine)
            distance = normal.real * position[:, 0] + normal.imag * position[:, 1]
            cubed = axis * axis * axis
            even = UPPER * cubed + LOWER * np.conj(cubed)
            odd = LOWER * np.conj(cubed) - UPPER * cubed
            r = geometry.middle_radius
            side = 1j * r * twist
            return cls(
                vertical=vertical,
                cosine=cosine,
                sine=sine,
                normal=normal,
                normal_m=normal_m,
                distance=distance,
                tilt_axis=axis,
                f=f,
                g=g,
                scale_u=scale_u,
                scale_v=scale_v,
                form_uu=(side * even * f * f).real - distance[:, None],
                form_uv=(side * odd * f * g).real,
                form_vv=(side * even * g * g).real - distance[:, None],
            )
