"""One stage by its coordinates: where its middle platform is, its readings and its determinant, with derivatives.

A stage is three legs, each of which keeps its ball in a plane. Its middle platform has three freedoms: (x, y), two
components of the unit quaternion (x0, x, y, x3), and the height Z of the triangle's centre, divided by its radius r.
The three planes give x3 and the centre's other coordinates: zero and (-2r xy, r (y² - x²)) in the nominal machine, and
a few steps of Newton's method from there in a calibrated one. So a state exists for all (x, y) in the unit circle. See
`docs/theory/reachable_set.md`.

The upper stage is the same seen from {m}. A stage of mode F has its balls turned by half a turn about the platform's
normal.
"""

from __future__ import annotations

import math

import numpy as np

from spm_pin.formulas.planar_legs import PRS_LEGS, RRS_LEGS, LegState, leg_rates, prs_state, rps_state, rrs_state
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
    dot,
    dots,
    largest,
    least,
    multiples,
    rotation_of,
    shifted,
    transposed,
    turned,
    weighted,
)
from spm_pin.formulas.wrenches import pairs
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, vector_at
from spm_pin.support.arguments import FloatArray

AXIS, PIVOT, BALL, OUTWARD, FORWARD, NUMBERS, OFFSET, KIND, MIDDLE = 0, 3, 6, 9, 12, 15, 18, 19, 20
"""Offsets of a leg's numbers in a row (21,) of `legs`: see `Legs`, `LegKind.number` and `planar_legs.crank_middle`."""
ROTATION, CENTRE, READINGS, DETERMINANT, ROOMS, STAGE_NUMBERS = 0, 9, 12, 15, 16, 19
"""Offsets of a stage's rotation, centre [m], readings, determinant and rooms of the legs [m], see `planar_legs.Room`,
in `values` (19,); and the length of that array."""
SPIN, VELOCITY, RATES, SLOPE_NUMBERS = 0, 3, 6, 13
"""First rows of derivatives in `slopes` (13, 3): of the rotation, as a rotation vector, of the centre, and
of the three readings, the determinant and the three rooms, in this order; and the number of rows."""
NO_STATE, OTHER_ASPECT, BEYOND, INSIDE = 0, 1, 2, 3
"""Classes of coordinates: no state exists; in another aspect; slightly beyond a forward singularity or one of
a leg; in the wanted aspect and within reach of the legs."""
_BEYOND = -0.05
"""Limits beyond a singularity to which searches may step: smallest determinant, in units in which it is about 1 at
home, and smallest room of a leg over r."""
_STEPS = 12  # most Newton steps for x3 and the centre


@jit
def vectors_at(array: FloatArray, first: int) -> Rows:
    """Return three numbers from `first` on of each of three rows of an array."""
    return vector_at(array[0], first), vector_at(array[1], first), vector_at(array[2], first)


@jit
def stage_rotation(values: FloatArray) -> Rows:
    """Return the rotation of a stage."""
    return vector_at(values, ROTATION), vector_at(values, ROTATION + 3), vector_at(values, ROTATION + 6)


@jit
def put(numbers: Vector, array: FloatArray, first: int) -> None:
    """Write three numbers into an array."""
    array[first], array[first + 1], array[first + 2] = numbers


@jit_inline
def _leg_state(leg: FloatArray, x: float, z: float) -> LegState:
    """Return the state of a leg by its kind."""
    if leg[KIND] == PRS_LEGS:
        return prs_state(x, z, vector_at(leg, NUMBERS))
    if leg[KIND] == RRS_LEGS:
        return rrs_state(x, z, leg[MIDDLE], vector_at(leg, NUMBERS))
    return rps_state(x, z, vector_at(leg, NUMBERS))


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
    """Write the `values` (19,) of a stage and their derivatives `slopes` (13, 3) by its three coordinates.

    Returned is where the stage is, `NO_STATE` to `INSIDE`. `legs` (3, 21) are in {B} of a lower stage, in {m} of an
    upper one; `radius` is r [m], `upward` the sign of Z at home, 0 for either, and `aspect` the wanted one, see
    `stages.HOME_ASPECT`, whose negative is the home assembly region of a stage that hangs.
    """
    x, y, z = coordinates[0], coordinates[1], radius * coordinates[2]
    axes, pivots, corners = vectors_at(legs, AXIS), vectors_at(legs, PIVOT), vectors_at(legs, BALL)
    centre, s = (-2.0 * radius * x * y, radius * (y * y - x * x), z), 0.0
    tolerance, last, gap = 4.0 * EPS * (radius + abs(z)), _STEPS - 1, np.inf
    for step in range(_STEPS):
        square = 1.0 - x * x - y * y - s * s
        if not square > 0.0:
            return NO_STATE
        w = math.sqrt(square)
        turn = rotation_of(x, y, s, w)
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
    outward, forward = vectors_at(legs, OUTWARD), vectors_at(legs, FORWARD)
    p, q = dots(outward, along), dots(forward, along)
    states = _leg_state(legs[0], p[0], q[0]), _leg_state(legs[1], p[1], q[1]), _leg_state(legs[2], p[2], q[2])
    (p1, q1), (p2, q2), (p3, q3) = states[0].direction, states[1].direction, states[2].direction
    # Directions from the circles' centres to the balls, and those in which the balls move with locked actuators.
    u = combinations(multiples((p1, p2, p3), outward), (q1, q2, q3), forward)
    normals = combinations(multiples((q1, q2, q3), outward), (-p1, -p2, -p3), forward)
    c, along_u = pairs(balls, normals), pairs(balls, u)
    # At home all six c_ij are 3/2 r times the sine of the legs' slope.
    unit = 1.0 / (6.75 * radius * radius * radius)
    if aspect < 0.0:
        unit = -unit
    put(centre, values, CENTRE)
    for i in range(3):
        put(turn[i], values, ROTATION + 3 * i)
        values[READINGS + i] = states[i].reading + legs[i, OFFSET]
        values[ROOMS + i] = states[i].room.distance
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
        p, q = dots(outward, moved), dots(forward, moved)
        rates = leg_rates(states[0], p[0], q[0]), leg_rates(states[1], p[1], q[1]), leg_rates(states[2], p[2], q[2])
        turns = rates[0].turn, rates[1].turn, rates[2].turn
        c12, c23, c31, c21, c32, c13 = pairs(moved, normals)
        # A turn of u_i turns the normal by as much towards -u_i.
        pair_slopes = (
            c12 - turns[0] * along_u[0],
            c23 - turns[1] * along_u[1],
            c31 - turns[2] * along_u[2],
            c21 - turns[1] * along_u[3],
            c32 - turns[2] * along_u[4],
            c13 - turns[0] * along_u[5],
        )
        for i in range(3):
            slopes[SPIN + i, k], slopes[VELOCITY + i, k] = turning[i], velocity[i]
            slopes[RATES + i, k], slopes[RATES + 4 + i, k] = rates[i].reading, rates[i].room
        slopes[RATES + 3, k] = unit * pair_determinant_slope(c, pair_slopes)

    room = least(vector_at(values, ROOMS)) / radius
    if not room > _BEYOND:
        return OTHER_ASPECT
    if aspect == ANY_ASPECT:
        return INSIDE if room > 0.0 else BEYOND
    # In the home assembly region at most one of the c_ij is negative, see `is_home_aspect`; no search goes farther.
    if abs(aspect) == HOME_ASPECT:
        negative = negative_pairs(c) if aspect > 0.0 else 6.0 - negative_pairs(c)
        if negative > 1.0 or upward * z < 0.0:
            return OTHER_ASPECT
    if values[DETERMINANT] > 0.0 and room > 0.0:
        return INSIDE
    return BEYOND if values[DETERMINANT] > _BEYOND else OTHER_ASPECT


@kernel("void(f8[:, ::1], f8[:, ::1], f8, f8, f8, f8[:, ::1], f8[:, :, ::1], i8[::1])")
def stage_states(coordinates, legs, radius, upward, aspect, values, slopes, places):
    """Write the values (N, 19) of a stage, their derivatives (N, 13, 3), and where it is (N,), see `evaluate_stage`."""
    for n in range(len(coordinates)):
        places[n] = evaluate_stage(coordinates[n], legs, radius, upward, aspect, values[n], slopes[n])
        if places[n] == NO_STATE:
            values[n], slopes[n] = np.nan, np.nan


@kernel("void(f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, :, ::1], f8, i8[:, ::1], i8[:, ::1], f8[:, ::1])")
def nearby_stages(points, rotations, offsets, table, spacing, stages, cells, distances):
    """Find, for points (N, 3) [m] in {B} and G groups of lower stages, the stage with the point nearest to the reach.

    `table` has, by cells of a cube's side `spacing` [m], the signed distances [m] from what the upper stage reaches, in
    the middle platform's frame, whose `rotations` (n, 3, 3) and `offsets` (n, 3) [cells] are those of the lower stages.
    Written are the best stage of each group, the cell of the table where the point then is, and its distance, (N, G)
    each.
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
                    off = u - a, v - b, w - c
                    distance += spacing * math.sqrt(dot(off, off))
                if distance < least:
                    least = distance
                    stages[n, group] = k
                    cells[n, group] = (i * table.shape[1] + j) * table.shape[2] + m
            distances[n, group] = least
