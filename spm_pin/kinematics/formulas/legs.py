"""Six general legs between two plates and a middle triangle, of any machine: where they are in {B}.

Axes and pivots of lower legs are in {B}, of upper legs in {m}. A leg's line starts at its pivot, is perpendicular to
its axis, and ends at the centre of a ball of the middle platform.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.kinematics.formulas.vectors import Rows, Vector, combined, cross, minus, times


class StageLegs(NamedTuple):
    """Revolute axes and pivots of the three legs of a stage, in one frame."""

    axes: Rows
    pivots: Rows


def turned(rotation: Rows, rows: Rows) -> Rows:
    """Return R v of three vectors v."""
    return times(rotation, rows[0]), times(rotation, rows[1]), times(rotation, rows[2])


def carried(legs: StageLegs, rotation: Rows, position: Vector) -> StageLegs:
    """Return the legs of a stage in {B}, given in {m}."""
    pivots = turned(rotation, legs.pivots)
    first, second = combined(pivots[0], 1.0, position), combined(pivots[1], 1.0, position)
    return StageLegs(turned(rotation, legs.axes), (first, second, combined(pivots[2], 1.0, position)))


def upper_balls(b: Rows, weights: Rows) -> Rows:
    """Return the upper legs' balls from the lower ones' b_i, by `upper_ball_weights`.

    Each is its own corner's b_i plus multiples of b_2 - b_1, b_3 - b_1 and their cross product; with weights of zero,
    those of the drawn machine, it is b_i exactly.
    """
    p, q = minus(b[1], b[0]), minus(b[2], b[0])
    n = cross(p, q)
    return _beside(b[0], weights[0], p, q, n), _beside(b[1], weights[1], p, q, n), _beside(b[2], weights[2], p, q, n)


def _beside(corner: Vector, weights: Vector, p: Vector, q: Vector, n: Vector) -> Vector:
    return combined(combined(combined(corner, weights[0], p), weights[1], q), weights[2], n)
