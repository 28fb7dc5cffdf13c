"""Motions of the middle platform's balls that close the legs, of any machine: `docs/theory/as_built.md`.

The unknowns are the three balls b_i of a stage. Each has two forces f_i and a_i: along the leg and along its axis where
the lengths are known, along the axes of both its legs where the pose is. A motion with rates q_i along f_i and p_i
along a_i is

    v_i = q_i n_i + p_i m_i + λ_i w_i,    w_i = f_i x a_i,    n_i = a_i x w_i / |w_i|²,    m_i = w_i x f_i / |w_i|²,

and the λ_i follow from the rates of the balls' distances, as in `spm_pin.formulas.wrenches`. With the rates that undo
the errors of the planes, lengths and distances it is a step of Newton's method.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import drawn_triangle
from spm_pin.formulas.leg_planes import StageLegs, upper_balls
from spm_pin.formulas.operations import sqrt
from spm_pin.formulas.stages import inverse, pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    crosses,
    differences,
    directions_and_lengths,
    dot,
    larger,
    largest,
    matrix_product,
    minus,
    scaled,
    times,
    transposed,
    weighted,
)
from spm_pin.formulas.wrenches import arms, determinant, mean, normals, pairs, structure_determinant

NONE = (0.0, 0.0, 0.0)


class BallMotions(NamedTuple):
    """The velocities of the b_i for unit rates along f_i, a_i and w_i, and what gives the last."""

    n: Rows
    m: Rows
    w: Rows
    columns: Rows  # of the inverse of the matrix of the c_ij
    b: Rows


class Errors(NamedTuple):
    """Errors of the positions of the balls of a stage, or of both."""

    along_f: Vector
    along_a: Vector
    apart: Vector  # half the errors of the squared distances of the balls 12, 23, 31


def leg_vectors(b: Rows, pivots: Rows) -> tuple[Rows, Vector]:
    """Return the unit vectors from pivots to balls, and the distances."""
    return directions_and_lengths(differences(b, pivots))


def plane_errors(b: Rows, legs: StageLegs) -> Vector:
    """Return the distances of the balls from the planes of their legs."""
    x, y, z = differences(b, legs.pivots)
    return dot(legs.axes[0], x), dot(legs.axes[1], y), dot(legs.axes[2], z)


def squared_sides(b: Rows) -> Vector:
    """Return the squared distances of the balls 12, 23, 31."""
    x, y, z = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    return dot(x, x), dot(y, y), dot(z, z)


def stage_errors(b: Rows, legs: StageLegs, lengths: Vector, squares: Vector) -> Errors:
    """Return the errors of a stage whose legs have these lengths; `squares` are the squared sides of its triangle."""
    _, distances = leg_vectors(b, legs.pivots)
    apart = scaled(0.5, minus(squared_sides(b), squares))
    return Errors(minus(distances, lengths), plane_errors(b, legs), apart)


def structure_errors(b: Rows, c: Rows, lower: StageLegs, upper: StageLegs, squares: Vector) -> Errors:
    """Return the errors of all six planes; `c` are the upper legs' balls, and the upper legs are seen from {B} too."""
    apart = scaled(0.5, minus(squared_sides(b), squares))
    return Errors(plane_errors(c, upper), plane_errors(b, lower), apart)


def largest_error(errors: Errors, size: float) -> float:
    """Return the largest error as a length; `size` is that of the balls' distances."""
    return larger(larger(largest(errors.along_f), largest(errors.along_a)), largest(errors.apart) / size)


def ball_motions(b: Rows, f: Rows, a: Rows) -> BallMotions:
    """Return the motions of balls with forces f_i and a_i."""
    w = normals(f, a)
    x, y, z = 1.0 / dot(w[0], w[0]), 1.0 / dot(w[1], w[1]), 1.0 / dot(w[2], w[2])
    n, m = crosses(a, w), crosses(w, f)
    n, m = (scaled(x, n[0]), scaled(y, n[1]), scaled(z, n[2])), (scaled(x, m[0]), scaled(y, m[1]), scaled(z, m[2]))
    return BallMotions(n, m, w, pair_inverse(pairs(b, w)), b)


def velocities(motions: BallMotions, rates: Errors) -> Rows:
    """Return the velocities of the balls with these rates along f_i and a_i and of half the squared distances."""
    q, p = rates.along_f, rates.along_a
    first = combined(scaled(q[0], motions.n[0]), p[0], motions.m[0])
    second = combined(scaled(q[1], motions.n[1]), p[1], motions.m[1])
    third = combined(scaled(q[2], motions.n[2]), p[2], motions.m[2])
    d12, d23, d31, d21, d32, d13 = pairs(motions.b, (first, second, third))
    missing = rates.apart[0] - (d12 + d21), rates.apart[1] - (d23 + d32), rates.apart[2] - (d31 + d13)
    free, w = weighted(missing, motions.columns), motions.w
    return combined(first, free[0], w[0]), combined(second, free[1], w[1]), combined(third, free[2], w[2])


def upper_velocities(b: Rows, v: Rows, weights: Rows) -> Rows:
    """Return the velocities of the upper legs' balls from those of the b_i, see `leg_planes.upper_balls`."""
    p, q, dp, dq = minus(b[1], b[0]), minus(b[2], b[0]), minus(v[1], v[0]), minus(v[2], v[0])
    dn = combined(cross(dp, q), 1.0, cross(p, dq))
    x, y, z = weighted(weights[0], (dp, dq, dn)), weighted(weights[1], (dp, dq, dn)), weighted(weights[2], (dp, dq, dn))
    return combined(v[0], 1.0, x), combined(v[1], 1.0, y), combined(v[2], 1.0, z)


def structure_velocities(motions: BallMotions, rates: Errors, a_m: Rows, weights: Rows) -> Rows:
    """Return what `velocities` does where `rates.along_f` are those of the upper legs' balls along their axes `a_m`."""
    b, first = motions.b, velocities(motions, Errors(NONE, rates.along_a, rates.apart))
    x = velocities(motions, Errors((1.0, 0.0, 0.0), NONE, NONE))
    y = velocities(motions, Errors((0.0, 1.0, 0.0), NONE, NONE))
    z = velocities(motions, Errors((0.0, 0.0, 1.0), NONE, NONE))
    missing = minus(rates.along_f, _rates(upper_velocities(b, first, weights), a_m))
    columns, _ = inverse(
        transposed(
            (
                _rates(upper_velocities(b, x, weights), a_m),
                _rates(upper_velocities(b, y, weights), a_m),
                _rates(upper_velocities(b, z, weights), a_m),
            )
        )
    )
    q0, q1, q2 = weighted(missing, columns)
    return (
        combined(combined(combined(first[0], q0, x[0]), q1, y[0]), q2, z[0]),
        combined(combined(combined(first[1], q0, x[1]), q1, y[1]), q2, z[1]),
        combined(combined(combined(first[2], q0, x[2]), q1, y[2]), q2, z[2]),
    )


def _rates(v: Rows, a: Rows) -> Vector:
    return dot(v[0], a[0]), dot(v[1], a[1]), dot(v[2], a[2])


def stage_step(b: Rows, legs: StageLegs, lengths: Vector, squares: Vector) -> Rows:
    """Return Newton's step, taken off the balls, for leg lengths, see `stage_errors`."""
    f, _ = leg_vectors(b, legs.pivots)
    return velocities(ball_motions(b, f, legs.axes), stage_errors(b, legs, lengths, squares))


def structure_step(b: Rows, lower: StageLegs, upper: StageLegs, weights: Rows, squares: Vector) -> Rows:
    """Return Newton's step, taken off the balls, for a pose, see `structure_errors`."""
    errors = structure_errors(b, upper_balls(b, weights), lower, upper, squares)
    return structure_velocities(ball_motions(b, upper.axes, lower.axes), errors, upper.axes, weights)


def stage_side(b: Rows, legs: StageLegs) -> float:
    """Return a number with the sign of the determinant of a stage's six forces."""
    return determinant(b, leg_vectors(b, legs.pivots)[0], legs.axes)


def structure_side(b: Rows, c: Rows, lower: StageLegs, upper: StageLegs) -> float:
    """Return det K."""
    p = mean(b)
    return structure_determinant(arms(b, p, 1.0), arms(c, p, 1.0), lower.axes, upper.axes)


def moved_balls(b: Rows, v: Rows, longest: float) -> Rows:
    """Return the balls after a step back along v, in which none moves farther than about `longest`."""
    factor = -1.0 / larger(1.0, larger(larger(largest(v[0]), largest(v[1])), largest(v[2])) / longest)
    return combined(b[0], factor, v[0]), combined(b[1], factor, v[1]), combined(b[2], factor, v[2])


def level_balls(lengths: Vector, radius: float, r: float, up: float) -> Rows:
    """Return the balls of the drawn stage with the mean of three lengths where it stands level."""
    length, offset = (lengths[0] + lengths[1] + lengths[2]) / 3.0, r - radius
    height = up * sqrt(larger(length * length - offset * offset, 0.03 * r * r))
    x, y, z = drawn_triangle(r)
    return (x[0], x[1], height), (y[0], y[1], height), (z[0], z[1], height)


def placeholder_state(r: float) -> tuple[Rows, tuple[Rows, Vector]]:
    """Return balls and a pose that stand clear of both platforms, for computations on what does not exist."""
    x, y, z = drawn_triangle(r)
    balls = (x[0], x[1], 2.0 * r), (y[0], y[1], 2.0 * r), (z[0], z[1], 2.0 * r)
    return balls, (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 4.0 * r))


def frame_of_triangle(axes: Rows, own_axes: Rows, b: Rows, own: Rows) -> tuple[Rows, Vector]:
    """Return rotation and position of the frame in which the balls are `own`, if they are at b.

    `axes` and `own_axes` are what `joint_values.triangle_axes` returns of both.
    """
    rotation = matrix_product(transposed(axes), own_axes)
    return rotation, minus(mean(b), times(rotation, mean(own)))


def pose_of_frames(turn: Rows, place: Vector, turn_m: Rows, place_m: Vector) -> tuple[Rows, Vector]:
    """Return R and o from the middle platform's frame in {B} and in {m}."""
    rotation = matrix_product(turn, transposed(turn_m))
    return rotation, minus(place, times(rotation, place_m))


def points_from_platform(points: Rows, rotation: Rows, position: Vector) -> Rows:
    """Return three points of {B} in {m}."""
    back, (x, y, z) = transposed(rotation), points
    return times(back, minus(x, position)), times(back, minus(y, position)), times(back, minus(z, position))
