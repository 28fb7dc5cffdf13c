"""All assembly modes of 3RPS stages alone, without those of the manipulator that they are part of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.formulas.stages import stage_equations
from spm_pin.kinematics.kernels.compilation import kernel, readonly_array
from spm_pin.kinematics.kernels.mode_kernels import (
    EXACT,
    PLACES,
    SAME,
    allocate_stage_scratch,
    has_continuous_family,
    solve_mode,
)
from spm_pin.support.arguments import BoolArray, FloatArray

MODES = ("T", "F")
"""The two families of solutions of a stage."""


@dataclass(frozen=True)
class StageModes:
    """Solutions above the pivots in both modes, of N stages in units of r; the mirror image of each is another one.

    `solutions` (N, 2, 4, 11) are quaternion, scalar first, height, radii and heights of the corners; NaN where there is
    none. In `continuous` modes (N, 2) there is a continuous family besides.
    """

    solutions: FloatArray
    continuous: BoolArray

    @property
    def radii(self) -> FloatArray:
        return self.solutions[..., 5:8]

    @property
    def heights(self) -> FloatArray:
        return self.solutions[..., 8:]

    @property
    def exists(self) -> BoolArray:
        return ~np.isnan(self.solutions[..., 0])

    @property
    def flat(self) -> BoolArray:
        """Which solutions are in the plane of the pivots, each its own mirror image."""
        return np.asarray(np.abs(self.heights).max(axis=-1) <= SAME)


def solve_stage(lengths: FloatArray, epsilon: float) -> StageModes:
    """Find all assembly modes of stages, from their leg lengths (N, 3) and the radius of their pivots in units of r.

    Per mode by falling mean radius of the corners; where nine digits of it agree, by the azimuth of the tilt axis.
    """
    modes = StageModes(np.full((len(lengths), 2, PLACES, 11), np.nan), np.empty((len(lengths), 2), dtype=np.bool_))
    _solve(lengths, epsilon, modes.solutions, modes.continuous)
    return modes


@kernel(f"void({readonly_array(2)}, f8, f8[:,:,:,::1], b1[:,::1])")
def _solve(lengths: FloatArray, epsilon: float, solutions: FloatArray, continuous: BoolArray) -> None:
    scratch = allocate_stage_scratch()
    for n in range(len(lengths)):
        first, second, third = lengths[n, 0], lengths[n, 1], lengths[n, 2]
        for m in range(2):
            turned = m == 1
            stage = stage_equations(first, second, third, -epsilon if turned else epsilon)
            continuous[n, m] = has_continuous_family(first, second, third, epsilon, turned, EXACT)
            for k in range(min(solve_mode(stage, turned, continuous[n, m], scratch), PLACES)):
                for i in range(11):
                    solutions[n, m, k, i] = scratch.kept[k, i]
