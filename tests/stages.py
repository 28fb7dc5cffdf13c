"""All assembly modes of 3RPS stages alone, without those of the manipulator that they are part of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.formulas.stages import corners, stage_equations
from spm_pin.kinematics.batches import run_kernel
from spm_pin.kinematics.kernels.compilation import kernel, readonly_array
from spm_pin.kinematics.kernels.mode_kernels import PLACES, SAME, allocate_scratch, has_continuous_family, solve_mode
from spm_pin.mechanism.arguments import BoolArray, FloatArray

__all__ = ["MODES", "StageModes", "placement", "solve_stage"]


MODES = ("T", "F")
"""The two families of solutions of a stage."""


@dataclass(frozen=True)
class StageModes:
    """Assembly modes of N stages in units of r: four places for each mode, T before F.

    A place holds a solution above the hips; its mirror image below them is another one.

    Attributes
    ----------
    quaternion : ndarray, shape (N, modes, 4, 4)
        Rotation of the triangle, scalar last; NaN in a place without a real solution.
    centre : ndarray, shape (N, modes, 4, 3)
        Position of its centre.
    radii, heights : ndarray, shape (N, modes, 4, 3)
        Of its corners in the vertical planes of the legs.
    flat : ndarray of bool, shape (N, modes, 4)
        The solution lies in the plane of the hips, and is its own mirror image.
    continuous : ndarray of bool, shape (N, modes)
        There is a continuous family of solutions besides.
    """

    quaternion: FloatArray
    centre: FloatArray
    radii: FloatArray
    heights: FloatArray
    flat: BoolArray
    continuous: BoolArray

    @property
    def exists(self) -> BoolArray:
        """Which places hold a solution, shape (N, modes, 4)."""
        return ~np.isnan(self.quaternion[..., 0])


def solve_stage(lengths: FloatArray, epsilon: float | FloatArray, modes: tuple[str, ...] = MODES) -> StageModes:
    """Find all assembly modes of 3RPS stages.

    Parameters
    ----------
    lengths : ndarray, shape (N, 3)
        Leg lengths in units of r, positive.
    epsilon : float or ndarray, shape (N,)
        Radius of the hips in units of r.
    modes : tuple of str
        Which of the modes T and F to solve.

    Returns
    -------
    StageModes
        Per mode by falling mean radius of the corners; where nine digits of it agree, by the azimuth of the tilt axis.
    """
    m, places = len(modes), (len(modes), PLACES)
    results = ((*places, 4), np.float64), (places, np.float64), (places, np.bool_), ((m,), np.bool_)
    hips = np.broadcast_to(np.asarray(epsilon, dtype=np.float64), len(lengths))
    half_turned = np.array([mode == "F" for mode in modes])

    def solve(lengths: FloatArray, hips: FloatArray, *written: npt.NDArray[Any]) -> None:
        stage_modes(lengths, hips, half_turned, *written)

    quaternion, height, flat, continuous = run_kernel(solve, (lengths, hips), (), results, 1 << 9)
    return StageModes(quaternion, *placement(quaternion, height), flat, continuous)


def placement(quaternion: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place the triangle in its stage.

    Parameters
    ----------
    quaternion : ndarray, shape (..., 4)
        Its rotation, scalar last, in mode T or F.
    height : ndarray, shape (...)
        Of its centre, in units of r.

    Returns
    -------
    centre, radii, heights : ndarrays, shape (..., 3)
        Position of the centre, and of the corners in the vertical planes of the legs, in units of r.
    """
    x1, x2, x3, x0 = np.moveaxis(quaternion, -1, 0)
    radii, heights = corners(x0, x1, x2, x3, height)
    centre = np.stack([-2.0 * x1 * x2, x2 * x2 - x1 * x1, height], axis=-1)
    return centre, np.stack(radii, axis=-1), np.stack(heights, axis=-1)


@kernel(f"void({readonly_array(2)}, {readonly_array(1)}, b1[::1], f8[:,:,:,::1], f8[:,:,::1], b1[:,:,::1], b1[:,::1])")
def stage_modes(
    lengths: FloatArray,
    epsilon: FloatArray,
    half_turned: BoolArray,
    quaternion: FloatArray,
    height: FloatArray,
    flat: BoolArray,
    continuous: BoolArray,
) -> None:
    """Solve N stages in some modes; see `StageModes` for what is written."""
    scratch = allocate_scratch()
    kept = scratch.kept
    for n in range(len(lengths)):
        for m in range(len(half_turned)):
            e, turned = epsilon[n], half_turned[m]
            stage = stage_equations(lengths[n, 0], lengths[n, 1], lengths[n, 2], -e if turned else e)
            continuous[n, m] = has_continuous_family(lengths[n, 0], lengths[n, 1], lengths[n, 2], e, turned)
            count = solve_mode(stage, turned, continuous[n, m], scratch)
            for k in range(PLACES):
                there = k < count
                for i in range(4):
                    quaternion[n, m, k, i] = kept[k, (i + 1) % 4] if there else np.nan
                height[n, m, k] = kept[k, 4] if there else np.nan
                highest = max(abs(kept[k, 8]), abs(kept[k, 9]), abs(kept[k, 10]))
                flat[n, m, k] = there and highest <= SAME
