"""The four quadratics of a pose and the branches of the inverse displacement: `docs/theory/inverse_displacement.md`.

Horizontal vectors and halves of quaternions are complex numbers, written as pairs of reals because the roots u, v may
be complex too. The families form two groups, equal modes (TT, FF) and mixed ones (TF, FT). Within a
group κ, μ and the weights of u and v are the same, and the forms differ in the sign of all but h.

    pose -> pose_frame -> families -> root -> middle_joints -> leg_lengths, stands_at_home
"""

from __future__ import annotations

from typing import Any, NamedTuple

from spm_pin.formulas.operations import COS_30, both, either, sqrt, where
from spm_pin.formulas.stages import cartesian, in_home_aspect
from spm_pin.formulas.vectors import (
    Rows,
    Vector,
    combined,
    cross,
    differences,
    dot,
    dots,
    larger,
    magnitude,
    minus,
    scaled,
    transposed,
    turned,
)

Complex = tuple[float, float]
Quaternion = tuple[float, float, float, float]

ROUNDING = 2.0**-46
"""Relative rounding error of a pose: smaller quantities count as zero in the test for degenerate families."""
ROUNDING_BOUND = 2.0**-39
"""Bound of the rounding error of a discriminant over r², divided by (1 + (|x| + |y|)/r)²: `docs/theory/proofs.md`."""
PARALLEL = 1e-12
"""Sine of the tilt up to which the Z axes of {B} and {m} count as parallel in proofs."""


class PoseFrame(NamedTuple):
    """Quantities that the families of a pose share."""

    is_vertical: bool  # the Z axes are parallel and have no common normal: all else is arbitrary and finite
    x0: float
    x3: float
    cosine: float  # c = |S|
    sine: float  # s = |W|
    s: Complex  # S / c
    w: Complex  # W / s
    normal: Complex  # the stages' common normal n, in {B}
    normal_m: Complex  # in {m}
    half_cosecant: float  # 1 / 2cs
    h: float
    noise: float  # rounding of the coefficients of the forms


class Family(NamedTuple):
    """The quadratic uu u² + 2 uv uv + vv v² = 0 of a family, and the weights of u and v in w_a, conj(w_b) and P."""

    uu: float
    uv: float
    vv: float
    a_u: Complex
    a_v: Complex
    b_u: Complex
    b_v: Complex
    p_u: float
    p_v: float
    lower: float  # e of the lower stage: +1 in mode T, -1 in mode F
    plus: float  # sign of the square root of the discriminant in the branch +


class Group(NamedTuple):
    """Quantities that the two families of a group share."""

    form: Vector  # uu, uv, vv without h
    f: Complex  # weights F and G of u and v in the quaternions of a and b
    g: Complex
    scale_u: float  # (P - Q) / 2su
    scale_v: float  # (P + Q) / 2sv


def product(a: Complex, b: Complex) -> Complex:
    """Multiply two pairs as complex numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def quaternions(rotation: Rows) -> tuple[Quaternion, Quaternion, Quaternion, Quaternion]:
    """Return the quaternion of a rotation matrix four times, not normalised: its products with x0, x3, x2 and x1."""
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rotation
    trace = r00 + r11 + r22
    return (
        (1.0 + trace, r21 - r12, r02 - r20, r10 - r01),
        (r10 - r01, r20 + r02, r21 + r12, 1.0 - trace + 2.0 * r22),
        (r02 - r20, r10 + r01, 1.0 - trace + 2.0 * r11, r21 + r12),
        (r21 - r12, 1.0 - trace + 2.0 * r00, r10 + r01, r20 + r02),
    )


def quaternion(rotation: Rows) -> Quaternion:
    """Return x0, x1, x2, x3 of a rotation matrix, from its largest component."""
    x, by_x3, by_x2, by_x1 = quaternions(rotation)
    r00, r11, r22 = rotation[0][0], rotation[1][1], rotation[2][2]
    largest = r00 + r11 + r22
    x, largest = _chosen(r22 > largest, by_x3, x), larger(r22, largest)
    x, largest = _chosen(r11 > largest, by_x2, x), larger(r11, largest)
    x0, x1, x2, x3 = _chosen(r00 > largest, by_x1, x)
    scale = 1.0 / sqrt(x0 * x0 + x1 * x1 + x2 * x2 + x3 * x3)
    return x0 * scale, x1 * scale, x2 * scale, x3 * scale


def _chosen(condition: bool, x: Quaternion, y: Quaternion) -> Quaternion:
    a, b = where(condition, x[0], y[0]), where(condition, x[1], y[1])
    return a, b, where(condition, x[2], y[2]), where(condition, x[3], y[3])


def pose_frame(rotation: Rows, position: Vector, r: float) -> PoseFrame:
    """Return the quaternion's halves, both stages' tilt axes and their common normal, and h."""
    x0, x1, x2, x3 = quaternion(rotation)
    cosine, sine = sqrt(x0 * x0 + x3 * x3), sqrt(x1 * x1 + x2 * x2)
    vertical = cosine * sine <= ROUNDING
    cosine, sine = where(vertical, 1.0, cosine), where(vertical, 1.0, sine)
    over_cosine, over_sine = 1.0 / cosine, 1.0 / sine
    s, w = (x0 * over_cosine, x3 * over_cosine), (x1 * over_sine, x2 * over_sine)
    normal, half_cosecant = product(s, w), 0.5 * (over_cosine * over_sine)
    h = normal[0] * position[0] + normal[1] * position[1]
    # No higher power of the position, which may be any number.
    noise = ROUNDING * (r + (magnitude(position[0]) + magnitude(position[1])) * (2.0 * half_cosecant))
    normal_m = product((s[0], -s[1]), w)
    return PoseFrame(vertical, x0, x3, cosine, sine, s, w, normal, normal_m, half_cosecant, h, noise)


def _group(kappa: float, mu: float, sine: float, even: Complex, odd: Complex) -> Group:
    """Return a group of families, its form Re(even F²), Re(odd F G), Re(even G²); for κ >= 0."""
    # 1 - κ without cancellation, from |S'|² + |W|² = 1.
    over_plus = 1.0 / (1.0 + kappa)
    one_minus = (sine * sine + mu * mu) * over_plus
    scale_u, scale_v = sqrt(0.5 * over_plus), sqrt(0.5 / one_minus)
    f, g = ((1.0 + kappa) * scale_u, mu * scale_u), (one_minus * scale_v, -mu * scale_v)
    form = product(even, product(f, f))[0], product(odd, product(f, g))[0], product(even, product(g, g))[0]
    return Group(form, f, g, scale_u, scale_v)


def families(frame: PoseFrame, r: float) -> tuple[Family, Family, Family, Family]:
    """Return the quadratics TT, TF, FT, FF of a pose."""
    # i s r [W³ ± conj(W)³], the brackets of families whose e are equal; in mixed ones they are exchanged.
    cubed, s, x0, x3 = product(product(frame.w, frame.w), frame.w), frame.s, frame.x0, frame.x3
    plus = -2.0 * r * cubed[0] * s[1], 2.0 * r * cubed[0] * s[0]
    minus_ = 2.0 * r * cubed[1] * s[0], 2.0 * r * cubed[1] * s[1]
    # Per group the quaternion has the sign with κ >= 0: κ does not change sign on any path along which a
    # family stays real, and so labels do not change either.
    lift = where(x0 < 0.0, -1.0, 1.0)
    group = _group(magnitude(x0), lift * x3, frame.sine, plus, minus_)
    a, b = lift * frame.w[0], lift * frame.w[1]
    tt = _family(1.0, 1.0, frame, group, (a, b), (a, -b))
    ff = _family(-1.0, 1.0, frame, group, (b, -a), (b, a))
    lift = where(x3 < 0.0, -1.0, 1.0)
    group = _group(magnitude(x3), -lift * x0, frame.sine, minus_, plus)
    a, b = lift * frame.w[0], lift * frame.w[1]
    tf = _family(1.0, -1.0, frame, group, (-b, a), (-a, b))
    return tt, tf, _family(-1.0, -1.0, frame, group, (a, b), (b, a)), ff


def _family(
    lower: float, plus: float, frame: PoseFrame, group: Group, lower_axis: Complex, upper_axis: Complex
) -> Family:
    """Return a family of a group; the axes are those of w_a and conj(w_b)."""
    (uu, uv, vv), f, g, scale_u, scale_v = group
    return Family(
        lower * uu - frame.h,
        lower * uv,
        lower * vv - frame.h,
        product(lower_axis, (-f[0], -f[1])),
        product(lower_axis, g),
        product(upper_axis, f),
        product(upper_axis, g),
        frame.sine * scale_u,
        frame.sine * scale_v,
        lower,
        plus,
    )


def discriminant(family: Family) -> float:
    """Return uv² - uu vv: the branches of a family are real where it is not negative."""
    return family.uv * family.uv - family.uu * family.vv


def rounding_bound(position: Vector, r: float) -> float:
    """Return a bound of the rounding error of a discriminant over r²."""
    size = 1.0 + (magnitude(position[0]) + magnitude(position[1])) / r
    return ROUNDING_BOUND * (size * size)


def is_tilted(rotation: Rows) -> bool:
    """Return whether the Z axes of {B} and {m} are not parallel to rounding, so that discriminants prove something."""
    return magnitude(rotation[0][2]) + magnitude(rotation[1][2]) > PARALLEL


def is_continuous(family: Family, noise: float) -> bool:
    """Return whether the quadratic vanishes, and with it all its solutions are a continuous family."""
    first, second = magnitude(family.uu) <= noise, magnitude(family.uv) <= noise
    return both(both(first, second), magnitude(family.vv) <= noise)


def root(family: Family, sign: float, discriminant_root: float) -> Vector:
    """Return u, v of the branch + or - of a family, not normalised, and u² + v²."""
    signed = sign * family.plus * discriminant_root
    u1, v1, u2, v2 = signed - family.uv, family.uu, family.vv, -signed - family.uv
    # Both pairs solve the form; the longer one has no cancellation.
    first, second = u1 * u1 + v1 * v1, u2 * u2 + v2 * v2
    longer = first >= second
    return where(longer, u1, u2), where(longer, v1, v2), where(longer, first, second)


def middle_joints(
    u: Any, v: Any, size: Any, family: Family, frame: PoseFrame, position: Vector
) -> tuple[Vector, Vector]:
    """Return the middle joints' radii ρ_i in the planes of their lower legs, and heights z_i, for a root u, v.

    `size` is r / (u² + v²). The three may be complex.
    """
    p = family.p_u * u + family.p_v * v
    # w_a and conj(w_b).
    a1, a2 = family.a_v[0] * v + family.a_u[0] * u, family.a_v[1] * v + family.a_u[1] * u
    b1, b2 = family.b_v[0] * v + family.b_u[0] * u, family.b_v[1] * v + family.b_u[1] * u
    # The centre's horizontal position in {B} and in {m}; only its part along the tilt is needed: with the common
    # normal n, that direction is -i n.
    twice, n, m = 2.0 * size, frame.normal, frame.normal_m
    x, y = -twice * (a1 * a2), size * (a2 * a2 - a1 * a1)
    x_m, y_m = twice * (b1 * b2), size * (b2 * b2 - b1 * b1)
    along, along_m = n[1] * (x - position[0]) - n[0] * (y - position[1]), m[1] * x_m - m[0] * y_m
    cos_tilt = frame.cosine * frame.cosine - frame.sine * frame.sine
    z = position[2] + (cos_tilt * along - along_m) * frame.half_cosecant
    square, across = family.lower * size * (p * p), 2.0 * COS_30 * x
    # Mode F is turned by half a turn about its normal.
    turned = family.lower < 0.0
    c, s = where(turned, a1, -a2), where(turned, a2, a1)
    c, s = COS_30 * twice * (p * c), size * (p * s)
    return (square + across - y, square + 2.0 * y, square - across - y), (z + c - s, z + 2.0 * s, z - c - s)


def branch_balls(family: Family, sign: float, frame: PoseFrame, position: Vector, r: float, least: float) -> Rows:
    """Return the b_i of the branch + or - of a family; a discriminant below `least` is replaced by `least`."""
    u, v, square = root(family, sign, sqrt(larger(discriminant(family), least)))
    radii, heights = middle_joints(u, v, r / where(square > 0.0, square, 1.0), family, frame, position)
    return cartesian(radii, heights)


def platform_corners(rotation: Rows, position: Vector, platform_radius: float) -> Rows:
    """Return c_1, c_2, c_3 in {B}."""
    first, second, _ = transposed(rotation)
    side = scaled(COS_30 * platform_radius, first)
    back = combined(position, -0.5 * platform_radius, second)
    return combined(back, 1.0, side), combined(position, platform_radius, second), combined(back, -1.0, side)


def leg_lengths(
    radii: Vector, heights: Vector, corners: Rows, base_radius: float
) -> tuple[float, float, float, float, float, float]:
    """Return r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 from the middle joints and the corners c_i."""
    x1, x2, x3 = minus(radii, (base_radius, base_radius, base_radius))
    z1, z2, z3 = heights
    upper = differences(corners, cartesian(radii, heights))
    c1, c2, c3 = dots(upper, upper)
    return sqrt(x1 * x1 + z1 * z1), sqrt(x2 * x2 + z2 * z2), sqrt(x3 * x3 + z3 * z3), sqrt(c1), sqrt(c2), sqrt(c3)


def seen_from_platform(b: Rows, rotation: Rows, position: Vector) -> tuple[Vector, Vector]:
    """Return the radii of the middle joints in the planes of their upper legs, and their distances below {m}."""
    (x1, y1, z1), (_, y2, z2), (x3, y3, z3) = turned(
        transposed(rotation), differences(b, (position, position, position))
    )
    return (COS_30 * x1 - 0.5 * y1, y2, -COS_30 * x3 - 0.5 * y3), (-z1, -z2, -z3)


def stands_at_home(
    radii: Vector, heights: Vector, rotation: Rows, position: Vector, base_radius: float, platform_radius: float
) -> tuple[bool, float]:
    """Return whether a branch TT is physical, without regard to leg limits, and the sum of its radii in both stages.

    Both stages are then upright and in their home assembly regions. The sum is larger if their tilts are smaller.
    """
    upper, below = seen_from_platform(cartesian(radii, heights), rotation, position)
    lower_sum, upper_sum = radii[0] + radii[1] + radii[2], upper[0] + upper[1] + upper[2]
    outer = both(heights[0] + heights[1] + heights[2] > 0.0, below[0] + below[1] + below[2] > 0.0)
    upright = both(both(lower_sum > 0.0, upper_sum > 0.0), outer)
    aspects = both(in_home_aspect(radii, heights, base_radius), in_home_aspect(upper, below, platform_radius))
    return both(upright, aspects), lower_sum + upper_sum


def tilt_cosine_sum(b: Rows, rotation: Rows) -> float:
    """Return the sum of the cosines of the two stages' tilts: 2 for a straight machine."""
    normal = cross(minus(b[0], b[2]), minus(minus(b[1], b[0]), minus(b[2], b[1])))
    along = normal[2] + dot(normal, (rotation[0][2], rotation[1][2], rotation[2][2]))
    return along / sqrt(dot(normal, normal))


def is_other_preferred(rank: float, tilts: float, other_rank: float, other_tilts: float) -> bool:
    """Return whether the second of two branches is chosen: by its rank, or by its sum of radii if ranks are equal.

    The rank is 0 for a branch that is not physical, 1 for a physical one, 2 if it is also within the leg limits.
    """
    return either(other_rank > rank, both(other_rank == rank, other_tilts > tilts))
