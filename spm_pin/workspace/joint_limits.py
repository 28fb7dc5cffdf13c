"""Limits beyond the legs': the passive joints' angles, and the distance between legs.

Angles are those of `spm_pin.mechanism.joint_angles`: of the description's joints, and of the ball joints of every leg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import Configuration, joint_angles
from spm_pin.mechanism.arguments import FloatArray, number_pair, real_number
from spm_pin.mechanism.configuration import check_configuration

_PAIRS = np.array([(i, j) for i in range(6) for j in range(i + 1, 6) if j != i + 3])
"""Pairs of legs that have no joint in common, by their indices in `LEGS`."""
_ANGLES = ("hip", "ball_x", "ball_y", "ball_z")
"""Names of the limits of angles."""

AngleRange = tuple[float, float]
"""Smallest and largest angle [rad]."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of passive joints; None where there is none.

    Parameters
    ----------
    hip : pair of floats, optional
        Smallest and largest angle of the six revolute joints, from the home's direction [rad].
    ball_x, ball_y, ball_z : pairs of floats, optional
        The same of each angle of the six ball joints [rad]: from the leg's rod to the middle platform about the leg's
        revolute axis, then about the middle one, then about the platform's normal.
    clearance : float, optional
        Least distance of the axes of two legs that have no joint in common [m]: the sum of their radii.

    Raises
    ------
    ArgumentError
        If a pair is not two increasing numbers, or `clearance` is negative or not finite.
    """

    hip: AngleRange | None = None
    ball_x: AngleRange | None = None
    ball_y: AngleRange | None = None
    ball_z: AngleRange | None = None
    clearance: float | None = None

    def __post_init__(self) -> None:
        for name in _ANGLES:
            pair = getattr(self, name)
            if pair is None:
                continue
            low, high = number_pair(pair, name, "radians")
            if not low < high:
                cause = "Minimum and maximum exchanged?" if low > high else ""
                raise ArgumentError(name, "a minimum below the maximum, in radians", f"({low:g}, {high:g})", cause)
            object.__setattr__(self, name, (low, high))
        if self.clearance is not None:
            clearance = real_number(self.clearance, "clearance", "a distance in metres, not negative", least=0.0)
            object.__setattr__(self, "clearance", clearance)

    def angle_margin(self, configuration: Configuration) -> FloatArray:
        """Return how far the worst angle is inside its limits, shape (...) [rad].

        Negative outside, infinite without limits, NaN where a state does not exist.
        """
        margin = np.full(check_configuration(configuration).shape, np.inf)
        if any(getattr(self, name) is not None for name in _ANGLES):
            angles = joint_angles(configuration)
            for name in _ANGLES:
                limits, values = getattr(self, name), getattr(angles, name)
                if limits is not None:
                    margin = np.minimum(margin, np.minimum(values - limits[0], limits[1] - values).min(axis=-1))
        return np.where(configuration.exists, margin, np.nan)

    def clearance_margin(self, configuration: Configuration) -> FloatArray:
        """Return by how much the nearest legs are farther apart than they must, shape (...) [m]; as `angle_margin`."""
        if self.clearance is None:
            return np.where(check_configuration(configuration).exists, np.inf, np.nan)
        return leg_clearance(configuration) - self.clearance


def leg_clearance(configuration: Configuration) -> FloatArray:
    """Return the least distance of the axes of two legs that have no joint in common, shape (...) [m].

    An axis is the segment from the revolute joint to the ball joint's centre. Of the fifteen pairs of legs, the three
    that meet at a corner of the middle platform are left out. NaN where a state does not exist.
    """
    check_configuration(configuration)
    starts = np.concatenate([configuration.leg_bases[..., :3, :], configuration.balls[..., 3:, :]], axis=-2)
    along = configuration.leg_vectors
    i, j = _PAIRS.T
    squares = _segment_distance2(starts[..., i, :], along[..., i, :], starts[..., j, :], along[..., j, :])
    return np.asarray(np.sqrt(squares.min(axis=-1)))


def _segment_distance2(p: FloatArray, u: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the squared distance of segments from p to p + u and from q to q + v, arrays (..., 3).

    It is at an end of one of them, or at the lines' common normal if that is within both.
    """

    def dot(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray((a * b).sum(axis=-1))

    def to_segment(point: FloatArray, start: FloatArray, along: FloatArray) -> FloatArray:
        square = dot(along, along)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(square > 0.0, dot(point - start, along) / square, 0.0)
        gap = point - start - np.clip(share, 0.0, 1.0)[..., None] * along
        return dot(gap, gap)

    ends = [to_segment(p, q, v), to_segment(p + u, q, v), to_segment(q, p, u), to_segment(q + v, p, u)]
    least = np.minimum.reduce(ends)
    a, b, c, d, e = dot(u, u), dot(u, v), dot(v, v), dot(u, q - p), dot(v, q - p)
    with np.errstate(invalid="ignore", divide="ignore"):
        determinant = a * c - b * b
        s, t = (c * d - b * e) / determinant, (b * d - a * e) / determinant
        gap = q - p + t[..., None] * v - s[..., None] * u
        between = (determinant > 0.0) & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
        return np.asarray(np.where(between, np.minimum(least, dot(gap, gap)), least))
