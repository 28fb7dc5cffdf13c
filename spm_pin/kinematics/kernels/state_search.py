"""States of six legs by the coordinates of both stages, and damped least squares over them.

A stage is three legs, each of which keeps its ball in a plane. Its middle platform has three freedoms: (x, y), two
components of the unit quaternion (x0, x, y, x3), and the height Z of the triangle's centre, divided by its radius r.
The three planes give x3 and the centre's other coordinates: zero and (-2r xy, r (y² - x²)) in the machine as drawn, and
a few steps of Newton's method from there in one as built. So a state exists for all (x, y) in the unit circle, and
poses, readings and determinants are smooth functions of the coordinates. See `docs/theory/reachable_set.md`.

The upper stage is the same seen from {m}. A stage of mode F has its balls turned by half a turn about the platform's
normal, see `Machine`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.formulas.stages import pair_determinant
from spm_pin.kinematics.formulas.vectors import Rows
from spm_pin.kinematics.formulas.wrenches import pairs
from spm_pin.kinematics.kernels.compilation import jit, kernel
from spm_pin.mechanism.arguments import FloatArray

AXIS, PIVOT, BALL, OFFSET, LEG_NUMBERS = 0, 3, 6, 9, 10
"""Places of a leg's numbers in a row of `legs`, and how many there are."""
ROTATION, CENTRE, READINGS, DETERMINANT, STAGE_NUMBERS = 0, 9, 12, 15, 16
"""Places of a stage's rotation, centre [m], readings [m] and determinant in `values`, and their number."""
NO_STATE, OTHER_ASPECT, BEYOND, INSIDE = 0, 1, 2, 3
"""Where a stage is: nowhere, in another aspect, slightly beyond a forward singularity, or in the wanted aspect."""
ANY_ASPECT, HOME_ASPECT = 0.0, 2.0
"""The aspects wanted of a stage, beside 1 and -1: any with this sign of the determinant."""
_BEYOND = -0.05
"""Determinant down to which a search may step beyond a forward singularity; it is about 1 at home."""

_LEAST_DETERMINANT = 1e-12
"""Least determinant of a state that is taken to be on this side of a forward singularity."""

GAUSS_NEWTON, NEWTON = 0, 1
_STEPS = (40, 120)
"""Steps of a search at most, of both methods."""
_GRADIENT = (1e-6, 1e-9)
"""Gradient of half the squared residual norm, over that norm, at which a state is stationary."""
_STALL_STEPS = 8
_LEAST_DECREASE = (1e-3, 1e-6)
"""Relative decrease of the residual norm in `_STALL_STEPS` steps, below which a search ends."""
_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e-13, 1e3
"""Damping of the first step, relative to the matrix, its least value, and the one at which a search ends."""
_DIFFERENCE = 1e-4
"""Step in the coordinates for second derivatives."""
RESOLUTION = 1e-9
"""Distances are found to this share of the machine's size."""
_DOUBT = 1e-4
"""Residual norm, over the size, up to which a search that has stalled leaves its point undecided."""
_SAME_STATE = 1e-6
"""Distance, over the size, by which a state may move when its readings are put within the limits."""
_PENALTY_WEIGHTS = (1.0, 3.0, 10.0)
"""Penalty weights of the first minimisation, of the second and of the further ones."""
_REMOTE_PENALTY = 1000.0
"""Growth of the squared penalty weight with the distance from the target, per machine's size of distance."""
_UPDATES, _RESTART = 30, 10
"""Updates of the multipliers at most, and those after which the first penalty weight comes again."""
_MULTIPLIER_TOLERANCE = 1e-13
"""Change of the shifts, over the size, at which the multipliers have converged."""
_MOST_STEPS = 400
"""Newton steps for one target at most."""
_EPS = float(np.finfo(np.float64).eps)

IntArray = npt.NDArray[np.int64]
Machine = tuple[FloatArray, float, float, FloatArray, FloatArray, FloatArray, FloatArray]
"""Legs (2, 3, 10) of both stages, r [m], the machine's size [m], the aspects wanted (2,), points of the body (K, 3)
in {m} [m], the diagonal of the half turn between stages of different modes (3,), and limits (2, 8): of six readings [m]
and of both determinants times the size."""
State = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Values (2, 16) and slopes (2, 16, 3) of both stages, residual (3K + 8,) and its Jacobian (3K + 8, 6): errors of the
points, violations of the limits of readings and determinants."""


@jit
def _put_rotation(w: float, x: float, y: float, s: float, values: FloatArray) -> None:
    """Write the rotation of the unit quaternion (w, x, y, s)."""
    values[0], values[1], values[2] = 1.0 - 2.0 * (y * y + s * s), 2.0 * (x * y - w * s), 2.0 * (x * s + w * y)
    values[3], values[4], values[5] = 2.0 * (x * y + w * s), 1.0 - 2.0 * (x * x + s * s), 2.0 * (y * s - w * x)
    values[6], values[7], values[8] = 2.0 * (x * s - w * y), 2.0 * (y * s + w * x), 1.0 - 2.0 * (x * x + y * y)


@jit
def _put_turn(
    w: float, x: float, y: float, s: float, dw: float, dx: float, dy: float, ds: float, slope: FloatArray
) -> None:
    """Write the derivative of the rotation of (w, x, y, s), which changes by (dw, dx, dy, ds)."""
    slope[0], slope[4], slope[8] = -4.0 * (y * dy + s * ds), -4.0 * (x * dx + s * ds), -4.0 * (x * dx + y * dy)
    xy, ws, xs = dx * y + x * dy, dw * s + w * ds, dx * s + x * ds
    wy, ys, wx = dw * y + w * dy, dy * s + y * ds, dw * x + w * dx
    slope[1], slope[2], slope[5] = 2.0 * (xy - ws), 2.0 * (xs + wy), 2.0 * (ys - wx)
    slope[3], slope[6], slope[7] = 2.0 * (xy + ws), 2.0 * (xs - wy), 2.0 * (ys + wx)


@jit
def _solve_3(m: FloatArray, right: FloatArray) -> None:
    """Replace `right` (3,) by the solution with the matrix (3, 3), by Cramer's rule; not finite where singular."""
    a, b, c = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1], m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2], 0.0
    c = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    determinant = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
    p, q, t = right[0], right[1], right[2]
    right[0] = (
        p * a + q * (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) + t * (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1])
    ) / determinant
    right[1] = (
        p * b + q * (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) + t * (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2])
    ) / determinant
    right[2] = (
        p * c + q * (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) + t * (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
    ) / determinant


@jit
def evaluate_stage(
    coordinates: FloatArray,
    legs: FloatArray,
    radius: float,
    upward: float,
    aspect: float,
    values: FloatArray,
    slopes: FloatArray,
    work: FloatArray,
) -> int:
    """Write the `values` (16,) of a stage and their derivatives `slopes` (16, 3); return where the stage is.

    `legs` (3, 10) are in the frame of its end, `upward` is the sign of Z at home, `work` (12, 3, 3) is for intermediate
    results.
    """
    x, y = coordinates[0], coordinates[1]
    if not x * x + y * y < 1.0:
        return NO_STATE
    s = 0.0
    values[CENTRE], values[CENTRE + 1] = -2.0 * radius * x * y, radius * (y * y - x * x)
    values[CENTRE + 2] = radius * coordinates[2]
    planes, right, turn = work[0], work[1], work[2].reshape(9)
    balls, normals = work[3], work[4]
    tolerance = 4.0 * _EPS * (radius + abs(values[CENTRE + 2]))
    for iteration in range(12):
        w2 = 1.0 - x * x - y * y - s * s
        if not w2 > 0.0:
            return NO_STATE
        w = math.sqrt(w2)
        _put_rotation(w, x, y, s, values)
        _put_turn(w, x, y, s, -s / w, 0.0, 0.0, 1.0, turn)
        largest = 0.0
        for i in range(3):
            gap, change = 0.0, 0.0
            for j in range(3):
                ball, moved = values[CENTRE + j], 0.0
                for k in range(3):
                    ball += values[3 * j + k] * legs[i, BALL + k]
                    moved += turn[3 * j + k] * legs[i, BALL + k]
                balls[i, j] = ball
                gap += legs[i, AXIS + j] * (ball - legs[i, PIVOT + j])
                change += legs[i, AXIS + j] * moved
            planes[i, 0], planes[i, 1], planes[i, 2] = change, legs[i, AXIS], legs[i, AXIS + 1]
            right[0, i] = -gap
            largest = max(largest, abs(gap))
        if largest <= tolerance or iteration == 11:
            break
        _solve_3(planes, right[0])
        s += right[0, 0]
        values[CENTRE] += right[0, 1]
        values[CENTRE + 1] += right[0, 2]
    if not largest <= 1e-9 * (radius + abs(values[CENTRE + 2])):
        return NO_STATE
    for k in range(3):
        dx, dy = (1.0 if k == 0 else 0.0), (1.0 if k == 1 else 0.0)
        height = radius if k == 2 else 0.0
        _put_turn(w, x, y, s, -(x * dx + y * dy) / w, dx, dy, 0.0, turn)
        for i in range(3):
            change = legs[i, AXIS + 2] * height
            for j in range(3):
                for m in range(3):
                    change += legs[i, AXIS + j] * turn[3 * j + m] * legs[i, BALL + m]
            right[0, i] = -change
        _solve_3(planes, right[0])
        ds = right[0, 0]
        _put_turn(w, x, y, s, -(x * dx + y * dy + s * ds) / w, dx, dy, ds, turn)
        for m in range(9):
            slopes[m, k] = turn[m]
        slopes[CENTRE, k], slopes[CENTRE + 1, k], slopes[CENTRE + 2, k] = right[0, 1], right[0, 2], height
    ball_slopes, normal_slopes = work[5:8], work[8:11]
    for i in range(3):
        square = 0.0
        for j in range(3):
            square += (balls[i, j] - legs[i, PIVOT + j]) ** 2
        length = math.sqrt(square)
        values[READINGS + i] = length + legs[i, OFFSET]
        a0, a1, a2 = legs[i, AXIS], legs[i, AXIS + 1], legs[i, AXIS + 2]
        u0, u1, u2 = balls[i, 0] - legs[i, PIVOT], balls[i, 1] - legs[i, PIVOT + 1], balls[i, 2] - legs[i, PIVOT + 2]
        u0, u1, u2 = upward * u0 / length, upward * u1 / length, upward * u2 / length
        normals[i, 0], normals[i, 1], normals[i, 2] = a1 * u2 - a2 * u1, a2 * u0 - a0 * u2, a0 * u1 - a1 * u0
        for k in range(3):
            for j in range(3):
                moved = slopes[CENTRE + j, k]
                for m in range(3):
                    moved += slopes[3 * j + m, k] * legs[i, BALL + m]
                ball_slopes[k, i, j] = moved
            d0, d1, d2 = ball_slopes[k, i, 0], ball_slopes[k, i, 1], ball_slopes[k, i, 2]
            along = u0 * d0 + u1 * d1 + u2 * d2
            slopes[READINGS + i, k] = upward * along
            v0, v1, v2 = (
                upward * (d0 - along * u0) / length,
                upward * (d1 - along * u1) / length,
                upward * (d2 - along * u2) / length,
            )
            normal_slopes[k, i, 0] = a1 * v2 - a2 * v1
            normal_slopes[k, i, 1] = a2 * v0 - a0 * v2
            normal_slopes[k, i, 2] = a0 * v1 - a1 * v0
    return _put_determinant(radius, aspect, upward * coordinates[2], values, slopes, work)


@jit
def _rows(matrix: FloatArray) -> Rows:
    return (
        (matrix[0, 0], matrix[0, 1], matrix[0, 2]),
        (matrix[1, 0], matrix[1, 1], matrix[1, 2]),
        (matrix[2, 0], matrix[2, 1], matrix[2, 2]),
    )


@jit
def _put_determinant(
    radius: float, aspect: float, height: float, values: FloatArray, slopes: FloatArray, work: FloatArray
) -> int:
    """Write D of the balls and the normals w_i in `work`, over its size at home; return where the stage is."""
    b, w = _rows(work[3]), _rows(work[4])
    # At home all six c_ij are 3/2 r times the sine of the legs' slope.
    unit = 1.0 / (6.75 * radius * radius * radius)
    if aspect == 1.0 or aspect == -1.0:
        unit *= aspect
    c = pairs(b, w)
    values[DETERMINANT] = unit * pair_determinant(c)
    for k in range(3):
        by_balls, by_normals = pairs(_rows(work[5 + k]), w), pairs(b, _rows(work[8 + k]))
        slope = 0.0
        for i in range(6):
            first = 3 * (i // 3)
            others = c[first + (i + 1) % 3] * c[first + (i + 2) % 3]
            slope += (by_balls[i] + by_normals[i]) * others
        slopes[DETERMINANT, k] = unit * slope
    negative = 0
    for i in range(6):
        if c[i] < 0.0:
            negative += 1
    if aspect == ANY_ASPECT:
        return INSIDE
    if aspect == HOME_ASPECT and not (height > 0.0 and negative <= 1):
        return OTHER_ASPECT
    if values[DETERMINANT] > 0.0:
        return INSIDE
    return BEYOND if values[DETERMINANT] > _BEYOND else OTHER_ASPECT


@jit
def _put_points(
    values: FloatArray,
    slopes: FloatArray,
    body: FloatArray,
    between: FloatArray,
    points: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write the positions of points `body` (K, 3) of {m} in {B}, (3K,), and their derivatives, (3K, 6), over √K.

    A point is at t_a + R_a s, s = R_bᵀ (p - t_b) being where it is seen from the middle platform; `between` (3,) is the
    diagonal of the half turn that is left between stages of different modes.
    """
    scale = 1.0 / math.sqrt(len(body))
    lower, upper, by_lower, by_upper = values[0], values[1], slopes[0], slopes[1]
    for n in range(len(body)):
        g0, g1, g2 = body[n, 0] - upper[9], body[n, 1] - upper[10], body[n, 2] - upper[11]
        s0 = between[0] * (upper[0] * g0 + upper[3] * g1 + upper[6] * g2)
        s1 = between[1] * (upper[1] * g0 + upper[4] * g1 + upper[7] * g2)
        s2 = between[2] * (upper[2] * g0 + upper[5] * g1 + upper[8] * g2)
        for i in range(3):
            a, b, c = lower[3 * i], lower[3 * i + 1], lower[3 * i + 2]
            points[3 * n + i] = scale * (lower[9 + i] + a * s0 + b * s1 + c * s2)
        for k in range(3):
            h0, h1, h2 = by_upper[9, k], by_upper[10, k], by_upper[11, k]
            d0 = by_upper[0, k] * g0 + by_upper[3, k] * g1 + by_upper[6, k] * g2
            d1 = by_upper[1, k] * g0 + by_upper[4, k] * g1 + by_upper[7, k] * g2
            d2 = by_upper[2, k] * g0 + by_upper[5, k] * g1 + by_upper[8, k] * g2
            d0 = between[0] * (d0 - upper[0] * h0 - upper[3] * h1 - upper[6] * h2)
            d1 = between[1] * (d1 - upper[1] * h0 - upper[4] * h1 - upper[7] * h2)
            d2 = between[2] * (d2 - upper[2] * h0 - upper[5] * h1 - upper[8] * h2)
            for i in range(3):
                row = 3 * n + i
                turned = by_lower[3 * i, k] * s0 + by_lower[3 * i + 1, k] * s1 + by_lower[3 * i + 2, k] * s2
                jacobian[row, k] = scale * (by_lower[9 + i, k] + turned)
                jacobian[row, 3 + k] = scale * (lower[3 * i] * d0 + lower[3 * i + 1] * d1 + lower[3 * i + 2] * d2)


@jit
def _put_limits(
    values: FloatArray,
    slopes: FloatArray,
    size: float,
    limits: FloatArray,
    weight: float,
    shifts: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    fixed: bool,
) -> None:
    """Write the violations (8,) of the limits of six readings and two determinants, and their derivatives (8, 6).

    With `fixed` the residual stays, and derivatives are those of the rows that are not zero.
    """
    for row in range(8):
        stage, place = (row // 3, READINGS + row % 3) if row < 6 else (row - 6, DETERMINANT)
        unit = 1.0 if row < 6 else size
        if not fixed:
            value = unit * values[stage, place] + shifts[row]
            residual[row] = weight * (value - min(max(value, limits[0, row]), limits[1, row]))
        for k in range(6):
            jacobian[row, k] = 0.0
        if residual[row] != 0.0:
            for k in range(3):
                jacobian[row, 3 * stage + k] = weight * unit * slopes[stage, place, k]


@jit
def _put_gradient(jacobian: FloatArray, residual: FloatArray, gradient: FloatArray) -> float:
    """Write the gradient (6,) of half the squared residual norm; return its largest component."""
    largest = 0.0
    for k in range(6):
        total = 0.0
        for row in range(len(residual)):
            total += jacobian[row, k] * residual[row]
        gradient[k] = total
        largest = max(largest, abs(total))
    return largest


@jit
def _norm(residual: FloatArray) -> float:
    total = 0.0
    for value in residual:
        total += value * value
    return math.sqrt(total)


@jit
def _solve_damped(matrix: FloatArray, right: FloatArray, damping: float, step: FloatArray, factor: FloatArray) -> bool:
    """Write (M + damping · trace(|M|) · I)⁻¹ right by Cholesky's method; False where that is not positive definite."""
    trace = 0.0
    for i in range(6):
        trace += abs(matrix[i, i])
    if not (trace > 0.0 and trace < np.inf):
        return False
    for i in range(6):
        for j in range(i + 1):
            total = matrix[i, j]
            if i == j:
                total += damping * trace
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 1e-14 * trace * damping:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(6):
        total = right[i]
        for k in range(i):
            total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    for i in range(5, -1, -1):
        total = step[i]
        for k in range(i + 1, 6):
            total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return True


@jit
def _evaluate(
    machine: Machine,
    coordinates: FloatArray,
    target: FloatArray,
    weight: float,
    shifts: FloatArray,
    state: State,
    work: FloatArray,
) -> int:
    """Write the stages, the residual and its Jacobian at coordinates (2, 3); return where the worse stage is."""
    legs, radius, size, aspects, body, between, limits = machine
    values, slopes, residual, jacobian = state
    worst, rows = INSIDE, len(target)
    for stage in range(2):
        upward = 1.0 - 2.0 * stage
        place = evaluate_stage(
            coordinates[stage], legs[stage], radius, upward, aspects[stage], values[stage], slopes[stage], work
        )
        worst = min(worst, place)
        if worst < BEYOND:
            return worst
    _put_points(values, slopes, body, between, residual, jacobian)
    for row in range(rows):
        residual[row] -= target[row]
    _put_limits(values, slopes, size, limits, weight, shifts, residual[rows:], jacobian[rows:], False)
    return worst


@jit
def _put_curvature(
    machine: Machine,
    coordinates: FloatArray,
    weight: float,
    shifts: FloatArray,
    state: State,
    trial: State,
    matrix: FloatArray,
    work: FloatArray,
) -> bool:
    """Write the residual times its second derivatives (6, 6), by differences of the gradient; False beyond the circle.

    Each of them changes one stage.
    """
    legs, radius, size, aspects, body, between, limits = machine
    values, slopes, residual = state[0], state[1], state[2]
    other_values, other_slopes, points, other_jacobian = trial
    rows = len(residual) - 8
    gradient, place = work[12].reshape(9)[:6], work[13, 0]
    for stage in range(2):
        other_values[:], other_slopes[:] = values, slopes
        for k in range(3):
            row = 3 * stage + k
            for j in range(6):
                matrix[row, j] = 0.0
            for sign in (1.0, -1.0):
                place[:] = coordinates[stage]
                place[k] += sign * _DIFFERENCE
                upward = 1.0 - 2.0 * stage
                where = evaluate_stage(
                    place, legs[stage], radius, upward, aspects[stage], other_values[stage], other_slopes[stage], work
                )
                if where == NO_STATE:
                    return False
                _put_points(other_values, other_slopes, body, between, points, other_jacobian)
                _put_limits(
                    other_values,
                    other_slopes,
                    size,
                    limits,
                    weight,
                    shifts,
                    residual[rows:],
                    other_jacobian[rows:],
                    True,
                )
                _put_gradient(other_jacobian, residual, gradient)
                for j in range(6):
                    matrix[row, j] += sign * gradient[j] / (2.0 * _DIFFERENCE)
    for i in range(6):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = 0.5 * (matrix[i, j] + matrix[j, i])
    return True


@jit
def _minimise(
    machine: Machine,
    coordinates: FloatArray,
    target: FloatArray,
    weight: float,
    shifts: FloatArray,
    method: int,
    most: int,
    state: State,
    trial: State,
    work: FloatArray,
) -> tuple[bool, int]:
    """Minimise the residual norm from `coordinates` (2, 3); return whether it is stationary there, and the steps taken.

    `state` is that at the coordinates, before and after. Damped steps, none of which leaves the wanted aspect, until
    the gradient is small, the residual vanishes, or hardly decreases any more.
    """
    size, (values, slopes, residual, jacobian) = machine[2], state
    other_values, other_slopes, other_residual, other_jacobian = trial
    gradient, flatter = np.empty(6), np.empty(6)
    matrix, factor, step, there = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty((2, 3))
    damping, norm = _DAMPING, _norm(residual)
    largest, before, rounding = _put_gradient(jacobian, residual, gradient), norm, 4.0 * _EPS * size
    fresh = True
    for count in range(1, most + 1):
        stationary = largest <= _GRADIENT[method] * norm
        if stationary or norm <= 1e-3 * RESOLUTION * size or damping >= _LARGEST_DAMPING:
            return stationary, count
        if count % _STALL_STEPS == 0:
            # Newton's method near a solution is faster than that.
            if norm > (1.0 - _LEAST_DECREASE[method]) * before:
                return stationary, count
            before = norm
        if fresh:
            if method != NEWTON or not _put_curvature(machine, coordinates, weight, shifts, state, trial, matrix, work):
                matrix[:] = 0.0
            for i in range(6):
                for j in range(i + 1):
                    for row in range(len(residual)):
                        matrix[i, j] += jacobian[row, i] * jacobian[row, j]
            fresh = False
        if not _solve_damped(matrix, gradient, damping, step, factor):
            damping *= 10.0
            continue
        for k in range(6):
            there[k // 3, k % 3] = coordinates[k // 3, k % 3] - step[k]
        better = False
        if _evaluate(machine, there, target, weight, shifts, trial, work) >= BEYOND:
            # At the end, what a step gains is less than the norm's rounding.
            change = _norm(other_residual) - norm
            steepest = _put_gradient(other_jacobian, other_residual, flatter)
            better = change < -rounding or (change < rounding and steepest < largest)
        if better:
            coordinates[:], values[:], slopes[:] = there, other_values, other_slopes
            residual[:], jacobian[:] = other_residual, other_jacobian
            norm, largest = _norm(residual), _put_gradient(jacobian, residual, gradient)
            damping, fresh = max(0.1 * damping, _LEAST_DAMPING), True
        else:
            damping *= 10.0
    return largest <= _GRADIENT[method] * norm, most


@jit
def _snap(
    machine: Machine,
    coordinates: FloatArray,
    target: FloatArray,
    shifts: FloatArray,
    state: State,
    tolerance: float,
    readings: FloatArray,
    work: FloatArray,
) -> bool:
    """Put the readings of the state at `coordinates` within the limits; False if it is not in the wanted aspect then.

    Or if it is farther from its `target` than before by more than `tolerance` [m]. Writes the readings (6,); a leg
    whose shift is not zero pushes against its limit, and is at it.
    """
    size, limits, rows = machine[2], machine[6], len(target)
    step, zeros, gap, before, last = np.empty(3), np.zeros(8), np.inf, 0.0, False
    for iteration in range(14):
        place = _evaluate(machine, coordinates, target, 1.0, zeros, state, work)
        if place < BEYOND:
            return False
        values, slopes = state[0], state[1]
        if iteration == 0:
            before = _norm(state[2][:rows])
            for i in range(6):
                reading = values[i // 3, READINGS + i % 3]
                if reading <= limits[0, i] + 64.0 * _EPS * size or shifts[i] < 0.0:
                    reading = limits[0, i]
                if reading >= limits[1, i] - 64.0 * _EPS * size or shifts[i] > 0.0:
                    reading = limits[1, i]
                readings[i] = reading
        if last:
            # Nearer to a singularity rounding decides on which side of it the state is.
            certain = place == INSIDE and min(values[0, DETERMINANT], values[1, DETERMINANT]) > _LEAST_DETERMINANT
            return (certain or machine[3][0] == ANY_ASPECT) and _norm(state[2][:rows]) <= before + tolerance
        gap = 0.0
        for stage in range(2):
            for i in range(3):
                step[i] = readings[3 * stage + i] - values[stage, READINGS + i]
                gap = max(gap, abs(step[i]))
            _solve_3(slopes[stage, READINGS:DETERMINANT], step)
            for i in range(3):
                coordinates[stage, i] += step[i]
        last = gap <= 1e-9 * size
    return False


@jit
def _new_state(rows: int) -> State:
    return np.empty((2, STAGE_NUMBERS)), np.empty((2, STAGE_NUMBERS, 3)), np.empty(rows + 8), np.empty((rows + 8, 6))


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, f8[:, ::1], f8[:, :, ::1], i8[::1])")
def stage_states(
    coordinates: FloatArray,
    legs: FloatArray,
    radius: float,
    upward: float,
    aspect: float,
    values: FloatArray,
    slopes: FloatArray,
    places: IntArray,
) -> None:
    """Write the values (N, 16) of a stage, their derivatives (N, 16, 3), and where it is (N,), see `evaluate_stage`."""
    work = np.empty((14, 3, 3))
    for n in range(len(coordinates)):
        places[n] = evaluate_stage(coordinates[n], legs, radius, upward, aspect, values[n], slopes[n], work)
        if places[n] == NO_STATE:
            values[n], slopes[n] = np.nan, np.nan


_MACHINE = "f8[:, :, ::1], f8, f8, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1]"


@kernel(f"void(f8[:, ::1], f8[:, :, :, ::1], f8[:, ::1], {_MACHINE}, f8[:, :, ::1], f8[:, ::1], i8[::1], f8[:, ::1])")
def search_points(
    targets: FloatArray,
    starts: FloatArray,
    distances: FloatArray,
    legs: FloatArray,
    radius: float,
    size: float,
    aspects: FloatArray,
    body: FloatArray,
    between: FloatArray,
    limits: FloatArray,
    coordinates: FloatArray,
    readings: FloatArray,
    outcome: IntArray,
    errors: FloatArray,
) -> None:
    """Search, from `starts` (N, M, 2, 3) one after the other, for a state with o at the `targets` (N, 3).

    Starts are left out whose `distances` (N, M) from the target are not finite.

    Writes the states, or those with the smallest residual, (N, 2, 3); their readings (N, 6); the outcome (N,): 1 with a
    state, 0 without, -1 if undecided, because a search left the aspect or stalled just short of a state; and what is
    left of the residual, (N, 4): the error of o and the norm.
    """
    machine = legs, radius, size, aspects, body, between, limits
    state, trial, work = _new_state(3), _new_state(3), np.empty((14, 3, 3))
    shifts, place, snapped = np.zeros(8), np.empty((2, 3)), np.empty(6)
    tolerance = RESOLUTION * size
    for n in range(len(targets)):
        least = np.inf
        outcome[n] = 0
        coordinates[n], errors[n] = starts[n, 0], np.inf
        readings[n] = np.nan
        for m in range(starts.shape[1]):
            if not distances[n, m] < np.inf:
                continue
            place[:] = starts[n, m]
            if _evaluate(machine, place, targets[n], 1.0, shifts, state, work) < BEYOND:
                continue
            stationary, _ = _minimise(
                machine, place, targets[n], 1.0, shifts, GAUSS_NEWTON, _STEPS[GAUSS_NEWTON], state, trial, work
            )
            norm = _norm(state[2])
            if norm < least:
                least = norm
                coordinates[n], errors[n, :3], errors[n, 3] = place, state[2][:3], norm
            if norm <= tolerance:
                if _snap(machine, place, targets[n], shifts, state, tolerance, snapped, work):
                    coordinates[n], readings[n] = place, snapped
                    outcome[n] = 1
                    break
                outcome[n] = -1
            elif norm <= _DOUBT * size and not stationary:
                outcome[n] = -1


@kernel(f"void(f8[:, ::1], f8[:, :, :, ::1], {_MACHINE}, i8, f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def search_nearest(
    targets: FloatArray,
    starts: FloatArray,
    legs: FloatArray,
    radius: float,
    size: float,
    aspects: FloatArray,
    body: FloatArray,
    between: FloatArray,
    limits: FloatArray,
    most: int,
    coordinates: FloatArray,
    readings: FloatArray,
    multipliers: FloatArray,
    quality: FloatArray,
) -> None:
    """Search for the states within the limits that put the points of the body nearest to the `targets` (N, 3K).

    From all `starts` (N, M, 2, 3) by the Gauss-Newton method, limits penalised; from the best by Newton's method and
    updates of the multipliers, `most` steps at most. A result that is not within the limits and in the wanted aspect,
    or is farther than the first of the starts, is replaced by this, which has to be.

    Writes the states (N, 2, 3), their readings (N, 6), the multipliers of the readings' limits (N, 6), the
    distance [m] and the gradient of half its square (N, 2), infinite where the start has been taken.
    """
    machine = legs, radius, size, aspects, body, between, limits
    rows = targets.shape[1]
    state, trial, work = _new_state(rows), _new_state(rows), np.empty((14, 3, 3))
    shifts, place, best, old = np.zeros(8), np.empty((2, 3)), np.empty((2, 3)), np.empty(8)
    for n in range(len(targets)):
        target, least, first = targets[n], np.inf, np.inf
        shifts[:] = 0.0
        best[:] = starts[n, 0]
        for m in range(starts.shape[1]):
            place[:] = starts[n, m]
            weight = 1.0
            if _evaluate(machine, place, target, 1.0, shifts, state, work) < BEYOND:
                continue
            weight = _norm(state[2][:rows])
            if m == 0:
                first = weight
            weight = math.sqrt(max(1.0, _REMOTE_PENALTY * weight / size))
            state[2][rows:] *= weight
            state[3][rows:] *= weight
            _minimise(machine, place, target, weight, shifts, GAUSS_NEWTON, _STEPS[GAUSS_NEWTON], state, trial, work)
            norm = _norm(state[2])
            if norm < least:
                least, best[:] = norm, place
        place[:] = best
        weight, left, distance = 1.0, most, least
        for update in range(_UPDATES):
            before = weight
            weight = _PENALTY_WEIGHTS[min(update % _RESTART, 2)]
            weight *= math.sqrt(max(1.0, _REMOTE_PENALTY * distance / size))
            for row in range(8):
                shifts[row] *= (before / weight) ** 2
                old[row] = shifts[row]
            _evaluate(machine, place, target, weight, shifts, state, work)
            stationary, steps = _minimise(
                machine, place, target, weight, shifts, NEWTON, min(left, _STEPS[NEWTON]), state, trial, work
            )
            left -= steps
            change = 0.0
            for row in range(8):
                shifts[row] = state[2][rows + row] / weight
                change = max(change, abs(shifts[row] - old[row]))
            distance = _norm(state[2][:rows])
            if left <= 0 or ((stationary or distance <= RESOLUTION * size) and change <= _MULTIPLIER_TOLERANCE * size):
                break
        for row in range(6):
            multipliers[n, row] = weight * weight * shifts[row]
        quality[n, 1] = _put_gradient(state[3], state[2], work[12].reshape(9))
        coordinates[n] = place
        kept = _snap(machine, coordinates[n], target, shifts, state, _SAME_STATE * size, readings[n], work)
        if not kept or _norm(state[2][:rows]) > first + RESOLUTION * size:
            coordinates[n], shifts[:] = starts[n, 0], 0.0
            _snap(machine, coordinates[n], target, shifts, state, np.inf, readings[n], work)
            quality[n, 1], multipliers[n] = np.inf, 0.0
        quality[n, 0] = _norm(state[2][:rows])


@kernel("void(f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8, i8[:, ::1], i8[:, ::1], f8[:, ::1])")
def nearby_stages(
    points: FloatArray,
    rotations: FloatArray,
    offsets: FloatArray,
    table: FloatArray,
    spacing: float,
    stages: IntArray,
    cells: IntArray,
    distances: FloatArray,
) -> None:
    """Look points (N, 3) up in a table of distances, seen from lower stages (n, 3, 3) and (n, 3) [cells] in G groups.

    Writes the best stage of each group, the cell of the table where the point then is, and the distance, (N, G) each.
    """
    groups = stages.shape[1]
    members = len(rotations) // groups
    last0, last1, last2 = table.shape[0] - 1.0, table.shape[1] - 1.0, table.shape[2] - 1.0
    for n in range(len(points)):
        x, y, z = points[n, 0] / spacing, points[n, 1] / spacing, points[n, 2] / spacing
        for group in range(groups):
            least = np.inf
            for k in range(group * members, (group + 1) * members):
                u = rotations[k, 0, 0] * x + rotations[k, 1, 0] * y + rotations[k, 2, 0] * z - offsets[k, 0]
                v = rotations[k, 0, 1] * x + rotations[k, 1, 1] * y + rotations[k, 2, 1] * z - offsets[k, 1]
                w = rotations[k, 0, 2] * x + rotations[k, 1, 2] * y + rotations[k, 2, 2] * z - offsets[k, 2]
                i = int(min(max(u, 0.0), last0))
                j = int(min(max(v, 0.0), last1))
                m = int(min(max(w, 0.0), last2))
                if table[i, j, m] < least:
                    least = table[i, j, m]
                    stages[n, group] = k
                    cells[n, group] = (i * table.shape[1] + j) * table.shape[2] + m
            distances[n, group] = least
