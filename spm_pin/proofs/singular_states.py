"""Search for a forward singular state of a stage within limits of its leg lengths, in double precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spm_pin.kinematics.intervals import Interval
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.proofs.stage_region import StageRegion

STARTS = 2_000
STEPS = 60


def singular_state(region: StageRegion, boxes: FloatArray) -> FloatArray | None:
    """Find a state (x, y, Z) with D = 0 and all leg lengths within the limits, from the centres of boxes (N, 3, 2).

    Newton's method towards D = 0 along its gradient, started in up to 2,000 boxes. Of the states found within the
    limits the one that is farthest inside is returned; None if there is none, which proves nothing.
    """
    if not len(boxes):
        return None
    region = replace(region, length_error=0.0, angle_error=0.0)
    chosen = boxes[np.linspace(0, len(boxes) - 1, min(len(boxes), STARTS)).astype(np.intp)]
    states = chosen.mean(axis=-1)
    states = states[(states[:, :2] ** 2).sum(axis=1) < 1.0]
    for _ in range(STEPS):
        value, gradient = _determinant(region, states)
        slope = (gradient**2).sum(axis=1)
        step = np.where(slope > 0.0, value / np.where(slope > 0.0, slope, 1.0), 0.0)[:, None] * gradient
        size = np.linalg.norm(step, axis=1, keepdims=True)
        states = states - step * np.minimum(1.0, 0.1 / np.maximum(size, 0.1))
        tilt = np.sqrt((states[:, :2] ** 2).sum(axis=1, keepdims=True))
        states[:, :2] /= np.maximum(1.0, tilt / 0.999)
    value, gradient = _determinant(region, states)
    arrived = np.abs(value) <= 1e-12 * np.linalg.norm(gradient, axis=1)
    lengths = np.sqrt(_evaluate(region, states)[0])
    inside = np.minimum(lengths - region.minimum, region.maximum - lengths).min(axis=1)
    inside[~arrived] = -np.inf
    best = int(np.argmax(inside)) if len(inside) else 0
    return states[best] if len(inside) and inside[best] >= 0.0 else None


def _evaluate(region: StageRegion, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the squared leg lengths (N, 3) and D (N,)."""
    squares, determinant = region.evaluate(*map(Interval.of, states.T))
    *lengths, value = (0.5 * (x.low + x.high) for x in (*squares, determinant))
    return np.stack(lengths, axis=1), value


def _determinant(region: StageRegion, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return D (N,) and its gradient (N, 3) by central differences."""
    ends = ((_evaluate(region, states + h)[1], _evaluate(region, states - h)[1]) for h in 1e-6 * np.eye(3))
    return _evaluate(region, states)[1], np.stack([(after - before) / 2e-6 for after, before in ends], axis=1)
