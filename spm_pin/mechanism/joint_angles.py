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
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.formulas import joint_values as formulas
from spm_pin.formulas.leg_constants import AXES, TANGENT_SIGNS, home_length, leg_frame
from spm_pin.formulas.leg_planes import upper_balls
from spm_pin.formulas.operations import ARRAYS, bind
from spm_pin.formulas.vectors import dot, minus, times, transposed
from spm_pin.mechanism.arguments import FloatArray, type_and_value, whole_number
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry, check_rps

JOINTS = (
    *("leg_b1_hip", "leg_b1_slide", "ball_b1_x", "ball_b1_y", "ball_b1_z"),
    *("ball_c1_z", "ball_c1_y", "ball_c1_x", "leg_c1_slide", "leg_c1_hip"),
    *("leg_b2_hip", "leg_b2_slide", "leg_b3_hip", "leg_b3_slide"),
    *("leg_c2_hip", "leg_c2_slide", "leg_c3_hip", "leg_c3_slide"),
)
"""The eighteen joints of the URDF: up the first legs to the terminal platform, then the other lower and upper legs."""
# Configurations computed together: intermediate arrays stay in the processor's cache.
_BLOCK = 2048


def home_lengths(geometry: Geometry) -> tuple[float, float]:
    """Return the leg length at home of the lower and of the upper stage [m].

    It is the middle of the limits that the stage's three legs share, if it is longer than the radial distance from hip
    to ball. Otherwise, and without limits, it is the shortest length allowed plus that of legs whose stage is as high
    as the sum of its two radii.
    """
    limits = geometry.limits
    lengths = []
    for stage, radius in enumerate((geometry.base_radius, geometry.platform_radius)):
        legs = slice(3 * stage, 3 * stage + 3)
        low = max(limits.minimum[legs]) if limits else 0.0
        high = min(limits.maximum[legs]) if limits else math.inf
        lengths.append(float(home_length(radius, geometry.middle_radius, low, high)))
    return lengths[0], lengths[1]


_FORMULAS = upper_balls, formulas.leg_values, formulas.triangle_axes, formulas.ball_angles, leg_frame
# By the names of the formulas, and with the square root of each kind of number.
_ON_NUMBERS, _ON_ARRAYS = (
    SimpleNamespace(sqrt=operations["sqrt"], **{formula.__name__: bind(formula, **operations) for formula in _FORMULAS})
    for operations in ({"sqrt": math.sqrt}, ARRAYS)
)


class _Constants(NamedTuple):
    legs: tuple[formulas.LegFrame, ...]
    sides: tuple[float, ...]  # b_1 b_2, b_2 b_3 and b_3 b_1
    weights: Any  # see `upper_ball_weights`


@functools.lru_cache(maxsize=16)
def _constants(geometry: Geometry) -> _Constants:
    check_rps(geometry, "joint values")
    axes, pivots, balls = map(_tuples, geometry.legs.arrays[:3])
    own_axes, legs = _ON_NUMBERS.triangle_axes(balls[:3]), []
    for leg in range(6):
        radius, up = ((geometry.base_radius, 1.0), (geometry.platform_radius, -1.0))[leg // 3]
        home = home_lengths(geometry)[leg // 3], geometry.middle_radius - radius, TANGENT_SIGNS[leg % 3], up
        legs.append(_ON_NUMBERS.leg_frame(axes[leg], pivots[leg], AXES[leg % 3], own_axes, home))
    weights = geometry.legs.upper_ball_weights
    return _Constants(tuple(legs), tuple(geometry.legs.sides.tolist()), _tuples(weights))


def _tuples(matrix: FloatArray) -> Any:
    return tuple(map(tuple, matrix.tolist()))


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
            parts = [tuple(np.ascontiguousarray(a[block].T)) for a in arrays]
            angles, slides, errors = _values(_rows(parts), constants, corners, _ON_ARRAYS)
            rows = rows[:, : len(parts[1][0])]
            for row, (sine, cosine) in zip(rows, angles, strict=False):
                np.arctan2(sine, cosine, out=row)
            rows[-6:] = slides
            values[block] = rows.T
            residual[block] = functools.reduce(np.maximum, errors)
    return JointAngles(values.reshape(*shape, count), residual.reshape(shape))


def _single(state: list[FloatArray], constants: _Constants, corners: tuple[int, ...]) -> JointAngles:
    """Return the values of one state, computed in Python's numbers: NumPy takes longer for arrays of one."""
    try:
        parts = [tuple(a.ravel().tolist()) for a in state]
        angles, slides, errors = _values(_rows(parts), constants, corners, _ON_NUMBERS)
    except ZeroDivisionError:  # balls in one place or in a line
        return JointAngles(np.full(12 + 6 * len(corners), np.nan), np.array(np.nan))
    return JointAngles(np.concatenate([np.arctan2(*zip(*angles, strict=True)), slides]), np.array(max(errors)))


def _rows(parts: Sequence[Sequence[Any]]) -> Sequence[Any]:
    """Return R, o and the b_i as formulas take them, from their components."""
    rotation, position, b = parts
    return (rotation[:3], rotation[3:6], rotation[6:]), position, (b[:3], b[3:6], b[6:])


def _values(
    state: Sequence[Any], constants: _Constants, corners: tuple[int, ...], run: SimpleNamespace
) -> tuple[list[formulas.Angle], list[Any], list[Any]]:
    """Return joint angles as multiples of (sine, cosine), slides, and closure errors: of numbers, or of arrays (n,).

    The angles are the six hips', then the balls' x, y and z. `state` has R, o and the b_i as formulas take them.
    """
    rotation, position, b = state
    columns = transposed(rotation)
    upper = run.upper_balls(b, constants.weights)
    balls = [*b, *(times(columns, minus(ball, position)) for ball in upper)]
    legs = [run.leg_values(ball, frame) for ball, frame in zip(balls, constants.legs, strict=True)]
    edges = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    errors = [abs(leg.plane_distance) for leg in legs]
    errors += [abs(run.sqrt(dot(edge, edge)) - side) for edge, side in zip(edges, constants.sides, strict=True)]
    axes = run.triangle_axes(b)
    turns = [
        run.ball_angles(legs[k], constants.legs[k], seen, sign)
        for first, seen, sign in ((0, axes, 1.0), (3, tuple(times(columns, x) for x in axes), -1.0))
        for k in (first + corner for corner in corners)
    ]
    angles = [leg.hip for leg in legs] + [turn[k] for k in range(3) for turn in turns]
    return angles, [leg.slide for leg in legs], errors
