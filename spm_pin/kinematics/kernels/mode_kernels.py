"""All assembly modes of a nominal machine for a batch of leg lengths.

The equations of a stage are `spm_pin.formulas.stages`. With ψ the azimuth of the tilt w, p = |w|²,
A = Im(λ e^{iψ}) / κ = p sin 3ψ and B = Re(λ e^{iψ}), p is the root of a quadratic, `stages.tilt_quadratic`, and ψ of a
polynomial in e^{2iψ}. With δ = ψ + arg λ and μ = e^{3i arg λ} that is a quartic in tan δ, `stages.quartic`. For small κ
all its roots are crowded around zero; tan δ = ω tan γ with ω = |κ| / √(κ² + |λ|²) spreads them over all γ. Newton's
method begins at the solutions of the quartic. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spm_pin.formulas.stages import (
    EPS,
    ModeState,
    StageEquations,
    cartesian,
    corners,
    damped,
    inverse,
    jacobian,
    moved,
    quartic,
    residual,
    residual_by_legs,
    stage_equations,
    tilt_quadratic,
)
from spm_pin.formulas.vectors import Rows, Vector, dot, largest, scaled, times, transposed, weighted
from spm_pin.kinematics.kernels.compilation import ComplexArray, jit, jit_inline, put_rows, vector_at
from spm_pin.kinematics.kernels.quadric_newton import reciprocal, squared
from spm_pin.support.arguments import FloatArray

Quartic = tuple[float, float, float, float, float]

SAME = float(4.0 * np.sqrt(EPS))
"""Solutions closer than this, in units of r, are one: rounding resolves a double root no better."""
PLACES = 4
"""The most solutions of one mode, mirror images apart."""
_NEAR_FOLD = 1e3  # gain, see `_polished`, above which a fold or a continuous family is near
_RESIDUAL_ROUNDING = 4.0 * EPS
"""Largest residual of a solution relative to the largest term of its equations; half of it has been seen."""
_MOST_STEPS = 40
_LONGEST_TURN = 0.3
_SHORT = 0.25  # leg length below which the equations, which are made of squares of all legs, lose digits
_OF_FAMILY = 1e6
"""Gain, see `_polished`, above which a solution beside a continuous family belongs to the family."""
EXACT, _NEAR = 64.0 * EPS, 1e-5
"""Relative distance of squared lengths from those of a family within which lengths are the family's, or near it."""
_SHORTEST = 1e-3  # length in units of r below which a leg is too short to count modes
_EIGHTHS = np.exp(0.125j * np.pi * np.arange(8))
_QUARTERS = np.exp(1j * (0.5 * np.pi * np.arange(4) + 0.4))
_SYMMETRIC = np.exp(1j * np.pi / 3.0 * np.array([0.0, 1.0, 2.0, 0.0]))
_MOST_ITERATIONS = 60
# What is kept of a solution: three radii, three heights, and
_BLUR, _RANK, _AZIMUTH = 6, 7, 8


class StageScratch(NamedTuple):
    """Arrays that stages are solved in, one after another."""

    roots: ComplexArray  # of the quartic (4,)
    starts: FloatArray  # where Newton's method begins (8, 4)
    ends: FloatArray  # where it ended, and the gain (16, 5)
    kept: FloatArray  # what is kept of that (16, 9)


@jit
def _tilts(stage: StageEquations, turn: complex, a: float, starts: FloatArray, count: int) -> int:
    """Append approximate solutions with one azimuth: A = p sin 3ψ, and the other equations are a quadratic in p.

    Both of its roots are tried: legs symmetric about a plane have two solutions of one azimuth, where sin 3ψ = 0.
    """
    epsilon, level, kappa = stage.epsilon, stage.level, 2.0 * stage.epsilon - 1.0
    b = stage.real * turn.real - stage.imag * turn.imag
    cubed = turn * turn * turn
    square, linear, constant = tilt_quadratic(stage, a, b, cubed.real)
    root = math.sqrt(max(linear * linear - 4.0 * square * constant, 0.0))
    larger = -0.5 * (linear + (-root if linear < 0.0 else root))
    for which in range(2):
        p = larger / square if which == 0 else constant / larger
        if not math.isfinite(p):
            if which == 0:
                continue
            p = 0.0
        mismatch = abs(a - p * cubed.imag)
        fits = mismatch <= 0.05 * (abs(a) + abs(p * cubed.imag)) + 1e-6 or abs(cubed.imag) < 0.05
        if not (fits and -0.01 < p < 1.01):
            continue
        p = min(max(p, 0.0), 1.0)
        # b = (κ + 2p) p cos 3ψ + 2 ζ x0 |w|: its sign decides which of w and -w is the one with ζ >= 0.
        upper = math.sqrt(p) if b >= (kappa + 2.0 * p) * p * cubed.real else -math.sqrt(p)
        starts[count, 0], starts[count, 1] = math.sqrt(1.0 - p), upper * turn.real
        starts[count, 2] = upper * turn.imag
        starts[count, 3] = math.sqrt(max(level - 2.0 * epsilon * p - p * p, 0.0))
        count += 1
    return count


@jit_inline
def _turned_quartic(coefficients: Quartic) -> tuple[Quartic, complex]:
    """Return the monic quartic of tan(γ - β), from its constant up, and e^{iβ}.

    As a function of γ the quartic is a mean and two harmonics of 2γ. β is taken where it is large a quarter turn
    away, so that no root is near infinity.
    """
    c0, c1, c2, c3, c4 = coefficients
    mean = 0.375 * (c0 + c4) + 0.125 * c2
    first = complex(0.5 * (c0 - c4), -0.25 * (c1 + c3))
    second = complex(0.125 * (c0 - c2 + c4), -0.125 * (c1 - c3))
    best, largest = 0, -1.0
    for k in range(8):
        turn = _EIGHTHS[k] * _EIGHTHS[k]
        value = abs(mean - (first * turn).real + (second * (turn * turn)).real)
        if value > largest:
            best, largest = k, value
    turn = _EIGHTHS[best]
    twice = turn * turn
    first, second = first * twice, second * (twice * twice)
    leading = mean - first.real + second.real
    leading = 1.0 if leading == 0.0 else leading
    a3, a2 = 4.0 * second.imag - 2.0 * first.imag, 2.0 * mean - 6.0 * second.real
    a1, a0 = -2.0 * first.imag - 4.0 * second.imag, mean + first.real + second.real
    return (a0 / leading, a1 / leading, a2 / leading, a3 / leading, 1.0), turn


@jit
def _roots(coefficients: Quartic, roots: ComplexArray) -> None:
    """Find the four roots of a monic quartic at once, by Aberth's method."""
    a0, a1, a2, a3, _ = coefficients
    centre = -0.25 * a3
    # Taylor's coefficients at the roots' mean give their size.
    b2 = a2 + centre * (3.0 * a3 + 6.0 * centre)
    b1 = a1 + centre * (2.0 * a2 + centre * (3.0 * a3 + 4.0 * centre))
    b0 = a0 + centre * (a1 + centre * (a2 + centre * (a3 + centre)))
    radius = max(math.sqrt(abs(b2)), abs(b1) ** (1.0 / 3.0), math.sqrt(math.sqrt(abs(b0))))
    for k in range(4):
        roots[k] = centre + radius * _QUARTERS[k]
    for _ in range(_MOST_ITERATIONS):
        moved = 0.0
        for k in range(4):
            z = roots[k]
            value = a0 + z * (a1 + z * (a2 + z * (a3 + z)))
            slope = a1 + z * (2.0 * a2 + z * (3.0 * a3 + 4.0 * z))
            crowd = complex(0.0, 0.0)
            for j in range(4):
                gap = z - roots[j]
                if j != k and squared(gap) > 0.0:
                    crowd += reciprocal(gap)
            divisor = slope - value * crowd
            if squared(divisor) > 0.0:
                step = value * reciprocal(divisor)
                roots[k] = z - step
                moved = max(moved, abs(step.real) + abs(step.imag))
        if moved <= 1e-13 * (abs(centre) + radius):
            break


@jit
def _approximate_solutions(stage: StageEquations, is_continuous: bool, roots: ComplexArray, starts: FloatArray) -> int:
    """Write x0, x1, x2, ζ of where Newton's method begins, at most eight states, and count them.

    `is_continuous` says that the quartic vanishes; `roots` (4,) is overwritten.
    """
    real, imag, kappa = stage.real, stage.imag, 2.0 * stage.epsilon - 1.0
    size = abs(complex(real, imag))
    # Without λ there is no direction to count from, and any will do.
    nu = complex(real / size, imag / size) if size > 0.0 else complex(0.6, 0.8)
    mu = nu * nu * nu
    span = abs(complex(kappa, size))
    span = span if span > 0.0 else 1.0
    omega, gain = abs(kappa) / span, (-1.0 if kappa < 0.0 else 1.0) / span
    lead = complex(1.0, 0.0)
    if not is_continuous:
        turned, lead = _turned_quartic(quartic(stage, size, mu.real, mu.imag, omega, gain))
        _roots(turned, roots)
    count = 0
    for k in range(4):
        if is_continuous:
            # What is isolated is level or tilted in the plane of a leg.
            turn, a = _SYMMETRIC[k], 0.0
        else:
            tangent = roots[k]
            if abs(tangent.imag) > 0.01 * (1.0 + tangent.real * tangent.real):
                continue
            secant = abs(complex(1.0, tangent.real))
            gamma = complex(1.0 / secant, tangent.real / secant) * lead
            delta = complex(gamma.real, omega * gamma.imag)
            length = abs(delta)
            a = size * gain * gamma.imag / length
            turn = complex(delta.real / length, delta.imag / length) * nu.conjugate()
        count = _tilts(stage, turn, a, starts, count)
    return count


@jit
def _polished(stage: StageEquations, start: ModeState) -> tuple[ModeState, float, bool]:
    """Bring an approximate solution, x0 >= 0, to rounding by Newton's method.

    Returned are the state where it ended, brought to ζ >= 0 by reflection; the gain, by which a relative error of the
    leg lengths is multiplied in the state; and whether this is a solution.
    """
    state, gain = start, 0.0
    for _ in range(_MOST_STEPS):
        error = residual(stage, state)
        columns, singular = inverse(jacobian(stage, state))
        step = scaled(-1.0, weighted(error, columns))
        square = dot(columns[0], columns[0]) + dot(columns[1], columns[1]) + dot(columns[2], columns[2])
        gain = 1.0 / EPS if singular else np.sqrt(square) * stage.scale
        length, off = np.sqrt(dot(step, step)), largest(error) / stage.scale
        # Beside a fold or a family, a step no longer than its own rounding leads nowhere better.
        if length <= 8.0 * EPS * gain and gain > _NEAR_FOLD and off <= _RESIDUAL_ROUNDING:
            break
        state = moved(state, damped(step, _LONGEST_TURN))
        # What a step leaves is its square, divided by the distance to the fold.
        if length * length * max(gain, 1.0) <= EPS or off <= EPS:
            break
    arrived = largest(residual(stage, state)) <= _RESIDUAL_ROUNDING * stage.scale
    if arrived and min(stage.lengths) < _SHORT:
        columns, _ = inverse(jacobian(stage, state))
        step = scaled(-1.0, weighted(residual_by_legs(stage, state), columns))
        if np.sqrt(dot(step, step)) <= 8.0 * EPS * gain:  # rounding, and nothing else
            state = moved(state, step)
    if state[3] < 0.0:
        state = state[0], -state[1], -state[2], -state[3]
    return state, gain, arrived


@jit_inline
def _longest(rows: Rows) -> Vector:
    """Return the direction of the longest of three vectors."""
    first, second, third = dot(rows[0], rows[0]), dot(rows[1], rows[1]), dot(rows[2], rows[2])
    longest = rows[0] if first >= second and first >= third else (rows[1] if second >= third else rows[2])
    return scaled(1.0 / max(np.sqrt(dot(longest, longest)), EPS), longest)


@jit
def _other_side_of_fold(stage: StageEquations, state: ModeState) -> ModeState:
    """Return about where the other one is of two solutions that nearly meet in a fold.

    Along the direction n in which f hardly changes, the component l·f that J hardly changes is a quadratic.
    """
    rows = jacobian(stage, state)
    columns, _ = inverse(rows)
    n = _longest(columns)
    left = _longest(transposed(columns))
    slope = dot(left, times(rows, n))
    h = 1e-4
    ahead, behind = residual(stage, moved(state, scaled(h, n))), residual(stage, moved(state, scaled(-h, n)))
    curvature = (dot(left, ahead) + dot(left, behind)) / (2.0 * h * h)
    distance = 0.0 if curvature == 0.0 else -slope / curvature
    return moved(state, scaled(min(max(distance, -0.1), 0.1), n))


@jit_inline
def allocate_stage_scratch() -> StageScratch:
    """Allocate the arrays that stages are solved in, one after another."""
    return StageScratch(np.empty(4, np.complex128), np.empty((8, 4)), np.empty((16, 5)), np.empty((16, 9)))


@jit_inline
def has_continuous_family(
    first: float, second: float, third: float, epsilon: float, half_turned: bool, relative: float
) -> bool:
    """Return whether squared lengths are next to those with a continuous family, where alone the quartic vanishes.

    - E < r, one leg 3 E long and the others √3 √(r² - E²): both modes.
    - E = r/2 and equal legs longer than r/2: mode T.
    """
    a, b, c = first * first, second * second, third * third
    tolerance = relative * ((a + b + c) / 3.0 + (1.0 + epsilon) * (1.0 + epsilon))
    odd, even = 9.0 * epsilon * epsilon, 3.0 - 3.0 * epsilon * epsilon
    distance = min(
        max(abs(a - odd), abs(b - even), abs(c - even)),
        max(abs(a - even), abs(b - odd), abs(c - even)),
        max(abs(a - even), abs(b - even), abs(c - odd)),
    )
    if distance <= tolerance and epsilon < 1.0 + relative:
        return True
    equal = max(abs(b - a), abs(c - a)) <= tolerance
    return not half_turned and equal and a > 0.25 + tolerance and abs(2.0 * epsilon - 1.0) <= relative


@jit_inline
def _copy(rows: FloatArray, source: int, target: int) -> None:
    # Number by number, for an assignment of rows brings all of NumPy's broadcasting along, which takes long to compile.
    for i in range(rows.shape[1]):
        rows[target, i] = rows[source, i]


@jit_inline
def _distance(first: FloatArray, second: FloatArray) -> float:
    """Return how far the corners of two solutions are apart, or of one and the other's mirror image."""
    across, same, mirrored = 0.0, 0.0, 0.0
    for i in range(3):
        radius, gap, total = first[i] - second[i], first[3 + i] - second[3 + i], first[3 + i] + second[3 + i]
        across += radius * radius
        same += gap * gap
        mirrored += total * total
    return math.sqrt(across + min(same, mirrored))


@jit
def _append(stage: StageEquations, start: ModeState, ends: FloatArray, count: int) -> int:
    """Append the solution that Newton's method leads to, if it is one; return their number."""
    state, gain, arrived = _polished(stage, start)
    if arrived:
        ends[count, 0], ends[count, 1], ends[count, 2], ends[count, 3] = state
        ends[count, 4] = gain
        count += 1
    return count


@jit
def solve_mode(stage: StageEquations, half_turned: bool, is_continuous: bool, scratch: StageScratch) -> int:
    """Find the solutions of one mode, and count them.

    They are put into the first rows of `scratch.kept`, by falling mean radius of the corners; where nine digits of it
    agree, by the azimuth of the tilt axis.
    """
    roots, starts, ends, kept = scratch
    solutions = 0
    for k in range(_approximate_solutions(stage, is_continuous, roots, starts)):
        solutions = _append(stage, (starts[k, 0], starts[k, 1], starts[k, 2], starts[k, 3]), ends, solutions)
    for k in range(solutions):
        if ends[k, 4] > _NEAR_FOLD:
            state = ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3]
            solutions = _append(stage, _other_side_of_fold(stage, state), ends, solutions)

    count = 0
    for k in range(solutions):
        if is_continuous and ends[k, 4] >= _OF_FAMILY:
            continue
        e0, e1, e2 = ends[k, 0], ends[k, 1], ends[k, 2]
        x0, x1, x2, x3 = (0.0, -e2, e1, e0) if half_turned else (e0, e1, e2, 0.0)
        radii, heights = corners(x0, x1, x2, x3, ends[k, 3])
        # Azimuths of the tilt axis modulo a half turn, none of a symmetric solution's at the jump.
        azimuth = (math.atan2(ends[k, 2], ends[k, 1]) + math.pi / 6.0) % math.pi
        rank = -np.rint(1e9 * ((radii[0] + radii[1] + radii[2]) / 3.0))
        place = count
        while place > 0 and (kept[place - 1, _RANK], kept[place - 1, _AZIMUTH]) > (rank, azimuth):
            _copy(kept, place - 1, place)
            place -= 1
        row = kept[place]
        row[0], row[1], row[2] = radii
        row[3], row[4], row[5] = heights
        row[_BLUR], row[_RANK], row[_AZIMUTH] = min(max(16.0 * EPS * ends[k, 4], SAME), 0.01), rank, azimuth
        count += 1

    # Drop what occurs twice.
    places = 0
    for k in range(count):
        repeated = False
        for j in range(k):
            repeated = repeated or _distance(kept[k], kept[j]) <= max(kept[k, _BLUR], kept[j, _BLUR])
        if repeated:
            kept[k, _RANK] = np.nan
    for k in range(count):
        if kept[k, _RANK] == kept[k, _RANK]:
            _copy(kept, k, places)
            places += 1
    return min(places, PLACES)


@jit
def stage_modes(
    first: float, second: float, third: float, epsilon: float, above: float, scratch: StageScratch, balls: FloatArray
) -> tuple[bool, bool]:
    """Write the balls of the modes that a stage has, of at most sixteen (16, 3, 3), in units of r.

    Returned is which of T, F is continuous. The sheet + is above the pivots, or below, by the sign of `above`; the
    other is its mirror image.
    """
    kept = scratch.kept
    straight = has_continuous_family(first, second, third, epsilon, False, EXACT)
    half_turned = has_continuous_family(first, second, third, epsilon, True, EXACT)
    for m in range(2):
        stage = stage_equations(first, second, third, epsilon if m == 0 else -epsilon)
        for k in range(solve_mode(stage, m == 1, straight if m == 0 else half_turned, scratch)):
            radii, heights = vector_at(kept[k], 0), vector_at(kept[k], 3)
            for sheet in range(1 if largest(heights) <= SAME else 2):
                b = cartesian(radii, scaled(above if sheet == 0 else -above, heights))
                put_rows(b, balls[(m * PLACES + k) * 2 + sheet])
    return straight, half_turned


@jit
def is_countable(first: float, second: float, third: float, epsilon: float) -> bool:
    """Return whether double precision is enough to count modes: away from families, and without a very short leg."""
    return min(first, second, third) >= _SHORTEST and not has_continuous_family(
        first, second, third, epsilon, False, _NEAR
    )
