"""All assembly modes of any machine: the sixteen ways to place a triangle on three circles, complex ones too.

For an angle θ of the first leg the sides 12 and 31 give two angles each of the other legs; the side 23 then is a
polynomial of degree sixteen in e^{iθ}, made from its values at roots of unity. Its roots come from the method of
Ehrlich and Aberth, and Newton's method on the three sides gives them all their digits. Sixteen distinct ones are all.
See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from spm_pin.formulas.ball_motions import frame_of_triangle, pose_of_frames
from spm_pin.formulas.circles import (
    Circles,
    PairForm,
    eliminant,
    form_sizes,
    has_converged,
    in_first_angle,
    in_other_angle,
    newton_step,
    pair_forms,
    squared_sides,
    turn_equations,
    turn_origins,
)
from spm_pin.formulas.joint_values import triangle_axes
from spm_pin.formulas.leg_constants import mean_radius
from spm_pin.formulas.stages import pair_adjugate, pair_determinant
from spm_pin.formulas.vectors import Rows, combinations, largest, multiples, weighted
from spm_pin.formulas.wrenches import mean
from spm_pin.kinematics.kernels.ball_circles import circles_at, solution
from spm_pin.kinematics.kernels.compilation import (
    OK,
    UNREACHABLE,
    UNSOLVED,
    ComplexArray,
    jit,
    jit_inline,
    kernel,
    put_rows,
    readonly_array,
    rows_at,
    vector_at,
)
from spm_pin.kinematics.kernels.mode_kernels import allocate_stage_scratch, is_countable, stage_modes
from spm_pin.kinematics.kernels.quadric_newton import reciprocal
from spm_pin.support.arguments import FloatArray

Forms = tuple[PairForm, PairForm, PairForm]

MODES = 16
_DEGREE = 8
_SAMPLES = 17
_ANGLES = 2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES
_COSINES, _SINES = np.cos(_ANGLES), np.sin(_ANGLES)
_WAVES = np.exp(-1j * np.outer(np.arange(_DEGREE + 1), _ANGLES)) / _SAMPLES
_STARTS = np.where(np.arange(MODES) % 2, 0.8, 1.25) * np.exp(2j * np.pi * (np.arange(MODES) + 0.3) / MODES)
_MOST_ITERATIONS, _MOST_STEPS = 40, 30
_SEPARATE = 1e-7
"""Solutions closer than this, relative to e^{iθ}, are one: rounding resolves a double one no better."""
_REGULAR = 3e7
"""Largest change of the angles per relative change of the equations at which a solution counts. Up to a few times as
much the theorem of Newton and Kantorovich holds in spite of rounding; beyond, a fold or a continuous family is near."""
_LONGEST_LEG = 50.0
"""Radius of a circle over the longest side of the triangle beyond which modes are not known to be all."""
_NEARLY_REAL = 1e-5  # relative imaginary part from which Newton's method is first tried with real angles
_FITS = 1e-3  # relative error of the third side up to which a pair of angles is tried
# Rows of the work array of the polynomial's roots.
_RE, _IM, _VALUE_RE, _VALUE_IM, _SLOPE_RE, _SLOPE_IM, _CROWD_RE, _CROWD_IM, _MOVED, _ROWS = range(10)


class ModeScratch(NamedTuple):
    """Arrays that stages are solved in, one after another."""

    polynomial: ComplexArray  # (17,)
    work: FloatArray  # (rows, 16)
    cosines: ComplexArray  # of the solutions' angles (16, 3)
    sines: ComplexArray


@jit_inline
def allocate_mode_scratch() -> ModeScratch:
    """Allocate the arrays that stages are solved in, one after another."""
    numbers = np.empty((MODES, 3), np.complex128), np.empty((MODES, 3), np.complex128)
    return ModeScratch(np.empty(2 * _DEGREE + 1, np.complex128), np.empty((_ROWS, MODES)), *numbers)


@jit
def _put_polynomial(forms: Forms, polynomial: ComplexArray) -> None:
    """Write the coefficients in e^{iθ} of the first angle, from the constant up."""
    for j in range(_DEGREE + 1):
        polynomial[_DEGREE + j] = 0.0
    for k in range(_SAMPLES):
        value = eliminant(forms, _COSINES[k], _SINES[k])
        for j in range(_DEGREE + 1):
            polynomial[_DEGREE + j] += value * _WAVES[j, k]
    for j in range(1, _DEGREE + 1):
        polynomial[_DEGREE - j] = np.conj(polynomial[_DEGREE + j])


@jit
def _put_roots(polynomial: ComplexArray, work: FloatArray) -> None:
    """Find all roots of the polynomial side by side."""
    for k in range(MODES):
        work[_RE, k], work[_IM, k] = _STARTS[k].real, _STARTS[k].imag
    for _ in range(_MOST_ITERATIONS):
        lead = polynomial[2 * _DEGREE]
        for k in range(MODES):
            work[_VALUE_RE, k], work[_VALUE_IM, k] = lead.real, lead.imag
            work[_SLOPE_RE, k], work[_SLOPE_IM, k] = 0.0, 0.0
            work[_CROWD_RE, k], work[_CROWD_IM, k] = 0.0, 0.0
        for j in range(2 * _DEGREE - 1, -1, -1):
            re, im = polynomial[j].real, polynomial[j].imag
            for k in range(MODES):
                x, y = work[_RE, k], work[_IM, k]
                p, q = work[_VALUE_RE, k], work[_VALUE_IM, k]
                u, v = work[_SLOPE_RE, k], work[_SLOPE_IM, k]
                work[_SLOPE_RE, k], work[_SLOPE_IM, k] = u * x - v * y + p, u * y + v * x + q
                work[_VALUE_RE, k], work[_VALUE_IM, k] = p * x - q * y + re, p * y + q * x + im
        for j in range(MODES):
            re, im = work[_RE, j], work[_IM, j]
            for k in range(MODES):
                x, y = work[_RE, k] - re, work[_IM, k] - im
                scale = 1.0 / (x * x + y * y + 1e-300)
                work[_CROWD_RE, k] += x * scale
                work[_CROWD_IM, k] -= y * scale
        for k in range(MODES):
            p, q = work[_VALUE_RE, k], work[_VALUE_IM, k]
            u, v = work[_CROWD_RE, k], work[_CROWD_IM, k]
            x, y = work[_SLOPE_RE, k] - (p * u - q * v), work[_SLOPE_IM, k] - (p * v + q * u)
            scale = 1.0 / (x * x + y * y + 1e-300)
            u, v = (p * x + q * y) * scale, (q * x - p * y) * scale
            re, im = work[_RE, k], work[_IM, k]
            work[_MOVED, k] = (u * u + v * v) / (re * re + im * im + 1e-300)
            work[_RE, k], work[_IM, k] = re - u, im - v
        moved = 0.0
        for k in range(MODES):
            moved = max(moved, work[_MOVED, k])
        if moved < 1e-14:
            break


@jit_inline
def _size(z):
    """Return the sum of the magnitudes of both parts, which takes a tenth of the time of |z|."""
    return abs(z.real) + abs(z.imag)


@jit_inline
def _of_exponential(z):
    """Return cosine and sine of the angle whose e^{iθ} is z."""
    back = reciprocal(z)
    return 0.5 * (z + back), complex(0.0, -0.5) * (z - back)


@jit_inline
def _fitting_angles(coefficients):
    """Return cosine and sine of both angles at which n + a cos θ + b sin θ vanishes."""
    n, a, b = coefficients
    lead, last = 0.5 * complex(a.real + b.imag, a.imag - b.real), 0.5 * complex(a.real - b.imag, a.imag + b.real)
    root = cmath.sqrt(n * n - 4.0 * lead * last)
    below, above = n - root, n + root
    larger = -0.5 * (above if _size(above) >= _size(below) else below)
    first, second = _of_exponential(larger * reciprocal(lead)), _of_exponential(last * reciprocal(larger))
    return first[0], first[1], second[0], second[1]


@jit
def _polished(forms, sizes, c, s):
    """Return the cosines and sines to which Newton's method leads, and whether they are a regular solution, `_REGULAR`.

    `sizes` are `circles.form_sizes`. Real angles stay real.
    """
    last = np.nan
    for _ in range(_MOST_STEPS):
        values, slopes = turn_equations(forms, c, s)
        adjugate, scale = pair_adjugate(slopes), reciprocal(pair_determinant(slopes))
        x, y, z = weighted(values, adjugate)
        x, y, z = scale * x, scale * y, scale * z
        longest = max(_size(x), _size(y), _size(z))
        if not longest < 1.0:
            return c, s, False
        (c0, s0), (c1, s1), (c2, s2) = _turned(c[0], s[0], x), _turned(c[1], s[1], y), _turned(c[2], s[2], z)
        c, s = (c0, c1, c2), (s0, s1, s2)
        if has_converged(longest, last):
            gain, x, y, z = 0.0, _size(c0) + _size(s0), _size(c1) + _size(s1), _size(c2) + _size(s2)
            for a, b, d in multiples((sizes[0] * x * y, sizes[1] * y * z, sizes[2] * z * x), adjugate):
                gain = max(gain, _size(a), _size(b), _size(d))
            return c, s, gain * _size(scale) < _REGULAR
        last = longest
    return c, s, False


@jit_inline
def _turned(c, s, step):
    """Return cosine and sine of an angle less a step, by the rational map that is a turn to third order."""
    t = 0.5 * step
    square = t * t
    scale = reciprocal(1.0 + square)
    cosine, sine = (1.0 - square) * scale, 2.0 * t * scale
    return c * cosine + s * sine, s * cosine - c * sine


@jit_inline
def _is_near(a, b, c, d):
    return _size(a - c) + _size(b - d) <= _SEPARATE * (_size(c) + _size(d))


@jit
def _add(c, s, offset, found, count):
    """Append a solution, whose first angle is that of the leg `offset`, if it is new; return their number."""
    for j in range(count):
        same = True
        for i in range(3):
            leg = (i + offset) % 3
            same = same and _is_near(c[i], s[i], found.cosines[j, leg], found.sines[j, leg])
        if same:
            return count
    if count == MODES:
        return count
    for i in range(3):
        leg = (i + offset) % 3
        found.cosines[count, leg], found.sines[count, leg] = c[i], s[i]
    return count + 1


@jit_inline
def _real(x):
    return x[0].real, x[1].real, x[2].real


@jit_inline
def _real_angles(c, s):
    """Return cosines and sines of the real angles next to nearly real ones, whose real parts are on larger circles."""
    p, q = _real(c), _real(s)
    scales = (
        1.0 / math.sqrt(p[0] * p[0] + q[0] * q[0]),
        1.0 / math.sqrt(p[1] * p[1] + q[1] * q[1]),
        1.0 / math.sqrt(p[2] * p[2] + q[2] * q[2]),
    )
    return (
        (scales[0] * p[0], scales[1] * p[1], scales[2] * p[2]),
        (scales[0] * q[0], scales[1] * q[1], scales[2] * q[2]),
    )


@jit_inline
def _complex(x):
    return complex(x[0], 0.0), complex(x[1], 0.0), complex(x[2], 0.0)


@jit
def _is_real(c, s, tolerance):
    """Return whether the imaginary parts of angles are at most `tolerance`, relative to e^{iθ}."""
    is_real = True
    for i in range(3):
        is_real = is_real and abs(c[i].imag) + abs(s[i].imag) <= tolerance * (_size(c[i]) + _size(s[i]))
    return is_real


@jit
def _add_solution(forms, sizes, c, s, offset, found, count):
    """Append the solution near these angles, and its conjugate, as far as they are new; return their number."""
    if _is_real(c, s, _NEARLY_REAL):
        real_c, real_s = _real_angles(c, s)
        real_c, real_s, converged = _polished(forms, sizes, real_c, real_s)
        if converged:
            return _add(_complex(real_c), _complex(real_s), offset, found, count)
    c, s, converged = _polished(forms, sizes, c, s)
    if not converged:
        return count
    if _is_real(c, s, _SEPARATE):
        real_c, real_s = _real_angles(c, s)
        return _add(_complex(real_c), _complex(real_s), offset, found, count)
    count = _add(c, s, offset, found, count)
    c, s = (np.conj(c[0]), np.conj(c[1]), np.conj(c[2])), (np.conj(s[0]), np.conj(s[1]), np.conj(s[2]))
    return _add(c, s, offset, found, count)


@jit
def _collect(forms, offset, is_retry, found, count):
    """Append the solutions of the roots of one elimination; in a retry, all pairs of the other angles are tried."""
    (f12, f23, f31), sizes = forms, form_sizes(forms)
    for k in range(MODES):
        z = complex(found.work[_RE, k], found.work[_IM, k])
        # The other root of a conjugate pair is the inverse of this one's conjugate.
        if not 1.0 - 1e-4 < abs(z) < 1e100 or count == MODES:
            continue
        c, s = _of_exponential(z)
        p = _fitting_angles(in_other_angle(f12, c, s))
        q = _fitting_angles(in_first_angle(f31, 1.0, c, s))
        best, least = -1, np.inf
        for choice in range(4):
            error = _misfit(f23, p, q, choice)
            if error < least:
                best, least = choice, error
        for choice in range(4):
            if choice == best or (is_retry and _misfit(f23, p, q, choice) < _FITS):
                i, j = 2 * (choice % 2), 2 * (choice // 2)
                count = _add_solution(forms, sizes, (c, p[i], q[j]), (s, p[i + 1], q[j + 1]), offset, found, count)
    return count


@jit_inline
def _misfit(form, p, q, choice):
    """Return the relative error of a side between one of two angles of its first leg and one of two of its second."""
    i, j = 2 * (choice % 2), 2 * (choice // 2)
    n, a, b = in_other_angle(form, p[i], p[i + 1])
    size = _size(n) + (_size(a) + _size(b)) * (_size(q[j]) + _size(q[j + 1]))
    return _size(n + a * q[j] + b * q[j + 1]) / size


@jit
def real_modes(stage: Circles, found: ModeScratch, balls: FloatArray) -> tuple[int, bool]:
    """Write the balls of all real modes of a stage (16, 3, 3); return how many they are, and whether these are all."""
    first, second = turn_origins(stage)
    forms, count = pair_forms(stage, first, second), 0
    for attempt in range(3):
        f12, f23, f31 = forms
        rolled = forms if attempt == 0 else ((f23, f31, f12) if attempt == 1 else (f31, f12, f23))
        _put_polynomial(rolled, found.polynomial)
        _put_roots(found.polynomial, found.work)
        count = _collect(rolled, attempt, attempt > 0, found, count)
        if count == MODES:
            break
    # Long legs leave too few digits for what is of the triangle's size.
    r1, r2, r3 = stage.radii
    real, complete = 0, count == MODES and max(r1 * r1, r2 * r2, r3 * r3) <= _LONGEST_LEG**2 * largest(stage.squares)
    for k in range(count):
        c, s = vector_at(found.cosines[k], 0), vector_at(found.sines[k], 0)
        if _is_real(c, s, 0.0):
            e = combinations(multiples(_real(c), first), _real(s), second)
            # By coordinates of the balls: the forms lose digits where legs are long.
            _, b, converged = solution(stage, e, newton_step(stage, e))
            complete = complete and converged
            put_rows(b, balls[real])
            real += 1
    # Complex ones are pairs.
    return real, complete and real % 2 == 0


@jit
def _put_labelled(roots: FloatArray, count: int, up: float, balls: FloatArray) -> None:
    """Write the balls of `count` modes `roots` (16, 3, 3) in the places of their labels, the others NaN.

    From the largest mean radius on, each takes the first label left of its mode and sheet; if none is left, of one of
    these. `roots` is overwritten.
    """
    for label in range(MODES):
        balls[label] = np.nan
    for _ in range(count):
        chosen, most = -1, -np.inf
        for k in range(count):
            radius = mean_radius(rows_at(roots[k], 0))
            if radius > most:
                chosen, most = k, radius
        b, best, closest = rows_at(roots[chosen], 0), -1, -1
        half_turned, below = most < 0.0, up * mean(b)[2] < 0.0
        for label in range(MODES):
            fits = 2 * (half_turned == (label >= MODES // 2)) + (below == (label % 2 == 1))
            if math.isnan(balls[label, 0, 0]) and fits > closest:
                best, closest = label, fits
        put_rows(b, balls[best])
        roots[chosen] = np.nan


@jit
def _put_frames(own: Rows, balls: FloatArray, frames: FloatArray) -> None:
    """Write rotations and positions (16, 4, 3) of the middle platform with balls (16, 3, 3)."""
    axes = triangle_axes(own)
    for k in range(MODES):
        b = rows_at(balls[k], 0)
        turn, place = frame_of_triangle(triangle_axes(b), axes, b, own)
        put_rows(turn, frames[k])
        frames[k, 3, 0], frames[k, 3, 1], frames[k, 3, 2] = place


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(2)}, b1, f8, f8, f8, "
    "f8[:,:,:,::1], b1[:,::1], i1[::1])"
)
def modes_of_stages(centres, radii, axes, balls, is_nominal_rps, r, base_radius, up, joints, continuous, status):
    """Find all assembly modes of N stages, under their labels.

    The circles are as for `ball_circles.home_states`; `r` and `base_radius` [m] are the circumradii of the platform and
    the base of a nominal stage with RPS legs, `up` is +1 or -1 for the side on which the sheet + is. Written are the
    balls (N, 16, 3, 3) [m], NaN where a mode is not real; which of the modes T, F of a nominal stage with RPS legs are
    `continuous` (N, 2); and `Status` (N,), continuous families not counted.
    """
    found, scratch, roots = allocate_mode_scratch(), allocate_stage_scratch(), np.empty((MODES, 3, 3))
    squares, epsilon = squared_sides(rows_at(balls, 0)), base_radius / r
    for n in range(len(radii)):
        straight, half_turned = False, False
        if is_nominal_rps:
            first, second, third = radii[n, 0] / r, radii[n, 1] / r, radii[n, 2] / r
            joints[n], count = np.nan, 0
            straight, half_turned = stage_modes(first, second, third, epsilon, up, scratch, joints[n])
            for k in range(MODES):
                count += not math.isnan(joints[n, k, 0, 0])
                put_rows(multiples((r, r, r), rows_at(joints[n, k], 0)), joints[n, k])
            is_complete = straight or half_turned or is_countable(first, second, third, epsilon)
        else:
            count, is_complete = real_modes(circles_at(axes, centres[n], radii[n], squares), found, roots)
            _put_labelled(roots, count, up, joints[n])
        continuous[n, 0], continuous[n, 1] = straight, half_turned
        if is_complete:
            status[n] = OK if count > 0 or straight or half_turned else UNREACHABLE
        else:
            status[n], joints[n] = UNSOLVED, np.nan


@kernel(
    f"void(Array(f8, 4, 'C', True), Array(f8, 4, 'C', True), {readonly_array(2)}, "
    "f8[:,:,:,::1], f8[:,:,::1], f8[:,:,:,::1])"
)
def join_modes(lower, upper, balls, rotation, translation, joints):
    """Put the modes of N lower and N upper stages together, each of the one with each of the other.

    The balls (N, 16, 3, 3) [m] are in {B} and in {m}, `balls` (6, 3) [m] in the middle platform's frame. Written are
    R (N, 256, 3, 3), o (N, 256, 3) [m] and the b_i (N, 256, 3, 3) [m], NaN where either mode is not real.
    """
    frames = np.empty((2, MODES, 4, 3))
    for n in range(len(lower)):
        _put_frames(rows_at(balls, 0), lower[n], frames[0])
        _put_frames(rows_at(balls, 3), upper[n], frames[1])
        for i in range(MODES):
            below, b = frames[0, i], rows_at(lower[n, i], 0)
            for j in range(MODES):
                mode, above = MODES * i + j, frames[1, j]
                turn, o = pose_of_frames(
                    rows_at(below, 0), vector_at(below[3], 0), rows_at(above, 0), vector_at(above[3], 0)
                )
                put_rows(turn, rotation[n, mode])
                translation[n, mode, 0], translation[n, mode, 1], translation[n, mode, 2] = o
                joints[n, mode] = np.nan
                # Not numbers where either mode is not real.
                if o[0] == o[0]:
                    put_rows(b, joints[n, mode])
