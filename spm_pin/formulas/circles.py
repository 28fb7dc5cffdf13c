"""Newton's method for a stage of any machine, three circles and a triangle: `docs/theory/forward_displacement.md`.

With locked actuators each ball lies on a circle about the leg's revolute axis, and the three balls of a stage are
the corners of a triangle. Circles and balls are in the frame of the legs' plate: {B} for the lower stage, {m}
for the upper one. Lengths may have any unit.

The unknowns are the directions e_i from the centres c_i of the circles to the balls b_i = c_i + ρ_i e_i. The equations
are that the balls have the triangle's distances; errors are those of half the squared distances. A turn of e_i about
the axis a_i moves b_i along t_i = ρ_i a_i x e_i, so the errors have the derivatives c_ij = (b_i - b_j)·t_i, and
Newton's step is `wrenches.pairs` and `stages.pair_inverse`.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import RADIAL, mean_radius
from spm_pin.formulas.operations import both, either, sqrt, where
from spm_pin.formulas.stages import Pairs, pair_inverse
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combinations,
    combined,
    crosses,
    differences,
    directions,
    dot,
    dots,
    larger,
    largest,
    magnitude,
    minus,
    multiples,
    scaled,
    shifted,
    weighted,
)
from spm_pin.formulas.wrenches import is_stage_at_home, mean, pairs

LONGEST_TURN = 0.3
"""Largest rotation of a leg in one of Newton's steps [rad]."""
SEARCH_STEPS, MOST_STEPS, WANDERING = 20, 60, 1e-2
"""If a step after `SEARCH_STEPS` of Newton's steps is larger than `WANDERING` [rad], there is no solution; at most
`MOST_STEPS` are made. At most 14 were observed, except near a fold, where steps only halve."""
_KANTOROVICH, _DRIFT = 0.125, 0.25
"""Bounds of `is_safe_step`: largest products of the inverse derivative's norm at the end of a step with the Lipschitz
constant times Newton's first step, and with the change of the derivative along the step. At constant angles the errors
are quadratic in radii and centres, so along the step they are at most 5/4 of those in the middle and at the end, and
the norm is at most 4/3 of that at the end: the first product is below (4/3)² 5/4 · 1/8 < 0.28; the theorem requires
1/2."""


class Circles(NamedTuple):
    """Circles on which the balls of a stage lie, and the squared distances of the balls 12, 23, 31."""

    axes: Rows
    centres: Rows
    radii: Vector
    squares: Vector


def squared_sides(b: Rows) -> Vector:
    """Return the squared distances of the balls 12, 23, 31."""
    sides = differences(b, (b[1], b[2], b[0]))
    return dots(sides, sides)


def circles_between(start: Circles, end: Circles, share: float) -> Circles:
    """Return the circles at a fraction, 0 to 1, of the straight line between those of two stages with equal axes."""
    centres = combinations(start.centres, (share, share, share), differences(end.centres, start.centres))
    radii = combined(start.radii, share, minus(end.radii, start.radii))
    return Circles(end.axes, centres, radii, combined(start.squares, share, minus(end.squares, start.squares)))


def level_balls(stage: Circles, corners: Rows, up: float) -> Rows:
    """Return the balls of a level platform at its height for legs of mean length, the start of a search.

    `corners` are the balls in the platform's frame; the platform is above the plate if `up` is 1, below it if -1. If
    the stage would be flat, which is singular, the platform is raised.
    """
    r = mean_radius(corners)
    aside = r - mean_radius(stage.centres)
    length = (stage.radii[0] + stage.radii[1] + stage.radii[2]) / 3.0
    height = up * sqrt(larger(length * length - aside * aside, 0.03 * r * r))
    return shifted(corners, (0.0, 0.0, height + mean(stage.centres)[2] - mean(corners)[2]))


def directions_to(stage: Circles, b: Rows) -> Rows:
    """Return the directions e_i from the centres of the circles towards balls near the circles."""
    arms = differences(b, stage.centres)
    return directions(combinations(arms, scaled(-1.0, dots(stage.axes, arms)), stage.axes))


def balls_at(stage: Circles, e: Rows) -> Rows:
    """Return the balls b_i on the circles in the directions e_i."""
    return combinations(stage.centres, stage.radii, e)


def errors(stage: Circles, b: Rows) -> Vector:
    """Return the errors of half the squared distances of the balls."""
    return scaled(0.5, minus(squared_sides(b), stage.squares))


def inverse_derivative(stage: Circles, e: Rows, b: Rows) -> Rows:
    """Return the columns of the inverse of the matrix of the c_ij: rotations of the legs per unit error."""
    return pair_inverse(pairs(b, multiples(stage.radii, crosses(stage.axes, e))))


def newton_step(stage: Circles, e: Rows) -> Vector:
    """Return Newton's step: the angles [rad] by which the legs are turned back."""
    b = balls_at(stage, e)
    return weighted(errors(stage, b), inverse_derivative(stage, e, b))


def turned_back(stage: Circles, e: Rows, step: Vector) -> Rows:
    """Return the directions turned back by the angles of a step."""
    return directions(combinations(e, scaled(-1.0, step), crosses(stage.axes, e)))


def limited(step: Vector) -> Vector:
    """Return a step scaled down so that no leg turns by more than `LONGEST_TURN`."""
    return scaled(1.0 / larger(1.0, largest(step) / LONGEST_TURN), step)


def has_converged(size: float, last: float) -> bool:
    """Return whether Newton's method has converged with a step of this size; `last` is the previous one, NaN if none.

    Steps are of the size of rounding, or the next one will be: its size is about (size / last)² size.
    """
    at_rounding = either(size < 1e-15, both(size < 1e-10, size > 0.5 * last))
    return either(at_rounding, size * size * size < 1e-17 * last * last)


def is_next_to_solution(size: float, last: float) -> bool:
    """Return whether Newton's method began close to exactly one solution, by its first and second step.

    `size` is that of the first step, with `last` NaN, or of the second, at most a tenth of the first, `last`.
    """
    return size <= where(last == last, larger(0.1 * last, 1e-13), 0.1)


def is_stalled(size: float, last: float) -> bool:
    """Return whether small steps hardly shrink: they halve towards a fold, or are rounding, which is large there."""
    return both(size < 1e-6, size > 0.25 * last)


def is_closed(stage: Circles, e: Rows) -> bool:
    """Return whether the balls have their distances to rounding; at a fold the angles have half the digits."""
    size = largest(stage.squares) + largest(stage.radii) * largest(stage.radii)
    return largest(errors(stage, balls_at(stage, e))) <= 1e-15 * size


class FirstStep(NamedTuple):
    """Newton's first step from balls next to the circles: directions, columns of the inverse derivative, and step."""

    directions: Rows
    inverse: Rows
    step: Vector


def first_step(stage: Circles, b: Rows) -> FirstStep:
    """Return Newton's first step from balls near the circles."""
    e = directions_to(stage, b)
    balls = balls_at(stage, e)
    inverse = inverse_derivative(stage, e, balls)
    return FirstStep(e, inverse, weighted(errors(stage, balls), inverse))


def is_safe_step(middle: Circles, end: Circles, b: Rows, first: FirstStep, change: float) -> bool:
    """Return whether one branch of solutions leads from the balls b at the start of a step to the circles at its end.

    That is so, and Newton's method converges to the end from b, if the Newton-Kantorovich theorem holds along the
    step: `middle` and `end` are the circles half-way and at the end, `first` is Newton's first step from b to `end`,
    and centres and radii change by at most `change`.
    """
    columns = first.inverse
    half_way = weighted(errors(middle, balls_at(middle, directions_to(middle, b))), columns)
    sums = (
        magnitude(columns[0][0]) + magnitude(columns[1][0]) + magnitude(columns[2][0]),
        magnitude(columns[0][1]) + magnitude(columns[1][1]) + magnitude(columns[2][1]),
        magnitude(columns[0][2]) + magnitude(columns[1][2]) + magnitude(columns[2][2]),
    )
    norm, (lipschitz, drift) = largest(sums), _bounds(end, change)
    # False also for NaN, if there is no inverse.
    is_regular = norm * drift <= _DRIFT
    return both(is_regular, norm * lipschitz * larger(largest(first.step), largest(half_way)) <= _KANTOROVICH)


def _bounds(stage: Circles, change: float) -> tuple[float, float]:
    """Return bounds of the change of the derivative's rows: per radian, and for changes of centres and radii."""
    gaps, sides, (a, b, c) = _roots(squared_sides(stage.centres)), _roots(stage.squares), stage.radii
    first, second = gaps[0] * (a + b) + 4.0 * a * b, gaps[1] * (b + c) + 4.0 * b * c
    lipschitz = larger(larger(first, second), gaps[2] * (c + a) + 4.0 * c * a)
    longest = larger(larger(a + b + sides[0], b + c + sides[1]), c + a + sides[2])
    return lipschitz, 2.0 * change * (longest + 2.0 * change)


def _roots(a: Vector) -> Vector:
    return sqrt(a[0]), sqrt(a[1]), sqrt(a[2])


def largest_change(start: Circles, end: Circles) -> float:
    """Return a bound of the displacements of balls between two stages with their directions e_i constant."""
    centres = differences(end.centres, start.centres)
    return largest(minus(end.radii, start.radii)) + largest(_roots(dots(centres, centres)))


def is_upright(b: Rows, centres: Rows, up: float) -> bool:
    """Return whether a stage has no torsion, and its balls are on the outer side of the circles' centres."""
    return both(mean_radius(b) > 0.0, up * (mean(b)[2] - mean(centres)[2]) > 0.0)


def is_home_state(b: Rows, centres: Rows, axes: Rows, up: float) -> bool:
    """Return whether a stage is upright and in its home assembly region: physical, without regard to leg limits.

    Balls, circles' centres and axes are in the frame of the legs' plate; `up` is as for `level_balls`.
    """
    legs = multiples((up, up, up), differences(b, centres))
    return both(is_upright(b, centres, up), is_stage_at_home(b, legs, axes))


class PairForm(NamedTuple):
    """Coefficients of the error of half the squared distance of two balls, in cosine and sine of either leg's angle."""

    constant: float
    cosine: float  # of the first angle
    sine: float
    other_cosine: float
    other_sine: float
    cosines: float  # of the product of both cosines
    cosine_sine: float
    sine_cosine: float
    sines: float


def turn_origins(stage: Circles) -> tuple[Rows, Rows]:
    """Return for each circle the direction of angle zero, outwards, and that of a right angle."""
    first = directions(crosses(stage.axes, crosses(RADIAL, stage.axes)))
    return first, crosses(stage.axes, first)


def pair_forms(stage: Circles, first: Rows, second: Rows) -> tuple[PairForm, PairForm, PairForm]:
    """Return the equations of the sides 12, 23, 31 in the legs' angles from the directions of `turn_origins`."""
    (c1, c2, c3), (s1, s2, s3), (r1, r2, r3) = stage.centres, stage.squares, stage.radii
    p, q = multiples(stage.radii, first), multiples(stage.radii, second)
    return (
        _pair_form(minus(c1, c2), r1 * r1 + r2 * r2 - s1, p[0], q[0], p[1], q[1]),
        _pair_form(minus(c2, c3), r2 * r2 + r3 * r3 - s2, p[1], q[1], p[2], q[2]),
        _pair_form(minus(c3, c1), r3 * r3 + r1 * r1 - s3, p[2], q[2], p[0], q[0]),
    )


def _pair_form(gap: Vector, squares: float, p: Vector, q: Vector, p2: Vector, q2: Vector) -> PairForm:
    return PairForm(
        0.5 * (dot(gap, gap) + squares),
        dot(gap, p),
        dot(gap, q),
        -dot(gap, p2),
        -dot(gap, q2),
        -dot(p, p2),
        -dot(p, q2),
        -dot(q, p2),
        -dot(q, q2),
    )


def form_sizes(forms: tuple[PairForm, PairForm, PairForm]) -> Vector:
    """Return a bound of each error and of its second derivatives, over all real angles."""
    return _sum(forms[0]), _sum(forms[1]), _sum(forms[2])


def _sum(form: PairForm) -> float:
    linear = magnitude(form.cosine) + magnitude(form.sine) + magnitude(form.other_cosine) + magnitude(form.other_sine)
    products = magnitude(form.cosines) + magnitude(form.cosine_sine) + magnitude(form.sine_cosine)
    return magnitude(form.constant) + linear + products + magnitude(form.sines)


def in_other_angle(form: PairForm, c: float, s: float) -> Vector:
    """Return the coefficients of 1, cosine and sine of the second angle if the first has cosine c and sine s."""
    return (
        form.constant + form.cosine * c + form.sine * s,
        form.other_cosine + form.cosines * c + form.sine_cosine * s,
        form.other_sine + form.cosine_sine * c + form.sines * s,
    )


def in_first_angle(form: PairForm, one: float, c: float, s: float) -> Vector:
    """Return the coefficients of 1, cosine and sine of the first angle; the second's have the ratio one, c, s."""
    return (
        form.constant * one + form.other_cosine * c + form.other_sine * s,
        form.cosine * one + form.cosines * c + form.cosine_sine * s,
        form.sine * one + form.sine_cosine * c + form.sines * s,
    )


def eliminant(forms: tuple[PairForm, PairForm, PairForm], c: float, s: float) -> float:
    """Return a trigonometric polynomial of degree eight that vanishes at the first leg's angles in all assembly modes.

    c and s are cosine and sine of that angle. The sides 12 and 31 allow two angles for each other leg; this is the
    product of the errors of the side 23 over the four pairs, times a factor that removes its denominators.
    """
    f12, f23, f31 = forms
    n2, a2, b2 = in_other_angle(f12, c, s)
    n3, a3, b3 = in_first_angle(f31, 1.0, c, s)
    m2, m3 = a2 * a2 + b2 * b2, a3 * a3 + b3 * b3
    # The other angles have (cosine, sine) = (-n a ∓ b w, -n b ± a w) / m with w² = m - n².
    w2, w3 = m2 - n2 * n2, m3 - n3 * n3
    x, y = -n3 * a3, -n3 * b3
    n, a, b = in_first_angle(f23, m3, x, y)
    constant, along = n * m2 - n2 * (a * a2 + b * b2), b * a2 - a * b2
    n, a, b = in_first_angle(f23, 0.0, -b3, a3)
    other, both_along = n * m2 - n2 * (a * a2 + b * b2), b * a2 - a * b2
    even = constant * constant + along * along * w2 - (other * other + both_along * both_along * w2) * w3
    odd = 2.0 * (constant * along - other * both_along * w3)
    scale = m2 * m3
    return (even * even - odd * odd * w2) / (scale * scale)


def turn_equations(forms: tuple[PairForm, PairForm, PairForm], c: Vector, s: Vector) -> tuple[Vector, Pairs]:
    """Return the errors, and their derivatives c12, c23, c31, c21, c32, c13, from cosines and sines of the angles.

    These may be complex.
    """
    f12, f23, f31 = forms
    (n12, a12, b12), (_, a21, b21) = in_other_angle(f12, c[0], s[0]), in_first_angle(f12, 1.0, c[1], s[1])
    (n23, a23, b23), (_, a32, b32) = in_other_angle(f23, c[1], s[1]), in_first_angle(f23, 1.0, c[2], s[2])
    (n31, a31, b31), (_, a13, b13) = in_other_angle(f31, c[2], s[2]), in_first_angle(f31, 1.0, c[0], s[0])
    values = n12 + a12 * c[1] + b12 * s[1], n23 + a23 * c[2] + b23 * s[2], n31 + a31 * c[0] + b31 * s[0]
    slopes = (
        b21 * c[0] - a21 * s[0],
        b32 * c[1] - a32 * s[1],
        b13 * c[2] - a13 * s[2],
        b12 * c[1] - a12 * s[1],
        b23 * c[2] - a23 * s[2],
        b31 * c[0] - a31 * s[0],
    )
    return values, slopes
