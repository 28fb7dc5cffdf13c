"""The equations of one 3RPS stage, and Newton's method on them.

A state (x0, x1, x2, ζ) is that of `spm_pin.closed_form.stage` in the coordinates of its mode: in mode F, where r, ε and
ζ are negative, x0 stands for the quaternion's x3, and x1 + i x2 for i w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray

__all__ = ["NEAR", "SAME", "BoolArray", "IntArray", "StageEquations", "other_side_of_fold", "polished"]

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

_EPS = float(np.finfo(np.float64).eps)
SAME = 4.0 * np.sqrt(_EPS)
"""Solutions closer than this, in units of r, are one: rounding resolves a double root no better."""
NEAR = 1e3
"""Where a solution errs more than this many times as much as the leg lengths, a fold or a family is near."""
_ROUNDING = 4.0 * _EPS
"""Residual of a solution relative to the largest term of its equations; half of it has been seen."""
_LONGEST_STEP = np.array([0.3, 0.3, 1.0])
_MOST_STEPS = 40


@dataclass(frozen=True)
class StageEquations:
    """The equations f = 0 of K pairs of a stage and a mode, by their coefficients, arrays of shape (K,)."""

    epsilon: FloatArray  # E/r, negative in mode F
    level: FloatArray  # c = m - (1 - ε)², which is ζ² of the level triangle
    real: FloatArray  # λ
    imag: FloatArray
    scale: FloatArray  # the size of the largest terms

    @classmethod
    def of(cls, lengths: FloatArray, epsilon: FloatArray) -> StageEquations:
        """Set up the equations for leg lengths (K, 3) and signed hip radii (K,), in units of r."""
        first, second, third = lengths.T
        # Differences of squares as products: exact where legs are equal.
        imag = (first - third) * (first + third) * (np.sqrt(0.75) / 3.0)
        real = ((second - first) * (second + first) + (second - third) * (second + third)) / 6.0
        mean = (first * first + second * second + third * third) / 3.0
        return cls(epsilon, mean - (1.0 - epsilon) ** 2, real, imag, mean + (1.0 + np.abs(epsilon)) ** 2)

    def take(self, owner: IntArray) -> StageEquations:
        """Return the equations (M,) that states with these owners (M,) obey."""
        return StageEquations(
            self.epsilon[owner], self.level[owner], self.real[owner], self.imag[owner], self.scale[owner]
        )

    def residual(self, states: FloatArray) -> FloatArray:
        """Return f (K, 3) at states (K, 4): the parts of the equation for λ, and the one for ζ²."""
        x0, x1, x2, zeta = states.T
        a, b = x1 * x1 - x2 * x2, 2.0 * x1 * x2
        p = x1 * x1 + x2 * x2
        h = 2.0 * self.epsilon - x0 * x0
        lift = 2.0 * zeta * x0
        real = h * a + (a * a - b * b) + lift * x1 - self.real
        imag = h * b - 2.0 * a * b - lift * x2 - self.imag
        return np.stack([real, imag, zeta * zeta + (2.0 * self.epsilon + p) * p - self.level], axis=-1)

    def derivatives(self, states: FloatArray) -> FloatArray:
        """Return the derivatives of f with respect to x0, x1, x2, ζ, shape (K, 3, 4)."""
        x0, x1, x2, zeta = states.T
        a, b = x1 * x1 - x2 * x2, 2.0 * x1 * x2
        h = 2.0 * self.epsilon - x0 * x0
        lift = 2.0 * zeta * x0
        u, v = 2.0 * (a * x1 - b * x2), 2.0 * (a * x2 + b * x1)
        slope = 4.0 * (self.epsilon + x1 * x1 + x2 * x2)
        real = [2.0 * (zeta * x1 - x0 * a), 2.0 * (h * x1 + u) + lift, -2.0 * (h * x2 + v), 2.0 * x0 * x1]
        imag = [-2.0 * (zeta * x2 + x0 * b), 2.0 * (h * x2 - v), 2.0 * (h * x1 - u) - lift, -2.0 * x0 * x2]
        height = [np.zeros_like(x0), slope * x1, slope * x2, 2.0 * zeta]
        return np.stack([*real, *imag, *height], axis=-1).reshape(-1, 3, 4)


def _tangents(states: FloatArray) -> FloatArray:
    """Return two orthonormal tangents of the sphere of quaternions, shape (M, 2, 3), smooth for x0 >= 0."""
    x0, x1, x2 = states[:, 0], states[:, 1], states[:, 2]
    q = 1.0 / (1.0 + x0)
    columns = [-x1, 1.0 - q * x1 * x1, -q * x1 * x2, -x2, -q * x1 * x2, 1.0 - q * x2 * x2]
    return np.stack(columns, axis=-1).reshape(-1, 2, 3)


def _jacobian(stage: StageEquations, states: FloatArray, tangents: FloatArray) -> FloatArray:
    """Return J (M, 3, 3), the derivatives of f along both tangents and along ζ."""
    full = stage.derivatives(states)

    def along(t: FloatArray) -> FloatArray:
        return full[:, :, 0] * t[:, None, 0] + full[:, :, 1] * t[:, None, 1] + full[:, :, 2] * t[:, None, 2]

    return np.stack([along(tangents[:, 0]), along(tangents[:, 1]), full[:, :, 3]], axis=-1)


def _moved(states: FloatArray, tangents: FloatArray, step: FloatArray) -> FloatArray:
    """Move states (M, 4) by steps (M, 3) along the tangents and ζ, back onto the sphere, with x0 >= 0."""
    x = states[:, :3] + step[:, :1] * tangents[:, 0] + step[:, 1:2] * tangents[:, 1]
    length = np.sqrt(x[:, 0] * x[:, 0] + x[:, 1] * x[:, 1] + x[:, 2] * x[:, 2])
    # Both signs of a quaternion are one rotation.
    x = x / np.where(x[:, 0] < 0.0, -length, length)[:, None]
    return np.concatenate([x, states[:, 3:] + step[:, 2:]], axis=-1)


def _inverse(matrix: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the inverses of matrices (M, 3, 3) by cofactors, finite ones even of the singular, and which are."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.transpose(1, 2, 0)
    cofactors = [e * i - f * h, c * h - b * i, b * f - c * e]
    cofactors += [f * g - d * i, a * i - c * g, c * d - a * f]
    cofactors += [d * h - e * g, b * g - a * h, a * e - b * d]
    determinant = a * cofactors[0] + b * cofactors[3] + c * cofactors[6]
    size = np.abs(matrix).max(axis=(-1, -2), initial=1.0)
    least = _EPS * _EPS * size * size * size
    singular = np.abs(determinant) < least
    determinant = np.where(singular, least, determinant)
    return (np.stack(cofactors, axis=-1) / determinant[:, None]).reshape(-1, 3, 3), singular


def polished(stage: StageEquations, owner: IntArray, states: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Bring approximate solutions to rounding by Newton's method.

    Parameters
    ----------
    stage : StageEquations
        K pairs of a stage and a mode.
    owner : ndarray of int, shape (M,)
        Which of them a state belongs to.
    states : ndarray, shape (M, 4)
        Where to start, unit quaternions with x0 >= 0.

    Returns
    -------
    owner, states : ndarrays, shapes (n,) and (n, 4)
        What has arrived, brought to ζ >= 0 by reflection. Each state stops by itself, so no result depends on what
        else is in the batch.
    gain : ndarray, shape (n,)
        By how much more, at most, it errs than the leg lengths, both relative to their size.
    """
    own = stage.take(owner)
    states = states.copy()
    gain = np.zeros(len(states))
    active = np.arange(len(states))
    for _ in range(_MOST_STEPS):
        mine, here = own.take(active), states[active]
        residual, tangents = mine.residual(here), _tangents(here)
        inverse, singular = _inverse(_jacobian(mine, here, tangents))
        step = -(inverse * residual[:, None, :]).sum(axis=-1)
        amplified = np.sqrt((inverse * inverse).sum(axis=(-1, -2))) * mine.scale
        amplified = np.where(singular, 1.0 / _EPS, amplified)
        length = np.sqrt((step * step).sum(axis=-1))
        off = np.abs(residual).max(axis=-1) / mine.scale
        # Beside a fold or a family, a step no longer than its own rounding leads nowhere better.
        idle = (length <= 8.0 * _EPS * amplified) & (amplified > NEAR) & (off <= _ROUNDING)
        step = step / np.maximum(1.0, np.abs(step / _LONGEST_STEP).max(axis=-1))[:, None]
        states[active] = np.where(idle[:, None], here, _moved(here, tangents, step))
        gain[active] = amplified
        # What a step leaves is its square, divided by the distance to the fold.
        at_rest = idle | (length * length * np.maximum(amplified, 1.0) <= _EPS) | (off <= _EPS)
        active = active[~at_rest]
        if not len(active):
            break
    arrived = np.abs(own.residual(states)).max(axis=-1, initial=0.0) <= _ROUNDING * own.scale
    states[states[:, 3] < 0.0, 1:] *= -1.0
    return owner[arrived], states[arrived], gain[arrived]


def other_side_of_fold(stage: StageEquations, owner: IntArray, states: FloatArray) -> FloatArray:
    """Return where the other solution is of a pair that is about to meet, shape (M, 4) as `states`.

    Along the direction n that hardly changes f, its part l·f that J hardly reaches is a quadratic.
    """
    own, tangents = stage.take(owner), _tangents(states)
    jacobian = _jacobian(own, states, tangents)
    inverse, _ = _inverse(jacobian)
    every = np.arange(len(states))
    n = inverse[every, :, (inverse**2).sum(axis=-2).argmax(axis=-1)]
    left = inverse[every, (inverse**2).sum(axis=-1).argmax(axis=-1)]
    n, left = (x / np.maximum(np.sqrt((x * x).sum(axis=-1, keepdims=True)), _EPS) for x in (n, left))
    slope = (left * (jacobian * n[:, None, :]).sum(axis=-1)).sum(axis=-1)
    h = 1e-4
    ends = own.residual(_moved(states, tangents, h * n)) + own.residual(_moved(states, tangents, -h * n))
    curvature = (left * ends).sum(axis=-1) / (2.0 * h * h)
    distance = -slope / np.where(curvature == 0.0, np.inf, curvature)
    return _moved(states, tangents, np.clip(distance, -0.1, 0.1)[:, None] * n)
