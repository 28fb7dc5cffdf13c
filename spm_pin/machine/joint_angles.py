"""Joint values of configurations (revolute, prismatic and ball joints), with the frames and the home that define them.

A leg's frame is at its pivot, x along the revolute axis, z as close to the normal of {B} or {m} as that allows. The
frame at a ball has in {n} the orientation of the nominal machine's leg frames in {B}: x along the middle platform's
tangent, z along its normal. The value of a leg's actuated joint, such as an RPS leg's slide, is its reading minus the
encoder's offset and the reading in the symmetric home; its passive joint turns about the revolute axis, from the
direction of leg or rod in the home. The ball joint of a lower leg turns the rod into the middle platform about the
leg's revolute axis (x), the middle axis (y) and the platform's normal (z), in this order. That of an upper leg turns
the middle platform into the rod, in the order z, y, x. A calibrated machine has the home of the nominal one.

A stage alone is treated as the lower stage of a manipulator, its platform as the middle one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.formulas import joint_values as formulas
from spm_pin.formulas.leg_constants import AXES, TANGENT_SIGNS
from spm_pin.formulas.leg_planes import upper_balls
from spm_pin.formulas.operations import ARRAYS, bind, on_arrays
from spm_pin.formulas.vectors import dot, minus, times, transposed
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.leg_kinds import KINDS, RPS, LegKind
from spm_pin.machine.legs import LEGS
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.support.arguments import FloatArray, frozen, type_and_value, whole_number

# Number of configurations computed together: intermediate arrays then stay in the processor's cache.
_BLOCK = 2048


def leg_joints(machine: Machine | None = None) -> dict[str, tuple[str, str]]:
    """Return the names of each leg's two joints, from its plate to its ball, by the leg's name."""
    names: dict[str, tuple[str, str]] = {}
    for leg, kind in _legs(machine):
        first, second = kind.joints
        names[leg] = f"leg_{leg[2:]}_{first}", f"leg_{leg[2:]}_{second}"
    return names


def _legs(machine: Machine | None) -> list[tuple[str, LegKind]]:
    """Return the names of the legs, with their kinds."""
    if machine is None:
        return [(leg, RPS()) for leg in LEGS]
    legs = check_machine(machine).legs
    return [(leg, legs.kinds[k // 3]) for k, leg in enumerate(legs.names)]


def joint_names(machine: Machine | None = None) -> tuple[str, ...]:
    """Return the joint names of a machine's URDF: eighteen, by default for RPS legs, or nine for a `Stage`.

    First those along the first legs to the moving platform, then those of the other lower and upper legs.
    """
    legs = leg_joints(machine)
    lower, *upper = ((*legs[leg], *(f"ball_{leg[2:]}_{x}" for x in "xyz")) for leg in list(legs)[::3])
    others = (joint for k, joints in enumerate(legs.values()) if k % 3 for joint in joints)
    return *lower, *(joint for chain in upper for joint in chain[::-1]), *others


def actuated_joints(machine: Machine | None = None) -> tuple[str, ...]:
    """Return the names of the joints that the actuators move, in the order of the legs; see `joint_names`."""
    return tuple(f"leg_{leg[2:]}_{kind.actuated}" for leg, kind in _legs(machine))


def value_names(machine: Machine | None = None) -> tuple[str, ...]:
    """Return the names of `JointAngles.values` in their order, for the balls of the first legs."""
    passive = [f"leg_{leg[2:]}_{kind.passive}" for leg, kind in _legs(machine)]
    balls = (f"ball_{leg[2:]}_{axis}" for axis in "xyz" for leg in list(leg_joints(machine))[::3])
    return *passive, *balls, *actuated_joints(machine)


JOINTS = joint_names()
"""The eighteen joints of a URDF with RPS legs; see `joint_names`."""


def home_readings(machine: Machine) -> FloatArray:
    """Return the readings in the symmetric home without offsets, (6,), for a stage (3,): [m], for RRS legs [rad].

    All platforms are level there. The reading is the middle of the limits common to the stage's three legs, if the
    stage can be level with it, in a manipulator above its pivots. Otherwise, and without limits, RPS legs have the
    smallest allowed length and those of a stage the sum of its two radii; carriages are at their pivots, and balls
    in the middle of the reach of crank and rod. A `GeometryError` is raised if the stage cannot be level with that
    either.
    """
    readings, _ = homes(check_machine(machine))
    return readings


@functools.lru_cache(maxsize=64)
def homes(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Return `home_readings`, and the positions of the balls there (6, 2), x and z in the planes of the legs [m]."""
    count = len(machine.legs.names)
    readings, places = np.empty(count), np.empty((count, 2))
    for stage, (radius, ball_radius) in enumerate(machine.stage_radii):
        legs, kind, limits = slice(3 * stage, 3 * stage + 3), machine.legs.kinds[stage].nominal, machine.limits
        low = max(limits.minimum[legs]) if limits else kind.least_reading
        high = min(limits.maximum[legs]) if limits else math.inf
        numbers, signs = tuple(kind.numbers[0].tolist()), machine.legs.slope_signs[legs]
        x, height, middle = ball_radius - radius, ball_radius + radius, 0.5 * (low + high)
        with np.errstate(invalid="ignore"):
            at_home = _HOME(x, height, (low, high), signs[0], numbers, kind.on_arrays)
            # A stage alone may be below its pivots, hanging or not.
            if machine.is_stage and low < high and math.isfinite(middle):
                z = _HEIGHT(x, middle, signs[0], numbers, kind.on_arrays)
                at_home = at_home if np.isnan(z) else formulas.LegHome(middle, x, z)
        places[legs] = x, at_home.z
        # Legs of the other working mode have another reading in the same place.
        own = kind.readings(places[legs], machine.crank_middles[legs])
        readings[legs] = np.where(signs == signs[0], at_home.reading, own)
        stands = at_home.z > 0.0 or machine.is_stage or kind.up < 0.0
        if not (stands and (signs * kind.slopes(places[legs], readings[legs]) > 0.0).all()):
            ends = f" between {low:g} and {high:g} {kind.unit}" if limits else ""
            expected = "a machine whose platforms are level at the middle of its limits"
            cause = "Is a rod too short, a sign wrong, or does the stage have no level state within its limits?"
            raise GeometryError("machine", expected, f"{kind!r} on radii of {radius:g} m{ends}", cause)
    return frozen(readings), frozen(places)


_HOME, _HEIGHT = on_arrays(formulas.leg_home), on_arrays(formulas.ball_height)
_FORMULAS = upper_balls, formulas.leg_values, formulas.leg_frame, formulas.triangle_axes, formulas.ball_angles


def _of_numbers(function: Callable[..., Any]) -> Callable[..., float]:
    """Return a function of NumPy arrays as one of Python floats, with the same bits."""
    return lambda *numbers: float(function(*numbers))


def _runner(**operations: Callable[..., Any]) -> SimpleNamespace:
    """Return the formulas with these operations, and those of each kind of legs."""
    bound = {formula.__name__: bind(formula, **operations) for formula in _FORMULAS}
    kinds = {kind: kind.bound(lambda formula: bind(formula, **operations)) for kind in KINDS.values()}
    return SimpleNamespace(sqrt=operations["sqrt"], kinds=kinds, **bound)


_ON_ARRAYS = _runner(**ARRAYS)
_ON_NUMBERS = _runner(
    sqrt=lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    **{name: _of_numbers(getattr(np, name)) for name in ("cos", "sin", "arctan2")},
)


class _Constants(NamedTuple):
    legs: tuple[formulas.LegFrame, ...]
    sides: tuple[float, ...]  # b_1 b_2, b_2 b_3 and b_3 b_1
    weights: Any  # see `upper_ball_weights`; None for a stage alone
    kinds: tuple[type[LegKind], ...]  # of the legs


@functools.lru_cache(maxsize=16)
def _constants(machine: Machine) -> _Constants:
    axes, pivots, balls = map(_tuples, machine.legs.arrays[:3])
    own_axes, legs, kinds = _ON_NUMBERS.triangle_axes(balls[:3]), [], []
    readings, places = homes(machine)
    middles = machine.crank_middles.tolist()
    for leg in range(len(readings)):
        kind, signs = machine.legs.kinds[leg // 3], (TANGENT_SIGNS[leg % 3], (1.0, -1.0)[leg // 3])
        kinds.append(type(kind))
        numbers = tuple(tuple(x.numbers[leg % 3].tolist()) for x in (kind.nominal, kind))
        at_home = formulas.LegHome(readings[leg].item(), *places[leg].tolist())
        placement, run = (axes[leg], pivots[leg]), _ON_NUMBERS
        drawn_axis, of_kind = AXES[leg % 3], run.kinds[type(kind)]
        legs.append(run.leg_frame(placement, drawn_axis, own_axes, signs, at_home, middles[leg], numbers, of_kind))
    weights = _tuples(machine.legs.upper_ball_weights) if not machine.is_stage else None
    return _Constants(tuple(legs), tuple(machine.legs.sides.tolist()), weights, tuple(kinds))


def leg_frames(machine: Machine) -> tuple[formulas.LegFrame, ...]:
    """Return the constants of the legs from which their joint values follow."""
    return _constants(machine).legs


def _tuples(matrix: FloatArray) -> Any:
    return tuple(map(tuple, matrix.tolist()))


@dataclass(frozen=True)
class JointAngles:
    """Joint values of configurations; NaN for missing ones."""

    values: FloatArray
    """Values of the passive joints, of the balls about x, y and z (n lower, then n upper legs), of the actuated joints;
    shape (..., 12 + 6 n), for a stage alone (..., 6 + 3 n). `value_names` has their names."""
    closure_residual: FloatArray
    """`Configuration.closure_residual` [m], shape (...)."""
    legs: int = 6
    """Number of legs: 6, or 3 for a stage alone."""

    @property
    def passive(self) -> FloatArray:
        """Angles of the revolute joints without an actuator [rad] in [-π, π], in the order of the legs, (..., legs).

        The hips of RPS legs, the knees of PRS and RRS legs.
        """
        return self.values[..., : self.legs]

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
    def actuated(self) -> FloatArray:
        """Readings minus offsets and readings in the home, shape (..., legs): [m], for RRS legs [rad]."""
        return self.values[..., -self.legs :]

    @property
    def _balls(self) -> FloatArray:
        balls = self.values[..., self.legs : -self.legs]
        return balls.reshape(*balls.shape[:-1], 3, balls.shape[-1] // 3)


def joint_angles(configuration: Configuration, corners: tuple[int, ...] = (0, 1, 2)) -> JointAngles:
    """Return the joint values of configurations of shape (...), closed or not.

    The ball joints are those of the legs `corners`, 0 to 2, of each stage. The values of a member are the
    same bits in any batch.
    """
    check_configuration(configuration)
    if not isinstance(corners, tuple | list):
        raise ArgumentError("corners", "a tuple of legs, 0 to 2", type_and_value(corners))
    corners = tuple(whole_number(corner, "corners", "legs, 0 to 2", most=2) for corner in corners)
    shape, constants = configuration.shape, _constants(configuration.machine)
    legs = len(constants.legs)
    count = 2 * legs + legs * len(corners)
    if configuration.machine.is_stage:
        state = [configuration.balls]
    else:
        state = [configuration.rotation, configuration.translation, configuration.middle_joints]
    if not shape:
        return _single(state, constants, corners)
    size = math.prod(shape)
    arrays = [a.reshape(size, math.prod(a.shape[len(shape) :])) for a in state]
    values, residual = np.empty((size, count)), np.empty(size)
    rows = np.empty((count, min(size, _BLOCK)))
    with np.errstate(invalid="ignore", divide="ignore"):
        for begin in range(0, size, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            # Components first: each operation runs along the configurations of a block.
            parts = [tuple(np.ascontiguousarray(a[block].T)) for a in arrays]
            angles, actuated, errors = _values(_rows(parts), constants, corners, _ON_ARRAYS)
            rows = rows[:, : len(parts[0][0])]
            for row, (sine, cosine) in zip(rows, angles, strict=False):
                np.arctan2(sine, cosine, out=row)
            rows[-legs:] = actuated
            values[block] = rows.T
            residual[block] = functools.reduce(np.maximum, errors)
    return JointAngles(values.reshape(*shape, count), residual.reshape(shape), legs)


def _single(state: list[FloatArray], constants: _Constants, corners: tuple[int, ...]) -> JointAngles:
    """Return the values of one state, computed with Python floats: NumPy takes longer for arrays of one."""
    legs = len(constants.legs)
    try:
        parts = [tuple(a.ravel().tolist()) for a in state]
        angles, actuated, errors = _values(_rows(parts), constants, corners, _ON_NUMBERS)
    except ZeroDivisionError:  # balls coincide or are in a line
        return JointAngles(np.full(2 * legs + legs * len(corners), np.nan), np.array(np.nan), legs)
    return JointAngles(np.concatenate([np.arctan2(*zip(*angles, strict=True)), actuated]), np.array(max(errors)), legs)


def _rows(parts: Sequence[Sequence[Any]]) -> Sequence[Any]:
    """Return b_i as the formulas take them, for a manipulator after R and o, from their components."""
    *pose, b = parts
    triangle = b[:3], b[3:6], b[6:]
    if not pose:
        return (triangle,)
    rotation, position = pose
    return (rotation[:3], rotation[3:6], rotation[6:]), position, triangle


def _values(
    state: Sequence[Any], constants: _Constants, corners: tuple[int, ...], run: SimpleNamespace
) -> tuple[list[formulas.Angle], list[Any], list[Any]]:
    """Return (sine, cosine) multiples of angles, actuated joints, and closure errors, for numbers or arrays (n,).

    The angles are those of the passive joints, then the balls' x, y and z. `state` comes from `_rows`.
    """
    *pose, b = state
    axes, balls = run.triangle_axes(b), [*b]
    seen = [(0, axes, 1.0)]
    if pose:
        rotation, position = pose
        columns = transposed(rotation)
        balls += [times(columns, minus(ball, position)) for ball in run.upper_balls(b, constants.weights)]
        seen.append((3, tuple(times(columns, x) for x in axes), -1.0))
    kinds = [run.kinds[kind] for kind in constants.kinds]
    legs = [run.leg_values(*leg) for leg in zip(balls, constants.legs, kinds, strict=True)]
    edges = minus(b[0], b[1]), minus(b[1], b[2]), minus(b[2], b[0])
    errors = [abs(leg.plane_distance) for leg in legs]
    errors += [abs(run.sqrt(dot(edge, edge)) - side) for edge, side in zip(edges, constants.sides, strict=True)]
    turns = [
        run.ball_angles(legs[k], constants.legs[k], own_axes, sign)
        for first, own_axes, sign in seen
        for k in (first + corner for corner in corners)
    ]
    angles = [leg.passive for leg in legs] + [turn[k] for k in range(3) for turn in turns]
    return angles, [leg.actuated for leg in legs], errors
