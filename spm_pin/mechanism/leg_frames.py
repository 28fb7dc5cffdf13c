"""Frames of the six legs and of the balls, in which joint angles are measured, and the home at which these are zero.

A leg's frame stands at its hip, x along the revolute axis, z as near to the normal of {B} or {m} as that allows. The
frame at a ball of the middle platform is turned in {n} as the nominal machine's leg frames are in {B}: x along the
middle platform's tangent, z along its normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.ball_triangles import triangle_frames
from spm_pin.mechanism.geometry import Geometry, axis_directions
from spm_pin.mechanism.pose import homogeneous

Vector = tuple[Any, Any, Any]
"""Three numbers, or arrays of equal shape."""

# The sign that turns a leg outwards about the revolute axis, in the paper's sense of the axes.
_OUTWARD = (1.0, -1.0, -1.0)


def home_lengths(geometry: Geometry) -> tuple[float, float]:
    """Return the leg length at home of the lower and of the upper stage [m].

    It is the middle of the limits that the stage's three legs share, if the stage can stand there: if it is
    longer than the radial distance from hip to ball. Otherwise, and without limits, it is the shortest length
    allowed plus that of legs whose stage is as high as the sum of its two radii.
    """
    limits = geometry.limits
    r = geometry.middle_radius
    lengths = []
    for stage, radius in enumerate((geometry.base_radius, geometry.platform_radius)):
        legs = slice(3 * stage, 3 * stage + 3)
        low = max(limits.minimum[legs]) if limits else 0.0
        high = min(limits.maximum[legs]) if limits else math.inf
        middle, reach = 0.5 * (low + high), abs(r - radius)
        stands = low < high and reach < middle < math.inf
        lengths.append(middle if stands else low + math.hypot(reach, r + radius))
    return lengths[0], lengths[1]


def home_leans(geometry: Geometry) -> tuple[float, ...]:
    """Return, for each leg in the order of `LEGS`, its direction at home [rad].

    The angle about the leg's revolute axis from the platform's normal, z of {B} or {m}, to the direction from
    hip to ball.
    """
    leans: list[float] = []
    radii = (geometry.base_radius, geometry.platform_radius)
    for radius, length, up in zip(radii, home_lengths(geometry), (1.0, -1.0), strict=True):
        offset = geometry.middle_radius - radius
        height = up * math.sqrt((length - offset) * (length + offset))
        leans.extend(math.atan2(outward * offset, height) for outward in _OUTWARD)
    return tuple(leans)


def leg_placements(geometry: Geometry) -> FloatArray:
    """Return the frames (6, 4, 4) of the legs, the lower in {B}, the upper in {m}."""
    x = geometry.legs.axes
    z = np.array([0.0, 0.0, 1.0]) - x[:, 2:] * x
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return homogeneous(np.stack([x, np.cross(z, x), z], axis=-1), geometry.legs.pivots)


def ball_placements(geometry: Geometry) -> FloatArray:
    """Return the frames (6, 4, 4) at the balls in {n}."""
    return homogeneous(_corner_turns(), geometry.legs.balls)


@dataclass(frozen=True)
class LegFrame:
    """Constants of a leg."""

    lean_cos: float
    """Cosine and sine of the leg's direction at home."""
    lean_sin: float
    length: float
    """Length at home [m]."""
    rows: tuple[tuple[float, ...], ...]
    """Axes of the frame, in {B} or {m}."""
    shifts: tuple[float, ...]
    """The pivot, in these axes [m]."""
    columns: tuple[tuple[float, ...], ...]
    """Axes of the frame at the ball, in those of the lower balls' triangle."""

    def place(self, p: Sequence[Any]) -> Vector:
        """Return the coordinates of a point of {B} or {m} in the leg's frame."""
        (x, y, z), (a, b, c) = self.rows, self.shifts
        return dot(x, p) - a, dot(y, p) - b, dot(z, p) - c

    def corner(self, x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]) -> tuple[Any, Vector, Vector]:
        """Return the axes of the frame at the leg's ball, seen from the leg's frame.

        Of the last one the component along the revolute axis; the second components and the third ones of all three. x,
        y and z are the axes of the lower balls' triangle, see `triangle_frames`, in {B} or {m}.
        """
        p, q, r = self.columns
        across, up = self.rows[1:]
        along = weighted(r, x, y, z)
        first, second = weighted(p, x, y, z), weighted(q, x, y, z)
        return (
            dot(self.rows[0], along),
            (dot(across, first), dot(across, second), dot(across, along)),
            (dot(up, first), dot(up, second), dot(up, along)),
        )


def leg_frames(geometry: Geometry) -> tuple[LegFrame, ...]:
    """Return the constants of the six legs."""
    homes = [
        (math.cos(lean), math.sin(lean), float(length))
        for lean, length in zip(home_leans(geometry), np.repeat(home_lengths(geometry), 3), strict=True)
    ]
    turns = np.swapaxes(leg_placements(geometry)[:, :3, :3], -1, -2)
    shifts = (turns @ geometry.legs.pivots[..., None])[..., 0]
    columns = np.swapaxes(triangle_frames(geometry.legs.balls[:3]).T @ _corner_turns(), -1, -2)
    return tuple(
        LegFrame(*home, _tuples(rows), tuple(shift), _tuples(corner))
        for home, rows, shift, corner in zip(homes, turns, shifts.tolist(), columns, strict=True)
    )


def _tuples(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


def _corner_turns() -> FloatArray:
    """Return the axes of the frames at the balls in {n} as columns, shape (6, 3, 3)."""
    return np.stack(axis_directions(), axis=-1)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Return the inner product of two vectors of numbers, or of arrays."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def weighted(weights: Sequence[float], x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]) -> Vector:
    """Return a combination of three vectors."""
    a, b, c = weights
    return a * x[0] + b * y[0] + c * z[0], a * x[1] + b * y[1] + c * z[1], a * x[2] + b * y[2] + c * z[2]
