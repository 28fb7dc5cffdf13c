"""Assembly modes of single stages with sixty digits, where double precision cannot count them.

Beside lengths with a continuous family all terms of the quartic nearly cancel, so that its roots lose as many digits as
the lengths share with the family's; and beside very short legs rounding of the equations is larger than the legs are.
The same equations are solved here as in `spm_pin.kinematics.kernels`, one stage at a time.
"""

from __future__ import annotations

import math
import operator
from functools import reduce
from typing import Any

import mpmath
import numpy as np
from numpy.polynomial import Polynomial

from spm_pin.formulas.operations import bind
from spm_pin.formulas.stages import (
    StageEquations,
    corners,
    derivatives,
    quartic,
    residual,
    stage_equations,
    tilt_quadratic,
)
from spm_pin.kinematics.kernels.mode_kernels import PLACES
from spm_pin.mechanism.arguments import FloatArray

_DIGITS = 60
_REAL, _SOLVED, _SAME = 1e-20, 1e-40, 1e-14


def solve_stage_with_more_digits(lengths: FloatArray, pivot_radius: float, side: float, above: float) -> FloatArray:
    """Return the sixteen assembly modes of a stage (16, 5), as `kernels.mode_kernels` orders them, NaN where none is.

    `pivot_radius` is E or C [m], and `above` 1 where the sheet + is above the pivots, -1 where it is below.
    """
    modes = np.full((4 * PLACES, 5), np.nan)
    with mpmath.workdps(_DIGITS):
        r = mpmath.mpf(float(side)) / mpmath.sqrt(3)
        legs = [mpmath.mpf(float(x)) / r for x in lengths]
        epsilon = mpmath.mpf(float(pivot_radius)) / r
        for mode, signed in enumerate((epsilon, -epsilon)):
            stage = bind(stage_equations, COS_30=mpmath.sqrt(3) / 2)(legs[0], legs[1], legs[2], signed)
            for place, state in enumerate(_in_order(_solutions(stage), mode == 1)[:PLACES]):
                x0, x1, x2, zeta = (float(x) for x in state)
                plain = (0.0, -x2, x1, x0, zeta) if mode else (x0, x1, x2, 0.0, zeta)
                _, heights = corners(*plain)
                flat = max(abs(h) for h in heights) <= _SAME
                for sheet in range(1 if flat else 2):
                    sign = above if sheet == 0 else -above
                    q0, q1, q2, q3, height = plain
                    modes[(mode * PLACES + place) * 2 + sheet] = q0, sign * q1, sign * q2, q3, sign * height
    return modes


def _solutions(stage: StageEquations) -> list[list[Any]]:
    """Return all distinct solutions x0, x1, x2, ζ of one mode, ζ not negative."""
    real, imag = stage.real, stage.imag
    kappa, size = 2 * stage.epsilon - 1, mpmath.hypot(real, imag)
    nu = mpmath.mpc(real, imag) / size if size > 0 else mpmath.mpc(0.6, 0.8)
    mu, span = nu**3, mpmath.hypot(kappa, size) or mpmath.mpf(1)
    omega, gain = abs(kappa) / span, (-1 if kappa < 0 else 1) / span
    # Turned by an angle that no root shares, so that none is at infinity.
    coefficients = quartic(stage, size, mu.real, mu.imag, omega, gain)
    turn = mpmath.tan(mpmath.mpf("0.777"))
    polynomial = _substituted(coefficients, turn)
    solutions: list[list[Any]] = []
    for root in mpmath.polyroots(polynomial, maxsteps=400, extraprec=400, asc=True):
        if abs(root.imag) > _REAL * (1 + abs(root.real)):
            continue
        t = root.real
        gamma = mpmath.mpc(1 - t * turn, t + turn)
        gamma /= abs(gamma)
        delta = mpmath.mpc(gamma.real, omega * gamma.imag)
        a = size * gain * gamma.imag / abs(delta)
        for start in _tilts(stage, delta / abs(delta) * mpmath.conj(nu), a):
            state = _newton(stage, start)
            if state is not None and all(
                max(abs(x - y) for x, y in zip(state, s, strict=True)) > _SAME for s in solutions
            ):
                solutions.append(state)
    return solutions


def _substituted(coefficients: tuple[Any, ...], turn: Any) -> list[Any]:
    """Return a quartic of tan γ as one of t, tan γ = (t + turn) / (1 - t turn), from its constant up."""
    above, below = (Polynomial(np.array(ends)) for ends in ([turn, mpmath.mpf(1)], [mpmath.mpf(1), -turn]))
    terms = (above**power * below ** (4 - power) * c for power, c in enumerate(coefficients))
    return list(reduce(operator.add, terms).coef)


def _tilts(stage: StageEquations, turn: Any, a: Any) -> list[list[Any]]:
    """Return approximate solutions of one azimuth, see `kernels.quartic`."""
    epsilon, level, kappa = stage.epsilon, stage.level, 2 * stage.epsilon - 1
    b = stage.real * turn.real - stage.imag * turn.imag
    cubed = turn**3
    square, linear, constant = tilt_quadratic(stage, a, b, cubed.real)
    root = mpmath.sqrt(max(linear * linear - 4 * square * constant, 0))
    larger = -(linear + (-root if linear < 0 else root)) / 2
    starts = []
    for p in ([larger / square] if square else []) + [constant / larger if larger else mpmath.mpf(0)]:
        if not -0.01 < p < 1.01:
            continue
        p = min(max(p, mpmath.mpf(0)), mpmath.mpf(1))
        upper = mpmath.sqrt(p) if b >= (kappa + 2 * p) * p * cubed.real else -mpmath.sqrt(p)
        height = mpmath.sqrt(max(level - 2 * epsilon * p - p * p, 0))
        starts.append([mpmath.sqrt(1 - p), upper * turn.real, upper * turn.imag, height])
    return starts


def _newton(stage: StageEquations, start: list[Any]) -> list[Any] | None:
    """Return the solution beside an approximate one, None if that is none."""
    x = mpmath.matrix(start)
    for _ in range(60):
        state = tuple(x)
        value = [*residual(stage, state), (state[0] ** 2 + state[1] ** 2 + state[2] ** 2 - 1) / 2]
        if max(abs(v) for v in value) <= _SOLVED * stage.scale:
            break
        rows = [list(row) for row in derivatives(stage, state)] + [[state[0], state[1], state[2], 0]]
        try:
            step = mpmath.lu_solve(mpmath.matrix(rows), -mpmath.matrix(value))
        except ZeroDivisionError:
            return None
        x += step
        # What is near a solution moves little.
        if mpmath.norm(x - mpmath.matrix(start)) > 1e-3:
            return None
    else:
        return None
    sign, mirror = (-1 if x[0] < 0 else 1), (-1 if x[3] < 0 else 1)
    return [sign * x[0], sign * mirror * x[1], sign * mirror * x[2], mirror * x[3]]


def _in_order(states: list[list[Any]], half_turned: bool) -> list[list[Any]]:
    """Sort by falling mean radius; where nine digits of it agree, by the azimuth of the tilt axis."""

    def key(state: list[Any]) -> tuple[float, float]:
        x0, x1, x2, _ = (float(x) for x in state)
        radius = -(x0**2) if half_turned else x0**2
        return -float(np.rint(1e9 * radius)), (math.atan2(x2, x1) + math.pi / 6.0) % math.pi

    return sorted(states, key=key)
