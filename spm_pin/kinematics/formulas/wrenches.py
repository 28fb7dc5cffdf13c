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

from spm_pin.kinematics.formulas.operations import sqrt
from spm_pin.kinematics.formulas.stages import Pairs, pair_determinant
from spm_pin.kinematics.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    dot,
    magnitude,
    minus,
    scaled,
    times,
    weighted,
)

Twist = tuple[Vector, Vector]
"""(v, ω), or a wrench (f, m)."""
Matrix = tuple[Twist, Twist, Twist]
"""Three rows, or three columns, of a matrix of forces or of twists."""


class StageRates(NamedTuple):
    """What a unit rate along each of three forces f_i does, none along the constraints a_i."""

    w: Rows
    n: Rows
    free_rates: Rows  # (λ_1, λ_2, λ_3) along the w_i, for each of the three unit rates


def normals(f: Rows, a: Rows) -> Rows:
    """Return w_i = f_i x a_i, along which neither force of leg i does work."""
    return cross(f[0], a[0]), cross(f[1], a[1]), cross(f[2], a[2])


def unit_rates(a: Rows, w: Rows) -> Rows:
    """Return n_i, the velocity of b_i with a unit rate along the force f_i, none along a_i and none along w_i."""
    first = scaled(1.0 / dot(w[0], w[0]), cross(a[0], w[0]))
    second = scaled(1.0 / dot(w[1], w[1]), cross(a[1], w[1]))
    return first, second, scaled(1.0 / dot(w[2], w[2]), cross(a[2], w[2]))


def pairs(b: Rows, w: Rows) -> Pairs:
    """Return c_ij = (b_i - b_j)·w_i."""
    e12, e23, e31 = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    return dot(e12, w[0]), dot(e23, w[1]), dot(e31, w[2]), -dot(e12, w[1]), -dot(e23, w[2]), -dot(e31, w[0])


def determinant(b: Rows, f: Rows, a: Rows) -> float:
    """Return the determinant of the six forces of a stage, rows (f, (b - o) x f) and then (a, (b - o) x a)."""
    return -pair_determinant(pairs(b, normals(f, a)))


def stage_rates(b: Rows, f: Rows, a: Rows) -> StageRates:
    """Return the velocities of the b_i for unit rates along the f_i that keep the platform rigid."""
    w = normals(f, a)
    n = unit_rates(a, w)
    c12, c23, c31, c21, c32, c13 = pairs(b, w)
    d12, d23, d31, d21, d32, d13 = pairs(b, n)
    s = -1.0 / (c12 * c23 * c31 + c21 * c32 * c13)
    i11, i12, i13 = s * c23 * c31, -s * c21 * c31, s * c21 * c32
    i21, i22, i23 = s * c32 * c13, s * c12 * c31, -s * c12 * c32
    i31, i32, i33 = -s * c23 * c13, s * c21 * c13, s * c12 * c23
    first = i11 * d12 + i13 * d13, i21 * d12 + i23 * d13, i31 * d12 + i33 * d13
    second = i11 * d21 + i12 * d23, i21 * d21 + i22 * d23, i31 * d21 + i32 * d23
    third = i12 * d32 + i13 * d31, i22 * d32 + i23 * d31, i32 * d32 + i33 * d31
    return StageRates(w, n, (first, second, third))


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


def drawn_inverse_jacobian(b: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector) -> tuple[Matrix, Matrix]:
    """Return the rows of J_f for the lower and for the upper legs of a machine whose balls coincide in pairs.

    `lower` and `upper` are the directions δ_bi and δ_ci, `a` and `a_m` the axes R_i1 and R_i2, all in {B}.
    """
    rates = stage_rates(b, a_m, a)
    # As seen from {B}, a motion of the platform carries the upper legs' planes, hence the b_i, along the R_i2.
    carried = force_row(a_m[0], b[0], o), force_row(a_m[1], b[1], o), force_row(a_m[2], b[2], o)
    (x1, x2, x3), (y1, y2, y3), (z1, z2, z3) = rates.free_rates
    free = (x1, y1, z1), (x2, y2, z2), (x3, y3, z3)
    first = _leg_rates(lower[0], upper[0], rates.w[0], rates.n[0], free[0], (1.0, 0.0, 0.0), carried)
    second = _leg_rates(lower[1], upper[1], rates.w[1], rates.n[1], free[1], (0.0, 1.0, 0.0), carried)
    third = _leg_rates(lower[2], upper[2], rates.w[2], rates.n[2], free[2], (0.0, 0.0, 1.0), carried)
    uppers = (
        _difference(force_row(upper[0], b[0], o), first[1]),
        _difference(force_row(upper[1], b[1], o), second[1]),
        _difference(force_row(upper[2], b[2], o), third[1]),
    )
    return (first[0], second[0], third[0]), uppers


def _leg_rates(
    lower: Vector, upper: Vector, w: Vector, n: Vector, free: Vector, unit: Vector, carried: Matrix
) -> tuple[Twist, Twist]:
    """Return the rates of b_i along both legs of a corner, as rows for the platform's twist."""
    along = combined(scaled(dot(lower, w), free), dot(lower, n), unit)
    across = combined(scaled(dot(upper, w), free), dot(upper, n), unit)
    return _combination(along, carried), _combination(across, carried)


def _combination(weights: Vector, rows: Matrix) -> Twist:
    forces, moments = (rows[0][0], rows[1][0], rows[2][0]), (rows[0][1], rows[1][1], rows[2][1])
    return weighted(weights, forces), weighted(weights, moments)


def _difference(first: Twist, second: Twist) -> Twist:
    return minus(first[0], second[0]), minus(first[1], second[1])


def inverse_jacobian(
    b: Rows, c: Rows, lower: Rows, upper: Rows, a: Rows, a_m: Rows, o: Vector
) -> tuple[Matrix, Matrix]:
    """Return what `drawn_inverse_jacobian` does where the upper legs' balls c_i are apart from the lower ones' b_i.

    The motions of the middle platform that the lower legs' structure leaves open are those of unit rates of the b_i
    along the R_i2; that of the upper legs takes its own three rates of them.
    """
    twists = stage_twists(b, a_m, a, o)
    carried = force_row(a_m[0], c[0], o), force_row(a_m[1], c[1], o), force_row(a_m[2], c[2], o)
    mixed = _rates(carried[0], twists), _rates(carried[1], twists), _rates(carried[2], twists)
    x, y, z = cross(mixed[1], mixed[2]), cross(mixed[2], mixed[0]), cross(mixed[0], mixed[1])
    scale = 1.0 / dot(mixed[0], x)
    columns = scaled(scale, x), scaled(scale, y), scaled(scale, z)
    lowers = (
        _combination(times(columns, _rates(force_row(lower[0], b[0], o), twists)), carried),
        _combination(times(columns, _rates(force_row(lower[1], b[1], o), twists)), carried),
        _combination(times(columns, _rates(force_row(lower[2], b[2], o), twists)), carried),
    )
    own = force_row(upper[0], c[0], o), force_row(upper[1], c[1], o), force_row(upper[2], c[2], o)
    uppers = (
        _difference(own[0], _combination(times(columns, _rates(own[0], twists)), carried)),
        _difference(own[1], _combination(times(columns, _rates(own[1], twists)), carried)),
        _difference(own[2], _combination(times(columns, _rates(own[2], twists)), carried)),
    )
    return lowers, uppers


def _rates(row: Twist, twists: Matrix) -> Vector:
    return power(twists[0], row), power(twists[1], row), power(twists[2], row)


def mixed_determinant(first: Matrix, second: Matrix) -> float:
    """Return the determinant of six forces as rows (f, m), three and three, by the expansion of Laplace."""
    f1, m1 = _columns(first[0][0], first[1][0], first[2][0]), _columns(first[0][1], first[1][1], first[2][1])
    f2, m2 = _columns(second[0][0], second[1][0], second[2][0]), _columns(second[0][1], second[1][1], second[2][1])
    f1_minors, m1_minors, f2_minors, m2_minors = _minors(f1), _minors(m1), _minors(f2), _minors(m2)
    both_forces = dot(f1[0], f1_minors[0]) * dot(m2[0], m2_minors[0])
    both_moments = dot(m1[0], m1_minors[0]) * dot(f2[0], f2_minors[0])
    total = both_forces - both_moments
    total = total - _sum_of_products(f1_minors, m1, f2, m2_minors)
    return total + _sum_of_products(f1, m1_minors, f2_minors, m2)


def _columns(a: Vector, b: Vector, c: Vector) -> Rows:
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


def _minors(columns: Rows) -> Rows:
    return cross(columns[1], columns[2]), cross(columns[2], columns[0]), cross(columns[0], columns[1])


def _sum_of_products(f1: Rows, m1: Rows, f2: Rows, m2: Rows) -> float:
    """Return the sum of (f1_i·m1_j)(f2_i·m2_j)."""
    first, second = dot(times(m1, f1[0]), times(m2, f2[0])), dot(times(m1, f1[1]), times(m2, f2[1]))
    return first + second + dot(times(m1, f1[2]), times(m2, f2[2]))


def arms(balls: Rows, p: Vector, side: float) -> Rows:
    """Return the lever arms of three balls about p in units of the middle platform's side."""
    unit = 1.0 / side
    return scaled(unit, minus(balls[0], p)), scaled(unit, minus(balls[1], p)), scaled(unit, minus(balls[2], p))


def may_be_singular(b: Rows, f: Rows, a: Rows, side: float, singular: float) -> bool:
    """Return whether the forces of a stage may be dependent: see `_is_suspect`."""
    about = arms(b, mean(b), side)
    size = _squared_size(about, f) + _squared_size(about, a)
    return _is_suspect(pair_determinant(pairs(about, normals(f, a))), size, singular)


def may_structure_be_singular(b: Rows, c: Rows, a: Rows, a_m: Rows, side: float, singular: float) -> bool:
    """Return whether the six constraints K may be dependent where the upper legs' balls are not the lower ones'."""
    lower, upper = arms(b, mean(b), side), arms(c, mean(b), side)
    size = _squared_size(lower, a) + _squared_size(upper, a_m)
    return _is_suspect(mixed_determinant(_rows(a, lower), _rows(a_m, upper)), size, singular)


def _rows(forces: Rows, about: Rows) -> Matrix:
    first, second = (forces[0], cross(about[0], forces[0])), (forces[1], cross(about[1], forces[1]))
    return first, second, (forces[2], cross(about[2], forces[2]))


def structure_determinant(b: Rows, c: Rows, a: Rows, a_m: Rows) -> float:
    """Return det K of any machine."""
    return mixed_determinant(_rows(a, b), _rows(a_m, c))


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
    x, y, z = cross(about[0], forces[0]), cross(about[1], forces[1]), cross(about[2], forces[2])
    own = dot(forces[0], forces[0]) + dot(forces[1], forces[1]) + dot(forces[2], forces[2])
    return own + dot(x, x) + dot(y, y) + dot(z, z)
