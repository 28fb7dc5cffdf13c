"""The forces of the legs on the middle platform, and what they allow: `docs/theory/rates_forces_singularities.md`.

A stage has three forces f_i through the ball joints b_i that hold, and three, a_i, that constrain. A motion of the
platform moves b_i by

    v_i = q_i n_i + λ_i w_i,    w_i = f_i x a_i,    n_i = a_i x w_i / |w_i|²,

where its rate along f_i is q_i and that along a_i zero. What is left of its being rigid are the joints' distances: with
c_ij = (b_i - b_j)·w_i and d_ij = (b_i - b_j)·n_i

    c_ij λ_i + c_ji λ_j = -d_ij q_i - d_ji q_j    for ij = 12, 23, 31,

three equations whose determinant D = c12 c23 c31 + c21 c32 c13 is minus that of the 6 x 6 matrix of the forces.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import TANGENT_SIGNS
from spm_pin.formulas.operations import sqrt
from spm_pin.formulas.stages import Pairs, inverse, is_home_aspect, pair_determinant, pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    crosses,
    dot,
    magnitude,
    matrix_product,
    minus,
    scaled,
    times,
    transposed,
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


def normals(f: Rows, a: Rows) -> Rows:
    """Return w_i = f_i x a_i, along which neither force of leg i does work."""
    return crosses(f, a)


def pairs(b: Rows, w: Rows) -> Pairs:
    """Return c_ij = (b_i - b_j)·w_i."""
    e12, e23, e31 = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    return dot(e12, w[0]), dot(e23, w[1]), dot(e31, w[2]), -dot(e12, w[1]), -dot(e23, w[2]), -dot(e31, w[0])


def determinant(b: Rows, f: Rows, a: Rows) -> float:
    """Return the determinant of the six forces of a stage, rows (f, (b - o) x f) and then (a, (b - o) x a)."""
    return -pair_determinant(pairs(b, normals(f, a)))


def is_stage_at_home(b: Rows, f: Rows, a: Rows) -> bool:
    """Return whether an upright stage of any machine is in the aspect of its home; f_i are along the legs, upwards."""
    tangents = scaled(TANGENT_SIGNS[0], a[0]), scaled(TANGENT_SIGNS[1], a[1]), scaled(TANGENT_SIGNS[2], a[2])
    return is_home_aspect(pairs(b, normals(tangents, f)))


def stage_rates(b: Rows, f: Rows, a: Rows) -> StageRates:
    """Return the velocities of the b_i for unit rates along the f_i that keep the platform rigid."""
    w = normals(f, a)
    x, y, z = crosses(a, w)
    n = scaled(1.0 / dot(w[0], w[0]), x), scaled(1.0 / dot(w[1], w[1]), y), scaled(1.0 / dot(w[2], w[2]), z)
    first, second, third = pair_inverse(pairs(b, w))
    d12, d23, d31, d21, d32, d13 = pairs(b, n)
    free_rates = (
        combined(scaled(-d12, first), -d13, third),
        combined(scaled(-d21, first), -d23, second),
        combined(scaled(-d32, second), -d31, third),
    )
    return StageRates(w, n, free_rates)


def mean(b: Rows) -> Vector:
    """Return the centre p of three points."""
    return scaled(1.0 / 3.0, combined(combined(b[0], 1.0, b[1]), 1.0, b[2]))


def _twist(b: Rows, v: Rows, o: Vector) -> Twist:
    """Return (v, ω) at o of a rigid motion that moves the b_i by v_i."""
    e1, e2, d1, d2 = minus(b[0], b[2]), minus(b[1], b[2]), minus(v[0], v[2]), minus(v[1], v[2])
    normal = cross(e1, e2)
    # ω along the normal, and in the basis that is dual to e1 x normal, e2 x normal.
    omega = combined(scaled(dot(d1, e2), normal), dot(d2, normal), e1)
    omega = scaled(1.0 / dot(normal, normal), combined(omega, -dot(d1, normal), e2))
    return combined(mean(v), 1.0, cross(omega, minus(o, mean(b)))), omega


def _velocities(rates: StageRates, free: Vector, unit: Vector) -> Rows:
    """Return the velocities of the b_i for a unit rate; `free` are its rates along the w_i, `unit` along the f_i."""
    first = combined(scaled(free[0], rates.w[0]), unit[0], rates.n[0])
    second = combined(scaled(free[1], rates.w[1]), unit[1], rates.n[1])
    return first, second, combined(scaled(free[2], rates.w[2]), unit[2], rates.n[2])


def stage_twists(b: Rows, f: Rows, a: Rows, o: Vector) -> Matrix:
    """Return the twists at o of unit rates along the f_i with none along the a_i: half the columns of G = J_f⁻¹."""
    rates = stage_rates(b, f, a)
    first = _twist(b, _velocities(rates, rates.free_rates[0], (1.0, 0.0, 0.0)), o)
    second = _twist(b, _velocities(rates, rates.free_rates[1], (0.0, 1.0, 0.0)), o)
    return first, second, _twist(b, _velocities(rates, rates.free_rates[2], (0.0, 0.0, 1.0)), o)


def stage_forces(twists: Matrix, wrench: Twist) -> Vector:
    """Return the leg forces of a stage that hold a wrench at o, from what `stage_twists` returned."""
    return -power(twists[0], wrench), -power(twists[1], wrench), -power(twists[2], wrench)


def power(twist: Twist, wrench: Twist) -> float:
    """Return the product of a twist and a wrench at one point."""
    return dot(twist[0], wrench[0]) + dot(twist[1], wrench[1])


def force_row(f: Vector, b: Vector, o: Vector) -> Twist:
    """Return the force f through b as a row (f, (b - o) x f)."""
    return f, cross(minus(b, o), f)


def force_rows(f: Rows, b: Rows, o: Vector) -> Matrix:
    """Return the forces f_i through b_i as rows."""
    return force_row(f[0], b[0], o), force_row(f[1], b[1], o), force_row(f[2], b[2], o)


def drawn_inverse_jacobian(b: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector) -> tuple[Matrix, Matrix]:
    """Return the rows of J_f for the lower and for the upper legs of a machine whose balls coincide in pairs.

    `lower` and `upper` are the directions δ_bi and δ_ci, `a` and `a_m` the axes R_i1 and R_i2, all in {B}.
    """
    rates = stage_rates(b, a_m, a)
    # As seen from {B}, a motion of the platform carries the upper legs' planes, hence the b_i, along the R_i2.
    carried, free = force_rows(a_m, b, o), transposed(rates.free_rates)
    uppers = _times(_rates_along(upper, rates, free), carried)
    return _times(_rates_along(lower, rates, free), carried), _difference(force_rows(upper, b, o), uppers)


def _rates_along(directions: Rows, rates: StageRates, free: Rows) -> Rows:
    """Return the rates of the b_i along directions, for unit rates along the f_i; `free` has a row for each b_i."""
    (w1, w2, w3), (n1, n2, n3), (d1, d2, d3) = rates.w, rates.n, directions
    first = combined(scaled(dot(d1, w1), free[0]), dot(d1, n1), (1.0, 0.0, 0.0))
    second = combined(scaled(dot(d2, w2), free[1]), dot(d2, n2), (0.0, 1.0, 0.0))
    return first, second, combined(scaled(dot(d3, w3), free[2]), dot(d3, n3), (0.0, 0.0, 1.0))


def inverse_jacobian(
    b: Rows, c: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector
) -> tuple[Matrix, Matrix]:
    """Return what `drawn_inverse_jacobian` does where the upper legs' balls c_i are apart from the lower ones' b_i.

    The motions of the middle platform that the lower legs' structure leaves open are those of unit rates of the b_i
    along the R_i2; that of the upper legs takes its own three rates of them.
    """
    twists, carried = stage_twists(b, a_m, a, o), force_rows(a_m, c, o)
    columns, _ = inverse(_rates(carried, twists))
    shares = transposed(columns)
    lowers = _times(matrix_product(_rates(force_rows(lower, b, o), twists), shares), carried)
    own = force_rows(upper, c, o)
    return lowers, _difference(own, _times(matrix_product(_rates(own, twists), shares), carried))


def _times(weights: Rows, rows: Matrix) -> Matrix:
    """Return the product of a matrix and three rows."""
    (f1, m1), (f2, m2), (f3, m3) = rows
    f, m = matrix_product(weights, (f1, f2, f3)), matrix_product(weights, (m1, m2, m3))
    return (f[0], m[0]), (f[1], m[1]), (f[2], m[2])


def _difference(first: Matrix, second: Matrix) -> Matrix:
    (f1, m1), (f2, m2), (f3, m3) = first
    (g1, n1), (g2, n2), (g3, n3) = second
    return (minus(f1, g1), minus(m1, n1)), (minus(f2, g2), minus(m2, n2)), (minus(f3, g3), minus(m3, n3))


def _rates(rows: Matrix, twists: Matrix) -> Rows:
    """Return the powers of forces, a row for each, under three twists."""
    x, y, z = twists
    first, second = (
        (power(x, rows[0]), power(y, rows[0]), power(z, rows[0])),
        (power(x, rows[1]), power(y, rows[1]), power(z, rows[1])),
    )
    return first, second, (power(x, rows[2]), power(y, rows[2]), power(z, rows[2]))


def mixed_determinant(first: Matrix, second: Matrix) -> float:
    """Return the determinant of six forces as rows (f, m), three and three, by the expansion of Laplace."""
    f1, m1 = _columns(first)
    f2, m2 = _columns(second)
    f1_minors, m1_minors, f2_minors, m2_minors = _minors(f1), _minors(m1), _minors(f2), _minors(m2)
    both_forces = dot(f1[0], f1_minors[0]) * dot(m2[0], m2_minors[0])
    both_moments = dot(m1[0], m1_minors[0]) * dot(f2[0], f2_minors[0])
    total = both_forces - both_moments
    total = total - _sum_of_products(f1_minors, m1, f2, m2_minors)
    return total + _sum_of_products(f1, m1_minors, f2_minors, m2)


def _columns(rows: Matrix) -> tuple[Rows, Rows]:
    (f1, m1), (f2, m2), (f3, m3) = rows
    return transposed((f1, f2, f3)), transposed((m1, m2, m3))


def _minors(rows: Rows) -> Rows:
    return cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])


def _sum_of_products(f1: Rows, m1: Rows, f2: Rows, m2: Rows) -> float:
    """Return the sum of (f1_i·m1_j)(f2_i·m2_j)."""
    first, second = dot(times(m1, f1[0]), times(m2, f2[0])), dot(times(m1, f1[1]), times(m2, f2[1]))
    return first + second + dot(times(m1, f1[2]), times(m2, f2[2]))


def structure_determinant(b: Rows, c: Rows, a: Rows, a_m: Rows) -> float:
    """Return det K of any machine."""
    origin = 0.0, 0.0, 0.0
    return mixed_determinant(force_rows(a, b, origin), force_rows(a_m, c, origin))


def arms(balls: Rows, p: Vector, side: float) -> Rows:
    """Return the lever arms of three balls about p in units of the middle platform's side."""
    x, y, z = balls
    unit = 1.0 / side
    return scaled(unit, minus(x, p)), scaled(unit, minus(y, p)), scaled(unit, minus(z, p))


def may_be_singular(b: Rows, f: Rows, a: Rows, side: float, singular: float) -> bool:
    """Return whether the forces of a stage may be dependent: see `_is_suspect`."""
    about = arms(b, mean(b), side)
    size = _squared_size(about, f) + _squared_size(about, a)
    return _is_suspect(pair_determinant(pairs(about, normals(f, a))), size, singular)


def may_structure_be_singular(b: Rows, c: Rows, a: Rows, a_m: Rows, side: float, singular: float) -> bool:
    """Return whether the six constraints K may be dependent where the upper legs' balls are not the lower ones'."""
    lower, upper = arms(b, mean(b), side), arms(c, mean(b), side)
    size = _squared_size(lower, a) + _squared_size(upper, a_m)
    return _is_suspect(structure_determinant(lower, upper, a, a_m), size, singular)


def _is_suspect(determinant: float, squared_size: float, singular: float) -> bool:
    """Return whether the smallest singular value of six forces may be `singular` times the largest or less; NaN is not.

    The five larger singular values multiply to at most (F²/5)^(5/2), F the Frobenius norm, so most matrices are known
    to be regular without a decomposition. The factor covers the determinant's rounding.
    """
    ratio = 5.0 / squared_size
    at_least = magnitude(determinant) * (ratio * ratio * sqrt(ratio))
    return at_least <= 1e3 * singular * sqrt(squared_size)


def _squared_size(about: Rows, forces: Rows) -> float:
    """Return the sum of the squares of three rows (f, arm x f)."""
    x, y, z = crosses(about, forces)
    own = dot(forces[0], forces[0]) + dot(forces[1], forces[1]) + dot(forces[2], forces[2])
    return own + dot(x, x) + dot(y, y) + dot(z, z)
