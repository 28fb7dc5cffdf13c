"""Proof that a stage has one state with given leg lengths among boxes of states: subdivision, then Krawczyk's test."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.proofs.stage_region import StageRegion

__all__ = ["has_one_state"]

_ROUNDS = 30
_MOST_BOXES = 20_000
_HALVES = np.array(list(product((0, 1), repeat=3)))


def has_one_state(region: StageRegion, boxes: FloatArray) -> bool:
    """Return whether it is proved that exactly one state has the lengths in the middle of the limits.

    It is the only one among the states in boxes (N, 3, 2) of (x, y, Z), at less than half a turn. False if there is
    none or several, or if the subdivision ends before; errors of the machine are left aside.
    """
    lengths = 0.5 * (region.minimum + region.maximum)
    region = replace(region, minimum=lengths, maximum=lengths, length_error=0.0, angle_error=0.0, margin=0.0)
    for _ in range(_ROUNDS):
        squares, _ = region.evaluate(*_columns(boxes))
        missed = [square.misses(length.square()) for square, length in zip(squares, region.lengths, strict=True)]
        boxes = boxes[~np.any(missed, axis=0)]
        if not 0 < len(boxes) <= _MOST_BOXES:
            return False
        if _krawczyk(region, np.stack([boxes[..., 0].min(axis=0), boxes[..., 1].max(axis=0)], axis=-1)):
            return True
        low, middle, high = boxes[:, None, :, 0], boxes.mean(axis=-1)[:, None], boxes[:, None, :, 1]
        halves = np.stack([np.where(_HALVES, middle, low), np.where(_HALVES, high, middle)], axis=-1)
        boxes = halves.reshape(-1, 3, 2)
    return False


def _columns(boxes: FloatArray) -> list[Interval]:
    return [Interval(boxes[..., i, 0], boxes[..., i, 1]) for i in range(3)]


def _krawczyk(region: StageRegion, box: FloatArray) -> bool:
    """Return whether Krawczyk's operator maps a box (3, 2), widened by a tenth, into its interior."""
    box = box + (0.1 * (box[:, 1] - box[:, 0]) + 1e-12)[:, None] * [-1.0, 1.0]
    unknowns, centre = _columns(box), box.mean(axis=-1)
    if not float((unknowns[0].square() + unknowns[1].square()).high) < 1.0:
        return False
    slopes = _slopes(region, *unknowns)
    middle = np.array([[0.5 * float(slope.low + slope.high) for slope in row] for row in slopes])
    if not np.isfinite(middle).all() or np.linalg.matrix_rank(middle) < 3:
        return False
    inverse = np.linalg.inv(middle)
    squares, _ = region.evaluate(*(Interval.of(value) for value in centre))
    misses = [square - length.square() for square, length in zip(squares, region.lengths, strict=True)]
    for i in range(3):
        image = Interval.of(centre[i])
        for k in range(3):
            image = image - inverse[i, k] * misses[k]
        for j in range(3):
            rest = Interval.of(float(i == j))
            for k in range(3):
                rest = rest - inverse[i, k] * slopes[k][j]
            image = image + rest * (unknowns[j] - Interval.of(centre[j]))
        if not (image.low > box[i, 0] and image.high < box[i, 1]):
            return False
    return True


def _slopes(region: StageRegion, x: Interval, y: Interval, z: Interval) -> list[list[Interval]]:
    """Return enclosures of the derivatives of the three squared lengths with respect to x, y and Z."""
    r = Interval.of(region.side) * SQRT_3.reciprocal()
    x0 = (1.0 - (x.square() + y.square())).root()
    radii, heights = region.corners(x, y, z)
    slopes = []
    # Corner k is at the azimuth (a, b): z_k = Z + 2 r x0 (b x - a y).
    directions = ((0.5 * SQRT_3, -0.5), (Interval.of(0.0), 1.0), (-0.5 * SQRT_3, -0.5))
    outward = (
        (-2.0 * SQRT_3 * y, -4.0 * y - 2.0 * SQRT_3 * x),
        (-6.0 * x, 2.0 * y),
        (2.0 * SQRT_3 * y, -4.0 * y + 2.0 * SQRT_3 * x),
    )
    for (a, b), out, radius, height in zip(directions, outward, radii, heights, strict=True):
        lever = b * x - a * y
        up = b * x0 - x * lever / x0, -(a * x0) - y * lever / x0
        slope = [
            2.0 * (r * ((radius - region.hips) * part + 2.0 * (height * rise)))
            for part, rise in zip(out, up, strict=True)
        ]
        slopes.append([*slope, 2.0 * height])
    return slopes
