"""All assembly modes of one 3RPS stage, in canonical order, and the one in the aspect of its home."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.kinematics.kernels.quartic import approximate_solutions
from spm_pin.kinematics.kernels.stage_equations import (
    EPS,
    NEAR,
    SAME,
    Equations,
    State,
    equations,
    in_home_aspect,
    other_side_of_fold,
    placed,
    polished,
)
from spm_pin.mechanism.arguments import FloatArray

Workspace = tuple[npt.NDArray[np.complex128], FloatArray, FloatArray, FloatArray]
"""The quartic's roots, where Newton's method starts, where it ended (with the gain), and what is kept of that."""

PLACES = 4
"""The most solutions of one mode, mirror images apart."""
_FAMILY = 1e6
"""A solution beside a continuous family that errs more than this many times as much as the lengths belongs to it."""
# What is kept of a solution: x0, x1, x2, x3, ζ, three radii, three heights, and
_BLUR, _RANK, _AZIMUTH = 11, 12, 13


@jit_inline
def workspace() -> Workspace:
    """Allocate the arrays that stages are solved in, one after another."""
    return np.empty(4, np.complex128), np.empty((8, 4)), np.empty((16, 5)), np.empty((16, 14))


@jit_inline
def is_continuous(first: float, second: float, third: float, epsilon: float, half_turned: bool) -> bool:
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
def solve_mode(stage: Equations, half_turned: bool, family: bool, work: Workspace) -> int:
    """Find the solutions of one mode, and count them.

    They are put into the first rows of `work[3]`, by falling mean radius of the corners; where nine digits of it agree,
    by the azimuth of the tilt axis.
    """
    roots, starts, ends, kept = work
    found = 0
    for k in range(approximate_solutions(stage, family, roots, starts)):
        state, gain, arrived = polished(stage, (starts[k, 0], starts[k, 1], starts[k, 2], starts[k, 3]))
        if arrived:
            ends[found, 0], ends[found, 1], ends[found, 2], ends[found, 3] = state
            ends[found, 4] = gain
            found += 1
    for k in range(found):
        if ends[k, 4] > NEAR:
            across = other_side_of_fold(stage, (ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3]))
            state, gain, arrived = polished(stage, across)
            if arrived:
                ends[found, 0], ends[found, 1], ends[found, 2], ends[found, 3] = state
                ends[found, 4] = gain
                found += 1

    count = 0
    for k in range(found):
        if family and ends[k, 4] >= _FAMILY:
            continue
        x0, x1, x2, x3 = _quaternion(ends[k, 0], ends[k, 1], ends[k, 2], half_turned)
        radii, heights = placed(x0, x1, x2, x3, ends[k, 3])
        # Azimuths of the tilt axis modulo a half turn, none of a symmetric solution's at the jump.
        azimuth = (math.atan2(ends[k, 2], ends[k, 1]) + math.pi / 6.0) % math.pi
        rank = -np.rint(1e9 * ((radii[0] + radii[1] + radii[2]) / 3.0))
        at = count
        while at > 0 and (kept[at - 1, _RANK], kept[at - 1, _AZIMUTH]) > (rank, azimuth):
            _copy(kept, at - 1, at)
            at -= 1
        row = kept[at]
        row[0], row[1], row[2], row[3], row[4] = x0, x1, x2, x3, ends[k, 3]
        row[5], row[6], row[7] = radii
        row[8], row[9], row[10] = heights
        row[_BLUR], row[_RANK], row[_AZIMUTH] = min(max(16.0 * EPS * ends[k, 4], SAME), 0.01), rank, azimuth
        count += 1

    # Drop what was found twice.
    places = 0
    for k in range(count):
        again = False
        for j in range(k):
            again = again or _distance(kept[k], kept[j]) <= max(kept[k, _BLUR], kept[j, _BLUR])
        if again:
            kept[k, _RANK] = np.nan
    for k in range(count):
        if kept[k, _RANK] == kept[k, _RANK]:
            _copy(kept, k, places)
            places += 1
    return min(places, PLACES)


@jit
def home_mode(first: float, second: float, third: float, epsilon: float) -> tuple[State, bool]:
    """Return the solution of mode T in the home's aspect, and whether Newton's method from the level position found it.

    There is one at most, so whatever way led into that aspect led to it.
    """
    stage = equations(first, second, third, epsilon)
    if stage[1] > 0.0 and not is_continuous(first, second, third, epsilon, False):
        state, gain, arrived = polished(stage, (1.0, 0.0, 0.0, math.sqrt(stage[1])))
        if arrived and gain <= NEAR:
            radii, heights = placed(state[0], state[1], state[2], 0.0, state[3])
            if in_home_aspect(radii, heights, epsilon):
                return state, True
    return (np.nan, np.nan, np.nan, np.nan), False


@jit
def home_mode_of_all(first: float, second: float, third: float, epsilon: float, work: Workspace) -> State:
    """Return the solution of mode T in the home's aspect, NaN if none of all is."""
    family = is_continuous(first, second, third, epsilon, False)
    kept = work[3]
    for k in range(solve_mode(equations(first, second, third, epsilon), False, family, work)):
        radii, heights = (kept[k, 5], kept[k, 6], kept[k, 7]), (kept[k, 8], kept[k, 9], kept[k, 10])
        if in_home_aspect(radii, heights, epsilon):
            return kept[k, 0], kept[k, 1], kept[k, 2], kept[k, 4]
    return np.nan, np.nan, np.nan, np.nan
