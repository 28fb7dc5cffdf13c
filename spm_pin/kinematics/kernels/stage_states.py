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
    is_home_aspect,
    pair_determinant,
    pair_determinant_slope,
)
from spm_pin.formulas.vectors import Rows, Vector, combined, cross, dot, largest, minus, scaled, times, weighted
from spm_pin.formulas.vectors import rotation_of as rotation_of_quaternion
from spm_pin.formulas.wrenches import pairs
from spm_pin.kinematics.kernels.compilation import Int64Array, jit, kernel
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
_BEYOND = -0.05
"""Determinant down to which a search may step beyond a forward singularity; it is about 1 at home."""
_STEPS = 12
"""Newton steps for x3 and the centre at most."""


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
def _by_turn(axes: Rows, spin: Vector, arms: Rows) -> Vector:
    """Return how fast the balls leave their planes while the platform turns."""
    first, second = dot(axes[0], cross(spin, arms[0])), dot(axes[1], cross(spin, arms[1]))
    return first, second, dot(axes[2], cross(spin, arms[2]))


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
        arms = times(turn, corners[0]), times(turn, corners[1]), times(turn, corners[2])
        # The rotation by x3, and from it how the planes are left.
        spin = 2.0 * (s * x / w + y), 2.0 * (s * y / w - x), 2.0 * (w + s * s / w)
        turned = _by_turn(axes, spin, arms)
        columns, _ = inverse(
            (
                (turned[0], axes[0][0], axes[0][1]),
                (turned[1], axes[1][0], axes[1][1]),
                (turned[2], axes[2][0], axes[2][1]),
            )
        )
        balls = combined(centre, 1.0, arms[0]), combined(centre, 1.0, arms[1]), combined(centre, 1.0, arms[2])
        along = minus(balls[0], pivots[0]), minus(balls[1], pivots[1]), minus(balls[2], pivots[2])
        gaps = dot(axes[0], along[0]), dot(axes[1], along[1]), dot(axes[2], along[2])
        gap = largest(gaps)
        if gap <= tolerance or step == last:
            break
        change = weighted(gaps, columns)
        s -= change[0]
        centre = centre[0] - change[1], centre[1] - change[2], z
    if not gap <= 1e-9 * (radius + abs(z)):
        return NO_STATE
    lengths = math.sqrt(dot(along[0], along[0])), math.sqrt(dot(along[1], along[1])), math.sqrt(dot(along[2], along[2]))
    u = (
        scaled(upward / lengths[0], along[0]),
        scaled(upward / lengths[1], along[1]),
        scaled(upward / lengths[2], along[2]),
    )
    normals = cross(axes[0], u[0]), cross(axes[1], u[1]), cross(axes[2], u[2])
    c = pairs(balls, normals)
    # At home all six c_ij are 3/2 r times the sine of the legs' slope.
    unit = 1.0 / (6.75 * radius * radius * radius)
    if aspect == 1.0 or aspect == -1.0:
        unit *= aspect
    put(turn[0], values, ROTATION)
    put(turn[1], values, ROTATION + 3)
    put(turn[2], values, ROTATION + 6)
    put(centre, values, CENTRE)
    for i in range(3):
        values[READINGS + i] = lengths[i] + legs[i, OFFSET]
    values[DETERMINANT] = unit * pair_determinant(c)

    for k in range(3):
        if k == 0:
            direct, height = (2.0 * (w + x * x / w), 2.0 * (x * y / w + s), 2.0 * (x * s / w - y)), 0.0
        elif k == 1:
            direct, height = (2.0 * (x * y / w - s), 2.0 * (w + y * y / w), 2.0 * (y * s / w + x)), 0.0
        else:
            direct, height = (0.0, 0.0, 0.0), radius
        leaving = combined(_by_turn(axes, direct, arms), height, (axes[0][2], axes[1][2], axes[2][2]))
        change = weighted(leaving, columns)
        turning = combined(direct, -change[0], spin)
        velocity = -change[1], -change[2], height
        moved = (
            combined(velocity, 1.0, cross(turning, arms[0])),
            combined(velocity, 1.0, cross(turning, arms[1])),
            combined(velocity, 1.0, cross(turning, arms[2])),
        )
        rates = dot(u[0], moved[0]), dot(u[1], moved[1]), dot(u[2], moved[2])
        tilted = (
            cross(axes[0], scaled(upward / lengths[0], combined(moved[0], -rates[0], u[0]))),
            cross(axes[1], scaled(upward / lengths[1], combined(moved[1], -rates[1], u[1]))),
            cross(axes[2], scaled(upward / lengths[2], combined(moved[2], -rates[2], u[2]))),
        )
        slope = pair_determinant_slope(c, pairs(moved, normals)) + pair_determinant_slope(c, pairs(balls, tilted))
        for i in range(3):
            slopes[SPIN + i, k], slopes[VELOCITY + i, k] = turning[i], velocity[i]
            slopes[RATES + i, k] = upward * rates[i]
        slopes[RATES + 3, k] = unit * slope

    if aspect == ANY_ASPECT:
        return INSIDE
    if aspect == HOME_ASPECT:
        negative = 0
        for i in range(6):
            negative += c[i] < 0.0
        # In the home's aspect at most one of the c_ij is negative, see `is_home_aspect`; no search goes farther.
        if negative > 1 or not upward * z > 0.0 or (values[DETERMINANT] > 0.0 and not is_home_aspect(c)):
            return OTHER_ASPECT
    if values[DETERMINANT] > 0.0:
        return INSIDE
    return BEYOND if values[DETERMINANT] > _BEYOND else OTHER_ASPECT


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, f8[:, ::1], f8[:, :, ::1], i8[::1])")
def stage_states(
    coordinates: FloatArray,
    legs: FloatArray,
    radius: float,
    upward: float,
    aspect: float,
    values: FloatArray,
    slopes: FloatArray,
    places: Int64Array,
) -> None:
    """Write the values (N, 16) of a stage, their derivatives (N, 10, 3), and where it is (N,), see `evaluate_stage`."""
    for n in range(len(coordinates)):
        places[n] = evaluate_stage(coordinates[n], legs, radius, upward, aspect, values[n], slopes[n])
        if places[n] == NO_STATE:
            values[n], slopes[n] = np.nan, np.nan


@kernel("void(f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8, i8[:, ::1], i8[:, ::1], f8[:, ::1])")
def nearby_stages(
    points: FloatArray,
    rotations: FloatArray,
    offsets: FloatArray,
    table: FloatArray,
    spacing: float,
    stages: Int64Array,
    cells: Int64Array,
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
