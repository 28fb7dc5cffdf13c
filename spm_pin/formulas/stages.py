"""The equations of one nominal 3RPS stage: `docs/theory/forward_displacement.md`.

A stage is three legs of given lengths from pivots at radius E, each in its pivot's vertical plane, to a triangle of
circumradius r. Lengths are in units of r: ε = E/r, ζ is the height of the triangle's centre, w = x1 + i x2 of its
quaternion, m the mean and λ the first harmonic of the squared leg lengths over the three azimuths, κ = 2ε - 1.

A state (x0, x1, x2, ζ) has the coordinates of its mode: in mode F, where r, ε and ζ are negative, x0 is the
quaternion's x3, and x1 + i x2 is i w.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.operations import COS_30, both, sqrt, where
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    dot,
    larger,
    largest,
    magnitude,
    scaled,
)

ModeState = tuple[float, float, float, float]
Pairs = tuple[float, float, float, float, float, float]
"""Quantities of the pairs of legs 12, 23, 31, 21, 32, 13."""

ANY_ASPECT, HOME_ASPECT = 0.0, 2.0
"""Numbers of a stage's aspects; 1 and -1 are all others with this sign of the determinant."""

EPS = 2.0**-52
"""The distance from 1 to the next larger double."""


class StageEquations(NamedTuple):
    """The constants of the equations f = 0 of a stage in one mode, in units of r."""

    epsilon: float  # E/r, negative in mode F
    level: float  # c = m - (1 - ε)², ζ² of the level triangle
    real: float  # λ
    imag: float
    scale: float  # size of the largest terms
    lengths: Vector


def stage_equations(first: float, second: float, third: float, epsilon: float) -> StageEquations:
    """Set up f = 0 for three leg lengths and ε, in units of r."""
    # Differences of squares as products: exact for equal legs.
    real, imag = _harmonic(
        (second - first) * (second + first), (second - third) * (second + third), (first - third) * (first + third)
    )
    mean = (first * first + second * second + third * third) / 3.0
    size = 1.0 + magnitude(epsilon)
    level = mean - (1.0 - epsilon) * (1.0 - epsilon)
    return StageEquations(epsilon, level, real, imag, mean + size * size, (first, second, third))


def _harmonic(second_first: float, second_third: float, first_third: float) -> tuple[float, float]:
    """Return the first Fourier coefficient of three numbers over the legs' azimuths, from their differences."""
    return (second_first + second_third) / 6.0, first_third * (COS_30 / 3.0)


def residual(stage: StageEquations, state: ModeState) -> Vector:
    """Return f: real and imaginary part of the equation for λ, and the equation for ζ²."""
    x0, x1, x2, zeta = state
    a, b, p = x1 * x1 - x2 * x2, 2.0 * x1 * x2, x1 * x1 + x2 * x2
    h, lift = 2.0 * stage.epsilon - x0 * x0, 2.0 * zeta * x0
    real = h * a + (a * a - b * b) + lift * x1 - stage.real
    imag = h * b - 2.0 * a * b - lift * x2 - stage.imag
    return real, imag, zeta * zeta + (2.0 * stage.epsilon + p) * p - stage.level


def residual_by_legs(stage: StageEquations, state: ModeState) -> Vector:
    """Return f from the errors of the squared lengths leg by leg, which is accurate for a short leg."""
    radii, heights = corners(state[0], state[1], state[2], 0.0, state[3])
    first = _error_of_square(radii[0] - stage.epsilon, heights[0], stage.lengths[0])
    second = _error_of_square(radii[1] - stage.epsilon, heights[1], stage.lengths[1])
    third = _error_of_square(radii[2] - stage.epsilon, heights[2], stage.lengths[2])
    real, imag = _harmonic(second - first, second - third, first - third)
    return real, imag, (first + second + third) / 3.0


def _error_of_square(x: float, z: float, length: float) -> float:
    return x * x + (z * z - length * length)


def derivatives(stage: StageEquations, state: ModeState) -> tuple[ModeState, ModeState, ModeState]:
    """Return the derivatives of f with respect to x0, x1, x2, ζ."""
    x0, x1, x2, zeta = state
    a, b = x1 * x1 - x2 * x2, 2.0 * x1 * x2
    h, lift = 2.0 * stage.epsilon - x0 * x0, 2.0 * zeta * x0
    u, v = 2.0 * (a * x1 - b * x2), 2.0 * (a * x2 + b * x1)
    slope = 4.0 * (stage.epsilon + x1 * x1 + x2 * x2)
    real = 2.0 * (zeta * x1 - x0 * a), 2.0 * (h * x1 + u) + lift, -2.0 * (h * x2 + v), 2.0 * x0 * x1
    imag = -2.0 * (zeta * x2 + x0 * b), 2.0 * (h * x2 - v), 2.0 * (h * x1 - u) - lift, -2.0 * x0 * x2
    return real, imag, (0.0, slope * x1, slope * x2, 2.0 * zeta)


def _tangents(state: ModeState) -> tuple[Vector, Vector]:
    """Return two orthonormal tangents of the sphere of quaternions, smooth for x0 >= 0."""
    x0, x1, x2, _ = state
    q = 1.0 / (1.0 + x0)
    return (-x1, 1.0 - q * x1 * x1, -q * x1 * x2), (-x2, -q * x1 * x2, 1.0 - q * x2 * x2)


def _along(row: ModeState, first: Vector, second: Vector) -> Vector:
    slope = row[0], row[1], row[2]
    return dot(slope, first), dot(slope, second), row[3]


def jacobian(stage: StageEquations, state: ModeState) -> Rows:
    """Return J, the derivatives of f along both tangents of the sphere of quaternions and along ζ."""
    first, second = _tangents(state)
    real, imag, height = derivatives(stage, state)
    return _along(real, first, second), _along(imag, first, second), _along(height, first, second)


def moved(state: ModeState, step: Vector) -> ModeState:
    """Return a state after a step along the tangents and ζ, normalised, with x0 >= 0."""
    first, second = _tangents(state)
    x = combined(combined((state[0], state[1], state[2]), step[0], first), step[1], second)
    # Both signs of a quaternion are the same rotation.
    x = scaled(where(x[0] < 0.0, -1.0, 1.0) / sqrt(dot(x, x)), x)
    return x[0], x[1], x[2], state[3] + step[2]


def inverse(rows: Rows) -> tuple[Rows, bool]:
    """Return the columns of the inverse of J by cofactors, finite even if it is singular, and whether it is."""
    first, second, third = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])
    determinant = dot(rows[0], first)
    size = larger(larger(1.0, largest(rows[0])), larger(largest(rows[1]), largest(rows[2])))
    least = EPS * EPS * size * size * size
    singular = magnitude(determinant) < least
    scale = 1.0 / where(singular, least, determinant)
    return (scaled(scale, first), scaled(scale, second), scaled(scale, third)), singular


def damped(step: Vector, longest: float) -> Vector:
    """Return a step scaled down so that it rotates by at most `longest` [rad] and changes ζ by at most 1."""
    excess = larger(larger(1.0, magnitude(step[0]) / longest), larger(magnitude(step[1]) / longest, magnitude(step[2])))
    return scaled(1.0 / excess, step)


def quartic(
    stage: StageEquations, size: float, x: float, y: float, omega: float, gain: float
) -> tuple[float, float, float, float, float]:
    """Return the coefficients of tan^j γ, j = 0..4, of the azimuths of the tilt, divided by |λ|.

    `size` is |λ|, x + iy is μ = e^{3i arg λ}, and gain = ω/κ; see `spm_pin.kinematics.kernels.mode_kernels`.
    """
    c, weight = stage.level, 2.0 * stage.epsilon + 1.0
    g = weight * weight + 4.0 * c
    w2, k2 = omega * omega, gain * gain
    second = (4.0 * size * x - g) * size * k2 + 12.0 * c * gain * omega * x - 3.0 * w2 * size * (x * x - y * y)
    fourth = (4.0 * size * size * k2 - 4.0 * size * w2 * x - g * w2) * size * k2
    return (
        -size * y * y,
        (4.0 * omega * size * x - 4.0 * gain * c) * y,
        second,
        (8.0 * size * size * k2 * omega + 12.0 * c * gain * w2 - 4.0 * w2 * omega * size * x) * y,
        fourth - 4.0 * c * gain * w2 * omega * x + w2 * w2 * size * x * x,
    )


def tilt_quadratic(stage: StageEquations, a: float, b: float, cos_three: float) -> Vector:
    """Return the coefficients of p², p, 1 for the tilt p = |w|² of one azimuth ψ.

    a = p sin 3ψ, b = Re(λ e^{iψ}), and `cos_three` is cos 3ψ.
    """
    kappa = 2.0 * stage.epsilon - 1.0
    square = 4.0 * (a * a + b * cos_three) - 4.0 * (2.0 * stage.epsilon + stage.level) - kappa * kappa
    linear = 4.0 * kappa * a * a + 4.0 * stage.level + 2.0 * kappa * b * cos_three
    return square, linear, kappa * a * (kappa * a) - b * b


def corners(x0: float, x1: float, x2: float, x3: float, zeta: float) -> tuple[Vector, Vector]:
    """Return radii and heights of the triangle's corners in the vertical planes of the legs, in units of r.

    The quaternion is that of mode T or F itself, ζ the height of the centre.
    """
    square_c, square_s = 2.0 * COS_30 * (2.0 * x1 * x2), x1 * x1 - x2 * x2
    radius = x0 * x0 - x3 * x3
    c, s = 2.0 * COS_30 * (x3 * x1 - x0 * x2), x0 * x1 + x3 * x2
    radii = radius - square_c + square_s, radius - 2.0 * square_s, radius + square_c + square_s
    return radii, (zeta + c - s, zeta + 2.0 * s, zeta - c - s)


def stage_pairs(radii: Vector, heights: Vector, base_radius: float) -> Pairs:
    """Return c_ij = (b_i - b_j)·w_i of a nominal stage, w_i = z_i u_i - (ρ_i - E) Z normal to leg i and to its axis.

    ρ_i and z_i are radius and height of b_i, u_i is the radial direction. These are `wrenches.pairs` for legs that are
    not divided by their lengths.
    """
    (p1, p2, p3), (z1, z2, z3) = radii, heights
    return (
        z1 * (p1 + 0.5 * p2) - (p1 - base_radius) * (z1 - z2),
        z2 * (p2 + 0.5 * p3) - (p2 - base_radius) * (z2 - z3),
        z3 * (p3 + 0.5 * p1) - (p3 - base_radius) * (z3 - z1),
        z2 * (p2 + 0.5 * p1) - (p2 - base_radius) * (z2 - z1),
        z3 * (p3 + 0.5 * p2) - (p3 - base_radius) * (z3 - z2),
        z1 * (p1 + 0.5 * p3) - (p1 - base_radius) * (z1 - z3),
    )


def pair_determinant(c: Pairs) -> float:
    """Return D = c12 c23 c31 + c21 c32 c13, minus the determinant of a stage's six forces, see `wrenches`."""
    return c[0] * c[1] * c[2] + c[3] * c[4] * c[5]


def pair_determinant_slope(c: Pairs, slopes: Pairs) -> float:
    """Return the derivative of D for these derivatives of the c_ij."""
    a, b = slopes[0] * c[1] * c[2] + slopes[1] * c[2] * c[0], slopes[3] * c[4] * c[5] + slopes[4] * c[5] * c[3]
    return a + slopes[2] * c[0] * c[1] + b + slopes[5] * c[3] * c[4]


def pair_inverse(c: Pairs) -> Rows:
    """Return the columns of the inverse of the matrix with the rows (c12, c21, 0), (0, c23, c32), (c13, 0, c31)."""
    scale, (first, second, third) = 1.0 / pair_determinant(c), pair_adjugate(c)
    return scaled(scale, first), scaled(scale, second), scaled(scale, third)


def pair_adjugate(c: Pairs) -> Rows:
    """Return D times the columns of `pair_inverse`."""
    c12, c23, c31, c21, c32, c13 = c
    first, second = (c23 * c31, c32 * c13, -(c23 * c13)), (-(c21 * c31), c12 * c31, c21 * c13)
    return first, second, (c21 * c32, -(c12 * c32), c12 * c23)


def is_home_aspect(c: Pairs) -> bool:
    """Return whether a stage is reached from equal legs without a forward singularity.

    The senses of the axes are such that all tangents of the nominal stage point the same way round. det J_b is D up to
    a positive factor, and all six c_ij are positive for equal legs. If D is positive, none, one, three or four of them
    are negative, never two: its sign alone does not determine the region, but together with this number it does.
    """
    return both(pair_determinant(c) > 0.0, negative_pairs(c) <= 1.0)


def negative_pairs(c: Pairs) -> float:
    """Return how many of the c_ij are negative."""
    return _sign_bit(c[0]) + _sign_bit(c[1]) + _sign_bit(c[2]) + _sign_bit(c[3]) + _sign_bit(c[4]) + _sign_bit(c[5])


def in_home_aspect(radii: Vector, heights: Vector, base_radius: float) -> bool:
    """Return whether a nominal stage is in its home assembly region."""
    return is_home_aspect(stage_pairs(radii, heights, base_radius))


def _sign_bit(x: float) -> float:
    return where(x < 0.0, 1.0, 0.0)


def cartesian(radii: Vector, heights: Vector) -> Rows:
    """Return in {B} the three points with these radii and heights in the vertical planes of the nominal legs."""
    p1, p2, p3 = radii
    first, second = (COS_30 * p1, -0.5 * p1, heights[0]), (0.0 * p2, p2, heights[1])
    return first, second, (-COS_30 * p3, -0.5 * p3, heights[2])
