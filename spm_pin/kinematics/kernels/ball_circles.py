"""Following a state of any machine while its leg lengths and its dimensions change, each stage by itself.

A leg of known length holds its ball on a circle about its revolute axis. Three angles are unknown, and the three
distances between the balls are the equations. A step is taken if the theorem of Newton and Kantorovich holds at its
start for all lengths along it: there is one solution near, and Newton's method finds it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spm_pin.formulas.ball_motions import (
    frame_of_triangle,
    leg_vectors,
    points_from_platform,
    pose_of_frames,
    squared_sides,
)
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.leg_planes import upper_ball_weights, upper_balls
from spm_pin.formulas.stages import pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    combined,
    crosses,
    differences,
    directions,
    dots,
    larger,
    largest,
    magnitude,
    minus,
    multiples,
    scaled,
    weighted,
)
from spm_pin.formulas.wrenches import pairs
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array, rows_at
from spm_pin.kinematics.kernels.quadric_newton import has_converged
from spm_pin.mechanism.arguments import FloatArray

_KANTOROVICH, _DRIFT = 0.125, 0.25
"""Largest products of the inverse's norm at the end of a step with the Lipschitz constant times Newton's first step and
with the change of the derivative on the way. At constant angles the errors are quadratic in the lengths, so all along
the step they are at most 5/4 of those in the middle and at the end, and the norm is at most 4/3 of that at the end: the
first product stays below (4/3)² 5/4 · 1/8 < 0.28; the theorem asks for 1/2."""
_SHORTEST = 1e-9  # a step shorter than this part of the way stands before a singularity
_MOST_STEPS = 250_000  # a bound of the time; more are taken for a singularity
_ITERATIONS = 12


class Circles(NamedTuple):
    """A stage as circles on which its balls are, and their distances 12, 23, 31."""

    axes: Rows
    pivots: Rows
    radii: Vector
    sides: Vector


@jit_inline
def _sides(b: Rows) -> Vector:
    d12, d23, d31 = squared_sides(b)
    return math.sqrt(d12), math.sqrt(d23), math.sqrt(d31)


@jit_inline
def _circles(machine: FloatArray, first: int, radii: Vector) -> Circles:
    """Return the circles of three legs, from the leg `first`, of a machine (3, 6, 3): axes, pivots, balls."""
    return Circles(rows_at(machine[0], first), rows_at(machine[1], first), radii, _sides(rows_at(machine[2], first)))


@jit_inline
def _along(start: Vector, end: Vector, share: float) -> Vector:
    return combined(start, share, minus(end, start))


@jit_inline
def _between(start: Circles, end: Circles, share: float) -> Circles:
    """Return the circles at this share of the way."""
    shares = share, share, share
    axes = combinations(start.axes, shares, differences(end.axes, start.axes))
    pivots = combinations(start.pivots, shares, differences(end.pivots, start.pivots))
    radii, sides = _along(start.radii, end.radii, share), _along(start.sides, end.sides, share)
    return Circles(directions(axes), pivots, radii, sides)


@jit_inline
def _directions(stage: Circles, balls: Rows) -> Rows:
    """Return the directions from the centres of the circles towards balls that are near them."""
    arms = differences(balls, stage.pivots)
    return directions(combinations(arms, scaled(-1.0, dots(stage.axes, arms)), stage.axes))


@jit_inline
def _balls(stage: Circles, towards: Rows) -> Rows:
    return combinations(stage.pivots, stage.radii, towards)


@jit_inline
def _errors(stage: Circles, balls: Rows) -> Vector:
    """Return half the errors of the squared distances."""
    d12, d23, d31 = stage.sides
    return scaled(0.5, minus(squared_sides(balls), (d12 * d12, d23 * d23, d31 * d31)))


@jit_inline
def _inverse(stage: Circles, across: Rows, balls: Rows) -> Rows:
    """Return the columns of the inverse of the errors' derivative by the angles, whose entries are the c_ij."""
    return pair_inverse(pairs(balls, multiples(stage.radii, across)))


@jit_inline
def _bounds(stage: Circles, change: float) -> tuple[float, float]:
    """Return bounds of the change of the derivative's rows, per radian and as all radii change by at most `change`."""
    gaps, (a, b, c), d = _sides(stage.pivots), stage.radii, stage.sides
    first, second = gaps[0] * (a + b) + 4.0 * a * b, gaps[1] * (b + c) + 4.0 * b * c
    lipschitz = larger(larger(first, second), gaps[2] * (c + a) + 4.0 * c * a)
    longest = larger(larger(a + b + d[0], b + c + d[1]), c + a + d[2])
    return lipschitz, 2.0 * change * (longest + 2.0 * change)


@jit
def _is_near(middle: Circles, end: Circles, balls: Rows, change: float) -> bool:
    """Return whether a solution at the start of a step is next to those all along it, as radii change by `change`."""
    towards = _directions(end, balls)
    moved = _balls(end, towards)
    first, second, third = _inverse(end, crosses(end.axes, towards), moved)
    at_end = weighted(_errors(end, moved), (first, second, third))
    at_middle = weighted(_errors(middle, _balls(middle, towards)), (first, second, third))
    sums = (
        magnitude(first[0]) + magnitude(second[0]) + magnitude(third[0]),
        magnitude(first[1]) + magnitude(second[1]) + magnitude(third[1]),
        magnitude(first[2]) + magnitude(second[2]) + magnitude(third[2]),
    )
    norm, (lipschitz, drift) = largest(sums), _bounds(end, change)
    # Not a number where there is no inverse.
    is_regular = norm * drift <= _DRIFT
    return is_regular and norm * lipschitz * larger(largest(at_middle), largest(at_end)) <= _KANTOROVICH


@jit
def _solution(stage: Circles, balls: Rows) -> tuple[Rows, bool]:
    """Return the solution near these balls, and whether Newton's method arrived."""
    towards, last = _directions(stage, balls), np.nan
    for _ in range(_ITERATIONS):
        across, here = crosses(stage.axes, towards), _balls(stage, towards)
        step = weighted(_errors(stage, here), _inverse(stage, across, here))
        towards = directions(combinations(towards, scaled(-1.0, step), across))
        size = largest(step)
        if has_converged(size, last):
            return _balls(stage, towards), True
        last = size
    return _balls(stage, towards), last < 1e-9


@jit
def _followed(start: Circles, end: Circles, first: Rows) -> tuple[Rows, bool]:
    """Return where balls at the start are led, and whether that is the end."""
    balls, share, length = first, 0.0, 1.0
    change = largest(minus(end.radii, start.radii))
    for _ in range(_MOST_STEPS):
        target = min(share + length, 1.0)
        stage, middle = _between(start, end, target), _between(start, end, 0.5 * (share + target))
        if _is_near(middle, stage, balls, change * (target - share)):
            moved, arrived = _solution(stage, balls)
            if arrived:
                balls, share, length = moved, target, 2.0 * length
                if share == 1.0:
                    return balls, True
                continue
        length *= 0.5
        if length < _SHORTEST:
            break
    return balls, False


@jit_inline
def _placement(local: Rows, balls: Rows) -> tuple[Rows, Vector]:
    """Return the rotation and the position that take balls from their own frame to where they are."""
    return frame_of_triangle(triangle_axes(balls), triangle_axes(local), balls, local)


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(3)}, {readonly_array(2)}, {readonly_array(3)}, "
    f"{readonly_array(3)}, f8[:,:,::1], f8[:,::1], f8[:,:,::1])"
)
def follow_states(rotation, position, joints, lengths, start, end, end_rotation, end_position, end_joints):
    """Follow N states from one machine to another and to other leg lengths, all changing in proportion.

    States are R (N, 3, 3), o (N, 3) [m] and the b_i (N, 3, 3) [m], NaN where there is none at the start, and where the
    path meets a singularity before the end. `lengths` (N, 6) are the distances from pivots to balls at the end [m],
    `start` and `end` (3, 6, 3) axes, pivots and balls of the machines [m].
    """
    weights = upper_ball_weights(rows_at(start[2], 0), rows_at(start[2], 3))
    for n in range(len(lengths)):
        end_rotation[n], end_position[n], end_joints[n] = np.nan, np.nan, np.nan
        r, o, b = rows_at(rotation[n], 0), (position[n, 0], position[n, 1], position[n, 2]), rows_at(joints[n], 0)
        c = points_from_platform(upper_balls(b, weights), r, o)
        _, radii = leg_vectors(b, rows_at(start[1], 0))
        lower = _circles(start, 0, radii)
        b, arrived = _followed(lower, _circles(end, 0, (lengths[n, 0], lengths[n, 1], lengths[n, 2])), b)
        if not arrived:
            continue
        _, radii = leg_vectors(c, rows_at(start[1], 3))
        upper = _circles(start, 3, radii)
        c, arrived = _followed(upper, _circles(end, 3, (lengths[n, 3], lengths[n, 4], lengths[n, 5])), c)
        if not arrived:
            continue
        middle, place = _placement(rows_at(end[2], 0), b)
        middle_m, place_m = _placement(rows_at(end[2], 3), c)
        r, o = pose_of_frames(middle, place, middle_m, place_m)
        for i in range(3):
            end_position[n, i] = o[i]
            for j in range(3):
                end_rotation[n, i, j], end_joints[n, i, j] = r[i][j], b[i][j]
