"""All assembly modes of one 3RPS stage, in canonical order, and the one in the aspect of its home.

The equations are `spm_pin.kinematics.formulas.stages`; here are Newton's method on them, the place of each solution,
and what tells two solutions apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.formulas.stages import (
    EPS,
    StageEquations,
    State,
    corners,
    damped,
    in_home_aspect,
    inverse,
    jacobian,
    moved,
    residual,
    residual_by_legs,
    stage_equations,
)
from spm_pin.kinematics.formulas.vectors import Rows, Vector, dot, largest, scaled, times, weighted
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.quartic import approximate_solutions
from spm_pin.mechanism.arguments import FloatArray

SAME = float(4.0 * np.sqrt(EPS))
"""Solutions closer than this, in units of r, are one: rounding resolves a double root no better."""
PLACES = 4
"""The most solutions of one mode, mirror images apart."""
_NEAR_FOLD = 1e3
"""Ratio of a solution's error to that of the leg lengths above which a fold or a family is near."""
_ROUNDING = 4.0 * EPS
"""Residual of a solution relative to the largest term of its equations; half of it has been seen."""
_MOST_STEPS = 40
_LONGEST_TURN = 0.3
_SHORT = 0.25
"""Leg length below which the equations, which are made of squares of all legs, lose digits."""
_OF_FAMILY = 1e6
"""A solution beside a continuous family that errs more than this many times as much as the lengths belongs to it."""
# What is kept of a solution: x0, x1, x2, x3, ζ, three radii, three heights, and
_BLUR, _RANK, _AZIMUTH = 11, 12, 13


class Scratch(NamedTuple):
    """Arrays that stages are solved in, one after another."""

    roots: npt.NDArray[np.complex128]  # of the quartic (4,)
    starts: FloatArray  # where Newton's method begins (8, 4)
    ends: FloatArray  # where it ended, and the gain (16, 5)
    kept: FloatArray  # what is kept of that (16, 14)


@jit
def polished(stage: StageEquations, start: State) -> tuple[State, float, bool]:
    """Bring an approximate solution to rounding by Newton's method.

    Parameters
    ----------
    stage : StageEquations
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
        columns, singular = inverse(jacobian(stage, state))
        step = scaled(-1.0, weighted(error, columns))
        square = dot(columns[0], columns[0]) + dot(columns[1], columns[1]) + dot(columns[2], columns[2])
        gain = 1.0 / EPS if singular else np.sqrt(square) * stage.scale
        length, off = np.sqrt(dot(step, step)), largest(error) / stage.scale
        # Beside a fold or a family, a step no longer than its own rounding leads nowhere better.
        if length <= 8.0 * EPS * gain and gain > _NEAR_FOLD and off <= _ROUNDING:
            break
        state = moved(state, damped(step, _LONGEST_TURN))
        # What a step leaves is its square, divided by the distance to the fold.
        if length * length * max(gain, 1.0) <= EPS or off <= EPS:
            break
    arrived = largest(residual(stage, state)) <= _ROUNDING * stage.scale
    if arrived and min(stage.lengths) < _SHORT:
        columns, _ = inverse(jacobian(stage, state))
        step = scaled(-1.0, weighted(residual_by_legs(stage, state), columns))
        if np.sqrt(dot(step, step)) <= 8.0 * EPS * gain:  # rounding, and nothing else
            state = moved(state, step)
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
def other_side_of_fold(stage: StageEquations, state: State) -> State:
    """Return where the other solution is of a pair that is about to meet.

    Along the direction n that hardly changes f, its part l·f that J hardly reaches is a quadratic.
    """
    rows = jacobian(stage, state)
    columns, _ = inverse(rows)
    n = _longest(columns)
    left = _longest(
        (
            (columns[0][0], columns[1][0], columns[2][0]),
            (columns[0][1], columns[1][1], columns[2][1]),
            (columns[0][2], columns[1][2], columns[2][2]),
        )
    )
    slope = dot(left, times(rows, n))
    h = 1e-4
    ahead, behind = residual(stage, moved(state, scaled(h, n))), residual(stage, moved(state, scaled(-h, n)))
    curvature = (dot(left, ahead) + dot(left, behind)) / (2.0 * h * h)
    distance = 0.0 if curvature == 0.0 else -slope / curvature
    return moved(state, scaled(min(max(distance, -0.1), 0.1), n))


@jit_inline
def allocate_scratch() -> Scratch:
    """Allocate the arrays that stages are solved in, one after another."""
    return Scratch(np.empty(4, np.complex128), np.empty((8, 4)), np.empty((16, 5)), np.empty((16, 14)))


@jit_inline
def has_continuous_family(first: float, second: float, third: float, epsilon: float, half_turned: bool) -> bool:
    """Return whether solutions form a continuous family: these are the only lengths at which the quartic vanishes.

    - E < r, one leg 3 E long and the others √3 √(r² - E²): both modes.
    - E = r/2 and equal legs longer than r/2: mode T.
    """
    a, b, c = first * first, second * second, third * third
    tolerance = 64.0 * EPS * ((a + b + c) / 3.0 + (1.0 + epsilon) ** 2)
    odd, even = 9.0 * epsilon * epsilon, 3.0 - 3.0 * epsilon * epsilon
    distance = min(
        max(abs(a - odd), abs(b - even), abs(c - even)),
        max(abs(a - even), abs(b - odd), abs(c - even)),
        max(abs(a - even), abs(b - even), abs(c - odd)),
    )
    if distance <= tolerance and epsilon < 1.0:
        return True
    equal = max(abs(b - a), abs(c - a)) <= tolerance
    return not half_turned and equal and a > 0.25 + tolerance and abs(2.0 * epsilon - 1.0) <= 64.0 * EPS


@jit_inline
def _quaternion(x0: float, x1: float, x2: float, half_turned: bool) -> State:
    """Return the quaternion's x0, x1, x2, x3 from a mode's own coordinates."""
    return (0.0, -x2, x1, x0) if half_turned else (x0, x1, x2, 0.0)


@jit_inline
def _copy(rows: FloatArray, source: int, target: int) -> None:
    # Number by number, for an assignment of rows brings all of NumPy's broadcasting along, which takes long to compile.
    for i in range(rows.shape[1]):
        rows[target, i] = rows[source, i]


@jit_inline
def _distance(first: FloatArray, second: FloatArray) -> float:
    """Return how far the corners of two solutions are apart, or of one and the other's mirror image."""
    across, same, mirrored = 0.0, 0.0, 0.0
    for i in range(3):
        across += (first[5 + i] - second[5 + i]) ** 2
        same += (first[8 + i] - second[8 + i]) ** 2
        mirrored += (first[8 + i] + second[8 + i]) ** 2
    return math.sqrt(across + min(same, mirrored))


@jit
def solve_mode(stage: StageEquations, half_turned: bool, is_continuous: bool, scratch: Scratch) -> int:
    """Find the solutions of one mode, and count them.

    They are put into the first rows of `scratch.kept`, by falling mean radius of the corners; where nine digits of it
    agree, by the azimuth of the tilt axis.
    """
    roots, starts, ends, kept = scratch
    solutions = 0
    for k in range(approximate_solutions(stage, is_continuous, roots, starts)):
        state, gain, arrived = polished(stage, (starts[k, 0], starts[k, 1], starts[k, 2], starts[k, 3]))
        if arrived:
            ends[solutions, 0], ends[solutions, 1], ends[solutions, 2], ends[solutions, 3] = state
            ends[solutions, 4] = gain
            solutions += 1
    for k in range(solutions):
        if ends[k, 4] > _NEAR_FOLD:
            across = other_side_of_fold(stage, (ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3]))
            state, gain, arrived = polished(stage, across)
            if arrived:
                ends[solutions, 0], ends[solutions, 1], ends[solutions, 2], ends[solutions, 3] = state
                ends[solutions, 4] = gain
                solutions += 1

    count = 0
    for k in range(solutions):
        if is_continuous and ends[k, 4] >= _OF_FAMILY:
            continue
        x0, x1, x2, x3 = _quaternion(ends[k, 0], ends[k, 1], ends[k, 2], half_turned)
        radii, heights = corners(x0, x1, x2, x3, ends[k, 3])
        # Azimuths of the tilt axis modulo a half turn, none of a symmetric solution's at the jump.
        azimuth = (math.atan2(ends[k, 2], ends[k, 1]) + math.pi / 6.0) % math.pi
        rank = -np.rint(1e9 * ((radii[0] + radii[1] + radii[2]) / 3.0))
        place = count
        while place > 0 and (kept[place - 1, _RANK], kept[place - 1, _AZIMUTH]) > (rank, azimuth):
            _copy(kept, place - 1, place)
            place -= 1
        row = kept[place]
        row[0], row[1], row[2], row[3], row[4] = x0, x1, x2, x3, ends[k, 3]
        row[5], row[6], row[7] = radii
        row[8], row[9], row[10] = heights
        row[_BLUR], row[_RANK], row[_AZIMUTH] = min(max(16.0 * EPS * ends[k, 4], SAME), 0.01), rank, azimuth
        count += 1

    # Drop what occurs twice.
    places = 0
    for k in range(count):
        repeated = False
        for j in range(k):
            repeated = repeated or _distance(kept[k], kept[j]) <= max(kept[k, _BLUR], kept[j, _BLUR])
        if repeated:
            kept[k, _RANK] = np.nan
    for k in range(count):
        if kept[k, _RANK] == kept[k, _RANK]:
            _copy(kept, k, places)
            places += 1
    return min(places, PLACES)


@jit
def home_state(first: float, second: float, third: float, epsilon: float, scratch: Scratch) -> State:
    """Return the solution of mode T in the home's aspect, NaN if there is none.

    There is one at most, so whatever way leads into that aspect leads to it: Newton's method from the level position,
    and where that does not, a search through all solutions.
    """
    stage = stage_equations(first, second, third, epsilon)
    is_continuous = has_continuous_family(first, second, third, epsilon, False)
    if stage.level > 0.0 and not is_continuous:
        state, gain, arrived = polished(stage, (1.0, 0.0, 0.0, math.sqrt(stage.level)))
        if arrived and gain <= _NEAR_FOLD:
            radii, heights = corners(state[0], state[1], state[2], 0.0, state[3])
            if in_home_aspect(radii, heights, epsilon):
                return state
    kept = scratch.kept
    for k in range(solve_mode(stage, False, is_continuous, scratch)):
        radii, heights = (kept[k, 5], kept[k, 6], kept[k, 7]), (kept[k, 8], kept[k, 9], kept[k, 10])
        if in_home_aspect(radii, heights, epsilon):
            return kept[k, 0], kept[k, 1], kept[k, 2], kept[k, 4]
    return np.nan, np.nan, np.nan, np.nan
