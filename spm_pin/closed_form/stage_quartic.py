"""Approximate solutions of one 3RPS stage: the roots of one quartic per mode.

Multiplied by e^{iψ}, ψ the azimuth of w, the equation for λ of `spm_pin.closed_form.stage` has the parts

    Im(λ e^{iψ}) = κ p sin 3ψ,      Re(λ e^{iψ}) = (κ + 2p) p cos 3ψ + 2 ζ x0 |w|,

with p = |w|². The square of the second one holds no root, since ζ² = c - 2εp - p² and x0² = 1 - p. With
A = Im(λ e^{iψ}) / κ, thus p sin 3ψ = A, and B = Re(λ e^{iψ}) it becomes, c = m - (1 - ε)²,

    [4 A² + 4 B cos 3ψ - 4 (2ε + c) - κ²] p² + [4 κ A² + 4 c + 2 κ B cos 3ψ] p + κ² A² - B² = 0

and, times sin² 3ψ, a polynomial in e^{2iψ} alone:

    4 A⁴ + 4 A² Re(λ e^{-2iψ}) - [4 (2ε + c) + κ²] A² + 4 c A sin 3ψ + ½ Re(λ² e^{-4iψ} - λ² e^{2iψ}) = 0.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.stage_newton import BoolArray, StageEquations
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["approximate_solutions"]

ComplexArray = npt.NDArray[np.complex128]


def approximate_solutions(stage: StageEquations, family: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return x0, x1, x2, ζ of approximate solutions (K, 8, 4), and which of them deserve a Newton iteration."""
    kappa = 2.0 * stage.epsilon - 1.0
    turn, a, found = _azimuths(stage, family, kappa)
    # A = Im(λ e^{iψ}) / κ = p sin 3ψ, and the rest is quadratic in the tilt p, whose two roots are both tried: legs
    # symmetric about a plane have two solutions of one azimuth, where sin 3ψ = 0.
    b = stage.real[:, None] * turn.real - stage.imag[:, None] * turn.imag
    cubed = turn * turn * turn
    level, epsilon, kappa = stage.level[:, None], stage.epsilon[:, None], kappa[:, None]
    square = 4.0 * (a * a + b * cubed.real) - 4.0 * (2.0 * epsilon + level) - kappa * kappa
    linear = 4.0 * kappa * a * a + 4.0 * level + 2.0 * kappa * b * cubed.real
    constant = (kappa * a) ** 2 - b * b
    root = np.sqrt(np.maximum(linear * linear - 4.0 * square * constant, 0.0))
    larger = -0.5 * (linear + np.where(linear < 0.0, -root, root))
    with np.errstate(invalid="ignore", divide="ignore"):
        p = np.concatenate([larger / square, constant / larger], axis=-1)
    p = np.where(np.isfinite(p), p, np.where(np.arange(8) < 4, -1.0, 0.0))
    turn, cubed, a, b, found = (np.concatenate([x, x], axis=-1) for x in (turn, cubed, a, b, found))
    mismatch = np.abs(a - p * cubed.imag)
    fits = (mismatch <= 0.05 * (np.abs(a) + np.abs(p * cubed.imag)) + 1e-6) | (np.abs(cubed.imag) < 0.05)
    plausible = found & fits & (p > -0.01) & (p < 1.01)
    p = np.clip(p, 0.0, 1.0)
    # b = (κ + 2p) p cos 3ψ + 2 ζ x0 |w|: its sign tells which of w and -w is the one with ζ >= 0.
    upper = np.where(b >= (kappa + 2.0 * p) * p * cubed.real, 1.0, -1.0) * np.sqrt(p)
    zeta = np.sqrt(np.maximum(level - 2.0 * epsilon * p - p * p, 0.0))
    return np.stack([np.sqrt(1.0 - p), upper * turn.real, upper * turn.imag, zeta], axis=-1), plausible


def _azimuths(
    stage: StageEquations, family: BoolArray, kappa: FloatArray
) -> tuple[ComplexArray, FloatArray, BoolArray]:
    """Return e^{iψ}, A = Im(λ e^{iψ}) / κ, and whether it may be real, at the quartic's roots, each (K, 4).

    With δ = ψ + arg λ and μ = e^{3i arg λ}, it is a quartic in tan δ. For small κ all its roots are crowded around
    zero; tan δ = ω tan γ with ω = |κ| / √(κ² + |λ|²) spreads them over all γ.
    """
    size = np.hypot(stage.real, stage.imag)
    # Without λ there is no direction to count from, and any will do.
    some = size > 0.0
    nu = np.where(some, stage.real, 0.6) + 1j * np.where(some, stage.imag, 0.8)
    nu = nu / np.abs(nu)
    mu = nu * nu * nu
    span = np.hypot(kappa, size)
    span = np.where(span > 0.0, span, 1.0)
    omega, gain = np.abs(kappa) / span, np.where(kappa < 0.0, -1.0, 1.0) / span
    quartic = _quartic(stage, size, mu, omega, gain)
    tangent, lead = _roots(quartic)
    gamma = (1.0 + 1j * tangent.real) / np.hypot(1.0, tangent.real) * lead[:, None]
    found = np.abs(tangent.imag) <= 0.01 * (1.0 + tangent.real**2)
    delta = gamma.real + 1j * omega[:, None] * gamma.imag
    length = np.abs(delta)
    a = (size * gain)[:, None] * gamma.imag / length
    turn = delta / length * np.conj(nu)[:, None]
    # Where the quartic vanishes, what is isolated is level or tilted in the plane of a leg.
    family = family[:, None]
    symmetric = np.exp(1j * np.pi / 3.0 * np.array([0.0, 1.0, 2.0, 0.0]))
    chosen: ComplexArray = np.asarray(np.where(family, symmetric, turn), dtype=np.complex128)
    return chosen, np.where(family, 0.0, a), np.asarray(found | family)


def _quartic(
    stage: StageEquations, size: FloatArray, mu: ComplexArray, omega: FloatArray, gain: FloatArray
) -> FloatArray:
    """Return the coefficients of tan^j γ, j = 0..4, shape (5, K), divided by |λ|; gain is ω/κ."""
    c, x, y = stage.level, mu.real, mu.imag
    g = (2.0 * stage.epsilon + 1.0) ** 2 + 4.0 * c
    w2, k2 = omega * omega, gain * gain
    x2 = x * x - y * y
    return np.stack(
        [
            -size * y * y,
            (4.0 * omega * size * x - 4.0 * gain * c) * y,
            (4.0 * size * x - g) * size * k2 + 12.0 * c * gain * omega * x - 3.0 * w2 * size * x2,
            (8.0 * size * size * k2 * omega + 12.0 * c * gain * w2 - 4.0 * w2 * omega * size * x) * y,
            (4.0 * size * size * k2 - 4.0 * size * w2 * x - g * w2) * size * k2
            - 4.0 * c * gain * w2 * omega * x
            + w2 * w2 * size * x * x,
        ]
    )


def _roots(quartic: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the roots tan(γ - β) of quartics in tan γ (5, K), shape (K, 4), and e^{iβ}, shape (K,).

    As a function of γ the quartic is a mean and two harmonics of 2γ. β is taken where it is large a quarter turn
    away, so that no root is near infinity.
    """
    c0, c1, c2, c3, c4 = quartic
    mean = 0.375 * (c0 + c4) + 0.125 * c2
    first = 0.5 * (c0 - c4) - 0.25j * (c1 + c3)
    second = 0.125 * (c0 - c2 + c4) - 0.125j * (c1 - c3)
    turns = np.exp(0.125j * np.pi * np.arange(8))
    values = mean[:, None] - (first[:, None] * turns**2).real + (second[:, None] * turns**4).real
    turn = turns[np.abs(values).argmax(axis=-1)]
    first, second = first * turn**2, second * turn**4
    leading = mean - first.real + second.real
    leading = np.where(leading == 0.0, 1.0, leading)
    companion = np.zeros((len(mean), 4, 4))
    companion[:, 0, 0] = (2.0 * first.imag - 4.0 * second.imag) / leading
    companion[:, 0, 1] = (6.0 * second.real - 2.0 * mean) / leading
    companion[:, 0, 2] = (2.0 * first.imag + 4.0 * second.imag) / leading
    companion[:, 0, 3] = -(mean + first.real + second.real) / leading
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    return np.linalg.eigvals(companion).astype(np.complex128), turn
