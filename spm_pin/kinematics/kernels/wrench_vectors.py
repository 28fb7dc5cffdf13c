"""The forces of the legs on the middle platform, and the motions they allow, over scalars.

Notation: `spm_pin.kinematics.rates_and_forces`. A stage has three forces f_i through the ball joints b_i that hold, and
three, a_i, that constrain. A motion of the platform moves b_i by

    v_i = q_i n_i + λ_i w_i,    w_i = f_i x a_i,    n_i = a_i x w_i / |w_i|²,

where its rate along f_i is q_i and that along a_i zero. What is left of its being rigid are the joints' distances: with
c_ij = (b_i - b_j)·w_i and d_ij = (b_i - b_j)·n_i

    c_ij λ_i + c_ji λ_j = -d_ij q_i - d_ji q_j    for ij = 12, 23, 31,

three equations whose determinant D = c12 c23 c31 + c21 c32 c13 is minus that of the 6 x 6 matrix of the forces.
"""

from __future__ import annotations

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit_inline
from spm_pin.kinematics.kernels.quadratics import COS_30
from spm_pin.kinematics.kernels.vectors import Vector, combined, cross, dot, minus, scaled
from spm_pin.mechanism.arguments import FloatArray

Three = tuple[Vector, Vector, Vector]
"""Three vectors, one for each leg of a stage."""

BASE_AXES = ((0.5, COS_30, 0.0), (1.0, 0.0, 0.0), (-0.5, COS_30, 0.0))
"""The axes R_i1 in {B}, and R_i2 in {m}."""
_RADIAL = ((COS_30, -0.5, 0.0), (0.0, 1.0, 0.0), (-COS_30, -0.5, 0.0))


@jit_inline
def load(
    joints: FloatArray, rotation: FloatArray, position: FloatArray, first: int, width: int, tile: FloatArray
) -> None:
    """Fill rows b, R, o of a tile (21, TILE) with states of arrays (outer, inner, ...), counted through both axes."""
    inner = joints.shape[1]
    for k in range(width):
        m, n = divmod(first + k, inner)
        for i in range(3):
            for j in range(3):
                tile[3 * i + j, k] = joints[m, n, i, j]
                tile[9 + 3 * i + j, k] = rotation[m, n, i, j]
            tile[18 + i, k] = position[m, n, i]


@jit_inline
def joints_of(tile: FloatArray, k: int) -> Three:
    """Return the ball joints b_1, b_2, b_3 of the state in place k of a tile."""
    b1, b2 = (tile[0, k], tile[1, k], tile[2, k]), (tile[3, k], tile[4, k], tile[5, k])
    return b1, b2, (tile[6, k], tile[7, k], tile[8, k])


@jit_inline
def position_of(tile: FloatArray, k: int) -> Vector:
    """Return the origin o of the terminal platform of the state in place k of a tile."""
    return tile[18, k], tile[19, k], tile[20, k]


@jit_inline
def _turned(tile: FloatArray, k: int, a: Vector) -> Vector:
    """Return R a for a vector a in the plane of the terminal platform."""
    x, y = tile[9, k] * a[0] + tile[10, k] * a[1], tile[12, k] * a[0] + tile[13, k] * a[1]
    return x, y, tile[15, k] * a[0] + tile[16, k] * a[1]


@jit_inline
def platform_axes(tile: FloatArray, k: int) -> Three:
    """Return the axes R_i2 in {B}."""
    return _turned(tile, k, BASE_AXES[0]), _turned(tile, k, BASE_AXES[1]), _turned(tile, k, BASE_AXES[2])


@jit_inline
def _along(vector: Vector) -> Vector:
    return scaled(1.0 / np.sqrt(dot(vector, vector)), vector)


@jit_inline
def lower_legs(b: Three, base_radius: float) -> Three:
    """Return the directions δ_bi from a_i to b_i."""
    first = _along(combined(b[0], -base_radius, _RADIAL[0]))
    second = _along(combined(b[1], -base_radius, _RADIAL[1]))
    return first, second, _along(combined(b[2], -base_radius, _RADIAL[2]))


@jit_inline
def upper_legs(b: Three, tile: FloatArray, k: int, platform_radius: float) -> Three:
    """Return the directions δ_ci from b_i to c_i."""
    o = position_of(tile, k)
    first = _along(minus(combined(o, platform_radius, _turned(tile, k, _RADIAL[0])), b[0]))
    second = _along(minus(combined(o, platform_radius, _turned(tile, k, _RADIAL[1])), b[1]))
    return first, second, _along(minus(combined(o, platform_radius, _turned(tile, k, _RADIAL[2])), b[2]))


@jit_inline
def mean(b: Three) -> Vector:
    """Return the middle platform's centre p."""
    return scaled(1.0 / 3.0, combined(combined(b[0], 1.0, b[1]), 1.0, b[2]))


@jit_inline
def normals(f: Three, a: Three) -> Three:
    """Return w_i = f_i x a_i, along which neither force of leg i does work."""
    return cross(f[0], a[0]), cross(f[1], a[1]), cross(f[2], a[2])


@jit_inline
def unit_rates(a: Three, w: Three) -> Three:
    """Return n_i, the velocity of b_i with a unit rate along the force f_i, none along a_i and none along w_i."""
    first = scaled(1.0 / dot(w[0], w[0]), cross(a[0], w[0]))
    second = scaled(1.0 / dot(w[1], w[1]), cross(a[1], w[1]))
    return first, second, scaled(1.0 / dot(w[2], w[2]), cross(a[2], w[2]))


@jit_inline
def _cycles(b: Three, w: Three) -> tuple[float, float, float, float, float, float]:
    """Return the products (b_i - b_j)·w_i in the order 12, 23, 31, 21, 32, 13."""
    e12, e23, e31 = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    return dot(e12, w[0]), dot(e23, w[1]), dot(e31, w[2]), -dot(e12, w[1]), -dot(e23, w[2]), -dot(e31, w[0])


@jit_inline
def plane_determinant(b: Three, w: Three) -> float:
    """Return D = c12 c23 c31 + c21 c32 c13, minus the determinant of the six forces of a stage."""
    c12, c23, c31, c21, c32, c13 = _cycles(b, w)
    return c12 * c23 * c31 + c21 * c32 * c13


@jit_inline
def slides(b: Three, w: Three, n: Three) -> Three:
    """Return the rates λ_1, λ_2, λ_3 along w_i that keep the platform rigid, each for the three unit rates q."""
    c12, c23, c31, c21, c32, c13 = _cycles(b, w)
    d12, d23, d31, d21, d32, d13 = _cycles(b, n)
    s = -1.0 / (c12 * c23 * c31 + c21 * c32 * c13)
    i11, i12, i13 = s * c23 * c31, -s * c21 * c31, s * c21 * c32
    i21, i22, i23 = s * c32 * c13, s * c12 * c31, -s * c12 * c32
    i31, i32, i33 = -s * c23 * c13, s * c21 * c13, s * c12 * c23
    first = i11 * d12 + i13 * d13, i11 * d21 + i12 * d23, i12 * d32 + i13 * d31
    second = i21 * d12 + i23 * d13, i21 * d21 + i22 * d23, i22 * d32 + i23 * d31
    return first, second, (i31 * d12 + i33 * d13, i31 * d21 + i32 * d23, i32 * d32 + i33 * d31)


@jit_inline
def velocities(w: Three, n: Three, slide: Three, j: int) -> Three:
    """Return the velocities of the b_i for a unit rate q_j."""
    first = combined(scaled(slide[0][j], w[0]), 1.0 if j == 0 else 0.0, n[0])
    second = combined(scaled(slide[1][j], w[1]), 1.0 if j == 1 else 0.0, n[1])
    return first, second, combined(scaled(slide[2][j], w[2]), 1.0 if j == 2 else 0.0, n[2])


@jit_inline
def twist(b: Three, v: Three) -> tuple[Vector, Vector]:
    """Return the velocity of the centre p, and ω, of a rigid motion that moves the b_i by v_i."""
    e1, e2, d1, d2 = minus(b[0], b[2]), minus(b[1], b[2]), minus(v[0], v[2]), minus(v[1], v[2])
    normal = cross(e1, e2)
    # ω along the normal, and in the basis that is dual to e1 x normal, e2 x normal.
    omega = combined(scaled(dot(d1, e2), normal), dot(d2, normal), e1)
    return mean(v), scaled(1.0 / dot(normal, normal), combined(omega, -dot(d1, normal), e2))


@jit_inline
def is_suspect(b: Three, f: Three, a: Three, w: Three, side: float, singular: float) -> bool:
    """Return whether the smallest singular value of the forces may be `singular` times the largest or less; NaN is not.

    The five larger singular values multiply to at most (F²/5)^(5/2), F the Frobenius norm, so most matrices are known
    to be regular without a decomposition. The factor covers the determinant's rounding.
    """
    p = mean(b)
    arms = scaled(1.0 / side, minus(b[0], p)), scaled(1.0 / side, minus(b[1], p)), scaled(1.0 / side, minus(b[2], p))
    square = 0.0
    for i in range(3):
        m, n = cross(arms[i], f[i]), cross(arms[i], a[i])
        square += dot(f[i], f[i]) + dot(a[i], a[i]) + dot(m, m) + dot(n, n)
    ratio = 5.0 / square
    at_least = abs(plane_determinant(arms, w)) * (ratio * ratio * np.sqrt(ratio))
    return bool(at_least <= 1e3 * singular * np.sqrt(square))


@jit_inline
def is_short(b: Three, legs: Three) -> bool:
    """Return whether a leg has no length, hence a direction that is NaN, in a state that exists."""
    total = legs[0][0] + legs[1][0] + legs[2][0]
    return (b[0][0] == b[0][0]) & (total != total)
