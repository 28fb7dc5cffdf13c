"""The four quadratics of a pose and their roots, over scalars. Notation: `spm_pin.kinematics.inverse_displacement`.

Complex numbers are pairs of reals, horizontal vectors and quaternion halves alike, so that the roots u, v may be
complex in their own right. The families come in two groups, equal modes (TT, FF) and mixed ones (TF, FT). Within a
group κ, μ and the weights of u and v are the same, and the forms differ in the sign of all but h.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit_inline
from spm_pin.kinematics.kernels.vectors import Vector

ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Rounding of a pose relative to its size: what is smaller is taken for zero when a family is degenerate."""

FAMILY_GROUP = np.array([0, 1, 1, 0])
"""The group of each of the families TT, TF, FT, FF."""
FAMILY_LOWER = np.array([1.0, 1.0, -1.0, -1.0])
"""The mode of the lower stage in each family: +1 for T, -1 for F."""
ROOT_SIGN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0])
"""The root, in this order, of the branches + and - of each family (by the sign of det K)."""

RootWeights = tuple[float, float, float, float, float, float, float, float, float, float]
"""Weights of u, then v, in the parts of w_a and of conj(w_b), and in P, which is real."""

COS_30 = float(np.sqrt(0.75))
"""The cosine of 30°."""


@jit_inline
def where(condition: bool, yes: float, no: float) -> float:
    """Select one of two numbers, without a branch in the compiled code."""
    return yes if condition else no


@jit_inline
def complex_product(a: float, ai: float, b: float, bi: float) -> tuple[float, float]:
    """Multiply two pairs as complex numbers."""
    return a * b - ai * bi, a * bi + ai * b


@jit_inline
def quaternion(
    r00: float, r01: float, r02: float, r10: float, r11: float, r12: float, r20: float, r21: float, r22: float
) -> tuple[float, float, float, float]:
    """Return x0, x1, x2, x3 of a rotation matrix, from its largest component."""
    trace = r00 + r11 + r22
    x0, x1, x2, x3, largest = 1.0 + trace, r21 - r12, r02 - r20, r10 - r01, trace
    take = r22 > largest
    x0, x1, x2 = where(take, r10 - r01, x0), where(take, r20 + r02, x1), where(take, r21 + r12, x2)
    x3, largest = where(take, 1.0 - trace + 2.0 * r22, x3), where(take, r22, largest)
    take = r11 > largest
    x0, x1, x3 = where(take, r02 - r20, x0), where(take, r10 + r01, x1), where(take, r21 + r12, x3)
    x2, largest = where(take, 1.0 - trace + 2.0 * r11, x2), where(take, r11, largest)
    take = r00 > largest
    x0, x2, x3 = where(take, r21 - r12, x0), where(take, r10 + r01, x2), where(take, r20 + r02, x3)
    x1 = where(take, 1.0 - trace + 2.0 * r00, x1)
    scale = 1.0 / np.sqrt(x0 * x0 + x1 * x1 + x2 * x2 + x3 * x3)
    return x0 * scale, x1 * scale, x2 * scale, x3 * scale


@jit_inline
def axes(
    x0: float, x1: float, x2: float, x3: float
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """Return c, s, S/|S|, W/|W|, the common normal n seen from {B}, and seen from {m}, and 1 / cs."""
    cosine, sine = np.sqrt(x0 * x0 + x3 * x3), np.sqrt(x1 * x1 + x2 * x2)
    over_cosine, over_sine = 1.0 / cosine, 1.0 / sine
    s, si, w, wi = x0 * over_cosine, x3 * over_cosine, x1 * over_sine, x2 * over_sine
    n, ni = complex_product(s, si, w, wi)
    m, mi = complex_product(s, -si, w, wi)
    return cosine, sine, s, si, w, wi, n, ni, m, mi, over_cosine * over_sine


@jit_inline
def branch_weights(kappa: float, mu: float, sine: float) -> tuple[float, float, float, float, float, float]:
    """Return the weights F, G of u and v in the quaternions of a and b, and (P - Q)/2su, (P + Q)/2sv; for κ >= 0."""
    # 1 - κ without cancellation, from |S'|² + |W|² = 1.
    over_plus = 1.0 / (1.0 + kappa)
    one_minus = (sine * sine + mu * mu) * over_plus
    scale_u, scale_v = np.sqrt(0.5 * over_plus), np.sqrt(0.5 / one_minus)
    return (1.0 + kappa) * scale_u, mu * scale_u, one_minus * scale_v, -mu * scale_v, scale_u, scale_v


@jit_inline
def quadratic_form(
    even: float, even_i: float, odd: float, odd_i: float, f: float, fi: float, g: float, gi: float
) -> tuple[float, float, float]:
    """Return Re(even F²), Re(odd F G), Re(even G²)."""
    ff, ff_i = complex_product(f, fi, f, fi)
    fg, fg_i = complex_product(f, fi, g, gi)
    gg, gg_i = complex_product(g, gi, g, gi)
    return even * ff - even_i * ff_i, odd * fg - odd_i * fg_i, even * gg - even_i * gg_i


@jit_inline
def root_of(uu: float, uv: float, vv: float, root: float) -> tuple[float, float, float]:
    """Return u, v of any length on the form, and |u|² + |v|², given the root, with its sign, of the discriminant."""
    u1, v1, u2, v2 = root - uv, uu, vv, -root - uv
    # Both pairs solve the form; the longer one is free of cancellation.
    first = u1.real * u1.real + u1.imag * u1.imag + v1.real * v1.real + v1.imag * v1.imag
    second = u2.real * u2.real + u2.imag * u2.imag + v2.real * v2.real + v2.imag * v2.imag
    longer = first >= second
    return where(longer, u1, u2), where(longer, v1, v2), where(longer, first, second)


@jit_inline
def root_weights(
    weights: tuple[float, float, float, float, float, float],
    lower_axis: tuple[float, float],
    upper_axis: tuple[float, float],
    sine: float,
) -> RootWeights:
    """Return the weights of u and v, complex ones as two, in w_a, conj(w_b) and P of a family.

    `weights` is what `branch_weights` returned; the axes are those of w_a and conj(w_b) in this family.
    """
    f, fi, g, gi, scale_u, scale_v = weights
    a_u, a_ui = complex_product(lower_axis[0], lower_axis[1], -f, -fi)
    a_v, a_vi = complex_product(lower_axis[0], lower_axis[1], g, gi)
    b_u, b_ui = complex_product(upper_axis[0], upper_axis[1], f, fi)
    b_v, b_vi = complex_product(upper_axis[0], upper_axis[1], g, gi)
    return a_u, a_ui, a_v, a_vi, b_u, b_ui, b_v, b_vi, sine * scale_u, sine * scale_v


@jit_inline
def middle_joints(
    u: Any,
    v: Any,
    size: Any,
    weights: RootWeights,
    position: tuple[float, float, float],
    normals: tuple[float, float, float, float],
    tilt: tuple[float, float],
    lower: float,
) -> tuple[Vector, Vector]:
    """Return the middle joints' radii ρ_i in the planes of their lower legs, and heights z_i, of a root u, v.

    `size` is r / (u² + v²), `weights` what `root_weights` returned, `normals` n and n seen from {m}, `tilt` c² - s² and
    1 / 2cs, `lower` e of the lower stage.
    """
    a_u, a_ui, a_v, a_vi, b_u, b_ui, b_v, b_vi, p_u, p_v = weights
    p = p_u * u + p_v * v
    # w_a and conj(w_b).
    a1, a2 = a_v * v + a_u * u, a_vi * v + a_ui * u
    b1, b2 = b_v * v + b_u * u, b_vi * v + b_ui * u
    # The centre's horizontal position in {B} and in {m}; only its part along the tilt is needed: with the common
    # normal n, that direction is -i n.
    twice = 2.0 * size
    x, y = -twice * (a1 * a2), size * (a2 * a2 - a1 * a1)
    x_m, y_m = twice * (b1 * b2), size * (b2 * b2 - b1 * b1)
    along = normals[1] * (x - position[0]) - normals[0] * (y - position[1])
    along_m = normals[3] * x_m - normals[2] * y_m
    z = position[2] + (tilt[0] * along - along_m) * tilt[1]
    square = lower * size * (p * p)
    across = 2.0 * COS_30 * x
    # Mode F is turned half round its normal.
    c, s = where(lower < 0.0, a1, -a2), where(lower < 0.0, a2, a1)
    c, s = COS_30 * twice * (p * c), size * (p * s)
    return (square + across - y, square + 2.0 * y, square - across - y), (z + c - s, z + 2.0 * s, z - c - s)
