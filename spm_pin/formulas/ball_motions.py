"""Newton's method on the three balls b_i of the middle platform, for any machine: `docs/theory/calibrated.md`.

Two components of each ball's velocity are given, q_i along f_i and p_i along a_i: f_i and a_i are the directions of the
leg and of its axis if the readings are given, the axes of the ball's two legs if the pose is. The velocity is

    v_i = q_i n_i + p_i m_i + λ_i w_i,    w_i = f_i x a_i,    n_i = a_i x w_i / |w_i|²,    m_i = w_i x f_i / |w_i|²,

and the λ_i follow from the rates of the balls' distances, as in `spm_pin.formulas.wrenches`. If the errors of planes,
lengths and distances replace the rates, it is Newton's step, to be subtracted.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.circles import Circles, squared_sides
from spm_pin.formulas.leg_constants import drawn_triangle
from spm_pin.formulas.leg_planes import StageLegs, upper_balls
from spm_pin.formulas.stages import inverse, pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    combined,
    cross,
    crosses,
    differences,
    directions_and_lengths,
    dots,
    larger,
    largest,
    matrix_product,
    minus,
    multiples,
    scaled,
    shifted,
    times,
    transposed,
    turned,
    weighted,
)
from spm_pin.formulas.wrenches import arms, mean, pairs, structure_determinant

NONE = (0.0, 0.0, 0.0)


class BallMotions(NamedTuple):
    """Velocities of the b_i per unit of q_i, p_i and λ_i, and the equations for the λ_i."""

    n: Rows
    m: Rows
    w: Rows
    columns: Rows  # of the inverse of the matrix of the c_ij, see `wrenches`
    b: Rows


class Errors(NamedTuple):
    """Errors of the positions of the balls, or rates that remove them."""

    along_f: Vector
    along_a: Vector
    apart: Vector  # half the errors of the squared distances of the balls 12, 23, 31


def plane_errors(b: Rows, legs: StageLegs) -> Vector:
    """Return the distances of the balls from the planes of their legs."""
    return dots(legs.axes, differences(b, legs.pivots))


def stage_errors(b: Rows, stage: Circles) -> Errors:
    """Return the errors of balls relative to the circles of a stage, along the arms and the axes."""
    arms = differences(b, stage.centres)
    _, distances = directions_and_lengths(arms)
    return Errors(
        minus(distances, stage.radii), dots(stage.axes, arms), scaled(0.5, minus(squared_sides(b), stage.squares))
    )


def structure_errors(b: Rows, c: Rows, lower: StageLegs, upper: StageLegs, squares: Vector) -> Errors:
    """Return the errors of balls b, c relative to the planes of the lower and of the upper legs, all in {B}."""
    apart = scaled(0.5, minus(squared_sides(b), squares))
    return Errors(plane_errors(c, upper), plane_errors(b, lower), apart)


def largest_error(errors: Errors, size: float) -> float:
    """Return the largest error as a length; `size` is about the distance of two balls."""
    return larger(larger(largest(errors.along_f), largest(errors.along_a)), largest(errors.apart) / size)


def ball_motions(b: Rows, f: Rows, a: Rows) -> BallMotions:
    """Return the motions of balls b_i with the directions f_i and a_i."""
    w = crosses(f, a)
    x, y, z = dots(w, w)
    inverses = 1.0 / x, 1.0 / y, 1.0 / z
    n, m = multiples(inverses, crosses(a, w)), multiples(inverses, crosses(w, f))
    return BallMotions(n, m, w, pair_inverse(pairs(b, w)), b)


def velocities(motions: BallMotions, rates: Errors) -> Rows:
    """Return the velocities of the balls for these rates along f_i and a_i and of half the squared distances."""
    v = combinations(multiples(rates.along_f, motions.n), rates.along_a, motions.m)
    d12, d23, d31, d21, d32, d13 = pairs(motions.b, v)
    missing = minus(rates.apart, (d12 + d21, d23 + d32, d31 + d13))
    return combinations(v, weighted(missing, motions.columns), motions.w)


def upper_velocities(b: Rows, v: Rows, weights: Rows) -> Rows:
    """Return the velocities of the upper legs' balls from those of the b_i, see `leg_planes.upper_balls`."""
    p, q, dp, dq = minus(b[1], b[0]), minus(b[2], b[0]), minus(v[1], v[0]), minus(v[2], v[0])
    dn = combined(cross(dp, q), 1.0, cross(p, dq))
    return combinations(v, (1.0, 1.0, 1.0), matrix_product(weights, (dp, dq, dn)))


def structure_velocities(motions: BallMotions, rates: Errors, a_m: Rows, weights: Rows) -> Rows:
    """Return `velocities` for `rates.along_f` of the upper legs' balls along their axes `a_m`."""
    b, first = motions.b, velocities(motions, Errors(NONE, rates.along_a, rates.apart))
    x = velocities(motions, Errors((1.0, 0.0, 0.0), NONE, NONE))
    y = velocities(motions, Errors((0.0, 1.0, 0.0), NONE, NONE))
    z = velocities(motions, Errors((0.0, 0.0, 1.0), NONE, NONE))
    missing = minus(rates.along_f, dots(upper_velocities(b, first, weights), a_m))
    by_x, by_y = dots(upper_velocities(b, x, weights), a_m), dots(upper_velocities(b, y, weights), a_m)
    columns, _ = inverse(transposed((by_x, by_y, dots(upper_velocities(b, z, weights), a_m))))
    q0, q1, q2 = weighted(missing, columns)
    return combinations(combinations(combinations(first, (q0, q0, q0), x), (q1, q1, q1), y), (q2, q2, q2), z)


def structure_step(b: Rows, lower: StageLegs, upper: StageLegs, weights: Rows, squares: Vector) -> Rows:
    """Return Newton's step for the balls of a pose, to be subtracted from b, see `structure_errors`."""
    errors = structure_errors(b, upper_balls(b, weights), lower, upper, squares)
    return structure_velocities(ball_motions(b, upper.axes, lower.axes), errors, upper.axes, weights)


def structure_side(b: Rows, c: Rows, lower: StageLegs, upper: StageLegs) -> float:
    """Return det K [m³]: its sign is the side of the inverse singularities on which a state is."""
    p = mean(b)
    return structure_determinant(arms(b, p, 1.0), arms(c, p, 1.0), lower.axes, upper.axes)


def moved_balls(b: Rows, v: Rows, longest: float) -> Rows:
    """Return the balls after the step -v, scaled down so that none moves farther than about `longest`."""
    factor = -1.0 / larger(1.0, larger(larger(largest(v[0]), largest(v[1])), largest(v[2])) / longest)
    return combinations(b, (factor, factor, factor), v)


def placeholder_state(r: float) -> tuple[Rows, tuple[Rows, Vector]]:
    """Return balls and a pose far from any singularity, which replace a missing state to avoid NaN."""
    level = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return shifted(drawn_triangle(r), (0.0, 0.0, 2.0 * r)), (level, (0.0, 0.0, 4.0 * r))


def frame_of_triangle(axes: Rows, own_axes: Rows, b: Rows, own: Rows) -> tuple[Rows, Vector]:
    """Return rotation and position of the middle platform, whose balls are at b and, in its own frame, at `own`.

    `axes` and `own_axes` are `joint_values.triangle_axes` of both.
    """
    rotation = matrix_product(transposed(axes), own_axes)
    return rotation, minus(mean(b), times(rotation, mean(own)))


def pose_of_frames(turn: Rows, place: Vector, turn_m: Rows, place_m: Vector) -> tuple[Rows, Vector]:
    """Return the pose R, o of {m} in {B} from the middle platform's rotation and position in {B} and in {m}."""
    rotation = matrix_product(turn, transposed(turn_m))
    return rotation, minus(place, times(rotation, place_m))


def points_from_platform(points: Rows, rotation: Rows, position: Vector) -> Rows:
    """Return in {m}, whose pose is R and o, three points given in {B}."""
    return turned(transposed(rotation), differences(points, (position, position, position)))
