"""Values of the revolute, prismatic and ball joints of configurations, in closed form and batched.

A leg's hip turns about its revolute axis, from the leg's direction at the symmetric home; its slide is its length
less that at home. The ball joint of a lower leg turns the rod into the middle platform about the leg's revolute axis
(x), the middle axis (y) and the platform's normal (z), in this order. That of an upper leg turns the middle platform
into the rod, in the order z, y, x. In a machine as built, the hip turns about the leg's own axis, zero and home are
those of the nominal machine, and a slide is the distance of ball and pivot less the length at home, without the offset
of the reading.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, type_and_value, whole_number
from spm_pin.mechanism.ball_triangles import triangle_sides, upper_ball_weights
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_frames import LegFrame, Vector, dot, leg_frames

# Configurations computed together: intermediate arrays stay in the processor's cache.
_BLOCK = 2048


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
        return self._ball(0)

    @property
    def ball_y(self) -> FloatArray:
        """Middle angles of the ball joints [rad] in [-π/2, π/2], shape (..., 2 n)."""
        return self._ball(1)

    @property
    def ball_z(self) -> FloatArray:
        """Third angles of the ball joints [rad] in [-π, π], shape (..., 2 n)."""
        return self._ball(2)

    @property
    def slide(self) -> FloatArray:
        """Leg lengths less those at home [m], shape (..., 6)."""
        return self.values[..., -6:]

    def _ball(self, axis: int) -> FloatArray:
        count = (self.values.shape[-1] - 12) // 3
        return self.values[..., 6 + axis * count : 6 + (axis + 1) * count]


def joint_angles(configuration: Configuration, corners: tuple[int, ...] = (0, 1, 2)) -> JointAngles:
    """Return the joint values of configurations of shape (...).

    Parameters
    ----------
    configuration : Configuration
        One state or a batch, of the nominal machine or of one as built; a state need not be closed.
    corners : tuple of int
        The legs, 0 to 2, whose ball joints are wanted: of each stage these.

    Returns
    -------
    JointAngles
        The values of a member are bit for bit the same in any batch.

    Raises
    ------
    ArgumentError
        If an argument is of another kind.
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
    found, residual = np.empty((size, count)), np.empty(size)
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
            found[block] = rows.T
            residual[block] = functools.reduce(np.maximum, errors)
    return JointAngles(found.reshape(*shape, count), residual.reshape(shape))


Constants = tuple[tuple[LegFrame, ...], tuple[float, ...], list[list[float]]]
Angle = tuple[Any, Any]
"""Multiples of the sine and the cosine of an angle, by one positive factor."""


@functools.lru_cache(maxsize=16)
def _constants(geometry: Geometry) -> Constants:
    """Return the constants of the six legs, and of the middle platform.

    These are its sides b_1 b_2, b_2 b_3 and b_3 b_1, and `upper_ball_weights`.
    """
    balls = geometry.legs.balls
    return leg_frames(geometry), tuple(triangle_sides(balls[:3]).tolist()), upper_ball_weights(balls).tolist()


def _single(state: list[FloatArray], constants: Constants, corners: tuple[int, ...]) -> JointAngles:
    """Return the values of one state, computed in Python's numbers: NumPy takes longer for arrays of one."""
    try:
        angles, slides, errors = _values([a.ravel().tolist() for a in state], constants, corners, math.sqrt)
    except ZeroDivisionError:  # balls in one place or in a line
        return JointAngles(np.full(12 + 6 * len(corners), np.nan), np.array(np.nan))
    return JointAngles(np.concatenate([np.arctan2(*zip(*angles, strict=True)), slides]), np.array(max(errors)))


def _values(
    state: Sequence[Sequence[Any]], constants: Constants, corners: tuple[int, ...], sqrt: Callable[[Any], Any]
) -> tuple[list[Angle], list[Any], list[Any]]:
    """Return joint angles as multiples of (sine, cosine), slides, and closure errors: of numbers, or of arrays (n,).

    The angles are the six hips', then the balls' x, y and z. `state` has the components of R, o and the rows b_i;
    `sqrt` is the root of their kind.
    """
    legs, lengths_of_sides, weights = constants
    r, o, b = state
    rows = [b[0:3], b[3:6], b[6:9]]
    edges = _minus(rows[0], rows[1]), _minus(rows[1], rows[2]), _minus(rows[2], rows[0])
    upper = _upper_balls(rows, edges, weights) if weights else rows
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
    sides = [sqrt(dot(edge, edge)) for edge in edges]
    errors.extend([abs(length - side) for length, side in zip(sides, lengths_of_sides, strict=True)])
    x = _scaled(edges[2], -sides[2])
    y = _minus(edges[1], edges[0])
    shared = dot(x, y)
    y = y[0] - shared * x[0], y[1] - shared * x[1], y[2] - shared * x[2]
    y = _scaled(y, sqrt(dot(y, y)))
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
    rod: Angle, leg: LegFrame, axes: Sequence[Sequence[Any]], sign: float, sqrt: Callable[[Any], Any]
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
