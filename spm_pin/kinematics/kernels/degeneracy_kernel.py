"""Continuous families of a batch of poses whose two Z axes are parallel.

All legs' planes are vertical then, so a solution can move along Z: there are none, or a continuous family.

- Platform level, turned by 0 or a half turn: planes in pairs parallel. On the axis they coincide and the middle
  platform moves with three degrees of freedom, in equal or in opposite modes; off it, nothing.
- Platform level, turned by another angle τ: lines vertical. The middle platform stands upside down in both stages,
  which takes |o| = 2 r |sin τ| in the horizontal.
- Platform upside down, turned over about the horizontal axis W: y = i o / r must be on the segment from e_p W⁴ to
  e_q conj(W²); where that shrinks to a point, (P : Q) is free as well.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.quadratics import FAMILY_GROUP, FAMILY_LOWER, ROUNDING, complex_product
from spm_pin.mechanism.arguments import FloatArray


@jit_inline
def _half_angle(cosine: float, sine: float) -> tuple[float, float]:
    """Return cosine and sine of half an angle within a half turn."""
    if cosine >= 0.0:
        half = math.sqrt(0.5 * (1.0 + cosine))
        return half, 0.5 * sine / half
    half = math.sqrt(0.5 * (1.0 - cosine))
    return 0.5 * abs(sine) / half, -half if sine < 0.0 else half


@jit_inline
def _is_continuous_upside_down(
    family: int, cosine: float, sine: float, x: float, y: float, tolerance: float
) -> tuple[bool, bool]:
    """Return whether a family is continuous with the platform turned over, and whether it has two dimensions.

    R maps 1 to W², of this cosine and sine; W is defined up to a sign that does not matter. x + iy is o / r.
    """
    axis, axis_i = _half_angle(cosine, sine)
    square, square_i = complex_product(axis, axis_i, axis, axis_i)
    cubed, cubed_i = complex_product(square, square_i, axis, axis_i)
    turned, turned_i = complex_product(-y, x, axis, -axis_i)
    mixed = FAMILY_GROUP[family] == 1
    fixed = FAMILY_LOWER[family] * (cubed_i if mixed else cubed)
    extent = abs(cubed if mixed else cubed_i)
    across, along = (turned_i if mixed else turned), (turned if mixed else turned_i)
    found = (abs(across - fixed) <= tolerance) & (abs(along) <= extent + tolerance)
    return found, found & (extent <= tolerance)


@kernel(f"void({readonly_array(3)}, {readonly_array(2)}, f8, u1[:,::1], i1[::1])")
def continuous_families(
    rotation: FloatArray,
    position: FloatArray,
    r: float,
    families: npt.NDArray[np.uint8],
    dimension: npt.NDArray[np.int8],
) -> None:
    """Write which of TT, TF, FT, FF (N, 4) are continuous at poses with parallel Z axes, and their dimension (N,)."""
    for n in range(len(dimension)):
        x, y = position[n, 0] / r, position[n, 1] / r
        cosine, sine = rotation[n, 0, 0], rotation[n, 1, 0]
        aside = math.hypot(x, y)
        tolerance = ROUNDING * (1.0 + aside)
        level = rotation[n, 2, 2] > 0.0
        straight = level & (abs(sine) <= tolerance)
        dimension[n] = 0
        for family in range(4):
            mixed, size = FAMILY_GROUP[family] == 1, 0
            if straight:
                size = 3 if (aside <= tolerance) & (mixed == (cosine <= 0.0)) else 0
            elif level:
                size = 1 if abs(aside - 2.0 * abs(sine)) <= tolerance else 0
            else:
                found, plane = _is_continuous_upside_down(family, cosine, sine, x, y, tolerance)
                size = (2 if plane else 1) if found else 0
            families[n, family] = 1 if size > 0 else 0
            dimension[n] = max(dimension[n], size)
