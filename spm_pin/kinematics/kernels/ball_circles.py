"""Newton's method on stages of any machine: the physical state of leg lengths, and a state followed to other lengths.

Each stage is three circles and a triangle by itself, `spm_pin.formulas.circles`. The physical state is sought from the
level stage. From a state, a step is taken if the theorem of Newton and Kantorovich holds at its start for all lengths
along it: there is one solution near, and Newton's method finds it.
"""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.ball_motions import frame_of_triangle, points_from_platform, pose_of_frames
from spm_pin.formulas.circles import (
    MOST_STEPS,
    SEARCH_STEPS,
    WANDERING,
    Circles,
    balls_at,
    circles_between,
    directions_to,
    has_converged,
    is_closed,
    is_home_state,
    is_safe_step,
    is_stalled,
    largest_change,
    level_balls,
    limited,
    newton_step,
    squared_sides,
    turned_back,
)
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.leg_planes import upper_ball_weights, upper_balls
from spm_pin.formulas.vectors import Rows, Vector, largest
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array, rows_at
from spm_pin.mechanism.arguments import FloatArray

_SHORTEST = 1e-9  # a step shorter than this part of the way stands before a singularity
_MOST_SAFE_STEPS = 250_000  # a bound of the time; more are taken for a singularity
ABSENT, HOME, ELSEWHERE = 0, 1, 2
"""Where Newton's method from the level stages ended: nowhere, in the home's aspect, or in another one."""


@jit_inline
def circles_at(axes: FloatArray, centres: FloatArray, radii: FloatArray, squares: Vector, first: int) -> Circles:
    """Return the circles of three legs, from the leg `first`, of arrays (6, 3), (6, 3) and (6,)."""
    lengths = radii[first], radii[first + 1], radii[first + 2]
    return Circles(rows_at(axes, first), rows_at(centres, first), lengths, squares)


@jit
def solution(stage: Circles, start: Rows) -> tuple[Rows, Rows, bool]:
    """Return directions and balls where Newton's method leads from near these balls, and whether it has converged."""
    e, last = directions_to(stage, start), np.nan
    for count in range(MOST_STEPS):
        step = newton_step(stage, e)
        e, size = turned_back(stage, e, limited(step)), largest(step)
        if has_converged(size, last) or (is_stalled(size, last) and is_closed(stage, e)):
            return e, balls_at(stage, e), True
        if not size < (np.inf if count < SEARCH_STEPS else WANDERING):
            break
        last = size
    return e, balls_at(stage, e), last < 1e-9


@jit
def home_state(stage: Circles, corners: Rows, up: float) -> tuple[Rows, int]:
    """Return the balls of a stage to which Newton's method leads from the level one, and in which aspect they are."""
    e, b, converged = solution(stage, level_balls(stage, corners, up))
    if not converged:
        return b, ABSENT
    return b, HOME if is_home_state(stage, e, b, up) else ELSEWHERE


@jit
def followed(start: Circles, end: Circles, first: Rows, shortest: float) -> tuple[Rows, bool]:
    """Return where balls at the start are led in steps of at least a part of the way, and whether that is the end."""
    balls, share, length, change = first, 0.0, 1.0, largest_change(start, end)
    for _ in range(_MOST_SAFE_STEPS):
        target = min(share + length, 1.0)
        stage, middle = circles_between(start, end, target), circles_between(start, end, 0.5 * (share + target))
        if is_safe_step(middle, stage, balls, change * (target - share)):
            _, moved, arrived = solution(stage, balls)
            if arrived:
                balls, share, length = moved, target, 2.0 * length
                if share == 1.0:
                    return balls, True
                continue
        length *= 0.5
        if length < shortest:
            break
    return balls, False


@jit
def put_state(
    lower: Rows,
    upper: Rows,
    own: Rows,
    own_upper: Rows,
    rotation: FloatArray,
    position: FloatArray,
    joints: FloatArray,
) -> None:
    """Write R (3, 3), o (3,) and the b_i (3, 3) of two stages whose triangles are `own` in the platform's frame."""
    middle, place = frame_of_triangle(triangle_axes(lower), triangle_axes(own), lower, own)
    middle_m, place_m = frame_of_triangle(triangle_axes(upper), triangle_axes(own_upper), upper, own_upper)
    r, o = pose_of_frames(middle, place, middle_m, place_m)
    for i in range(3):
        position[i] = o[i]
        for j in range(3):
            rotation[i, j], joints[i, j] = r[i][j], lower[i][j]


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(2)}, "
    "f8[:,:,::1], f8[:,::1], f8[:,:,::1], i1[::1])"
)
def physical_states(centres, radii, axes, balls, rotation, position, joints, aspect):
    """Find the physical states of N stages by Newton's method from the level ones.

    The circles of the legs have `centres` (N, 6, 3) [m], `radii` (N, 6) [m] and `axes` (6, 3), each in {B} or {m};
    `balls` (6, 3) [m] are in the middle platform's frame. Written are R (N, 3, 3), o (N, 3) [m] and the b_i (N, 3, 3)
    [m], NaN where no state was found, and as `aspect` (N,) `ELSEWHERE` where it may have been passed over.
    """
    own, own_upper = rows_at(balls, 0), rows_at(balls, 3)
    squares, squares_upper = squared_sides(own), squared_sides(own_upper)
    for n in range(len(radii)):
        rotation[n], position[n], joints[n] = np.nan, np.nan, np.nan
        b, aspect[n] = home_state(circles_at(axes, centres[n], radii[n], squares, 0), own, 1.0)
        if aspect[n] == ABSENT:
            continue
        c, upper = home_state(circles_at(axes, centres[n], radii[n], squares_upper, 3), own_upper, -1.0)
        if upper != HOME:
            aspect[n] = upper
        if aspect[n] == HOME:
            put_state(b, c, own, own_upper, rotation[n], position[n], joints[n])


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(3)}, {readonly_array(3)}, {readonly_array(2)}, "
    f"{readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(2)}, "
    "f8[:,:,::1], f8[:,::1], f8[:,:,::1])"
)
def follow_states(
    rotation, position, joints, start, start_radii, end, end_radii, axes, balls, end_rotation, end_position, end_joints
):
    """Follow N states to other circles of their legs, whose centres and radii change in proportion.

    States are R (N, 3, 3), o (N, 3) [m] and the b_i (N, 3, 3) [m], NaN where there is none at the start, and where the
    path meets a singularity before the end. The circles have the centres `start` and `end` (N, 6, 3) [m] and radii
    (N, 6) [m]; `axes` and `balls` are as for `physical_states`.
    """
    own, own_upper = rows_at(balls, 0), rows_at(balls, 3)
    squares, squares_upper, weights = squared_sides(own), squared_sides(own_upper), upper_ball_weights(own, own_upper)
    for n in range(len(end_radii)):
        end_rotation[n], end_position[n], end_joints[n] = np.nan, np.nan, np.nan
        r, o, b = rows_at(rotation[n], 0), (position[n, 0], position[n, 1], position[n, 2]), rows_at(joints[n], 0)
        c = points_from_platform(upper_balls(b, weights), r, o)
        first = circles_at(axes, start[n], start_radii[n], squares, 0)
        b, arrived = followed(first, circles_at(axes, end[n], end_radii[n], squares, 0), b, _SHORTEST)
        if not arrived:
            continue
        first = circles_at(axes, start[n], start_radii[n], squares_upper, 3)
        c, arrived = followed(first, circles_at(axes, end[n], end_radii[n], squares_upper, 3), c, _SHORTEST)
        if arrived:
            put_state(b, c, own, own_upper, end_rotation[n], end_position[n], end_joints[n])
