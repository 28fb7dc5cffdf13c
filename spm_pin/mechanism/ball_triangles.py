"""Triangles of three ball joints: their frames and sides, and the upper legs' balls from the lower ones."""

from __future__ import annotations

import numpy as np

from spm_pin.mechanism.arguments import FloatArray


def triangle_frames(b: FloatArray) -> FloatArray:
    """Return the axes (..., 3, 3) of triangles b_1, b_2, b_3: x along b_3 b_1, y towards b_2, z normal, as columns."""
    x = b[..., 0, :] - b[..., 2, :]
    y = 2.0 * b[..., 1, :] - b[..., 0, :] - b[..., 2, :]
    with np.errstate(invalid="ignore", divide="ignore"):
        x = x / np.linalg.norm(x, axis=-1, keepdims=True)
        y = y - (x * y).sum(axis=-1, keepdims=True) * x
        y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def triangle_sides(b: FloatArray) -> FloatArray:
    """Return the sides b_1 b_2, b_2 b_3 and b_3 b_1 (..., 3) of triangles (..., 3, 3)."""
    return np.asarray(np.sqrt(((b - np.roll(b, -1, axis=-2)) ** 2).sum(axis=-1)))


def upper_ball_weights(balls: FloatArray) -> FloatArray:
    """Return where the last three of six balls (6, 3) are, seen from the first three, as rows (3, 3).

    Coordinates along b_2 - b_1, b_3 - b_1 and their cross product, from the first ball of the same corner; exactly zero
    where the two coincide.
    """
    first, second = balls[1] - balls[0], balls[2] - balls[0]
    basis = np.stack([first, second, np.cross(first, second)], axis=-1)
    return np.asarray(np.linalg.solve(basis, (balls[3:] - balls[:3]).T).T)


def all_balls(balls: FloatArray, lower: FloatArray) -> FloatArray:
    """Return the centres of balls (6, 3) in {B} [m], shape (..., 6, 3), from those of the lower legs (..., 3, 3)."""
    weights = upper_ball_weights(balls)
    sides = lower[..., 1, :] - lower[..., 0, :], lower[..., 2, :] - lower[..., 0, :]
    moved = np.stack([*sides, np.cross(*sides)], axis=-2)
    return np.concatenate([lower, lower + weights @ moved], axis=-2)
