"""Approximate solutions of one 3RPS stage and mode, over scalars: `docs/theory/forward_displacement.md`.

With ψ the azimuth of the tilt w, p = |w|², A = Im(λ e^{iψ}) / κ = p sin 3ψ and B = Re(λ e^{iψ}), p is the root of a
quadratic, `formulas.stages.tilt_quadratic`, and ψ of a polynomial in e^{2iψ}. With δ = ψ + arg λ and μ = e^{3i arg λ}
that is a quartic in tan δ, `formulas.stages.quartic`. For small κ all its roots are crowded around zero;
tan δ = ω tan γ with ω = |κ| / √(κ² + |λ|²) spreads them over all γ.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.formulas.stages import StageEquations, quartic, tilt_quadratic
from spm_pin.kinematics.kernels.compilation import jit, jit_inline
from spm_pin.mechanism.arguments import FloatArray

ComplexArray = npt.NDArray[np.complex128]
Quartic = tuple[float, float, float, float, float]

_EIGHTHS = np.exp(0.125j * np.pi * np.arange(8))
_QUARTERS = np.exp(1j * (0.5 * np.pi * np.arange(4) + 0.4))
_SYMMETRIC = np.exp(1j * np.pi / 3.0 * np.array([0.0, 1.0, 2.0, 0.0]))
_MOST_STEPS = 60


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
    for _ in range(_MOST_STEPS):
        moved = 0.0
        for k in range(4):
            z = roots[k]
            value = a0 + z * (a1 + z * (a2 + z * (a3 + z)))
            slope = a1 + z * (2.0 * a2 + z * (3.0 * a3 + 4.0 * z))
            crowd = complex(0.0, 0.0)
            for j in range(4):
                gap = z - roots[j]
                if j != k and gap != 0.0:
                    crowd += 1.0 / gap
            divisor = slope - value * crowd
            if divisor != 0.0:
                step = value / divisor
                roots[k] = z - step
                moved = max(moved, abs(step.real) + abs(step.imag))
        if moved <= 1e-13 * (abs(centre) + radius):
            break


@jit
def approximate_solutions(stage: StageEquations, is_continuous: bool, roots: ComplexArray, starts: FloatArray) -> int:
    """Write x0, x1, x2, ζ of where Newton's method begins, at most eight states, and count them.

    `is_continuous` says that the quartic vanishes; `roots` (4,) is overwritten.
    """
    real, imag, kappa = stage.real, stage.imag, 2.0 * stage.epsilon - 1.0
    size = math.hypot(real, imag)
    # Without λ there is no direction to count from, and any will do.
    nu = complex(real / size, imag / size) if size > 0.0 else complex(0.6, 0.8)
    mu = nu * nu * nu
    span = math.hypot(kappa, size)
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
            if abs(tangent.imag) > 0.01 * (1.0 + tangent.real**2):
                continue
            secant = math.hypot(1.0, tangent.real)
            gamma = complex(1.0 / secant, tangent.real / secant) * lead
            delta = complex(gamma.real, omega * gamma.imag)
            length = abs(delta)
            a = size * gain * gamma.imag / length
            turn = complex(delta.real / length, delta.imag / length) * nu.conjugate()
        count = _tilts(stage, turn, a, starts, count)
    return count


@jit
def _tilts(stage: StageEquations, turn: complex, a: float, starts: FloatArray, count: int) -> int:
    """Append the solutions of one azimuth: A = p sin 3ψ, and the rest is quadratic in the tilt p.

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
