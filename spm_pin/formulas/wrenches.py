"""Leg forces on the middle platform, and motions that they allow: `docs/theory/rates_forces_singularities.md`.

Each leg of a stage acts on its ball b_i with two forces: along f_i, where b_i moves at the rate q_i, and
along a_i, where it cannot move. So a motion of the platform moves b_i with the velocity

    v_i = q_i n_i + λ_i w_i,    w_i = f_i x a_i,    n_i = a_i x w_i / |w_i|².

As the platform is rigid, the distances of the balls do not change: with c_ij = (b_i - b_j)·w_i and
d_ij = (b_i - b_j)·n_i

    c_ij λ_i + c_ji λ_j = -d_ij q_i - d_ji q_j    for ij = 12, 23, 31,

three equations for the λ_i. Their determinant D = c12 c23 c31 + c21 c32 c13 is minus that of the 6 x 6 matrix of the
six forces. Usually f_i is along the leg and a_i along its revolute axis; for the structure matrix K both are axes.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import TANGENT_SIGNS
from spm_pin.formulas.operations import sqrt
from spm_pin.formulas.stages import Pairs, inverse, is_home_aspect, pair_determinant, pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    combined,
    cross,
    crosses,
    differences,
    dot,
    dots,
    magnitude,
    matrix_product,
    minus,
    multiples,
    scaled,
    transposed,
    turned,
)

Twist = tuple[Vector, Vector]
"""(v, ω), or a wrench (f, m)."""
Matrix = tuple[Twist, Twist, Twist]
"""Three rows, or three columns, of a matrix of forces or of twists."""


class StageRates(NamedTuple):
    """Velocities of the b_i for unit rates along three forces f_i, with none along the constraints a_i."""

    w: Rows
    n: Rows
    free_rates: Rows  # (λ_1, λ_2, λ_3) along the w_i, for each of the three unit rates


def pairs(b: Rows, w: Rows) -> Pairs:
    """Return c_ij = (b_i - b_j)·w_i."""
    e12, e23, e31 = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    return dot(e12, w[0]), dot(e23, w[1]), dot(e31, w[2]), -dot(e12, w[1]), -dot(e23, w[2]), -dot(e31, w[0])


def determinant(b: Rows, f: Rows, a: Rows) -> float:
    """Return the determinant of the six forces of a stage, rows (f, (b - o) x f) and then (a, (b - o) x a)."""
    return -pair_determinant(pairs(b, crosses(f, a)))


def is_stage_at_home(b: Rows, f: Rows, a: Rows) -> bool:
    """Return whether an upright stage is in its home assembly region; f_i are along the legs, upwards in the home."""
    return is_home_aspect(pairs(b, crosses(multiples(TANGENT_SIGNS, a), f)))


def stage_rates(b: Rows, f: Rows, a: Rows) -> StageRates:
    """Return the velocities of the b_i for unit rates along the f_i that keep the platform rigid."""
    w = crosses(f, a)
    x, y, z = dots(w, w)
    n = multiples((1.0 / x, 1.0 / y, 1.0 / z), crosses(a, w))
    first, second, third = pair_inverse(pairs(b, w))
    d12, d23, d31, d21, d32, d13 = pairs(b, n)
    free_rates = (
        combined(scaled(-d12, first), -d13, third),
        combined(scaled(-d21, first), -d23, second),
        combined(scaled(-d32, second), -d31, third),
    )
    return StageRates(w, n, free_rates)


def mean(b: Rows) -> Vector:
    """Return the mean of three points."""
    return scaled(1.0 / 3.0, combined(combined(b[0], 1.0, b[1]), 1.0, b[2]))


def _twist(b: Rows, v: Rows, o: Vector) -> Twist:
    """Return (v, ω) at o of a rigid motion that moves the b_i by v_i."""
    e1, e2, d1, d2 = minus(b[0], b[2]), minus(b[1], b[2]), minus(v[0], v[2]), minus(v[1], v[2])
    normal = cross(e1, e2)
    # ω along the normal, and in the basis that is dual to e1 x normal, e2 x normal.
    omega = combined(scaled(dot(d1, e2), normal), dot(d2, normal), e1)
    omega = scaled(1.0 / dot(normal, normal), combined(omega, -dot(d1, normal), e2))
    return combined(mean(v), 1.0, cross(omega, minus(o, mean(b)))), omega


def stage_twists(b: Rows, f: Rows, a: Rows, o: Vector) -> Matrix:
    """Return the twists at o for unit rates along the f_i and none along the a_i: half the columns of G = J_f⁻¹."""
    w, n, (first, second, third) = stage_rates(b, f, a)
    return (
        _twist(b, combinations(multiples(first, w), (1.0, 0.0, 0.0), n), o),
        _twist(b, combinations(multiples(second, w), (0.0, 1.0, 0.0), n), o),
        _twist(b, combinations(multiples(third, w), (0.0, 0.0, 1.0), n), o),
    )


def stage_forces(twists: Matrix, wrench: Twist) -> Vector:
    """Return the leg forces of a stage that balance a wrench (f, m) at o, from its `stage_twists`."""
    return -power(twists[0], wrench), -power(twists[1], wrench), -power(twists[2], wrench)


def power(twist: Twist, wrench: Twist) -> float:
    """Return the power of a wrench under a twist, both at one point."""
    return dot(twist[0], wrench[0]) + dot(twist[1], wrench[1])


def force_rows(f: Rows, b: Rows, o: Vector) -> Matrix:
    """Return the forces f_i through b_i as rows (f, (b - o) x f)."""
    return _joined(f, _moments(f, b, o))


def _moments(f: Rows, b: Rows, o: Vector) -> Rows:
    return crosses(differences(b, (o, o, o)), f)


def _joined(f: Rows, m: Rows) -> Matrix:
    return (f[0], m[0]), (f[1], m[1]), (f[2], m[2])


def drawn_inverse_jacobian(b: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector) -> tuple[Matrix, Matrix]:
    """Return the rows of J_f for the lower and for the upper legs of a machine whose balls coincide in pairs.

    `lower` and `upper` are the directions δ_bi and δ_ci, `a` and `a_m` the axes R_i1 and R_i2, all in {B}.
    """
    rates = stage_rates(b, a_m, a)
    free = transposed(rates.free_rates)
    below, above = _rates_along(lower, rates, free), _rates_along(upper, rates, free)
    return _without_structure(b, b, lower, upper, a_m, o, below, above)


def _rates_along(directions: Rows, rates: StageRates, free: Rows) -> Rows:
    """Return the rates of the b_i along directions, a row for each, per unit rate along the f_i; `free` are the λ_i."""
    along_w, (x, y, z) = multiples(dots(directions, rates.w), free), dots(directions, rates.n)
    return combinations(along_w, (x, y, z), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def inverse_jacobian(
    b: Rows, c: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector
) -> tuple[Matrix, Matrix]:
    """Return `drawn_inverse_jacobian` for upper legs' balls c_i that differ from the lower ones' b_i.

    The planes of the lower legs leave the platform three motions: those for unit rates of the b_i along the R_i2.
    They are combined so that one c_i has unit rate along its R_i2, and the other two have none.
    """
    twists = stage_twists(b, a_m, a, o)
    columns, _ = inverse(_rates(a_m, c, o, twists))
    shares = transposed(columns)
    below, above = _rates(lower, b, o, twists), _rates(upper, c, o, twists)
    below, above = matrix_product(below, shares), matrix_product(above, shares)
    return _without_structure(b, c, lower, upper, a_m, o, below, above)


def _rates(f: Rows, b: Rows, o: Vector, twists: Matrix) -> Rows:
    """Return the powers of forces f_i through b_i, a row for each, under three twists."""
    (v1, w1), (v2, w2), (v3, w3) = twists
    linear = matrix_product(f, transposed((v1, v2, v3)))
    return combinations(linear, (1.0, 1.0, 1.0), matrix_product(_moments(f, b, o), transposed((w1, w2, w3))))


def _without_structure(
    b: Rows, c: Rows, lower: Rows, upper: Rows, a_m: Rows, o: Vector, below: Rows, above: Rows
) -> tuple[Matrix, Matrix]:
    """Return the rows of J_f; `below` and `above` are the legs' rates, for unit rates of the platform along the R_i2.

    Relative to {B}, a motion of the platform moves the upper legs' planes, hence their balls, along the R_i2.
    """
    m, m_upper = _moments(a_m, c, o), _moments(upper, c, o)
    uppers = _joined(differences(upper, matrix_product(above, a_m)), differences(m_upper, matrix_product(above, m)))
    return _joined(matrix_product(below, a_m), matrix_product(below, m)), uppers


def structure_determinant(b: Rows, c: Rows, a: Rows, a_m: Rows) -> float:
    """Return det K of any machine, by Laplace's expansion for three rows (f, m) and three."""
    f1, m1, f2, m2 = transposed(a), transposed(crosses(b, a)), transposed(a_m), transposed(crosses(c, a_m))
    f1_minors, m1_minors, f2_minors, m2_minors = _minors(f1), _minors(m1), _minors(f2), _minors(m2)
    both_forces = dot(f1[0], f1_minors[0]) * dot(m2[0], m2_minors[0])
    both_moments = dot(m1[0], m1_minors[0]) * dot(f2[0], f2_minors[0])
    total = both_forces - both_moments - _sum_of_products(f1_minors, m1, f2, m2_minors)
    return total + _sum_of_products(f1, m1_minors, f2_minors, m2)


def _minors(rows: Rows) -> Rows:
    return cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])


def _sum_of_products(f1: Rows, m1: Rows, f2: Rows, m2: Rows) -> float:
    """Return the sum of (f1_i·m1_j)(f2_i·m2_j)."""
    x, y, z = dots(turned(m1, f1), turned(m2, f2))
    return x + y + z


def arms(balls: Rows, p: Vector, side: float) -> Rows:
    """Return the lever arms of three balls about p, divided by the middle platform's side."""
    unit = 1.0 / side
    return multiples((unit, unit, unit), differences(balls, (p, p, p)))


def may_be_singular(b: Rows, f: Rows, a: Rows, side: float, singular: float) -> bool:
    """Return whether the forces of a stage may be dependent: see `_is_suspect`."""
    about = arms(b, mean(b), side)
    size = _squared_size(about, f) + _squared_size(about, a)
    return _is_suspect(pair_determinant(pairs(about, crosses(f, a))), size, singular)


def may_structure_be_singular(b: Rows, c: Rows, a: Rows, a_m: Rows, side: float, singular: float) -> bool:
    """Return whether the six constraints K may be dependent if the upper legs' balls differ from the lower ones'."""
    lower, upper = arms(b, mean(b), side), arms(c, mean(b), side)
    size = _squared_size(lower, a) + _squared_size(upper, a_m)
    return _is_suspect(structure_determinant(lower, upper, a, a_m), size, singular)


def _is_suspect(determinant: float, squared_size: float, singular: float) -> bool:
    """Return False if the smallest singular value of six forces is certainly above `singular` times the largest.

    If True, a decomposition must decide; for NaN it is False. The product of the five larger singular values is at most
    (F²/5)^(5/2), F the Frobenius norm, so most matrices are certainly regular. The factor covers the determinant's
    rounding.
    """
    ratio = 5.0 / squared_size
    at_least = magnitude(determinant) * (ratio * ratio * sqrt(ratio))
    return at_least <= 1e3 * singular * sqrt(squared_size)


def _squared_size(about: Rows, forces: Rows) -> float:
    """Return the sum of the squares of three rows (f, arm x f)."""
    moments = crosses(about, forces)
    (x, y, z), (u, v, w) = dots(forces, forces), dots(moments, moments)
    return x + y + z + u + v + w
