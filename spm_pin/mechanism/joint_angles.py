"""Values of the revolute, prismatic and ball joints of configurations, and the frames and home they are measured from.

A leg's frame stands at its pivot, x along the revolute axis, z as near to the normal of {B} or {m} as that allows. The
frame at a ball is turned in {n} as the drawn machine's leg frames are in {B}: x along the middle platform's tangent, z
along its normal. A leg's hip turns about its revolute axis, from the leg's direction at the symmetric home; its slide
is its length less that at home. The ball joint of a lower leg turns the rod into the middle platform about the leg's
revolute axis (x), the middle axis (y) and the platform's normal (z), in this order. That of an upper leg turns the
middle platform into the rod, in the order z, y, x. The home of a machine as built is that of the drawn one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, type_and_value, whole_number
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.legs import axis_directions, triangle_frames, triangle_sides, upper_ball_weights
from spm_pin.mechanism.pose import homogeneous

Vector = tuple[Any, Any, Any]
"""Three numbers, or arrays of equal shape."""
Angle = tuple[Any, Any]
"""Multiples of the sine and the cosine of an angle, by one positive factor."""

_OUTWARD = (1.0, -1.0, -1.0)
"""Signs that turn a leg outwards about its revolute axis."""
# Configurations computed together: intermediate arrays stay in the processor's cache.
_BLOCK = 2048


def home_lengths(geometry: Geometry) -> tuple[float, float]:
    """Return the leg length at home of the lower and of the upper stage [m].

    It is the middle of the limits that the stage's three legs share, if it is longer than the radial distance from hip
    to ball. Otherwise, and without limits, it is the shortest length allowed plus that of legs whose stage is as high
    as the sum of its two radii.
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
    """Return the angle of each leg at home about its revolute axis, from z of {B} or {m} to its direction [rad]."""
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
    return homogeneous(np.stack(axis_directions(), axis=-1), geometry.legs.balls)


class _LegFrame(NamedTuple):
    """Constants of a leg."""

    lean_cos: float  # of the leg's direction at home
    lean_sin: float
    length: float  # at home [m]
    rows: tuple[Vector, ...]  # axes of the frame, in {B} or {m}
    shifts: Vector  # the pivot, in these axes [m]
    columns: tuple[Vector, ...]  # axes of the frame at the ball, in those of the lower balls' triangle

    def place(self, p: Sequence[Any]) -> Vector:
        """Return the coordinates of a point of {B} or {m} in the leg's frame."""
        (x, y, z), (a, b, c) = self.rows, self.shifts
        return _dot(x, p) - a, _dot(y, p) - b, _dot(z, p) - c

    def corner(self, x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]) -> tuple[Any, Vector, Vector]:
        """Return the axes of the frame at the ball, seen from the leg's frame, from those of the lower balls' triangle.

        Of the last one the component along the revolute axis; the second components and the third ones of all three.
        """
        first, second, last = (_weighted(column, x, y, z) for column in self.columns)
        _, across, up = self.rows
        return (
            _dot(self.rows[0], last),
            (_dot(across, first), _dot(across, second), _dot(across, last)),
            (_dot(up, first), _dot(up, second), _dot(up, last)),
        )


class _Constants(NamedTuple):
    legs: tuple[_LegFrame, ...]
    sides: tuple[float, ...]  # b_1 b_2, b_2 b_3 and b_3 b_1
    weights: list[list[float]]  # see `upper_ball_weights`


@functools.lru_cache(maxsize=16)
def _constants(geometry: Geometry) -> _Constants:
    balls = geometry.legs.balls
    homes = [
        (math.cos(lean), math.sin(lean), float(length))
        for lean, length in zip(home_leans(geometry), np.repeat(home_lengths(geometry), 3), strict=True)
    ]
    turns = np.swapaxes(leg_placements(geometry)[:, :3, :3], -1, -2)
    shifts = (turns @ geometry.legs.pivots[..., None])[..., 0]
    columns = np.swapaxes(triangle_frames(balls[:3]).T @ ball_placements(geometry)[:, :3, :3], -1, -2)
    legs = tuple(
        _LegFrame(*home, tuple(map(tuple, rows.tolist())), tuple(shift), tuple(map(tuple, corner.tolist())))
        for home, rows, shift, corner in zip(homes, turns, shifts.tolist(), columns, strict=True)
    )
    return _Constants(legs, tuple(triangle_sides(balls[:3]).tolist()), upper_ball_weights(balls).tolist())


@dataclass(frozen=True)
class JointAngles:
    """Joint values of configurations; NaN where one does not exist."""

    values: FloatArray
    """Six hips; the balls' angles about x, y and z, of n lower and then n upper legs; six slides; (..., 12 + 6 n)."""
    closure_residual: FloatArray
    """`Configuration.closure_residual` [m], shape (...)."""

    @property
    def hip(self) -> FloatArray:
        """Angles of the revolute joints [rad] in [-π, π], in the order of `LEGS`, shape (..., 6)."""
        return self.values[..., :6]

    @property
    def ball_x(self) -> FloatArray:
        """First angles of the ball joints [rad] in [-π, π], shape (..., 2 n)."""
        return self._balls[..., 0, :]

    @property
    def ball_y(self) -> FloatArray:
        """Middle angles of the ball joints [rad] in [-π/2, π/2], shape (..., 2 n)."""
        return self._balls[..., 1, :]

    @property
    def ball_z(self) -> FloatArray:
        """Third angles of the ball joints [rad] in [-π, π], shape (..., 2 n)."""
        return self._balls[..., 2, :]

    @property
    def slide(self) -> FloatArray:
        """Leg lengths less those at home [m], shape (..., 6)."""
        return self.values[..., -6:]

    @property
    def _balls(self) -> FloatArray:
        return self.values[..., 6:-6].reshape(*self.values.shape[:-1], 3, (self.values.shape[-1] - 12) // 3)


def joint_angles(configuration: Configuration, corners: tuple[int, ...] = (0, 1, 2)) -> JointAngles:
    """Return the joint values of configurations of shape (...), closed or not.

    The ball joints are those of the legs `corners`, 0 to 2, of each stage. The values of a member are bit for bit the
    same in any batch.
    """
    check_configuration(configuration)
    if not isinstance(corners, tuple | list):
        raise ArgumentError("corners", "a tuple of legs, 0 to 2", type_and_value(corners))
    corners = tuple(whole_number(corner, "corners", "legs, 0 to 2", most=2) for corner in corners)
    shape, count = configuration.shape, 12 + 6 * len(corners)
    constants = _constants(configuration.geometry)
    state = [configuration.rotation, configuration.translation, configuration.middle_joints]
    if not shape:
        return _single(state, constants, corners)
    arrays = [a.reshape(-1, n) for a, n in zip(state, (9, 3, 9), strict=True)]
    size = len(arrays[0])
    values, residual = np.empty((size, count)), np.empty(size)
    rows = np.empty((count, min(size, _BLOCK)))
    with np.errstate(invalid="ignore", divide="ignore"):
        for begin in range(0, size, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            # Components first: each operation runs along the configurations of a block.
            parts = [list(np.ascontiguousarray(a[block].T)) for a in arrays]
            angles, slides, errors = _values(parts, constants, corners, np.sqrt)
            rows = rows[:, : len(parts[0][0])]
            for row, (sine, cosine) in zip(rows, angles, strict=False):
                np.arctan2(sine, cosine, out=row)
            rows[-6:] = slides
            values[block] = rows.T
            residual[block] = functools.reduce(np.maximum, errors)
    return JointAngles(values.reshape(*shape, count), residual.reshape(shape))


def _single(state: list[FloatArray], constants: _Constants, corners: tuple[int, ...]) -> JointAngles:
    """Return the values of one state, computed in Python's numbers: NumPy takes longer for arrays of one."""
    try:
        angles, slides, errors = _values([a.ravel().tolist() for a in state], constants, corners, math.sqrt)
    except ZeroDivisionError:  # balls in one place or in a line
        return JointAngles(np.full(12 + 6 * len(corners), np.nan), np.array(np.nan))
    return JointAngles(np.concatenate([np.arctan2(*zip(*angles, strict=True)), slides]), np.array(max(errors)))


def _values(
    state: Sequence[Sequence[Any]], constants: _Constants, corners: tuple[int, ...], sqrt: Callable[[Any], Any]
) -> tuple[list[Angle], list[Any], list[Any]]:
    """Return joint angles as multiples of (sine, cosine), slides, and closure errors: of numbers, or of arrays (n,).

    The angles are the six hips', then the balls' x, y and z. `state` has the components of R, o and the rows b_i;
    `sqrt` is the root of their kind.
    """
    legs, lengths_of_sides, weights = constants
    r, o, b = state
    rows = [b[0:3], b[3:6], b[6:9]]
    edges = _minus(rows[0], rows[1]), _minus(rows[1], rows[2]), _minus(rows[2], rows[0])
    upper = _upper_balls(rows, edges, weights)
    balls = [*rows, *[_turned_back(r, _minus(p, o)) for p in upper]]
    hips: list[Angle] = []
    lengths, slides, errors = [], [], []
    for ball, leg in zip(balls, legs, strict=True):
        along, across, up = leg.place(ball)
        # Turned back by the lean at home, the direction's angle is the hip's.
        cosine = leg.lean_cos * up - leg.lean_sin * across
        sine = -leg.lean_sin * up - leg.lean_cos * across
        hips.append((sine, cosine))
        lengths.append(sqrt(cosine * cosine + sine * sine))
        slides.append(lengths[-1] - leg.length)
        errors.append(abs(along))

    # The triangle's axes, as in `Configuration.middle_pose`; then seen from {m}.
    sides = [sqrt(_dot(edge, edge)) for edge in edges]
    errors.extend([abs(length - side) for length, side in zip(sides, lengths_of_sides, strict=True)])
    x = _scaled(edges[2], -sides[2])
    y = _minus(edges[1], edges[0])
    shared = _dot(x, y)
    y = y[0] - shared * x[0], y[1] - shared * x[1], y[2] - shared * x[2]
    y = _scaled(y, sqrt(_dot(y, y)))
    z = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
    from_base, from_top = (x, y, z), (_turned_back(r, x), _turned_back(r, y), _turned_back(r, z))

    turns = []
    for stage, (axes, sign) in enumerate(((from_base, 1.0), (from_top, -1.0))):
        for corner in corners:
            place = 3 * stage + corner
            rod = _direction(*hips[place], lengths[place])
            turns.append(_ball_angles(rod, legs[place], axes, sign, sqrt))
    return [*hips, *(turn[k] for k in range(3) for turn in turns)], slides, errors


# Written out: a loop over three numbers takes longer than the numbers.
def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _weighted(weights: Sequence[float], x: Sequence[Any], y: Sequence[Any], z: Sequence[Any]) -> Vector:
    a, b, c = weights
    return a * x[0] + b * y[0] + c * z[0], a * x[1] + b * y[1] + c * z[1], a * x[2] + b * y[2] + c * z[2]


def _minus(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(v: Sequence[Any], divisor: Any) -> Vector:
    return v[0] / divisor, v[1] / divisor, v[2] / divisor


def _upper_balls(
    rows: Sequence[Sequence[Any]], edges: Sequence[Sequence[Any]], weights: list[list[float]]
) -> list[Sequence[Any]]:
    """Return the upper legs' balls, from the lower ones and their edges b_2 b_1, b_3 b_2, b_1 b_3."""
    if not any(map(any, weights)):
        return list(rows)
    # b_2 - b_1 negated, and b_3 - b_1.
    p, q = edges[0], edges[2]
    across = p[2] * q[1] - p[1] * q[2], p[0] * q[2] - p[2] * q[0], p[1] * q[0] - p[0] * q[1]
    return [
        [row[k] - u * p[k] + v * q[k] + w * across[k] for k in range(3)]
        for row, (u, v, w) in zip(rows, weights, strict=True)
    ]


def _turned_back(r: Sequence[Any], v: Sequence[Any]) -> Vector:
    """Return Rᵀ v."""
    a, b, c = v
    return r[0] * a + r[3] * b + r[6] * c, r[1] * a + r[4] * b + r[7] * c, r[2] * a + r[5] * b + r[8] * c


def _direction(sine: Any, cosine: Any, length: Any) -> Angle:
    """Return sine and cosine over their length, (0, 1) where that is zero."""
    zero = length == 0.0
    return sine / (length + zero), (cosine + zero) / (length + zero)


def _ball_angles(
    rod: Angle, leg: _LegFrame, axes: Sequence[Sequence[Any]], sign: float, sqrt: Callable[[Any], Any]
) -> tuple[Angle, Angle, Angle]:
    """Return the angles of the rotation Rx Ry Rz from the rod to the middle platform, times `sign`.

    `axes` are those of the lower balls' triangle, seen from the platform that the leg stands on; `rod` has sine and
    cosine of the hip. For an upper leg the rotation goes from the platform to the rod: its transpose has the angles
    negated.
    """
    # The axes of the middle platform's corner in the leg's frame, then turned back by the hip about x.
    along, across, up = leg.corner(*axes)
    s, c = rod
    (y_x, z_x), (y_y, z_y), (y_z, z_z) = [(c * a + s * u, c * u - s * a) for a, u in zip(across, up, strict=True)]
    level = sqrt(y_z * y_z + z_z * z_z)
    sine, cosine = _direction(-y_z, z_z, level)
    # The last from what the first leaves over, hence exact where the first is not determined.
    last = sign * (cosine * y_x + sine * z_x), cosine * y_y + sine * z_y
    return (sign * sine, cosine), (sign * along, level), last
