"""Continuous families of solutions: which families, their dimension, and the legs with coinciding planes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Degeneracy

__all__ = ["find_degeneracy"]

BoolArray = npt.NDArray[np.bool_]

# e of the families TT, TF, FT, FF in the lower and in the upper stage.
LOWER = np.array([1.0, 1.0, -1.0, -1.0])
UPPER = np.array([1.0, -1.0, 1.0, -1.0])


def find_degeneracy(
    geometry: Geometry, flagged: npt.NDArray[np.uint8], rotation: FloatArray, position: FloatArray
) -> Degeneracy:
    """Describe the continuous families of N poses that a kernel has flagged, see `kernels.branch_tiles`.

    Where the two Z axes meet or cross, a family is continuous iff its form vanishes: (P : Q) is then free and
    the family has one dimension. Where they are parallel, see `_parallel_axes`.
    """
    from spm_pin.closed_form.kernels.branch_tiles import VERTICAL
    from spm_pin.closed_form.kernels.quadratics import ROUNDING

    families = (flagged[:, None] & np.array([1, 2, 4, 8])) > 0
    dimension = families.any(axis=-1).astype(np.int8)
    axes = geometry.revolute_axes
    platform_axes = axes @ np.swapaxes(rotation, -1, -2)
    parallel = np.linalg.norm(np.cross(axes, platform_axes), axis=-1) <= ROUNDING
    aside = np.hypot(position[:, 0], position[:, 1])
    legs = parallel & (np.abs(position @ axes.T) <= ROUNDING * (geometry.middle_radius + aside)[:, None])
    at = (flagged & VERTICAL) > 0
    if at.any():
        families[at], dimension[at] = _parallel_axes(geometry, rotation[at], position[at], ROUNDING)
    return Degeneracy(dimension, families, legs & (dimension > 0)[:, None])


def _parallel_axes(
    geometry: Geometry, rotation: FloatArray, position: FloatArray, rounding: float
) -> tuple[BoolArray, npt.NDArray[np.int8]]:
    """Return families (n, 4) and dimension (n,) where the Z axes of {B} and {m} are parallel.

    All legs' planes are vertical, so a solution can move along Z: there are none, or a continuous family.

    - Platform level, turned by 0 or a half turn: planes in pairs parallel. On the axis they coincide and the
      middle platform moves with three degrees of freedom, in equal or in opposite modes; off it, nothing.
    - Platform level, turned by another angle τ: lines vertical. The middle platform stands upside down in both
      stages, which takes |o| = 2 r |sin τ| in the horizontal.
    - Platform upside down, turned over about the horizontal axis W: y = i o / r must be on the segment from
      e_p W⁴ to e_q conj(W²); where that shrinks to a point, (P : Q) is free as well.
    """
    r = geometry.middle_radius
    aside = position[:, 0] + 1j * position[:, 1]
    tolerance = rounding * (1.0 + np.abs(aside) / r)
    level = rotation[:, 2, 2] > 0.0
    cos_turn, sin_turn = rotation[:, 0, 0], rotation[:, 1, 0]
    straight = level & (np.abs(sin_turn) <= tolerance)
    centred = np.abs(aside) <= tolerance * r
    equal_modes, mixed_modes = LOWER == UPPER, LOWER != UPPER
    modes = np.where((cos_turn > 0.0)[:, None], equal_modes, mixed_modes)
    free = (straight & centred)[:, None] & modes
    upside_down = level & ~straight & (np.abs(np.abs(aside) / r - 2.0 * np.abs(sin_turn)) <= tolerance)

    # R is diag(W², -1) on complex conjugates: R maps 1 to W², and W is defined up to a sign that does not matter.
    axis = np.sqrt(cos_turn + 1j * sin_turn)
    cubed = axis**3
    y = 1j * aside / r * np.conj(axis)
    tolerance = tolerance[:, None]
    fixed = np.where(equal_modes, LOWER * cubed.real[:, None], LOWER * cubed.imag[:, None])
    reach = np.where(equal_modes, np.abs(cubed.imag)[:, None], np.abs(cubed.real)[:, None])
    across = np.where(equal_modes, y.real[:, None], y.imag[:, None])
    along = np.where(equal_modes, y.imag[:, None], y.real[:, None])
    turned_over = ~level[:, None] & (np.abs(across - fixed) <= tolerance) & (np.abs(along) <= reach + tolerance)

    families = free | upside_down[:, None] | turned_over
    plane = (turned_over & (reach <= tolerance)).any(axis=-1)
    dimension = np.select([free.any(axis=-1), plane, families.any(axis=-1)], [3, 2, 1], 0)
    return families, dimension.astype(np.int8)
