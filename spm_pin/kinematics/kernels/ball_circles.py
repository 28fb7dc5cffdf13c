"""Newton's method on a stage: the physical state of its legs' circles, and a state followed to other circles.

With locked actuators each ball lies on a circle, see `spm_pin.formulas.circles`; the two stages of a robot are solved
separately and combined afterwards. The search for the physical state begins at the level stage. A state is followed in
steps that are safe by the theorem of Newton and Kantorovich, `circles.is_safe_step`: there is one solution nearby, and
Newton's method converges to it.
"""

from __future__ import annotations

import numpy as np

from spm_pin.formulas.ball_motions import frame_of_triangle, pose_of_frames
from spm_pin.formulas.circles import (
    MOST_STEPS,
    SEARCH_STEPS,
    WANDERING,
    Circles,
    balls_at,
    circles_between,
    first_step,
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
from spm_pin.formulas.vectors import Rows, Vector, combinations, largest
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, put_rows, readonly_array, rows_at, vector_at
from spm_pin.support.arguments import FloatArray

_SHORTEST = 1e-9  # where a step would have to be shorter than this share of the way, a singularity is met
_SHORT = 0.1  # radius over the largest one below which Newton's method may wander although there is a home state
_MOST_SAFE_STEPS = 250_000  # a bound of the time; a way that needs more is said to meet a singularity


@jit_inline
def circles_at(axes: FloatArray, centres: FloatArray, radii: FloatArray, squares: Vector) -> Circles:
    """Return the circles of three legs from arrays (3, 3), (3, 3) and (3,)."""
    return Circles(rows_at(axes, 0), rows_at(centres, 0), vector_at(radii, 0), squares)


@jit
def solution(stage: Circles, e: Rows, step: Vector) -> tuple[Rows, Rows, bool]:
    """Return directions and balls to which Newton's method leads from directions e and its step there; and if so."""
    last = np.nan
    for count in range(MOST_STEPS):
        e, size = turned_back(stage, e, limited(step)), largest(step)
        if has_converged(size, last) or (is_stalled(size, last) and is_closed(stage, e)):
            return e, balls_at(stage, e), True
        if not size < (np.inf if count < SEARCH_STEPS else WANDERING):
            break
        last, step = size, newton_step(stage, e)
    return e, balls_at(stage, e), last < 1e-9


@jit
def followed(start: Circles, end: Circles, balls: Rows) -> tuple[Rows, bool]:
    """Follow balls while circles change from `start` to `end`; return the balls, and if they got there."""
    share, length, change = 0.0, 1.0, largest_change(start, end)
    for _ in range(_MOST_SAFE_STEPS):
        target = min(share + length, 1.0)
        stage, middle = circles_between(start, end, target), circles_between(start, end, 0.5 * (share + target))
        first = first_step(stage, balls)
        if is_safe_step(middle, stage, balls, first, change * (target - share)):
            _, moved, arrived = solution(stage, first.directions, first.step)
            if arrived:
                balls, share, length = moved, target, 2.0 * length
                if share == 1.0:
                    return balls, True
                continue
        length *= 0.5
        if length < _SHORTEST:
            break
    return balls, False


@kernel(f"void({readonly_array(2)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(3)}, f8[:,:,::1])")
def circle_centres(x, z, pivots, planes, centres):
    """Write the points (N, 3, 3) [m] at x and z (N, 3) in the planes of three legs, from `pivots` (3, 3).

    `planes` (2, 3, 3) are the directions of x and z.
    """
    p, outward, forward = rows_at(pivots, 0), rows_at(planes[0], 0), rows_at(planes[1], 0)
    for n in range(len(x)):
        put_rows(combinations(combinations(p, vector_at(x[n], 0), outward), vector_at(z[n], 0), forward), centres[n])


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(1)}, "
    "f8[:,:,:,::1], b1[:,::1])"
)
def home_states(centres, radii, axes, balls, ups, joints, is_elsewhere):
    """Find the physical states of N machines of m stages, 1 or 2, by Newton's method from the level ones.

    The circles of the legs have `centres` (N, 3m, 3) [m], `radii` (N, 3m) [m] and `axes` (3m, 3), in {B} of a lower
    stage and in {m} of an upper one; `balls` (3m, 3) [m] are in the platform's frame and `ups` (m,) the stages'
    `PlacedLegs.up`. Written are the balls (N, m, 3, 3) [m], NaN where no physical state was found, and whether one may
    exist all the same (N, m): Newton's method ended in another aspect, or wandered with a short leg.
    """
    for k in range(len(ups)):
        leg, own = 3 * k, rows_at(balls, 3 * k)
        squares = squared_sides(own)
        for n in range(len(radii)):
            stage = circles_at(axes[leg:], centres[n, leg:], radii[n, leg:], squares)
            first = first_step(stage, level_balls(stage, own, ups[k]))
            _, b, converged = solution(stage, first.directions, first.step)
            is_home = is_home_state(b, stage.centres, stage.axes, ups[k])
            is_short = min(radii[n, leg : leg + 3]) < _SHORT * max(radii[n, leg : leg + 3])
            is_elsewhere[n, k] = not is_home if converged else is_short
            joints[n, k] = np.nan
            if converged and is_home:
                put_rows(b, joints[n, k])


@kernel(
    f"void({readonly_array(4)}, {readonly_array(3)}, {readonly_array(2)}, {readonly_array(3)}, {readonly_array(2)}, "
    f"{readonly_array(2)}, {readonly_array(2)}, f8[:,:,:,::1])"
)
def follow_states(joints, start, start_radii, end, end_radii, axes, balls, end_joints):
    """Follow N states of m stages, balls (N, m, 3, 3) [m], from one set of circles to another along a straight line.

    The circles have the centres `start` and `end` (N, 3m, 3) [m] and radii (N, 3m) [m]; `axes` and `balls` are as for
    `home_states`. The results are the balls, NaN where there are none at the start or the path meets a singularity.
    """
    for k in range(joints.shape[1]):
        leg = 3 * k
        squares = squared_sides(rows_at(balls, leg))
        for n in range(len(end_radii)):
            first = circles_at(axes[leg:], start[n, leg:], start_radii[n, leg:], squares)
            last = circles_at(axes[leg:], end[n, leg:], end_radii[n, leg:], squares)
            b, arrived = followed(first, last, rows_at(joints[n, k], 0))
            end_joints[n, k] = np.nan
            if arrived:
                put_rows(b, end_joints[n, k])


@kernel(f"void({readonly_array(4)}, {readonly_array(2)}, f8[:,:,::1], f8[:,::1], f8[:,:,::1])")
def join_stages(stages, balls, rotation, position, joints):
    """Put the states of m stages together, 1 or 2, whose balls (N, m, 3, 3) [m] are in {B} and in {m}.

    Written are R (N, 3, 3) and o (N, 3) [m] of the platform, and of two stages the b_i (N, 3, 3) [m], NaN where either
    has no state. `balls` (3m, 3) [m] are in the middle platform's frame.
    """
    count = stages.shape[1]
    own, own_upper = rows_at(balls, 0), rows_at(balls, 3 * count - 3)
    axes, axes_upper = triangle_axes(own), triangle_axes(own_upper)
    for n in range(len(stages)):
        b, c = rows_at(stages[n, 0], 0), rows_at(stages[n, count - 1], 0)
        r, o = frame_of_triangle(triangle_axes(b), axes, b, own)
        if count == 2:
            turn_m, place_m = frame_of_triangle(triangle_axes(c), axes_upper, c, own_upper)
            r, o = pose_of_frames(r, o, turn_m, place_m)
            joints[n] = np.nan
            # Not numbers where either stage has no state.
            if o[0] == o[0]:
                put_rows(b, joints[n])
        put_rows(r, rotation[n])
        position[n, 0], position[n, 1], position[n, 2] = o
