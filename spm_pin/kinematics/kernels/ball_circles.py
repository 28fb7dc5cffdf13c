"""Following a stage of an imperfect machine while its dimensions and leg lengths change.

A leg of known length holds its ball on a circle about its revolute axis. Three angles are unknown, and the three
distances between the balls are the equations. A step is taken if the theorem of Newton and Kantorovich holds at its
start, with a margin of four, for the dimensions at its end: there is one solution near, and Newton's method finds it.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from spm_pin.kinematics.kernels.compilation import jit, kernel, readonly_array
from spm_pin.mechanism.arguments import FloatArray

_KANTOROVICH = 0.125
"""Largest product of the inverse's norm, the Lipschitz constant and Newton's first step; the theorem asks for 1/2."""
_SHORTEST = 1e-7
"""A step shorter than this part of the way stands before a singularity."""
_ITERATIONS = 12


@jit
def _put_stage(start: FloatArray, end: FloatArray, part: float, axes: FloatArray, pivots: FloatArray) -> None:
    """Write the axes and the pivots at this part of the way between two stages (3, 3, 3)."""
    for i in range(3):
        square = 0.0
        for j in range(3):
            axes[i, j] = start[0, i, j] + part * (end[0, i, j] - start[0, i, j])
            pivots[i, j] = start[1, i, j] + part * (end[1, i, j] - start[1, i, j])
            square += axes[i, j] * axes[i, j]
        scale = 1.0 / math.sqrt(square)
        for j in range(3):
            axes[i, j] *= scale


@jit
def _put_balls(pivots: FloatArray, radii: FloatArray, towards: FloatArray, balls: FloatArray) -> None:
    for i in range(3):
        for j in range(3):
            balls[i, j] = pivots[i, j] + radii[i] * towards[i, j]


@jit
def _put_step(
    axes: FloatArray,
    radii: FloatArray,
    sides: FloatArray,
    towards: FloatArray,
    balls: FloatArray,
    across: FloatArray,
    step: FloatArray,
) -> float:
    """Write the directions (3, 3) in which the balls can move and Newton's step (3,) [rad].

    The return value is the norm of the inverse, not a number where there is none.
    """
    for i in range(3):
        a, e = axes[i], towards[i]
        across[i, 0] = a[1] * e[2] - a[2] * e[1]
        across[i, 1] = a[2] * e[0] - a[0] * e[2]
        across[i, 2] = a[0] * e[1] - a[1] * e[0]
    # Side k joins the balls k and k + 1: its derivative has two entries, p_k and q_k.
    f0 = f1 = f2 = p0 = p1 = p2 = q0 = q1 = q2 = 0.0
    for j in range(3):
        g0, g1, g2 = balls[0, j] - balls[1, j], balls[1, j] - balls[2, j], balls[2, j] - balls[0, j]
        f0, f1, f2 = f0 + g0 * g0, f1 + g1 * g1, f2 + g2 * g2
        p0, p1, p2 = p0 + g0 * across[0, j], p1 + g1 * across[1, j], p2 + g2 * across[2, j]
        q0, q1, q2 = q0 - g0 * across[1, j], q1 - g1 * across[2, j], q2 - g2 * across[0, j]
    f0, f1, f2 = f0 - sides[0] * sides[0], f1 - sides[1] * sides[1], f2 - sides[2] * sides[2]
    p0, p1, p2 = 2.0 * radii[0] * p0, 2.0 * radii[1] * p1, 2.0 * radii[2] * p2
    q0, q1, q2 = 2.0 * radii[1] * q0, 2.0 * radii[2] * q1, 2.0 * radii[0] * q2
    # The rows of the derivative are (p0, q0, 0), (0, p1, q1), (q2, 0, p2).
    determinant = p0 * p1 * p2 + q0 * q1 * q2
    if determinant == 0.0:
        return np.nan
    scale = 1.0 / determinant
    step[0] = scale * (p1 * p2 * f0 - q0 * p2 * f1 + q0 * q1 * f2)
    step[1] = scale * (q1 * q2 * f0 + p0 * p2 * f1 - p0 * q1 * f2)
    step[2] = scale * (-p1 * q2 * f0 + q0 * q2 * f1 + p0 * p1 * f2)
    norm0 = abs(p1 * p2) + abs(q0 * p2) + abs(q0 * q1)
    norm1 = abs(q1 * q2) + abs(p0 * p2) + abs(p0 * q1)
    norm2 = abs(p1 * q2) + abs(q0 * q2) + abs(p0 * p1)
    return float(abs(scale) * max(norm0, norm1, norm2))


@jit
def _lipschitz(pivots: FloatArray, radii: FloatArray) -> float:
    """Return a bound of the change of the derivative's rows per radian, in the norm of the largest angle."""
    largest = 0.0
    for k in range(3):
        m = (k + 1) % 3
        square = 0.0
        for j in range(3):
            square += (pivots[k, j] - pivots[m, j]) ** 2
        bound = 2.0 * (math.sqrt(square) * (radii[k] + radii[m]) + 4.0 * radii[k] * radii[m])
        largest = max(largest, bound)
    return largest


@jit
def _turn(towards: FloatArray, across: FloatArray, step: FloatArray) -> None:
    """Turn the directions (3, 3) by the angles -`step`."""
    for i in range(3):
        c, s = math.cos(step[i]), math.sin(step[i])
        square = 0.0
        for j in range(3):
            towards[i, j] = c * towards[i, j] - s * across[i, j]
            square += towards[i, j] * towards[i, j]
        scale = 1.0 / math.sqrt(square)
        for j in range(3):
            towards[i, j] *= scale


@kernel(
    f"void({readonly_array(3)}, {readonly_array(2)}, {readonly_array(2)}, {readonly_array(3)}, {readonly_array(3)}, "
    f"{readonly_array(1)}, {readonly_array(1)}, f8[:,:,::1], b1[::1])"
)
def follow_circles(
    seeds: FloatArray,
    start_lengths: FloatArray,
    end_lengths: FloatArray,
    start: FloatArray,
    end: FloatArray,
    start_sides: FloatArray,
    end_sides: FloatArray,
    balls: FloatArray,
    arrived: npt.NDArray[np.bool_],
) -> None:
    """Follow N states of a stage from one machine and its leg lengths to another, all changing in proportion.

    Parameters
    ----------
    seeds : ndarray, shape (N, 3, 3)
        Ball centres at the start.
    start_lengths, end_lengths : ndarray, shape (N, 3)
        Lengths of the legs.
    start, end : ndarray, shape (2, 3, 3)
        Axes and pivots of the legs.
    start_sides, end_sides : ndarray, shape (3,)
        Distances of balls 1 and 2, 2 and 3, 3 and 1.
    balls : ndarray, shape (N, 3, 3), written
        Ball centres at the end, NaN where the path meets a singularity before.
    arrived : ndarray of bool, shape (N,), written
        Whether it does not.
    """
    axes, pivots, radii, sides = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    towards, across, trial, step = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for n in range(len(balls)):
        balls[n] = seeds[n]
        arrived[n] = False
        done, length = 0.0, 1.0
        while done < 1.0 and length >= _SHORTEST:
            target = min(done + length, 1.0)
            _put_stage(start, end, target, axes, pivots)
            for i in range(3):
                radii[i] = start_lengths[n, i] + target * (end_lengths[n, i] - start_lengths[n, i])
                sides[i] = start_sides[i] + target * (end_sides[i] - start_sides[i])
                along = 0.0
                for j in range(3):
                    along += axes[i, j] * (balls[n, i, j] - pivots[i, j])
                square = 0.0
                for j in range(3):
                    towards[i, j] = balls[n, i, j] - pivots[i, j] - along * axes[i, j]
                    square += towards[i, j] * towards[i, j]
                scale = 1.0 / math.sqrt(square) if square > 0.0 else np.nan
                for j in range(3):
                    towards[i, j] *= scale
            _put_balls(pivots, radii, towards, trial)
            norm = _put_step(axes, radii, sides, towards, trial, across, step)
            size = max(abs(step[0]), abs(step[1]), abs(step[2]))
            if not norm * _lipschitz(pivots, radii) * size <= _KANTOROVICH:
                length *= 0.5
                continue
            for _ in range(_ITERATIONS):
                _turn(towards, across, step)
                _put_balls(pivots, radii, towards, trial)
                if size < 1e-15:
                    break
                last = size
                _put_step(axes, radii, sides, towards, trial, across, step)
                size = max(abs(step[0]), abs(step[1]), abs(step[2]))
                if size < 1e-10 and size >= 0.5 * last:
                    break
            balls[n] = trial
            done = target
            length *= 2.0
        arrived[n] = done >= 1.0
        if not arrived[n]:
            balls[n] = np.nan
