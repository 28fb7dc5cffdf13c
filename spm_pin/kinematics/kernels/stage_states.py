"""One stage by its coordinates: where its middle platform is, its readings and its determinant, with derivatives.

A stage is three legs, each of which keeps its ball in a plane. Its middle platform has three freedoms: (x, y), two
components of the unit quaternion (x0, x, y, x3), and the height Z of the triangle's centre, divided by its radius r.
The three planes give x3 and the centre's other coordinates: zero and (-2r xy, r (y² - x²)) in the machine as drawn, and
a few steps of Newton's method from there in one as built. So a state exists for all (x, y) in the unit circle. See
`docs/theory/reachable_set.md`.

The upper stage is the same seen from {m}. A stage of mode F has its balls turned by half a turn about the platform's
normal.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.formulas.stages import (
    ANY_ASPECT,
    EPS,
    HOME_ASPECT,
    inverse,
    negative_pairs,
    pair_determinant,
    pair_determinant_slope,
)
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    combined,
    crosses,
    differences,
    dots,
    largest,
    multiples,
    shifted,
    transposed,
    turned,
    weighted,
)
from spm_pin.formulas.vectors import rotation_of as rotation_of_quaternion
from spm_pin.formulas.wrenches import pairs
from spm_pin.kinematics.kernels.compilation import jit, kernel
from spm_pin.mechanism.arguments import FloatArray

AXIS, PIVOT, BALL, OFFSET = 0, 3, 6, 9
"""Places of a leg's numbers in a row of `legs`."""
ROTATION, CENTRE, READINGS, DETERMINANT, STAGE_NUMBERS = 0, 9, 12, 15, 16
"""Places of a stage's rotation, centre [m], readings [m] and determinant in `values`, and their number."""
SPIN, VELOCITY, RATES, SLOPE_NUMBERS = 0, 3, 6, 10
"""Places in `slopes` of the derivatives: the rotation's, as a rotation vector, the centre's, the readings' and the
determinant's; and their number."""
NO_STATE, OTHER_ASPECT, BEYOND, INSIDE = 0, 1, 2, 3
"""Where a stage is: nowhere, in another aspect, slightly beyond a forward singularity, or in the wanted aspect."""
_BEYOND = -0.05  # determinant down to which a search may step beyond a forward singularity; it is about 1 at home
_STEPS = 12  # Newton steps for x3 and the centre at most


@jit
def vector(array: FloatArray, first: int) -> Vector:
    """Return three numbers of an array."""
    return array[first], array[first + 1], array[first + 2]


@jit
def vectors(array: FloatArray, first: int) -> Rows:
    """Return three numbers of each of three rows of an array."""
    return vector(array[0], first), vector(array[1], first), vector(array[2], first)


@jit
def rotation_of(values: FloatArray) -> Rows:
    """Return the rotation of a stage."""
    return vector(values, ROTATION), vector(values, ROTATION + 3), vector(values, ROTATION + 6)


@jit
def put(numbers: Vector, array: FloatArray, first: int) -> None:
    """Write three numbers into an array."""
    array[first], array[first + 1], array[first + 2] = numbers


@jit
def evaluate_stage(
    coordinates: FloatArray,
    legs: FloatArray,
    radius: float,
    upward: float,
    aspect: float,
    values: FloatArray,
    slopes: FloatArray,
) -> int:
    """Write the `values` (16,) of a stage and their derivatives `slopes` (10, 3); return where the stage is.

    `legs` (3, 10) are in the frame of the stage's end, `upward` is the sign of Z at home.
    """
    x, y, z = coordinates[0], coordinates[1], radius * coordinates[2]
    axes, pivots, corners = vectors(legs, AXIS), vectors(legs, PIVOT), vectors(legs, BALL)
    centre, s = (-2.0 * radius * x * y, radius * (y * y - x * x), z), 0.0
    tolerance, last, gap = 4.0 * EPS * (radius + abs(z)), _STEPS - 1, np.inf
    for step in range(_STEPS):
        square = 1.0 - x * x - y * y - s * s
        if not square > 0.0:
            return NO_STATE
        w = math.sqrt(square)
        turn = rotation_of_quaternion(x, y, s, w)
        arms = turned(turn, corners)
        # The rotation by x3, and from it how the planes are left.
        spin = 2.0 * (s * x / w + y), 2.0 * (s * y / w - x), 2.0 * (w + s * s / w)
        first, second, _ = transposed(axes)
        by_spin = dots(axes, crosses((spin, spin, spin), arms))
        columns, _ = inverse(transposed((by_spin, first, second)))
        balls = shifted(arms, centre)
        along = differences(balls, pivots)
        gaps = dots(axes, along)
        gap = largest(gaps)
        if gap <= tolerance or step == last:
            break
        change = weighted(gaps, columns)
        s -= change[0]
        centre = centre[0] - change[1], centre[1] - change[2], z
    if not gap <= 1e-9 * (radius + abs(z)):
        return NO_STATE
    squares = dots(along, along)
    lengths = math.sqrt(squares[0]), math.sqrt(squares[1]), math.sqrt(squares[2])
    over_lengths = upward / lengths[0], upward / lengths[1], upward / lengths[2]
    u = multiples(over_lengths, along)
    normals = crosses(axes, u)
    c = pairs(balls, normals)
    # At home all six c_ij are 3/2 r times the sine of the legs' slope.
    unit = 1.0 / (6.75 * radius * radius * radius)
    if aspect == 1.0 or aspect == -1.0:
        unit *= aspect
    put(centre, values, CENTRE)
    for i in range(3):
        put(turn[i], values, ROTATION + 3 * i)
        values[READINGS + i] = lengths[i] + legs[i, OFFSET]
    values[DETERMINANT] = unit * pair_determinant(c)

    for k in range(3):
        if k == 0:
            direct, height = (2.0 * (w + x * x / w), 2.0 * (x * y / w + s), 2.0 * (x * s / w - y)), 0.0
        elif k == 1:
            direct, height = (2.0 * (x * y / w - s), 2.0 * (w + y * y / w), 2.0 * (y * s / w + x)), 0.0
        else:
            direct, height = (0.0, 0.0, 0.0), radius
        by_turn = dots(axes, crosses((direct, direct, direct), arms))
        leaving = combined(by_turn, height, (axes[0][2], axes[1][2], axes[2][2]))
        change = weighted(leaving, columns)
        turning = combined(direct, -change[0], spin)
        velocity = -change[1], -change[2], height
        moved = shifted(crosses((turning, turning, turning), arms), velocity)
        rates = dots(u, moved)
        across = combinations(moved, (-rates[0], -rates[1], -rates[2]), u)
        tilted = crosses(axes, multiples(over_lengths, across))
        slope = pair_determinant_slope(c, pairs(moved, normals)) + pair_determinant_slope(c, pairs(balls, tilted))
        for i in range(3):
            slopes[SPIN + i, k], slopes[VELOCITY + i, k] = turning[i], velocity[i]
            slopes[RATES + i, k] = upward * rates[i]
        slopes[RATES + 3, k] = unit * slope

    if aspect == ANY_ASPECT:
        return INSIDE
    # In the home's aspect at most one of the c_ij is negative, see `is_home_aspect`; no search goes farther.
    if aspect == HOME_ASPECT and (negative_pairs(c) > 1.0 or not upward * z > 0.0):
        return OTHER_ASPECT
    if values[DETERMINANT] > 0.0:
        return INSIDE
    return BEYOND if values[DETERMINANT] > _BEYOND else OTHER_ASPECT


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, f8[:, ::1], f8[:, :, ::1], i8[::1])")
def stage_states(coordinates, legs, radius, upward, aspect, values, slopes, places):
    """Write the values (N, 16) of a stage, their derivatives (N, 10, 3), and where it is (N,), see `evaluate_stage`."""
    for n in range(len(coordinates)):
        places[n] = evaluate_stage(coordinates[n], legs, radius, upward, aspect, values[n], slopes[n])
        if places[n] == NO_STATE:
            values[n], slopes[n] = np.nan, np.nan


@kernel("void(f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8, i8[:, ::1], i8[:, ::1], f8[:, ::1])")
def nearby_stages(points, rotations, offsets, table, spacing, stages, cells, distances):
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
                a, b, c = min(max(u, 0.0), last0), min(max(v, 0.0), last1), min(max(w, 0.0), last2)
                i, j, m = int(a), int(b), int(c)
                distance = table[i, j, m]
                if a != u or b != v or c != w:
                    distance += spacing * math.sqrt((u - a) ** 2 + (v - b) ** 2 + (w - c) ** 2)
                if distance < least:
                    least = distance
                    stages[n, group] = k
                    cells[n, group] = (i * table.shape[1] + j) * table.shape[2] + m
            distances[n, group] = least
