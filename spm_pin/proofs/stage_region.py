"""States of one 3RPS stage between limits of its leg lengths: lengths and determinant over boxes of states.

A state in mode T is the vector part (x, y) of the middle platform's quaternion (x0, x, y, 0), x0 = √(1 - x² - y²), and
the height Z of its centre. With r = d/√3, corner k has the radius ρ_k and the height z_k,

    ρ_1, ρ_3 = r (1 - 2y² ∓ 2√3 xy),   z_1, z_3 = Z - r x0 (x ± √3 y),
    ρ_2 = r (1 - 3x² + y²),             z_2 = Z + 2 r x0 x,

leg k the length √((ρ_k - ρ)² + z_k²), where ρ is E or C, and the stage is forward singular where

    D = m12 m23 m31 + m21 m32 m13 = 0,   m_ij = z_i (ρ + ρ_j / 2) + z_j (ρ_i - ρ).

In a machine with errors the quaternion has a small fourth component x3, and each of these numbers differs by what is
bounded over all machines. Derivation: `docs/theory/proofs.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.formulas.stages import pair_determinant
from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.mechanism import Configuration, Geometry
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branch_of_state import stage_coordinates

_MIRROR = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
"""The upper stage is the same upside down, mirrored at the terminal platform."""

_UP = 1.0 + 1e-12
"""Covers the rounding of a bound of errors, a few operations."""


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds of the changes that errors of a machine make in one stage, see `docs/theory/proofs.md`."""

    length: Interval
    """A coordinate of a pivot, or a reading [m]."""
    pivot: Interval
    """A pivot in a horizontal direction [m]."""
    leaning: Interval
    """A ball's distance from the nominal plane of its leg that goes through its pivot [m]."""
    sideways: Interval
    """√3/2 times a ball's distance from the nominal plane of its leg through the centre [m]."""
    radius: Interval
    """A ball's radius without torsion [m]."""
    height: Interval
    """A ball's height without torsion [m]."""
    factor: Interval
    """m_ij, by the direction of the axis [m²]."""
    torsion: FloatArray
    """|x0 x3|."""


@dataclass(frozen=True)
class StageRegion:
    """The states of a stage that are searched, those of one machine or of all within errors.

    Of N stages at once, whose boxes are then N, it has arrays (N,) for numbers, and (3, N) for the lengths.
    """

    leg_base_radius: float | FloatArray
    """Distance of the legs' revolute joints from the axis: E or C [m]."""
    side: float | FloatArray
    """Side of the middle platform's triangle [m]."""
    minimum: FloatArray
    """Least leg lengths as they are read [m], shape (3,)."""
    maximum: FloatArray
    """Largest leg lengths as they are read [m], shape (3,)."""
    length_error: float = 0.0
    """Largest error of each coordinate of a pivot and of a ball, and of a reading [m]."""
    angle_error: float = 0.0
    """Largest turn of a revolute axis about either direction perpendicular to it [rad]."""
    margin: float | FloatArray = 0.0
    """By how much a length may be outside its limits, by rounding [m]."""

    @cached_property
    def lengths(self) -> list[Interval]:
        """Distances from pivot to ball of legs whose readings are within the limits [m]."""
        all_legs = Interval(self.minimum - self.margin, self.maximum + self.margin)
        if self.length_error:
            all_legs = all_legs + self.error_bounds.length
        ends = zip(np.maximum(all_legs.low, 0.0), all_legs.high, strict=True)
        return [Interval(np.asarray(low), np.asarray(high)) for low, high in ends]

    @cached_property
    def longest(self) -> FloatArray:
        """Bound of the distance from pivot to ball [m]."""
        return np.asarray((self.maximum.max(axis=0) + self.margin + self.length_error) * _UP)

    @property
    def height(self) -> FloatArray:
        """Bound of |Z| [m]: the mean of the z_k is Z but for errors of the balls, and none exceeds its leg."""
        return np.asarray((self.longest + 3.0 * self.length_error) * _UP)

    @cached_property
    def error_bounds(self) -> ErrorBounds:
        """Bounds of all that the errors change."""
        pivot, ball = np.sqrt([2.0, 3.0]) * self.length_error * _UP
        leaning = np.sqrt(2.0) * self.angle_error * self.longest * _UP
        corner = (leaning + pivot + ball) * _UP
        return ErrorBounds(
            length=Interval.within(self.length_error),
            pivot=Interval.within(pivot),
            leaning=Interval.within(leaning),
            sideways=Interval.within(np.sqrt(0.75) * (leaning + pivot) * _UP),
            radius=Interval.within((np.sqrt(4.0 / 3.0) * corner + ball) * _UP),
            height=Interval.within(ball),
            factor=Interval.within(leaning * (self.side + 2.0 * ball) * _UP),
            torsion=np.asarray(np.sqrt(0.75) * corner / self.side * _UP),
        )

    def corners(self, x: Interval, y: Interval, z: Interval) -> tuple[list[Interval], list[Interval]]:
        """Return radii and heights of the balls [m] in states with |x3| <= x0."""
        r = Interval.from_numbers(self.side) * SQRT_3.reciprocal()
        x_2, y_2 = x.square(), y.square()
        mixed = 2.0 * SQRT_3 * (x * y)
        remainder = 1.0 - (x_2 + y_2)
        # x0² + x3² is the remainder, of which x3² is at most half, and |x0 x3| is bounded.
        most = 2.0 * self.error_bounds.torsion**2 * _UP / np.maximum(remainder.low, 1e-300)
        twist = Interval(np.zeros_like(most), np.clip(most, 0.0, np.maximum(0.5 * remainder.high, 0.0)))
        common = 1.0 - 2.0 * twist
        radii = [common - 2.0 * y_2 - mixed, common - 3.0 * x_2 + y_2, common - 2.0 * y_2 + mixed]
        lever, turned = r * (remainder - twist).root(), r * Interval.within(twist.root().high)
        cross = SQRT_3 * y
        heights = [
            z - lever * (x + cross) + turned * (SQRT_3 * x - y),
            z + 2.0 * (lever * x) + 2.0 * (turned * y),
            z - lever * (x - cross) - turned * (SQRT_3 * x + y),
        ]
        return [r * radius + self.error_bounds.radius for radius in radii], [
            h + self.error_bounds.height for h in heights
        ]

    def evaluate(self, x: Interval, y: Interval, z: Interval) -> tuple[list[Interval], Interval]:
        """Return the squares of the distances from pivots to balls [m²] and D [m⁶]."""
        bounds = self.error_bounds
        radii, heights = self.corners(x, y, z)
        base = Interval.from_numbers(self.leg_base_radius) + bounds.pivot
        slopes, rises = [radius - base for radius in radii], [height + bounds.length for height in heights]
        squares = [s.square() + h.square() + bounds.leaning.square() for s, h in zip(slopes, rises, strict=True)]

        def m(i: int, j: int) -> Interval:
            upward = rises[i] * (base + 0.5 * radii[j] + bounds.sideways)
            return upward + (heights[j] + bounds.length) * slopes[i] + bounds.factor

        pairs: Any = m(0, 1), m(1, 2), m(2, 0), m(1, 0), m(2, 1), m(0, 2)
        return squares, pair_determinant(pairs)  # type: ignore[return-value]  # an Interval, as its arguments


def region_coordinates(configuration: Configuration) -> FloatArray:
    """Return the states (x, y, Z [m]) of both stages, shape (..., 2, 3); NaN where there is none in mode T."""
    return _MIRROR * stage_coordinates(configuration)


def configuration_at(geometry: Geometry, states: FloatArray) -> Configuration:
    """Return the configuration of the states (2, 3) of both stages of a drawn machine."""
    r, poses = geometry.middle_radius, []
    for x, y, z in _MIRROR * states:
        rotation = Rotation.from_quat([x, y, 0.0, np.sqrt(max(1.0 - x * x - y * y, 0.0))])
        poses.append(RigidTransform.from_components([-2.0 * r * x * y, r * (y * y - x * x), z], rotation))
    joints = poses[0].apply(r * geometry.radial_directions)
    return Configuration(geometry, poses[0] * poses[1].inv(), joints)
