"""Following one solution of a stage while its leg lengths change, over scalars.

Four unknowns x = (x0, x1, x2, ζ), four equations F = (f, |quaternion|² - 1). The stage is forward singular where
F' is singular, and where x0 is zero: modes T and F meet there. No step reaches either.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.formulas.operations import COS_30
from spm_pin.kinematics.formulas.stages import StageEquations, State, derivatives, residual, stage_equations
from spm_pin.kinematics.formulas.vectors import Vector
from spm_pin.kinematics.kernels.compilation import jit, jit_inline, kernel, readonly_array
from spm_pin.kinematics.kernels.elimination import reduce_rows
from spm_pin.kinematics.kernels.stage_modes import polished
from spm_pin.kinematics.kernels.three_quadrics import put_quaternion
from spm_pin.mechanism.arguments import FloatArray

_MARGIN = 0.2
"""At most this instead of 1/2, so that `_ITERATIONS` steps of Newton's method reach rounding: 0.4^(2^5) < 1e-12."""
_ITERATIONS = 5
_LENGTHS = readonly_array(2)
_PART_OF_X0 = 0.25
"""Newton's method moves x by at most twice its first step, so after a first step of less than x0 / 2 x0 is positive."""
_SHORTEST = 1e-9
"""A step shorter than this part of the way stands before a singularity."""
_MOST_STEPS = 250_000
"""A bound of the time; more are taken for a singularity. Of 440,000 random paths the longest took 50,000 steps."""


@jit_inline
def _value(stage: StageEquations, state: State) -> State:
    """Return F."""
    real, imag, height = residual(stage, state)
    return real, imag, height, state[0] * state[0] + state[1] * state[1] + state[2] * state[2] - 1.0


@jit
def _invert(stage: StageEquations, state: State, work: FloatArray, inverse: FloatArray) -> None:
    """Write the inverse (4, 4) of F' by Gauss and Jordan with `work` (4, 8); not finite where F' is singular."""
    real, imag, height = derivatives(stage, state)
    for j in range(4):
        work[0, j], work[1, j], work[2, j] = real[j], imag[j], height[j]
        work[3, j] = 2.0 * state[j] if j < 3 else 0.0
        for i in range(4):
            work[i, 4 + j] = 1.0 if i == j else 0.0
    reduce_rows(work)
    for i in range(4):
        for j in range(4):
            inverse[i, j] = work[i, 4 + j]


@jit_inline
def _product(matrix: FloatArray, x: State, i: int) -> float:
    total: float = matrix[i, 0] * x[0] + matrix[i, 1] * x[1] + matrix[i, 2] * x[2] + matrix[i, 3] * x[3]
    return total


@jit_inline
def _image_size(matrix: FloatArray, x: State) -> float:
    """Return |matrix · x|."""
    a, b, c, d = _product(matrix, x, 0), _product(matrix, x, 1), _product(matrix, x, 2), _product(matrix, x, 3)
    return math.sqrt(a * a + b * b + c * c + d * d)


@jit_inline
def _harmonics(first: float, second: float, third: float) -> State:
    """Return by how much λ and m, hence F, change with the squared lengths."""
    real, imag = (2.0 * second - first - third) / 6.0, (first - third) * (COS_30 / 3.0)
    return real, imag, (first + second + third) / 3.0, 0.0


@jit_inline
def _curvature(epsilon: float, zeta: float) -> float:
    """Return a bound K of the second derivative of F around a state.

    Term by term, for |x| <= 1.05 and ζ within 0.05 of its value: F'⁻¹ is at least 1/2, for the last row of F' is 2x,
    and K at least 20, so no step of Newton's method leaves that region.
    """
    size, extent = 1.05, abs(zeta) + 0.05
    harmonic = 4.0 * abs(epsilon) + 18.0 * size * size + 4.0 * size + 2.0 * extent
    height = 4.0 * abs(epsilon) + 12.0 * size * size
    return math.sqrt(harmonic * harmonic + height * height + 4.0)


@jit_inline
def _at(start: Vector, change: Vector, done: float, epsilon: float) -> StageEquations:
    first, second = start[0] + done * change[0], start[1] + done * change[1]
    return stage_equations(first, second, start[2] + done * change[2], epsilon)


@jit_inline
def _safe_step(
    start: Vector, change: Vector, done: float, epsilon: float, state: State, work: FloatArray, inverse: FloatArray
) -> float:
    """Return by how much of `change` the lengths may change."""
    stage = _at(start, change, done, epsilon)
    _invert(stage, state, work, inverse)
    square = 0.0
    for i in range(4):
        for j in range(4):
            square += inverse[i, j] * inverse[i, j]
    longest = min(_MARGIN / (math.sqrt(square) * _curvature(epsilon, state[3])), _PART_OF_X0 * state[0])
    allowed = max(longest - _image_size(inverse, _value(stage, state)), 0.0)
    # The squared lengths, of which F is a linear function, change by 2 l dl s + dl² s².
    a, b, c = start[0] + done * change[0], start[1] + done * change[1], start[2] + done * change[2]
    first = _image_size(inverse, _harmonics(2.0 * a * change[0], 2.0 * b * change[1], 2.0 * c * change[2]))
    second = _image_size(inverse, _harmonics(change[0] * change[0], change[1] * change[1], change[2] * change[2]))
    slowest = first + math.sqrt(first * first + 4.0 * second * allowed)
    return 2.0 * allowed / slowest if slowest > 0.0 else 1.0


@jit
def _followed(
    start: Vector, change: Vector, epsilon: float, seed: State, work: FloatArray, inverse: FloatArray
) -> tuple[State, bool]:
    state, done, steps = seed, 0.0, 0
    while done < 1.0:
        steps += 1
        step = _safe_step(start, change, done, epsilon, state, work, inverse)
        # Not a number beside a singular F'.
        if not step >= _SHORTEST or steps > _MOST_STEPS:
            return state, False
        done = min(done + step, 1.0)
        target = _at(start, change, done, epsilon)
        for _ in range(_ITERATIONS):
            value = _value(target, state)
            _invert(target, state, work, inverse)
            x0, x1 = state[0] - _product(inverse, value, 0), state[1] - _product(inverse, value, 1)
            state = x0, x1, state[2] - _product(inverse, value, 2), state[3] - _product(inverse, value, 3)
    end, _, arrived = polished(_at(start, change, 1.0, epsilon), state)
    # What had gone below the hips comes back reflected.
    if end[1] * state[1] + end[2] * state[2] + end[3] * state[3] < 0.0:
        end = end[0], -end[1], -end[2], -end[3]
    return end, arrived


@kernel(f"void({_LENGTHS}, {_LENGTHS}, {readonly_array(1)}, {readonly_array(2)}, f8[:,::1], b1[::1])")
def follow_stages(
    start: FloatArray,
    end: FloatArray,
    epsilon: FloatArray,
    seeds: FloatArray,
    states: FloatArray,
    arrived: npt.NDArray[np.bool_],
) -> None:
    """Follow states along straight paths of leg lengths.

    Parameters
    ----------
    start, end : ndarray, shape (K, 3)
        Leg lengths in units of r.
    epsilon : ndarray, shape (K,)
        E/r, negative in mode F.
    seeds : ndarray, shape (K, 4)
        Solutions at `start`, unit quaternions with x0 >= 0.
    states : ndarray, shape (K, 4), written
        Solutions at `end`, ζ of either sign.
    arrived : ndarray of bool, shape (K,), written
        False where a forward singularity was met on the way, or the path took more than `_MOST_STEPS` steps.
    """
    work, inverse = np.empty((4, 8)), np.empty((4, 4))
    for k in range(len(states)):
        here = start[k, 0], start[k, 1], start[k, 2]
        change = end[k, 0] - start[k, 0], end[k, 1] - start[k, 1], end[k, 2] - start[k, 2]
        seed = seeds[k, 0], seeds[k, 1], seeds[k, 2], seeds[k, 3]
        state, arrived[k] = _followed(here, change, epsilon[k], seed, work, inverse)
        states[k, 0], states[k, 1], states[k, 2], states[k, 3] = state


@kernel(f"void({readonly_array(3)}, f8, f8[:,::1], b1[::1])")
def stage_states(corners: FloatArray, r: float, states: FloatArray, half_turned: npt.NDArray[np.bool_]) -> None:
    """Write the states (M, 4) of stages whose triangles have these corners (M, 3, 3) [m], and which are in mode F (M,).

    In mode F the coordinates are those of the mode, see `formulas.stages`. `r` is the triangles' circumradius [m].
    """
    x = np.empty(4)
    for k in range(len(states)):
        b = corners[k]
        put_quaternion(b, x)
        zeta = (b[0, 2] + b[1, 2] + b[2, 2]) / (3.0 * r)
        turned = abs(x[2]) > abs(x[3])
        first, second = (-x[1] if turned else x[0]), (x[0] if turned else x[1])
        x0 = x[2] if turned else x[3]
        # The other of x0 and x3 is rounding.
        length = math.sqrt(x0 * x0 + first * first + second * second)
        scale = -1.0 / length if x0 < 0.0 else 1.0 / length
        states[k, 0], states[k, 1], states[k, 2] = scale * x0, scale * first, scale * second
        states[k, 3] = -zeta if turned else zeta
        half_turned[k] = turned
