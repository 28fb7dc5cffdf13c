"""Continuous families of solutions: which families, their dimension, and the legs with coinciding planes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Degeneracy

__all__ = ["find_degeneracy"]


def find_degeneracy(
    geometry: Geometry, flagged: npt.NDArray[np.uint8], rotation: FloatArray, position: FloatArray
) -> Degeneracy:
    """Describe the continuous families of N poses that a kernel has flagged, see `kernels.branch_tiles`.

    Where the two Z axes meet or cross, a family is continuous iff its form vanishes: (P : Q) is then free and
    the family has one dimension. Where they are parallel, see `kernels.degeneracy_kernel`.
    """
    from spm_pin.closed_form.kernels.branch_tiles import VERTICAL
    from spm_pin.closed_form.kernels.degeneracy_kernel import continuous_families
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
        flat = np.empty((np.count_nonzero(at), 4), np.uint8)
        sizes = np.empty(len(flat), np.int8)
        continuous_families(rotation[at], position[at], geometry.middle_radius, flat, sizes)
        families[at], dimension[at] = flat > 0, sizes
    return Degeneracy(dimension, families, legs & (dimension > 0)[:, None])
