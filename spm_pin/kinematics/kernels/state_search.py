"""Searches for a state that puts points of the upper platform at given places, over the coordinates of both stages.

They are damped least squares. Residuals are the errors of the points, over the root of their number, and the violations
of the limits of readings and determinants and, where legs have an end of their reach, of their rooms. See
`docs/theory/reachable_set.md`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spm_pin.formulas.stages import ANY_ASPECT
from spm_pin.formulas.vectors import combined, cross, minus, scaled, times, weighted
from spm_pin.kinematics.kernels import RESOLUTION
from spm_pin.kinematics.kernels.compilation import jit, kernel, vector, vector_at
from spm_pin.kinematics.kernels.stage_states import (
    BEYOND,
    CENTRE,
    DETERMINANT,
    INSIDE,
    NO_STATE,
    RATES,
    READINGS,
    SLOPE_NUMBERS,
    SPIN,
    STAGE_NUMBERS,
    VELOCITY,
    evaluate_stage,
    put,
    stage_rotation,
)
from spm_pin.support.arguments import FloatArray

GAUSS_NEWTON, NEWTON = 0, 1
_STEPS = (40, 120)  # steps of a search at most, of both methods
_GRADIENT = (1e-6, 1e-9)  # gradient of half the squared residual norm, over that norm, at which a state is stationary
_STALL_STEPS = 8
_LEAST_DECREASE = (1e-3, 1e-6)
"""Relative decrease of the residual norm in `_STALL_STEPS` steps, below which a search ends."""
_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e-13, 1e3
"""Damping of the first step, relative to the matrix, its least value, and the one at which a search ends."""
_DIFFERENCE = 1e-4  # step in the coordinates for second derivatives
_DOUBT = 1e-4  # residual norm, over the size, up to which a search that has stalled leaves its point undecided
_SAME_STATE = 1e-6  # distance, over the size, by which the points may move when the readings are put within the limits
_SETTLING = 10  # steps by which readings are put within the limits, at most
_READING_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)  # error of readings, over the size
_LEAST_DETERMINANT = 1e-12  # least determinant of a state that is taken to be on this side of a forward singularity
_SAME_END = 1e-3  # distance in the coordinates of two ends of searches that are taken for one
_PENALTY_WEIGHTS = (1.0, 3.0, 10.0)  # penalty weights of the first minimisation, of the second and of the further ones
_REMOTE_PENALTY = 1000.0
"""Growth of the squared penalty weight per distance from the target, over the machine's size."""
_STIFFNESS = (1.0, 10.0)
"""Factors of all penalty weights: the second where searches with the first have led out of the aspect."""
_UPDATES, _RESTART = 30, 10
"""Updates of the multipliers at most, and those after which the first penalty weight comes again."""
_MULTIPLIER_TOLERANCE, _STALLED = 1e-13, 1e-9
"""Change of the shifts, over the size, at which the multipliers have converged; and at which they may do so slowly."""

_PROBLEM = "Tuple((f8[:, :, ::1], f8, f8, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1]))"


class Problem(NamedTuple):
    """A machine, and which of its states to search: the `constants` of the kernels, where they are a plain tuple."""

    legs: FloatArray  # of both stages (2, 3, 20), see `stage_states`
    radius: float  # r [m]
    size: float  # of the machine [m]
    aspects: FloatArray  # the ones wanted (2,)
    body: FloatArray  # K points (K, 3) of the upper platform in {m} [m]
    half_turn: FloatArray  # the diagonal of that between stages of different modes (3,)
    limits: FloatArray
    """Least and largest values (3, L), L = 8 or 14, of six readings, of both determinants and perhaps of six rooms, and
    how many metres of residual a unit of each makes."""


class Terms(NamedTuple):
    """Both stages at given coordinates, and the residual of the least-squares problem with its derivatives."""

    values: FloatArray  # of both stages (2, 19), see `stage_states`
    slopes: FloatArray  # (2, 13, 3)
    residual: FloatArray  # (3K + L,)
    jacobian: FloatArray  # of the residual (3K + L, 6)


class Work(NamedTuple):
    """A problem, and memory to search in."""

    problem: Problem
    state: Terms  # at the coordinates
    trial: Terms
    matrix: FloatArray  # (6, 6)
    factor: FloatArray  # of the matrix


@jit
def _new_state(problem: Problem) -> Terms:
    rows = 3 * len(problem.body) + problem.limits.shape[1]
    values, slopes = np.empty((2, STAGE_NUMBERS)), np.empty((2, SLOPE_NUMBERS, 3))
    return Terms(values, slopes, np.empty(rows), np.empty((rows, 6)))


@jit
def _new_work(problem: Problem) -> Work:
    return Work(problem, _new_state(problem), _new_state(problem), np.empty((6, 6)), np.empty((6, 6)))


@jit
def _limited(row: int) -> tuple[int, int]:
    """Return, for a row of the limits, the stage and the place of its number after `READINGS` and after `RATES`."""
    if row < 6:
        return row // 3, row % 3
    return (row - 6, 3) if row < 8 else ((row - 8) // 3, 4 + (row - 8) % 3)


@jit
def _put_points(problem: Problem, state: Terms, points: FloatArray, jacobian: FloatArray) -> None:
    """Write the positions of the points of {m} in {B}, (3K,), and their derivatives, (3K, 6), over √K.

    With R_a, t_a of the middle platform in {B} and R_b, t_b in {m}, a point p is at t_a + R_a s, s = R_bᵀ (p - t_b).
    """
    values, slopes, body, half_turn = state.values, state.slopes, problem.body, problem.half_turn
    scale = 1.0 / math.sqrt(len(body))
    lower, upper = stage_rotation(values[0]), stage_rotation(values[1])
    for n in range(len(body)):
        arm = minus(vector_at(body[n], 0), vector_at(values[1], CENTRE))
        s0, s1, s2 = weighted(arm, upper)
        turned = times(lower, (half_turn[0] * s0, half_turn[1] * s1, half_turn[2] * s2))
        put(scaled(scale, combined(turned, 1.0, vector_at(values[0], CENTRE))), points, 3 * n)
        for k in range(3):
            spin, spin_m = vector(slopes[0], SPIN, k), vector(slopes[1], SPIN, k)
            moved = combined(vector(slopes[0], VELOCITY, k), 1.0, cross(spin, turned))
            d0, d1, d2 = weighted(combined(vector(slopes[1], VELOCITY, k), 1.0, cross(spin_m, arm)), upper)
            seen = times(lower, (half_turn[0] * d0, half_turn[1] * d1, half_turn[2] * d2))
            for i in range(3):
                jacobian[3 * n + i, k], jacobian[3 * n + i, 3 + k] = scale * moved[i], -scale * seen[i]


@jit
def _evaluate_stage(problem: Problem, stage: int, coordinates: FloatArray, state: Terms) -> int:
    legs, upward, aspect = problem.legs[stage], 1.0 - 2.0 * stage, problem.aspects[stage]
    return evaluate_stage(coordinates, legs, problem.radius, upward, aspect, state.values[stage], state.slopes[stage])


# One nearest pose takes some 1,500 calls, each counted as two members, for its stages.
@kernel(f"void(f8[:, ::1], {_PROBLEM}, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1], i8[::1])", few=5000)
def state_terms(coordinates, constants, points, moved, limited, rates, places):
    """Write what the state at coordinates (2, 3) is, and the derivatives of all by its six coordinates.

    The points of the body (3K,) over √K, and (3K, 6); what is limited (L,), see `Problem`, and (L, 6); and where each
    stage is (2,), see `evaluate_stage`.
    """
    problem = Problem(*constants)
    state = _new_state(problem)
    values, slopes = state.values, state.slopes
    for stage in range(2):
        places[stage] = _evaluate_stage(problem, stage, coordinates[stage], state)
    rates[:] = 0.0
    for row in range(len(limited)):
        stage, i = _limited(row)
        limited[row], rates[row, 3 * stage : 3 * stage + 3] = values[stage, READINGS + i], slopes[stage, RATES + i]
    _put_points(problem, state, points, moved)


@jit
def _put_limits(
    problem: Problem,
    state: Terms,
    weight: float,
    shifts: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    fixed: bool,
) -> None:
    """Write the violations (L,) of the limits, in metres, and their derivatives (L, 6).

    If `fixed`, the residual is not written, and derivatives are those of its rows that are not zero.
    """
    limits, values, slopes = problem.limits, state.values, state.slopes
    for row in range(limits.shape[1]):
        stage, i = _limited(row)
        unit = limits[2, row]
        if not fixed:
            value = unit * values[stage, READINGS + i] + shifts[row]
            residual[row] = weight * (value - min(max(value, unit * limits[0, row]), unit * limits[1, row]))
        jacobian[row] = 0.0
        if residual[row] != 0.0:
            for k in range(3):
                jacobian[row, 3 * stage + k] = weight * unit * slopes[stage, RATES + i, k]


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
def _add_products(jacobian: FloatArray, matrix: FloatArray) -> None:
    """Add JᵀJ to the lower half of a matrix (6, 6)."""
    for i in range(6):
        for j in range(i + 1):
            for row in range(len(jacobian)):
                matrix[i, j] += jacobian[row, i] * jacobian[row, j]


@jit
def _solve_damped(matrix: FloatArray, right: FloatArray, damping: float, step: FloatArray, factor: FloatArray) -> bool:
    """Write (M + damping · trace(|M|) · I)⁻¹ right by Cholesky's method; False where that is not positive definite."""
    trace = 0.0
    for i in range(6):
        trace += abs(matrix[i, i])
    if not (trace > 0.0 and trace < np.inf):
        return False
    for i in range(6):
        square, total = matrix[i, i] + damping * trace, right[i]
        for j in range(i):
            product = matrix[i, j]
            for k in range(j):
                product -= factor[i, k] * factor[j, k]
            factor[i, j] = product / factor[j, j]
            square -= factor[i, j] * factor[i, j]
            total -= factor[i, j] * step[j]
        if not square > 1e-14 * trace * damping:
            return False
        factor[i, i] = math.sqrt(square)
        step[i] = total / factor[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            step[i] -= factor[k, i] * step[k]
        step[i] /= factor[i, i]
    return True


@jit
def _evaluate(
    problem: Problem, coordinates: FloatArray, target: FloatArray, weight: float, shifts: FloatArray, state: Terms
) -> int:
    """Write the stages, the residual and its Jacobian at coordinates (2, 3); return where the worse stage is."""
    residual, jacobian, rows, worst = state.residual, state.jacobian, len(target), INSIDE
    for stage in range(2):
        worst = min(worst, _evaluate_stage(problem, stage, coordinates[stage], state))
        if worst < BEYOND:
            return worst
    _put_points(problem, state, residual, jacobian)
    for row in range(rows):
        residual[row] -= target[row]
    _put_limits(problem, state, weight, shifts, residual[rows:], jacobian[rows:], False)
    return worst


@jit
def _put_curvature(work: Work, coordinates: FloatArray, weight: float, shifts: FloatArray) -> bool:
    """Write the residual times its second derivatives (6, 6), by differences of the gradient.

    Each difference changes one stage. False where one of them leads to where there is no state.
    """
    problem, state, trial, matrix, _ = work
    residual, rows, gradient, place = state.residual, 3 * len(problem.body), np.empty(6), np.empty(3)
    values, slopes, points, jacobian = trial
    for stage in range(2):
        values[:], slopes[:] = state.values, state.slopes
        for k in range(3):
            row = 3 * stage + k
            matrix[row] = 0.0
            for sign in (1.0, -1.0):
                place[:] = coordinates[stage]
                place[k] += sign * _DIFFERENCE
                if _evaluate_stage(problem, stage, place, trial) == NO_STATE:
                    return False
                _put_points(problem, trial, points, jacobian)
                _put_limits(problem, trial, weight, shifts, residual[rows:], jacobian[rows:], True)
                _put_gradient(jacobian, residual, gradient)
                for j in range(6):
                    matrix[row, j] += sign * gradient[j] / (2.0 * _DIFFERENCE)
    for i in range(6):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = 0.5 * (matrix[i, j] + matrix[j, i])
    return True


@jit
def _minimise(
    work: Work,
    coordinates: FloatArray,
    target: FloatArray,
    weight: float,
    shifts: FloatArray,
    method: int,
    most: int,
) -> tuple[bool, int]:
    """Minimise the residual norm from `coordinates` (2, 3); return whether it is stationary there, and the steps taken.

    The state of `work` is that at the coordinates, before and after. Damped steps, none of which leaves the wanted
    aspect, until the gradient is small, the residual vanishes, or hardly decreases any more.
    """
    problem, state, trial, matrix, factor = work
    values, slopes, residual, jacobian = state
    size, gradient, flatter, step, tried = problem.size, np.empty(6), np.empty(6), np.empty(6), np.empty((2, 3))
    damping, norm, rounding, fresh = _DAMPING, _norm(residual), 0.25 * _READING_ROUNDING * size, True
    largest, before = _put_gradient(jacobian, residual, gradient), norm
    for count in range(1, min(most, _STEPS[method]) + 1):
        stationary = largest <= _GRADIENT[method] * norm
        if stationary or norm <= 1e-3 * RESOLUTION * size or damping >= _LARGEST_DAMPING:
            return stationary, count
        if count % _STALL_STEPS == 0:
            # Newton's method near a solution is faster than that.
            if norm > (1.0 - _LEAST_DECREASE[method]) * before:
                return stationary, count
            before = norm
        if fresh:
            if method != NEWTON or not _put_curvature(work, coordinates, weight, shifts):
                matrix[:] = 0.0
            _add_products(jacobian, matrix)
            fresh = False
        if not _solve_damped(matrix, gradient, damping, step, factor):
            damping *= 10.0
            continue
        for k in range(6):
            tried[k // 3, k % 3] = coordinates[k // 3, k % 3] - step[k]
        better = False
        if _evaluate(problem, tried, target, weight, shifts, trial) >= BEYOND:
            # At the end, what a step gains is less than the norm's rounding.
            change = _norm(trial.residual) - norm
            steepest = _put_gradient(trial.jacobian, trial.residual, flatter)
            better = change < -rounding or (change < rounding and steepest < largest)
        if better:
            coordinates[:], values[:], slopes[:] = tried, trial.values, trial.slopes
            residual[:], jacobian[:] = trial.residual, trial.jacobian
            norm, largest = _norm(residual), _put_gradient(jacobian, residual, gradient)
            damping, fresh = max(0.1 * damping, _LEAST_DAMPING), True
        else:
            damping *= 10.0
    return largest <= _GRADIENT[method] * norm, min(most, _STEPS[method])


@jit
def _settle(work: Work, coordinates: FloatArray, target: FloatArray, shifts: FloatArray, readings: FloatArray) -> bool:
    """Move the state at `coordinates` within the limits of the readings, by as little as possible; write these (6,).

    A leg whose shift is not zero pushes against its limit, and is put at it. Return False if the state then is not in
    the wanted aspect, or the steps have not converged: near forward singularities small changes of readings move the
    state far.
    """
    problem, state, _, matrix, factor = work
    values, slopes, residual, jacobian = state
    limits, rounding, rows, place = problem.limits, _READING_ROUNDING * problem.size, len(target), INSIDE
    gradient, step, zeros, gap = np.empty(6), np.empty(6), np.zeros(limits.shape[1]), np.inf
    for _ in range(_SETTLING):
        place = _evaluate(problem, coordinates, target, 1.0, zeros, state)
        if place < BEYOND:
            return False
        gap, errors, slope = 0.0, residual[rows : rows + 6], jacobian[rows : rows + 6]
        for row in range(6):
            stage, i = row // 3, row % 3
            value = values[stage, READINGS + i]
            readings[row] = min(max(value, limits[0, row]), limits[1, row])
            if shifts[row] != 0.0:
                readings[row] = limits[0 if shifts[row] < 0.0 else 1, row]
                unit = limits[2, row]
                errors[row] = unit * (value - readings[row])
                for k in range(3):
                    slope[row, 3 * stage + k] = unit * slopes[stage, RATES + i, k]
            gap = max(gap, limits[2, row] * abs(value - readings[row]))
        if gap <= rounding:
            break
        _put_gradient(slope, errors, gradient)
        matrix[:] = 0.0
        _add_products(slope, matrix)
        if not _solve_damped(matrix, gradient, 1e-12, step, factor):
            return False
        for k in range(6):
            coordinates[k // 3, k % 3] -= step[k]
    certain = min(values[0, DETERMINANT], values[1, DETERMINANT]) > _LEAST_DETERMINANT
    return gap <= rounding and place == INSIDE and (certain or problem.aspects[0] == ANY_ASPECT)


@kernel(f"void(f8[:, ::1], f8[:, :, :, ::1], f8[:, ::1], {_PROBLEM}, f8[:, :, ::1], f8[:, ::1], i8[::1])")
def search_points(targets, starts, distances, constants, coordinates, readings, outcome):
    """Search, from `starts` (N, M, 2, 3) one after the other, for a state with o at the `targets` (N, 3).

    Starts are left out whose `distances` (N, M) from the target are not finite.

    Writes the states, or those with the smallest residual, (N, 2, 3); their readings (N, 6); and the outcome (N,): 1
    with a state, 0 without, -1 if undecided, because a search left the aspect or stalled just short of a state.
    """
    problem = Problem(*constants)
    work, size = _new_work(problem), problem.size
    state = work.state
    shifts, place, nearest_readings = np.zeros(problem.limits.shape[1]), np.empty((2, 3)), np.empty(6)
    for n in range(len(targets)):
        least, target, most = np.inf, targets[n], _STEPS[GAUSS_NEWTON]
        coordinates[n], readings[n], outcome[n] = starts[n, 0], np.nan, 0
        for m in range(starts.shape[1]):
            place[:] = starts[n, m]
            if distances[n, m] == np.inf or _evaluate(problem, place, target, 1.0, shifts, state) < BEYOND:
                continue
            stationary, _ = _minimise(work, place, target, 1.0, shifts, GAUSS_NEWTON, most)
            norm = _norm(state.residual)
            if norm < least:
                least, coordinates[n] = norm, place
            if norm <= RESOLUTION * size:
                kept = _settle(work, place, target, shifts, nearest_readings)
                if kept and _norm(state.residual[:3]) <= 2.0 * RESOLUTION * size:
                    coordinates[n], readings[n], outcome[n] = place, nearest_readings, 1
                    break
                outcome[n] = -1
            elif norm <= _DOUBT * size and not stationary:
                outcome[n] = -1


@jit
def _polish(
    work: Work, coordinates: FloatArray, target: FloatArray, stiffness: float, most: int, shifts: FloatArray
) -> int:
    """Minimise the distance within the limits, by Newton's method and updates of the multipliers.

    Writes the multipliers over the squared weight, `shifts` (L,); returns the steps that are left.
    """
    problem, state, _, _, _ = work
    size, rows, weight, left, change = problem.size, len(target), 1.0, most, np.inf
    shifts[:] = 0.0
    _evaluate(problem, coordinates, target, 1.0, shifts, state)
    distance = _norm(state.residual[:rows])
    for update in range(_UPDATES):
        before, farther, last = weight, distance, change
        weight = stiffness * _PENALTY_WEIGHTS[min(update % _RESTART, 2)]
        weight *= math.sqrt(max(1.0, _REMOTE_PENALTY * distance / size))
        for row in range(len(shifts)):
            shifts[row] *= before / weight * (before / weight)
        _evaluate(problem, coordinates, target, weight, shifts, state)
        stationary, steps = _minimise(work, coordinates, target, weight, shifts, NEWTON, left)
        left, change, distance = left - steps, 0.0, _norm(state.residual[:rows])
        for row in range(len(shifts)):
            shift = state.residual[rows + row] / weight
            change = max(change, abs(shift - shifts[row]))
            shifts[row] = shift
        # Every step leads out of the wanted aspect.
        stuck = not stationary and update > 1 and abs(distance - farther) <= _MULTIPLIER_TOLERANCE * size
        # Where limits depend on each other, as in a cusp of a forward singularity, multipliers never converge.
        converged = change <= _MULTIPLIER_TOLERANCE * size or (change <= _STALLED * size and change > 0.5 * last)
        if left <= 0 or stuck or (converged and (stationary or distance <= RESOLUTION * size)):
            break
    return left


@jit
def _next_end(norms: FloatArray, ends: FloatArray, best: float) -> int:
    """Return the search with the smallest norm, -1 if none is below `best`; strike out all that ended where it did."""
    chosen = norms.argmin()
    if not norms[chosen] < best:
        return -1
    for m in range(len(norms)):
        if m == chosen or np.abs(ends[m] - ends[chosen]).max() <= _SAME_END:
            norms[m] = np.inf
    return int(chosen)


@kernel(f"void(f8[:, ::1], f8[:, :, :, ::1], {_PROBLEM}, i8, f8[:, :, ::1], f8[:, ::1], f8[:, ::1])", seconds=1.0)
def search_nearest(targets, starts, constants, most, coordinates, readings, quality):
    """Search for the states within the limits that put the points of the body nearest to the `targets` (N, 3K).

    From all `starts` (N, M, 2, 3) by the Gauss-Newton method, limits penalised; then, from the best on, by Newton's
    method and updates of the multipliers, until no other end of a penalised search is nearer than the nearest state
    within the limits; `most` Newton steps at most. Where nothing is nearer than the first of the starts, which has to
    be within the limits, that is the result.

    Writes the states (N, 2, 3), their readings (N, 6), the distance [m] and the gradient of half its square (N, 2),
    infinite where the start has been taken.
    """
    problem = Problem(*constants)
    rows, count, size = targets.shape[1], starts.shape[1], problem.size
    work = _new_work(problem)
    state = work.state
    shifts, zeros = np.zeros(problem.limits.shape[1]), np.zeros(problem.limits.shape[1])
    place, nearest_readings = np.empty((2, 3)), np.empty(6)
    ends, norms = np.empty((count, 2, 3)), np.empty(count)
    for n in range(len(targets)):
        target, left = targets[n], most
        coordinates[n] = starts[n, 0]
        exists = _settle(work, coordinates[n], target, zeros, readings[n])
        first = _norm(state.residual[:rows]) if exists else np.inf
        best, quality[n, 0], quality[n, 1] = first + RESOLUTION * size, first, np.inf
        for stiffness in _STIFFNESS:
            if quality[n, 1] < np.inf:
                break
            for m in range(count):
                ends[m], norms[m] = starts[n, m], np.inf
                if _evaluate(problem, ends[m], target, 1.0, zeros, state) < BEYOND:
                    continue
                weight = stiffness * math.sqrt(max(1.0, _REMOTE_PENALTY * _norm(state.residual[:rows]) / size))
                state.residual[rows:] *= weight
                state.jacobian[rows:] *= weight
                _minimise(work, ends[m], target, weight, zeros, GAUSS_NEWTON, _STEPS[GAUSS_NEWTON])
                norms[m] = _norm(state.residual)
            chosen = _next_end(norms, ends, np.inf)
            while chosen >= 0 and left > 0:
                place[:] = ends[chosen]
                left = _polish(work, place, target, stiffness, left, shifts)
                distance, slope = (
                    _norm(state.residual[:rows]),
                    _put_gradient(state.jacobian, state.residual, nearest_readings),
                )
                if _settle(work, place, target, shifts, nearest_readings):
                    before, distance = distance, _norm(state.residual[:rows])
                    if distance <= min(best, before + _SAME_STATE * size):
                        best, coordinates[n], readings[n] = distance, place, nearest_readings
                        quality[n, 0], quality[n, 1] = distance, slope
                chosen = _next_end(norms, ends, best)
