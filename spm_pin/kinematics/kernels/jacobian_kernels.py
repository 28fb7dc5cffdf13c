"""J_f, its inverse, leg forces and determinants of a batch of states, from forces through the ball joints.

States are arrays of two batch axes, (outer, inner), of any strides: what all branches of a pose share need not be
copied. Results are packed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import TILE, jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.vectors import Vector, combined, cross, dot, minus, scaled
from spm_pin.kinematics.kernels.wrench_vectors import (
    BASE_AXES,
    Three,
    is_short,
    is_suspect,
    joints_of,
    load,
    lower_legs,
    mean,
    normals,
    plane_determinant,
    platform_axes,
    position_of,
    slides,
    twist,
    unit_rates,
    upper_legs,
    velocities,
)
from spm_pin.mechanism.arguments import FloatArray

ByteArray = npt.NDArray[np.uint8]
_STATES = f"{readonly_array(4)}, {readonly_array(4)}, {readonly_array(3)}"
_Six = tuple[float, float, float, float, float, float]

_UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@jit_inline
def _row(f: Vector, b: Vector, o: Vector) -> _Six:
    """Return the force f through b as a row (f, (b - o) x f)."""
    m = cross(minus(b, o), f)
    return f[0], f[1], f[2], m[0], m[1], m[2]


@jit_inline
def _weighted(weights: Vector, first: _Six, second: _Six, third: _Six, j: int) -> float:
    return weights[0] * first[j] + weights[1] * second[j] + weights[2] * third[j]


@jit_inline
def _put_matrices(
    out: FloatArray, flags: FloatArray, start: int, width: int, matrices: FloatArray, suspect: ByteArray
) -> None:
    for k in range(width):
        suspect[start + k] = np.uint8(flags[k])
        for i in range(6):
            row, j = matrices[start + k, i], 6 * i
            row[0], row[1], row[2] = out[j, k], out[j + 1, k], out[j + 2, k]
            row[3], row[4], row[5] = out[j + 3, k], out[j + 4, k], out[j + 5, k]


@kernel(f"void({_STATES}, f8, f8, f8, f8, f8[:,:,::1], u1[::1])")
def inverse_jacobians(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    base_radius: float,
    platform_radius: float,
    side: float,
    singular: float,
    matrices: FloatArray,
    suspect: ByteArray,
) -> None:
    """Write J_f (S, 6, 6), and where K may be singular (S,)."""
    tile, out, flags = np.ones((21, TILE)), np.empty((36, TILE)), np.empty(TILE)
    for start in range(0, len(suspect), TILE):
        width = min(TILE, len(suspect) - start)
        load(joints, rotation, position, start, width, tile)
        for k in range(TILE):
            b, o, axes = joints_of(tile, k), position_of(tile, k), platform_axes(tile, k)
            w = normals(axes, BASE_AXES)
            n = unit_rates(BASE_AXES, w)
            slide = slides(b, w, n)
            # As seen from {B}, a motion of the platform carries the upper legs' planes, hence the b_i, along the R_i2.
            first, second, third = _row(axes[0], b[0], o), _row(axes[1], b[1], o), _row(axes[2], b[2], o)
            lower, upper = lower_legs(b, base_radius), upper_legs(b, tile, k, platform_radius)
            doubtful = is_suspect(b, axes, BASE_AXES, w, side, singular) | is_short(b, lower) | is_short(b, upper)
            flags[k] = 1.0 if doubtful else 0.0
            for i in range(3):
                fixed = _row(upper[i], b[i], o)
                share = combined(scaled(dot(lower[i], w[i]), slide[i]), dot(lower[i], n[i]), _UNIT[i])
                rest = combined(scaled(dot(upper[i], w[i]), slide[i]), dot(upper[i], n[i]), _UNIT[i])
                for j in range(6):
                    out[6 * i + j, k] = _weighted(share, first, second, third, j)
                    out[6 * (i + 3) + j, k] = fixed[j] - _weighted(rest, first, second, third, j)
        _put_matrices(out, flags, start, width, matrices, suspect)


@jit_inline
def _stage(
    b: Three, tile: FloatArray, k: int, stage: int, base_radius: float, platform_radius: float
) -> tuple[Three, Three]:
    """Return the holding and the constraining forces of the lower stage, 0, or of the upper, 1."""
    if stage == 0:
        return lower_legs(b, base_radius), BASE_AXES
    return upper_legs(b, tile, k, platform_radius), platform_axes(tile, k)


@kernel(f"void({_STATES}, f8, f8, f8, f8, f8[:,:,::1], u1[::1])")
def platform_jacobians(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    base_radius: float,
    platform_radius: float,
    side: float,
    singular: float,
    matrices: FloatArray,
    suspect: ByteArray,
) -> None:
    """Write G (S, 6, 6), and where J_b or J_c may be singular (S,)."""
    tile, out, flags = np.ones((21, TILE)), np.empty((36, TILE)), np.empty(TILE)
    for start in range(0, len(suspect), TILE):
        width = min(TILE, len(suspect) - start)
        load(joints, rotation, position, start, width, tile)
        flags[:] = 0.0
        for stage in range(2):
            for k in range(TILE):
                b = joints_of(tile, k)
                f, a = _stage(b, tile, k, stage, base_radius, platform_radius)
                w = normals(f, a)
                n = unit_rates(a, w)
                slide = slides(b, w, n)
                flags[k] += 1.0 if is_suspect(b, f, a, w, side, singular) | is_short(b, f) else 0.0
                lever = minus(position_of(tile, k), mean(b))
                for j in range(3):
                    linear, angular = twist(b, velocities(w, n, slide, j))
                    linear = combined(linear, 1.0, cross(angular, lever))
                    column = 3 * stage + j
                    for i in range(3):
                        out[6 * i + column, k] = linear[i]
                        out[6 * (i + 3) + column, k] = angular[i]
        _put_matrices(out, flags, start, width, matrices, suspect)


@kernel(f"void({_STATES}, {readonly_array(3)}, f8, f8, f8, f8, f8[:,::1], u1[::1])")
def stage_forces(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    wrench: FloatArray,
    base_radius: float,
    platform_radius: float,
    side: float,
    singular: float,
    forces: FloatArray,
    suspect: ByteArray,
) -> None:
    """Write the leg forces (S, 6) that hold wrenches (outer, inner, 6), and where J_b or J_c may be singular (S,)."""
    tile, out, flags, loads = np.ones((21, TILE)), np.empty((6, TILE)), np.empty(TILE), np.ones((6, TILE))
    inner = joints.shape[1]
    for start in range(0, len(suspect), TILE):
        width = min(TILE, len(suspect) - start)
        load(joints, rotation, position, start, width, tile)
        for k in range(width):
            m, n = divmod(start + k, inner)
            for i in range(6):
                loads[i, k] = wrench[m, n, i]
        flags[:] = 0.0
        for stage in range(2):
            for k in range(TILE):
                b = joints_of(tile, k)
                f, a = _stage(b, tile, k, stage, base_radius, platform_radius)
                w = normals(f, a)
                rates = unit_rates(a, w)
                slide = slides(b, w, rates)
                flags[k] += 1.0 if is_suspect(b, f, a, w, side, singular) | is_short(b, f) else 0.0
                force, moment = (loads[0, k], loads[1, k], loads[2, k]), (loads[3, k], loads[4, k], loads[5, k])
                moment = combined(moment, 1.0, cross(minus(position_of(tile, k), mean(b)), force))
                for j in range(3):
                    linear, angular = twist(b, velocities(w, rates, slide, j))
                    out[3 * stage + j, k] = -dot(linear, force) - dot(angular, moment)
        for k in range(width):
            suspect[start + k] = np.uint8(flags[k])
            for i in range(6):
                forces[start + k, i] = out[i, k]


@kernel(f"void({_STATES}, f8, f8, f8[:,::1])")
def all_determinants(
    joints: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    base_radius: float,
    platform_radius: float,
    determinants: FloatArray,
) -> None:
    """Write det J_b, det J_c, det K (S, 3)."""
    tile, out = np.ones((21, TILE)), np.empty((3, TILE))
    for start in range(0, len(determinants), TILE):
        width = min(TILE, len(determinants) - start)
        load(joints, rotation, position, start, width, tile)
        for k in range(TILE):
            b, axes = joints_of(tile, k), platform_axes(tile, k)
            out[0, k] = -plane_determinant(b, normals(lower_legs(b, base_radius), BASE_AXES))
            out[1, k] = -plane_determinant(b, normals(upper_legs(b, tile, k, platform_radius), axes))
            out[2, k] = -plane_determinant(b, normals(BASE_AXES, axes))
        for k in range(width):
            for i in range(3):
                determinants[start + k, i] = out[i, k]
