"""Forward displacement of a batch of leg lengths: all assembly modes, and the one in the home's aspect."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.formulas.stages import compose, stage_equations
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.stage_modes import (
    PLACES,
    SAME,
    Scratch,
    allocate_scratch,
    has_continuous_family,
    home_state,
    solve_mode,
)
from spm_pin.mechanism.arguments import FloatArray

Stage = tuple[float, float, float, float, float]
STAGE = 4 * PLACES
"""Assembly modes of a stage: two modes, four places, two sheets."""


@jit
def _put_composed(
    lower: Stage, upper: Stage, r: float, rotation: FloatArray, translation: FloatArray, joints: FloatArray
) -> None:
    """Write R (3, 3), o [m] and the b_i (3, 3) [m] of two stages joined at their middle platform, NaN if one is."""
    if math.isnan(lower[0]) or math.isnan(upper[0]):
        for i in range(3):
            translation[i] = np.nan
            for j in range(3):
                rotation[i, j], joints[i, j] = np.nan, np.nan
        return
    composed = compose(lower, upper)
    for i in range(3):
        translation[i] = r * composed.position[i]
        for j in range(3):
            rotation[i, j], joints[i, j] = composed.rotation[i][j], r * composed.b[i][j]


@jit
def _sheets(
    first: float, second: float, third: float, epsilon: float, above: float, scratch: Scratch, modes: FloatArray
) -> tuple[bool, bool]:
    """Write the sixteen assembly modes of a stage (16, 5), NaN where there is none; tell which of T, F is continuous.

    The sheet + is above the hips, or below, by the sign of `above`; the other is mirrored at their plane, where a
    rotation keeps its part about the normal.
    """
    kept = scratch.kept
    for k in range(STAGE):
        modes[k, 0] = np.nan
    straight = has_continuous_family(first, second, third, epsilon, False)
    half_turned = has_continuous_family(first, second, third, epsilon, True)
    for m in range(2):
        stage = stage_equations(first, second, third, epsilon if m == 0 else -epsilon)
        for k in range(solve_mode(stage, m == 1, straight if m == 0 else half_turned, scratch)):
            flat = max(abs(kept[k, 8]), abs(kept[k, 9]), abs(kept[k, 10])) <= SAME
            for sheet in range(1 if flat else 2):
                sign = above if sheet == 0 else -above
                row = modes[(m * PLACES + k) * 2 + sheet]
                row[0], row[1], row[2] = kept[k, 0], sign * kept[k, 1], sign * kept[k, 2]
                row[3], row[4] = kept[k, 3], sign * kept[k, 4]
    return straight, half_turned


@jit_inline
def _stage(stages: FloatArray, n: int) -> tuple[float, float, float, float, float]:
    """Return quaternion and height of one of several stages (…, 5)."""
    return stages[n, 0], stages[n, 1], stages[n, 2], stages[n, 3], stages[n, 4]


@jit_inline
def _is_there(modes: FloatArray, first: int) -> bool:
    """Return whether a stage has a mode T, counted from 0, or F, from 8; its first place is filled first."""
    return not math.isnan(modes[first, 0])


@kernel(
    f"void({readonly_array(2)}, f8, f8, f8, f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,::1], i1[:,::1], i1[::1])",
)
def all_modes(
    lengths: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    rotation: FloatArray,
    translation: FloatArray,
    joints: FloatArray,
    dimension: npt.NDArray[np.int8],
    status: npt.NDArray[np.int8],
) -> None:
    """Solve N sets of leg lengths (N, 6) [m].

    Parameters
    ----------
    lengths : ndarray, shape (N, 6)
        Leg lengths [m].
    r, base_radius, platform_radius : float
        Circumradii of the middle, base and terminal platforms [m].
    rotation, translation, joints : ndarray, shapes (N, 256, 3, 3), (N, 256, 3), (N, 256, 3, 3), written
        R, o [m], b_i [m]; NaN where a mode is not real.
    dimension : ndarray of int8, shape (N, 4), written
        Of the continuous families in TT, TF, FT, FF.
    status : ndarray of int8, shape (N,), written
        0 or 1, the first two of `Status`, continuous families not counted.
    """
    scratch = allocate_scratch()
    below, above = np.empty((STAGE, 5)), np.empty((STAGE, 5))
    for n in range(len(lengths)):
        q = lengths[n]
        lower = _sheets(q[0] / r, q[1] / r, q[2] / r, base_radius / r, 1.0, scratch, below)
        upper = _sheets(q[3] / r, q[4] / r, q[5] / r, platform_radius / r, -1.0, scratch, above)
        status[n] = 1
        for i in range(STAGE):
            for j in range(STAGE):
                mode = i * STAGE + j
                _put_composed(
                    _stage(below, i), _stage(above, j), r, rotation[n, mode], translation[n, mode], joints[n, mode]
                )
                if not math.isnan(rotation[n, mode, 0, 0]):
                    status[n] = 0
        for i in range(2):
            for j in range(2):
                free = (1 if lower[i] else 0) + (1 if upper[j] else 0)
                below_exists, above_exists = lower[i] or _is_there(below, 8 * i), upper[j] or _is_there(above, 8 * j)
                dimension[n, 2 * i + j] = free if below_exists and above_exists else 0


@kernel(f"void({readonly_array(2)}, f8, f8, f8, f8[:,:,::1], f8[:,::1], f8[:,:,::1])")
def home_modes(
    lengths: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    rotation: FloatArray,
    translation: FloatArray,
    joints: FloatArray,
) -> None:
    """Write R, o and the b_i in the home's aspect; NaN proves that there is none. Arguments as for `all_modes`."""
    scratch = allocate_scratch()
    for n in range(len(lengths)):
        q = lengths[n]
        lower = home_state(q[0] / r, q[1] / r, q[2] / r, base_radius / r, scratch)
        upper = home_state(q[3] / r, q[4] / r, q[5] / r, platform_radius / r, scratch)
        # The upper stage hangs below its hips.
        below = lower[0], lower[1], lower[2], 0.0, lower[3]
        above = upper[0], -upper[1], -upper[2], 0.0, -upper[3]
        _put_composed(below, above, r, rotation[n], translation[n], joints[n])


@kernel(f"void({readonly_array(2)}, {readonly_array(2)}, f8, f8[:,:,::1], f8[:,::1], f8[:,:,::1])")
def compose_all(
    lower: FloatArray, upper: FloatArray, r: float, rotation: FloatArray, translation: FloatArray, joints: FloatArray
) -> None:
    """Compose N pairs of stages (N, 5), NaN where either is."""
    for n in range(len(lower)):
        _put_composed(_stage(lower, n), _stage(upper, n), r, rotation[n], translation[n], joints[n])
