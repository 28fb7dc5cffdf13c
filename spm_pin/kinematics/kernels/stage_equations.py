"""The equations of one 3RPS stage, and Newton's method on them, over scalars.

A stage is three legs of given lengths from hips at radius E, each in the vertical plane of its hip, to a triangle of
circumradius r. In units of r, with ε = E/r, the height ζ of the triangle's centre and its quaternion (x0, w),
w = x1 + i x2, the squared leg lengths of mode T have the mean m and the first harmonic λ,

    m = (x0² - ε)² + 2 |w|² + ζ²,      λ = (2ε - x0²) w² + conj(w)⁴ + 2 ζ x0 conj(w),

over the three azimuths. Mode F is the same with -r for r, x3 for x0 and i w for w. It follows that
Im(λ w) = κ Im(w³), κ = 2ε - 1: the tilt |w|² is a ratio of sines of the azimuth ψ of w. Put into the rest, all high
harmonics cancel and a trigonometric polynomial of degree two in 2ψ is left: at most four solutions per mode, each
with its mirror image below the hips. Derivation: `docs/theory/forward_displacement.md`.

A state (x0, x1, x2, ζ) has the coordinates of its mode: in mode F,
where r, ε and ζ are negative, x0 stands for the quaternion's x3, and x1 + i x2 for i w.
"""

from __future__ import annotations

import numpy as np

from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.quadratics import COS_30
from spm_pin.kinematics.kernels.vectors import Vector, combined, cross, dot, scaled

State = tuple[float, float, float, float]
Rows = tuple[Vector, Vector, Vector]
Equations = tuple[float, float, float, float, float, Vector]
"""ε = E/r, negative in mode F; c = m - (1 - ε)², ζ² of the level triangle; λ; the largest terms' size; the lengths."""

EPS = float(np.finfo(np.float64).eps)
"""The distance from 1 to the next larger double."""
SAME = float(4.0 * np.sqrt(EPS))
"""Solutions closer than this, in units of r, are one: rounding resolves a double root no better."""
NEAR = 1e3
"""Ratio of a solution's error to that of the leg lengths above which a fold or a family is near."""
_ROUNDING = 4.0 * EPS
"""Residual of a solution relative to the largest term of its equations; half of it has been seen."""
_MOST_STEPS = 40
_SHORT = 0.25
"""Leg length below which the equations, which are made of squares of all legs, lose digits."""


@jit_inline
def equations(first: float, second: float, third: float, epsilon: float) -> Equations:
    """Set up f = 0 for leg lengths and a signed hip radius in units of r."""
    # Differences of squares as products: exact where legs are equal.
    imag = (first - third) * (first + third) * (COS_30 / 3.0)
    real = ((second - first) * (second + first) + (second - third) * (second + third)) / 6.0
    mean = (first * first + second * second + third * third) / 3.0
    scale = mean + (1.0 + abs(epsilon)) ** 2
    return epsilon, mean - (1.0 - epsilon) ** 2, real, imag, scale, (first, second, third)


@jit_inline
def residual(stage: Equations, state: State) -> Vector:
    """Return f: the parts of the equation for λ, and the one for ζ²."""
    x0, x1, x2, zeta = state
    a, b, p = x1 * x1 - x2 * x2, 2.0 * x1 * x2, x1 * x1 + x2 * x2
    h, lift = 2.0 * stage[0] - x0 * x0, 2.0 * zeta * x0
    real = h * a + (a * a - b * b) + lift * x1 - stage[2]
    imag = h * b - 2.0 * a * b - lift * x2 - stage[3]
    return real, imag, zeta * zeta + (2.0 * stage[0] + p) * p - stage[1]


@jit_inline
def _residual_by_legs(stage: Equations, state: State) -> Vector:
    """Return f from the error of each leg's own square, which rounds no more than that square."""
    radii, heights = placed(state[0], state[1], state[2], 0.0, state[3])
    lengths = stage[5]
    first = (radii[0] - stage[0]) ** 2 + (heights[0] ** 2 - lengths[0] ** 2)
    second = (radii[1] - stage[0]) ** 2 + (heights[1] ** 2 - lengths[1] ** 2)
    third = (radii[2] - stage[0]) ** 2 + (heights[2] ** 2 - lengths[2] ** 2)
    real, imag = ((second - first) + (second - third)) / 6.0, (first - third) * (COS_30 / 3.0)
    return real, imag, (first + second + third) / 3.0


@jit_inline
def derivatives(stage: Equations, state: State) -> tuple[State, State, State]:
    """Return the derivatives of f with respect to x0, x1, x2, ζ."""
    x0, x1, x2, zeta = state
    a, b = x1 * x1 - x2 * x2, 2.0 * x1 * x2
    h, lift = 2.0 * stage[0] - x0 * x0, 2.0 * zeta * x0
    u, v = 2.0 * (a * x1 - b * x2), 2.0 * (a * x2 + b * x1)
    slope = 4.0 * (stage[0] + x1 * x1 + x2 * x2)
    real = 2.0 * (zeta * x1 - x0 * a), 2.0 * (h * x1 + u) + lift, -2.0 * (h * x2 + v), 2.0 * x0 * x1
    imag = -2.0 * (zeta * x2 + x0 * b), 2.0 * (h * x2 - v), 2.0 * (h * x1 - u) - lift, -2.0 * x0 * x2
    return real, imag, (0.0, slope * x1, slope * x2, 2.0 * zeta)


@jit_inline
def _tangents(state: State) -> tuple[Vector, Vector]:
    """Return two orthonormal tangents of the sphere of quaternions, smooth for x0 >= 0."""
    x0, x1, x2, _ = state
    q = 1.0 / (1.0 + x0)
    return (-x1, 1.0 - q * x1 * x1, -q * x1 * x2), (-x2, -q * x1 * x2, 1.0 - q * x2 * x2)


@jit_inline
def _along(row: State, first: Vector, second: Vector) -> Vector:
    slope = row[0], row[1], row[2]
    return dot(slope, first), dot(slope, second), row[3]


@jit_inline
def _jacobian(stage: Equations, state: State) -> Rows:
    """Return J, the derivatives of f along both tangents and along ζ."""
    first, second = _tangents(state)
    real, imag, height = derivatives(stage, state)
    return _along(real, first, second), _along(imag, first, second), _along(height, first, second)


@jit_inline
def _moved(state: State, step: Vector) -> State:
    """Move a state by a step along the tangents and ζ, back onto the sphere, with x0 >= 0."""
    first, second = _tangents(state)
    x = combined(combined((state[0], state[1], state[2]), step[0], first), step[1], second)
    length = np.sqrt(dot(x, x))
    # Both signs of a quaternion are one rotation.
    x = scaled(-1.0 / length if x[0] < 0.0 else 1.0 / length, x)
    return x[0], x[1], x[2], state[3] + step[2]


@jit_inline
def _largest(a: Vector) -> float:
    return max(abs(a[0]), abs(a[1]), abs(a[2]))


@jit_inline
def _inverse(rows: Rows) -> tuple[Rows, bool]:
    """Return the columns of the inverse by cofactors, finite even if it is singular, and whether it is."""
    first, second, third = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])
    determinant = dot(rows[0], first)
    size = max(1.0, _largest(rows[0]), _largest(rows[1]), _largest(rows[2]))
    least = EPS * EPS * size * size * size
    singular = abs(determinant) < least
    scale = 1.0 / (least if singular else determinant)
    return (scaled(scale, first), scaled(scale, second), scaled(scale, third)), singular


@jit_inline
def _times(columns: Rows, x: Vector) -> Vector:
    return combined(combined(scaled(x[0], columns[0]), x[1], columns[1]), x[2], columns[2])


@jit
def polished(stage: Equations, start: State) -> tuple[State, float, bool]:
    """Bring an approximate solution to rounding by Newton's method.

    Parameters
    ----------
    stage : Equations
        What to solve.
    start : State
        A unit quaternion with x0 >= 0, and ζ.

    Returns
    -------
    state : State
        Where it ended, brought to ζ >= 0 by reflection.
    gain : float
        By how much more, at most, it errs than the leg lengths, both relative to their size.
    arrived : bool
        Whether that is a solution.
    """
    state, gain = start, 0.0
    for _ in range(_MOST_STEPS):
        error = residual(stage, state)
        columns, singular = _inverse(_jacobian(stage, state))
        step = scaled(-1.0, _times(columns, error))
        square = dot(columns[0], columns[0]) + dot(columns[1], columns[1]) + dot(columns[2], columns[2])
        gain = 1.0 / EPS if singular else np.sqrt(square) * stage[4]
        length, off = np.sqrt(dot(step, step)), _largest(error) / stage[4]
        # Beside a fold or a family, a step no longer than its own rounding leads nowhere better.
        if length <= 8.0 * EPS * gain and gain > NEAR and off <= _ROUNDING:
            break
        state = _moved(state, scaled(1.0 / max(1.0, abs(step[0]) / 0.3, abs(step[1]) / 0.3, abs(step[2])), step))
        # What a step leaves is its square, divided by the distance to the fold.
        if length * length * max(gain, 1.0) <= EPS or off <= EPS:
            break
    arrived = _largest(residual(stage, state)) <= _ROUNDING * stage[4]
    if arrived and min(stage[5]) < _SHORT:
        columns, _ = _inverse(_jacobian(stage, state))
        step = scaled(-1.0, _times(columns, _residual_by_legs(stage, state)))
        if np.sqrt(dot(step, step)) <= 8.0 * EPS * gain:  # rounding, and nothing else
            state = _moved(state, step)
    if state[3] < 0.0:
        state = state[0], -state[1], -state[2], -state[3]
    return state, gain, arrived


@jit_inline
def _direction(a: Vector) -> Vector:
    return scaled(1.0 / max(np.sqrt(dot(a, a)), EPS), a)


@jit_inline
def _longest(rows: Rows) -> Vector:
    first, second, third = dot(rows[0], rows[0]), dot(rows[1], rows[1]), dot(rows[2], rows[2])
    if first >= second and first >= third:
        return _direction(rows[0])
    return _direction(rows[1] if second >= third else rows[2])


@jit
def other_side_of_fold(stage: Equations, state: State) -> State:
    """Return where the other solution is of a pair that is about to meet.

    Along the direction n that hardly changes f, its part l·f that J hardly reaches is a quadratic.
    """
    rows = _jacobian(stage, state)
    columns, _ = _inverse(rows)
    n = _longest(columns)
    left = _longest(
        (
            (columns[0][0], columns[1][0], columns[2][0]),
            (columns[0][1], columns[1][1], columns[2][1]),
            (columns[0][2], columns[1][2], columns[2][2]),
        )
    )
    slope = left[0] * dot(rows[0], n) + left[1] * dot(rows[1], n) + left[2] * dot(rows[2], n)
    h = 1e-4
    ahead, behind = residual(stage, _moved(state, scaled(h, n))), residual(stage, _moved(state, scaled(-h, n)))
    curvature = (dot(left, ahead) + dot(left, behind)) / (2.0 * h * h)
    distance = 0.0 if curvature == 0.0 else -slope / curvature
    return _moved(state, scaled(min(max(distance, -0.1), 0.1), n))


@jit_inline
def placed(x0: float, x1: float, x2: float, x3: float, zeta: float) -> tuple[Vector, Vector]:
    """Return radii and heights of the triangle's corners in the vertical planes of the legs, in units of r.

    The quaternion is that of mode T or F itself, ζ the height of the centre.
    """
    square_c, square_s = 2.0 * COS_30 * (2.0 * x1 * x2), x1 * x1 - x2 * x2
    radius = x0 * x0 - x3 * x3
    c, s = 2.0 * COS_30 * (x3 * x1 - x0 * x2), x0 * x1 + x3 * x2
    radii = radius - square_c + square_s, radius - 2.0 * square_s, radius + square_c + square_s
    return radii, (zeta + c - s, zeta + 2.0 * s, zeta - c - s)


@jit_inline
def in_home_aspect(radii: Vector, heights: Vector, hips: float) -> bool:
    """Return whether a solution is reached from equal legs without a forward singularity.

    With c_ij = (b_i - b_j)·w_i, w_i normal to leg i and to its revolute axis, det J_b is c12 c23 c31 + c21 c32 c13
    up to a positive factor, and all six are positive at equal legs. Where the sum is positive, none, one, three or
    four of them are negative, never two: its sign alone does not tell the aspect, but together with this it does.
    """
    # w_i = z_i u_i - (ρ_i - E) Z, and u_i·u_j = -1/2.
    c12, c13 = _pair(radii, heights, hips, 0, 1), _pair(radii, heights, hips, 0, 2)
    c23, c21 = _pair(radii, heights, hips, 1, 2), _pair(radii, heights, hips, 1, 0)
    c31, c32 = _pair(radii, heights, hips, 2, 0), _pair(radii, heights, hips, 2, 1)
    negative = _sign_bit(c12) + _sign_bit(c13) + _sign_bit(c23) + _sign_bit(c21) + _sign_bit(c31) + _sign_bit(c32)
    return (c12 * c23 * c31 + c21 * c32 * c13 > 0.0) & (negative <= 1.0)


@jit_inline
def _pair(radii: Vector, heights: Vector, hips: float, i: int, j: int) -> float:
    return heights[i] * (radii[i] + 0.5 * radii[j]) - (radii[i] - hips) * (heights[i] - heights[j])


@jit_inline
def _sign_bit(x: float) -> float:
    return 1.0 if x < 0.0 else 0.0
