"""Forward displacement of a batch of leg lengths: all assembly modes, and the one in the home's aspect."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.quadratics import COS_30
from spm_pin.kinematics.kernels.stage_equations import SAME, State, equations, placed
from spm_pin.kinematics.kernels.stage_modes import (
    PLACES,
    Workspace,
    home_mode,
    home_mode_of_all,
    is_continuous,
    solve_mode,
    workspace,
)
from spm_pin.mechanism.arguments import FloatArray

Stage = tuple[float, float, float, float, float]
STAGE = 4 * PLACES
"""Assembly modes of a stage: two modes, four places, two sheets."""


@jit
def compose(
    lower: Stage, upper: Stage, r: float, rotation: FloatArray, translation: FloatArray, joints: FloatArray
) -> None:
    """Join two stages at their middle platform, and write R (3, 3), o [m] and the b_i (3, 3) [m].

    `lower` and `upper` hold x0, x1, x2, x3, ζ of the middle platform: of the lower stage in {B}, of the upper in {m}.
    """
    (a0, a1, a2, a3, zeta), (b0, b1, b2, b3, zeta_m) = lower, upper
    # The middle platform's rotation in {B} times the inverse of that in {m}.
    w, x = a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3, a1 * b0 - a0 * b1 - a2 * b3 + a3 * b2
    y, z = a2 * b0 - a0 * b2 - a3 * b1 + a1 * b3, a3 * b0 - a0 * b3 - a1 * b2 + a2 * b1
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z)
    rotation[0, 2], rotation[1, 0] = 2.0 * (x * z + w * y), 2.0 * (x * y + w * z)
    rotation[1, 1], rotation[1, 2] = 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    # The centre in {B} less the centre in {m}, turned.
    c0, c1, c2 = -2.0 * b1 * b2, b2 * b2 - b1 * b1, zeta_m
    centre = -2.0 * a1 * a2, a2 * a2 - a1 * a1, zeta
    for i in range(3):
        translation[i] = r * (centre[i] - (rotation[i, 0] * c0 + rotation[i, 1] * c1 + rotation[i, 2] * c2))
    radii, heights = placed(a0, a1, a2, a3, zeta)
    joints[0, 0], joints[0, 1], joints[0, 2] = r * radii[0] * COS_30, -0.5 * r * radii[0], r * heights[0]
    joints[1, 0], joints[1, 1], joints[1, 2] = 0.0, r * radii[1], r * heights[1]
    joints[2, 0], joints[2, 1], joints[2, 2] = -r * radii[2] * COS_30, -0.5 * r * radii[2], r * heights[2]


@jit
def _sheets(
    first: float, second: float, third: float, epsilon: float, above: float, work: Workspace, modes: FloatArray
) -> tuple[bool, bool]:
    """Write the sixteen assembly modes of a stage (16, 5), NaN where there is none; tell which of T, F is continuous.

    The sheet + is above the hips, or below, by the sign of `above`; the other is mirrored at their plane, where a
    rotation keeps its part about the normal.
    """
    kept = work[3]
    for k in range(STAGE):
        modes[k, 0] = np.nan
    straight = is_continuous(first, second, third, epsilon, False)
    half_turned = is_continuous(first, second, third, epsilon, True)
    for m in range(2):
        stage = equations(first, second, third, epsilon if m == 0 else -epsilon)
        for k in range(solve_mode(stage, m == 1, straight if m == 0 else half_turned, work)):
            flat = max(abs(kept[k, 8]), abs(kept[k, 9]), abs(kept[k, 10])) <= SAME
            for sheet in range(1 if flat else 2):
                sign = above if sheet == 0 else -above
                row = modes[(m * PLACES + k) * 2 + sheet]
                row[0], row[1], row[2] = kept[k, 0], sign * kept[k, 1], sign * kept[k, 2]
                row[3], row[4] = kept[k, 3], sign * kept[k, 4]
    return straight, half_turned


@jit_inline
def _put_nan(rotation: FloatArray, translation: FloatArray, joints: FloatArray) -> None:
    for i in range(3):
        translation[i] = np.nan
        for j in range(3):
            rotation[i, j], joints[i, j] = np.nan, np.nan


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
    work = workspace()
    below, above = np.empty((STAGE, 5)), np.empty((STAGE, 5))
    for n in range(len(lengths)):
        q = lengths[n]
        lower = _sheets(q[0] / r, q[1] / r, q[2] / r, base_radius / r, 1.0, work, below)
        upper = _sheets(q[3] / r, q[4] / r, q[5] / r, platform_radius / r, -1.0, work, above)
        status[n] = 1
        for i in range(STAGE):
            for j in range(STAGE):
                at = i * STAGE + j
                if math.isnan(below[i, 0]) or math.isnan(above[j, 0]):
                    _put_nan(rotation[n, at], translation[n, at], joints[n, at])
                else:
                    compose(_stage(below, i), _stage(above, j), r, rotation[n, at], translation[n, at], joints[n, at])
                    status[n] = 0
        for i in range(2):
            for j in range(2):
                free = (1 if lower[i] else 0) + (1 if upper[j] else 0)
                below_exists, above_exists = lower[i] or _is_there(below, 8 * i), upper[j] or _is_there(above, 8 * j)
                dimension[n, 2 * i + j] = free if below_exists and above_exists else 0


@jit_inline
def _put_home(
    lower: State, upper: State, r: float, n: int, rotation: FloatArray, translation: FloatArray, joints: FloatArray
) -> None:
    """Write the configuration of two solutions of mode T above their hips, NaN where one of them is."""
    if math.isnan(lower[0]) or math.isnan(upper[0]):
        _put_nan(rotation[n], translation[n], joints[n])
        return
    # The upper stage hangs below its hips.
    below = lower[0], lower[1], lower[2], 0.0, lower[3]
    compose(below, (upper[0], -upper[1], -upper[2], 0.0, -upper[3]), r, rotation[n], translation[n], joints[n])


@kernel(f"void({readonly_array(2)}, f8, f8, f8, f8[:,:,::1], f8[:,::1], f8[:,:,::1], b1[::1])")
def home_modes(
    lengths: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    rotation: FloatArray,
    translation: FloatArray,
    joints: FloatArray,
    found: npt.NDArray[np.bool_],
) -> None:
    """Write R, o and the b_i in the home's aspect, and where they are found (N,); arguments as for `all_modes`."""
    for n in range(len(lengths)):
        q = lengths[n]
        lower, lower_found = home_mode(q[0] / r, q[1] / r, q[2] / r, base_radius / r)
        upper, upper_found = home_mode(q[3] / r, q[4] / r, q[5] / r, platform_radius / r)
        _put_home(lower, upper, r, n, rotation, translation, joints)
        found[n] = lower_found and upper_found


@kernel(f"void({readonly_array(2)}, f8, f8, f8, f8[:,:,::1], f8[:,::1], f8[:,:,::1])")
def home_modes_of_all(
    lengths: FloatArray,
    r: float,
    base_radius: float,
    platform_radius: float,
    rotation: FloatArray,
    translation: FloatArray,
    joints: FloatArray,
) -> None:
    """Write what `home_modes` does, chosen from all solutions: NaN proves that there is none in the home's aspect."""
    work = workspace()
    for n in range(len(lengths)):
        q = lengths[n]
        lower = home_mode_of_all(q[0] / r, q[1] / r, q[2] / r, base_radius / r, work)
        upper = home_mode_of_all(q[3] / r, q[4] / r, q[5] / r, platform_radius / r, work)
        _put_home(lower, upper, r, n, rotation, translation, joints)


@kernel(f"void({readonly_array(2)}, {readonly_array(2)}, f8, f8[:,:,::1], f8[:,::1], f8[:,:,::1])")
def compose_all(
    lower: FloatArray, upper: FloatArray, r: float, rotation: FloatArray, translation: FloatArray, joints: FloatArray
) -> None:
    """Compose N pairs of stages (N, 5), NaN where either is."""
    for n in range(len(lower)):
        if math.isnan(lower[n, 0]) or math.isnan(upper[n, 0]):
            _put_nan(rotation[n], translation[n], joints[n])
        else:
            compose(_stage(lower, n), _stage(upper, n), r, rotation[n], translation[n], joints[n])
