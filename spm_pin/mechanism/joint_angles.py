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
from spm_pin.mechanism.as_built import AsBuiltGeometry
from spm_pin.mechanism.configuration import Configuration, check_configuration, triangle_sides
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_frames import LegFrame, leg_frames

__all__ = ["JointAngles", "joint_angles"]

# Configurations computed together: intermediate arrays stay in the processor's cache.
_BLOCK = 2048


@dataclass(frozen=True)
class JointAngles:
    """Joint values of configurations; NaN where one does not exist.

    Attributes
    ----------
    values : ndarray, shape (..., 12 + 6 n)
        The six hips, the balls' angles about x, y and z of the n lower and then of the n upper legs of `corners`, and
        the six slides.
    closure_residual : ndarray, shape (...)
        `Configuration.closure_residual` [m].
    """

    values: FloatArray
    closure_residual: FloatArray

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
        One state or a batch, of the ideal machine or of one as built; a state need not be closed.
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
    check_configuration(configuration, as_built=True)
    if not isinstance(corners, tuple | list):
        raise ArgumentError("corners", "a tuple of legs, 0 to 2", type_and_value(corners))
    corners = tuple(whole_number(corner, "corners", "legs, 0 to 2", most=2) for corner in corners)
    shape, count = configuration.shape, 12 + 6 * len(corners)
    constants = _constants(configuration.geometry)
    state = [configuration.rotation, configuration.translation, configuration.middle_joints]
    if isinstance(configuration.geometry, AsBuiltGeometry):
        state.append(configuration.balls[..., 3:, :])
    if not shape:
        return _single(state, constants, corners)
    arrays = [a.reshape(-1, n) for a, n in zip(state, (9, 3, 9, 9), strict=False)]
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


Constants = tuple[tuple[LegFrame, ...], tuple[float, ...]]
Pair = tuple[Any, Any]


@functools.lru_cache(maxsize=16)
def _constants(geometry: Geometry | AsBuiltGeometry) -> Constants:
    """Return the constants of the six legs, and the sides b_1 b_2, b_2 b_3 and b_3 b_1 of the middle platform."""
    if isinstance(geometry, AsBuiltGeometry):
        return leg_frames(geometry), tuple(triangle_sides(geometry.balls[:3]).tolist())
    return leg_frames(geometry), (float(geometry.middle_side),) * 3


def _single(state: list[FloatArray], constants: Constants, corners: tuple[int, ...]) -> JointAngles:
    """Return the values of one state, computed in Python's numbers: NumPy takes longer for arrays of one."""
    try:
        angles, slides, errors = _values([a.ravel().tolist() for a in state], constants, corners, math.sqrt)
    except ZeroDivisionError:  # balls in one place or in a line
        return JointAngles(np.full(12 + 6 * len(corners), np.nan), np.array(np.nan))
    sines, cosines = np.array(angles).T
    return JointAngles(np.concatenate([np.arctan2(sines, cosines), slides]), np.array(max(errors)))


def _values(
    state: Sequence[Sequence[Any]], constants: Constants, corners: tuple[int, ...], sqrt: Callable[[Any], Any]
) -> tuple[list[Pair], list[Any], list[Any]]:
    """Return joint angles as multiples of (sine, cosine), slides, and closure errors: of numbers, or of arrays (n,).

    The angles are the six hips', then the balls' x, y and z. `state` has the components of R, o, the rows b_i and,
    where they differ from these, of the upper legs' balls; `sqrt` is the root of their kind.
    """
    legs, lengths_of_sides = constants
    r, o, b = state[:3]
    rows = [b[0:3], b[3:6], b[6:9]]
    upper = [state[3][k : k + 3] for k in (0, 3, 6)] if len(state) > 3 else rows
    balls = [*rows, *(_turned_back(r, [p[k] - o[k] for k in range(3)]) for p in upper)]
    hips: list[Pair] = []
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
    edges = [[p[k] - q[k] for k in range(3)] for p, q in zip(rows, [rows[1], rows[2], rows[0]], strict=True)]
    sides = [sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) for v in edges]
    errors.extend(abs(length - side) for length, side in zip(sides, lengths_of_sides, strict=True))
    x = [-component / sides[2] for component in edges[2]]
    y = [edges[1][k] - edges[0][k] for k in range(3)]
    shared = x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
    y = [y[k] - shared * x[k] for k in range(3)]
    length = sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    y = [component / length for component in y]
    z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
    from_base, from_top = (x, y, z), tuple(_turned_back(r, axis) for axis in (x, y, z))

    turns = []
    for stage, (axes, sign) in enumerate(((from_base, 1.0), (from_top, -1.0))):
        for corner in corners:
            place = 3 * stage + corner
            rod = _direction(*hips[place], lengths[place])
            turns.append(_ball_angles(rod, legs[place], axes, sign, sqrt))
    return [*hips, *(turn[k] for k in range(3) for turn in turns)], slides, errors


def _turned_back(r: Sequence[Any], v: Sequence[Any]) -> list[Any]:
    """Return Rᵀ v."""
    return [r[k] * v[0] + r[3 + k] * v[1] + r[6 + k] * v[2] for k in range(3)]


def _direction(sine: Any, cosine: Any, length: Any) -> Pair:
    """Return sine and cosine over their length, (0, 1) where that is zero."""
    zero = length == 0.0
    return sine / (length + zero), (cosine + zero) / (length + zero)


def _ball_angles(
    rod: Pair, leg: LegFrame, axes: Sequence[Sequence[Any]], sign: float, sqrt: Callable[[Any], Any]
) -> tuple[Pair, Pair, Pair]:
    """Return the angles of the rotation Rx Ry Rz from the rod to the middle platform, times `sign`.

    `axes` are those of the lower balls' triangle, seen from the platform that the leg stands on; `rod` has sine and
    cosine of the hip. For an upper leg the rotation goes from the platform to the rod: its transpose has the angles
    negated.
    """
    # The axes of the middle platform's corner in the leg's frame, then turned back by the hip about x.
    along, across, up = leg.corner(*axes)
    sine, cosine = rod
    second = [cosine * a + sine * u for a, u in zip(across, up, strict=True)]
    third = [cosine * u - sine * a for a, u in zip(across, up, strict=True)]
    level = sqrt(second[2] * second[2] + third[2] * third[2])
    sine, cosine = _direction(-second[2], third[2], level)
    # The last from what the first leaves over, hence exact where the first is not determined.
    left = [cosine * second[k] + sine * third[k] for k in range(2)]
    return (sign * sine, cosine), (sign * along, level), (sign * left[0], left[1])
