"""Three circles and a triangle, one stage of any machine: `docs/theory/forward_displacement.md`.

A leg whose actuator is locked holds its ball on a circle about its revolute axis, and the three balls of a stage are
the corners of a triangle. Circles and balls are seen from the plate that carries the legs: {B} of the lower stage, {m}
of the upper one.

Unknown are the directions e_i from the centres of the circles to the balls b_i = c_i + ρ_i e_i. A turn of e_i about the
axis a_i moves b_i along t_i = ρ_i a_i x e_i, so that the errors of half the squared distances of the balls have the
derivatives c_ij = (b_i - b_j)·t_i, and Newton's step is `wrenches.pairs` and `stages.pair_inverse`.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.formulas.leg_constants import RADIAL, mean_radius
from spm_pin.formulas.operations import both, either, sqrt
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
"""Largest turn of a leg in one of Newton's steps [rad]."""
SEARCH_STEPS, MOST_STEPS, WANDERING = 20, 60, 1e-2
"""Newton's steps after which one larger than the last number [rad] says that there is no solution, and at most. No
state has been seen that took more than 14 but near a fold, towards which steps only halve."""
_KANTOROVICH, _DRIFT = 0.125, 0.25
"""Largest products of the inverse's norm at the end of a step with the Lipschitz constant times Newton's first step and
with the change of the derivative on the way. At constant angles the errors are quadratic in radii and centres, so all
along the step they are at most 5/4 of those in the middle and at the end, and the norm is at most 4/3 of that at the
end: the first product stays below (4/3)² 5/4 · 1/8 < 0.28; the theorem asks for 1/2."""


class Circles(NamedTuple):
    """Circles on which the balls of a stage are, and the squares of their distances 12, 23, 31."""

    axes: Rows
    centres: Rows
    radii: Vector
    squares: Vector


def squared_sides(b: Rows) -> Vector:
    """Return the squared distances of the balls 12, 23, 31."""
    sides = differences(b, (b[1], b[2], b[0]))
    return dots(sides, sides)


def circles_between(start: Circles, end: Circles, share: float) -> Circles:
    """Return the circles at a share of the straight way from one stage to another."""
    shares = share, share, share
    axes = combinations(start.axes, shares, differences(end.axes, start.axes))
    centres = combinations(start.centres, shares, differences(end.centres, start.centres))
    radii = combined(start.radii, share, minus(end.radii, start.radii))
    return Circles(directions(axes), centres, radii, combined(start.squares, share, minus(end.squares, start.squares)))


def level_balls(stage: Circles, corners: Rows, up: float) -> Rows:
    """Return the corners of a triangle where the stage of three mean circles stands level, above or below, as up is ±1.

    Beside a stage that is flat the triangle is put higher, clear of the singularity.
    """
    r = mean_radius(corners)
    aside = r - mean_radius(stage.centres)
    length = (stage.radii[0] + stage.radii[1] + stage.radii[2]) / 3.0
    height = up * sqrt(larger(length * length - aside * aside, 0.03 * r * r))
    return shifted(corners, (0.0, 0.0, height + mean(stage.centres)[2] - mean(corners)[2]))


def directions_to(stage: Circles, b: Rows) -> Rows:
    """Return the directions from the centres of the circles towards balls that are near them."""
    arms = differences(b, stage.centres)
    return directions(combinations(arms, scaled(-1.0, dots(stage.axes, arms)), stage.axes))


def balls_at(stage: Circles, e: Rows) -> Rows:
    """Return the balls in these directions."""
    return combinations(stage.centres, stage.radii, e)


def errors(stage: Circles, b: Rows) -> Vector:
    """Return the errors of half the squared distances of the balls."""
    return scaled(0.5, minus(squared_sides(b), stage.squares))


def inverse_derivative(stage: Circles, e: Rows, b: Rows) -> Rows:
    """Return the columns of the inverse of the errors' derivative by the turns of the legs."""
    return pair_inverse(pairs(b, multiples(stage.radii, crosses(stage.axes, e))))


def newton_step(stage: Circles, e: Rows) -> Vector:
    """Return the turns of Newton's step, to be taken off."""
    b = balls_at(stage, e)
    return weighted(errors(stage, b), inverse_derivative(stage, e, b))


def turned_back(stage: Circles, e: Rows, step: Vector) -> Rows:
    """Return the directions after a step."""
    return directions(combinations(e, scaled(-1.0, step), crosses(stage.axes, e)))


def limited(step: Vector) -> Vector:
    """Return a step in which no leg turns farther than `LONGEST_TURN`."""
    return scaled(1.0 / larger(1.0, largest(step) / LONGEST_TURN), step)


def has_converged(size: float, last: float) -> bool:
    """Return whether Newton's method is at rounding after a step of this size; `last` is the one before, NaN if none.

    Rounding is reached, or will be by what is left after this step.
    """
    at_rounding = either(size < 1e-15, both(size < 1e-10, size > 0.5 * last))
    return either(at_rounding, size * size * size < 1e-17 * last * last)


def is_stalled(size: float, last: float) -> bool:
    """Return whether steps as small as these still only halve, as towards a fold; in vain where rounding is larger."""
    return both(size < 1e-6, size > 0.25 * last)


def is_closed(stage: Circles, e: Rows) -> bool:
    """Return whether these directions close the stage to rounding, half of whose digits the angles have at a fold."""
    size = largest(stage.squares) + largest(stage.radii) * largest(stage.radii)
    return largest(errors(stage, balls_at(stage, e))) <= 1e-15 * size


def is_safe_step(middle: Circles, end: Circles, b: Rows, change: float) -> bool:
    """Return whether a solution b at the start of a step is next to those all along it.

    By the theorem of Newton and Kantorovich, as centres and radii change by at most `change`.
    """
    e = directions_to(end, b)
    at_end = balls_at(end, e)
    first, second, third = inverse_derivative(end, e, at_end)
    step = weighted(errors(end, at_end), (first, second, third))
    at_middle = balls_at(middle, directions_to(middle, b))
    half_way = weighted(errors(middle, at_middle), (first, second, third))
    sums = (
        magnitude(first[0]) + magnitude(second[0]) + magnitude(third[0]),
        magnitude(first[1]) + magnitude(second[1]) + magnitude(third[1]),
        magnitude(first[2]) + magnitude(second[2]) + magnitude(third[2]),
    )
    norm, (lipschitz, drift) = largest(sums), _bounds(end, change)
    # Not a number where there is no inverse.
    is_regular = norm * drift <= _DRIFT
    return both(is_regular, norm * lipschitz * larger(largest(step), largest(half_way)) <= _KANTOROVICH)


def _bounds(stage: Circles, change: float) -> tuple[float, float]:
    """Return bounds of the change of the derivative's rows, per radian and as centres and radii change."""
    gaps, sides, (a, b, c) = _roots(squared_sides(stage.centres)), _roots(stage.squares), stage.radii
    first, second = gaps[0] * (a + b) + 4.0 * a * b, gaps[1] * (b + c) + 4.0 * b * c
    lipschitz = larger(larger(first, second), gaps[2] * (c + a) + 4.0 * c * a)
    longest = larger(larger(a + b + sides[0], b + c + sides[1]), c + a + sides[2])
    return lipschitz, 2.0 * change * (longest + 2.0 * change)


def _roots(a: Vector) -> Vector:
    return sqrt(a[0]), sqrt(a[1]), sqrt(a[2])


def largest_change(start: Circles, end: Circles) -> float:
    """Return by how much at most a ball moves that keeps its direction from one stage to another."""
    centres = differences(end.centres, start.centres)
    return largest(minus(end.radii, start.radii)) + largest(_roots(dots(centres, centres)))


def is_home_state(stage: Circles, e: Rows, b: Rows, up: float) -> bool:
    """Return whether a stage is in the aspect of its home, upright and without torsion; up is as for `level_balls`."""
    stands = both(mean_radius(b) > 0.0, up * (mean(b)[2] - mean(stage.centres)[2]) > 0.0)
    return both(stands, is_stage_at_home(b, (scaled(up, e[0]), scaled(up, e[1]), scaled(up, e[2])), stage.axes))


class PairForm(NamedTuple):
    """Half the squared distance of two balls less that of the triangle: linear in cosine and sine of either angle."""

    constant: float
    cosine: float  # of the first angle
    sine: float
    other_cosine: float
    other_sine: float
    cosines: float
    cosine_sine: float
    sine_cosine: float
    sines: float


def turn_origins(stage: Circles) -> tuple[Rows, Rows]:
    """Return for each leg the direction of angle zero, the outermost on the circle, and that of a right angle."""
    first = directions(crosses(stage.axes, crosses(RADIAL, stage.axes)))
    return first, crosses(stage.axes, first)


def pair_forms(stage: Circles, first: Rows, second: Rows) -> tuple[PairForm, PairForm, PairForm]:
    """Return the equations of the sides 12, 23, 31 in the angles from the directions of `turn_origins`."""
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
    """Return bounds of the terms of the errors and of their second derivatives."""
    return _sum(forms[0]), _sum(forms[1]), _sum(forms[2])


def _sum(form: PairForm) -> float:
    linear = magnitude(form.cosine) + magnitude(form.sine) + magnitude(form.other_cosine) + magnitude(form.other_sine)
    products = magnitude(form.cosines) + magnitude(form.cosine_sine) + magnitude(form.sine_cosine)
    return magnitude(form.constant) + linear + products + magnitude(form.sines)


def in_other_angle(form: PairForm, c: float, s: float) -> Vector:
    """Return the coefficients of 1, cosine and sine of the second angle where the first has cosine c and sine s."""
    return (
        form.constant + form.cosine * c + form.sine * s,
        form.other_cosine + form.cosines * c + form.sine_cosine * s,
        form.other_sine + form.cosine_sine * c + form.sines * s,
    )


def in_first_angle(form: PairForm, one: float, c: float, s: float) -> Vector:
    """Return the coefficients of 1, cosine and sine of the first angle where the second has a multiple of (1, c, s)."""
    return (
        form.constant * one + form.other_cosine * c + form.other_sine * s,
        form.cosine * one + form.cosines * c + form.cosine_sine * s,
        form.sine * one + form.sine_cosine * c + form.sines * s,
    )


def eliminant(forms: tuple[PairForm, PairForm, PairForm], c: float, s: float) -> float:
    """Return the product of the third equation over the four pairs of angles that fit one of the first.

    It is free of denominators: a trigonometric polynomial of degree eight in the first angle, with cosine c and sine s.
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
    """Return the errors, and the c_ij, from cosines and sines of the angles, which may be complex."""
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
