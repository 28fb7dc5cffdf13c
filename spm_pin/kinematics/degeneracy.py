"""Continuous families of solutions: which families, their dimension, and the legs with coinciding planes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Degeneracy, Status


def find_degeneracy(
    geometry: Geometry,
    shape: tuple[int, ...],
    rotation: FloatArray,
    position: FloatArray,
    flagged: npt.NDArray[np.uint8],
    status: npt.NDArray[np.int8],
) -> Degeneracy:
    """Describe the continuous families of a batch of this shape, N poses (N, 3, 3), (N, 3); set their `status` (N,).

    Only poses that a kernel has `flagged` (N,) can have any, see `kernels.branch_kernels`.
    """
    n = len(flagged)
    dimension, families, legs = np.zeros(n, np.int8), np.zeros((n, 4), np.bool_), np.zeros((n, 3), np.bool_)
    at = np.flatnonzero(flagged)
    if len(at):
        dimension[at], families[at], legs[at] = _describe(geometry, flagged[at], rotation[at], position[at])
        status[dimension > 0] = Status.DEGENERATE
    return Degeneracy(dimension.reshape(shape), families.reshape(*shape, 4), legs.reshape(*shape, 3))


def _describe(
    geometry: Geometry, flagged: npt.NDArray[np.uint8], rotation: FloatArray, position: FloatArray
) -> tuple[npt.NDArray[np.int8], BoolArray, BoolArray]:
    """Return the dimension (N,), families (N, 4) and legs (N, 3) of `Degeneracy` of flagged poses.

    Where the two Z axes meet or cross, a family is continuous iff its form vanishes: (P : Q) is then free and
    the family has one dimension. Where they are parallel, see `kernels.branch_kernels.continuous_families`.
    """
    from spm_pin.kinematics.kernels.branch_kernels import VERTICAL
    from spm_pin.kinematics.kernels.branch_kernels import continuous_families
    from spm_pin.kinematics.formulas.branches import ROUNDING

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
    return dimension, families, legs & (dimension > 0)[:, None]
