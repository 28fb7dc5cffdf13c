"""The loop equations in task space, as CasADi functions made from the machine alone.

The unknowns are the nine coordinates of the lower legs' ball joints b_1, b_2, b_3 in {B}. Each leg moves in a plane,
Eqs. (5b) and (5c), and the joints are as far apart as the middle platform holds them, Eq. (12): nine equations, of any
machine, nominal or calibrated. Nothing is eliminated.

A `casadi.Function` can be called with numbers or symbols, saved with `Function.save`, and turned into C with
`Function.generate`: https://web.casadi.org/docs/#generating-c-code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.machine.leg_kinds import PRS, RPS, RRS, LegKind
from spm_pin.machine.manipulator import Manipulator, check_manipulator
from spm_pin.support.arguments import FloatArray, real_array, type_and_value

_SHAPES = (9, 9), (9, 6), (6, 9), (6, 6)
"""Shapes of the derivatives that `leg_jacobian` returns."""


def legs(machine: Manipulator, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return of each leg the unit revolute axis, and the vector from its pivot to its ball [m], in {B}. Eqs. (2), (4b).

    b (9,) are the lower legs' balls in {B} [m]; `rotation` (3, 3) and `translation` (3,) are the pose of {m} in {B}.
    """
    axes, pivots = ([ca.SX(row) for row in rows] for rows in (machine.legs.axes, machine.legs.pivots))
    axes[3:] = [rotation @ axis for axis in axes[3:]]
    pivots[3:] = [translation + rotation @ pivot for pivot in pivots[3:]]
    b_1, b_2, b_3 = balls = _points(b)
    # In a calibrated machine the upper legs' balls are beside the lower ones, fixed to their triangle.
    frame = ca.horzcat(b_2 - b_1, b_3 - b_1, ca.cross(b_2 - b_1, b_3 - b_1))
    weights = machine.legs.upper_ball_weights
    balls = balls + [ball + frame @ ca.SX(row) for ball, row in zip(balls, weights, strict=True)]
    return [(axis, ball - pivot) for axis, pivot, ball in zip(axes, pivots, balls, strict=True)]


def equations(machine: Manipulator, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
    """Return the nine loop equations [m] as an expression (9,).

    They are the distances of the six legs' balls from the planes of their legs; and for the sides 12, 23, 31 of length
    s, (|b_i - b_j|² - s²)/(2s), which is the side's error to first order and smooth everywhere. Arguments are those of
    `legs`.
    """
    points = _points(b)
    planes = [ca.dot(axis, vector) for axis, vector in legs(machine, b, rotation, translation)]
    sides = [
        (ca.sumsqr(points[i] - points[(i + 1) % 3]) - side * side) / (2.0 * side)
        for i, side in enumerate(machine.legs.sides.tolist())
    ]
    return ca.vertcat(*planes, *sides)


def readings_of_legs(machine: Manipulator, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
    """Return the readings of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 as an expression (6,): leg lengths by Eq. (20)."""
    planes, shown = machine.legs.planes, list[ca.SX]()
    for leg, (_, vector) in enumerate(legs(machine, b, rotation, translation)):
        kind, turn = machine.legs.kinds[leg // 3], (ca.SX.eye(3), rotation)[leg // 3]
        x, z = (ca.dot(turn @ ca.SX(direction[leg]), vector) for direction in planes)
        reading = _READINGS[type(kind)](x, z, *kind.numbers[leg % 3].tolist())
        if kind.unit == "rad":
            # Among the angles that differ by full turns, use the one nearest to the middle of the limits, or to π/2.
            reading -= 2.0 * np.pi * ca.floor((reading - machine.crank_middles[leg]) / (2.0 * np.pi) + 0.5)
        shown.append(reading + machine.legs.offsets[leg])
    readings: ca.SX = ca.vertcat(*shown)
    return readings


def _carriage(x: ca.SX, z: ca.SX, rod: float, direction: float, sign: float) -> ca.SX:
    """Return the place of a PRS leg's carriage, by the theorem of Pythagoras."""
    along: ca.SX = np.cos(direction) * x + np.sin(direction) * z
    place: ca.SX = along + sign * ca.sqrt(rod**2 - (x**2 + z**2 - along**2))
    return place


def _crank(x: ca.SX, z: ca.SX, crank: float, rod: float, sign: float) -> ca.SX:
    """Return the angle of an RRS leg's crank, but for whole turns, by the law of cosines."""
    distance = ca.sqrt(x**2 + z**2)
    opening = ca.acos((distance**2 + crank**2 - rod**2) / (2.0 * crank * distance))
    angle: ca.SX = ca.atan2(z, x) + sign * opening
    return angle


_READINGS: dict[type[LegKind], Callable[..., ca.SX]] = {
    RPS: lambda x, z: ca.sqrt(x**2 + z**2),
    PRS: _carriage,
    RRS: _crank,
}
"""Readings of balls in the planes of the legs, written here again: methods share no code."""


def closure(machine: Manipulator) -> ca.Function:
    """Make ``closure(b, rotation, translation) -> residual, jacobian``.

    b (9,) [m] and the pose of {m} in {B}; residual (9,) [m] as in `equations`, and its dense Jacobian (9, 9) with
    respect to b, dimensionless with entries of at most one where the sides are right.
    """
    b, rotation, translation = state = _symbols(machine)
    residual = equations(machine, b, rotation, translation)
    return _function("closure", state, residual=residual, jacobian=ca.densify(ca.jacobian(residual, b)))


def readings(machine: Manipulator) -> ca.Function:
    """Make ``readings(b, rotation, translation) -> readings``: those of r_b1, r_b2, r_b3, r_c1, r_c2, r_c3.

    In metres, for RRS legs in radians; not a number for a ball out of a leg's reach.
    """
    state = _symbols(machine)
    return _function("readings", state, readings=readings_of_legs(machine, *state))


def leg_jacobian(machine: Manipulator) -> ca.Function:
    """Make the derivatives from which the inverse Jacobian follows by the implicit function theorem.

    With F the loop equations, q the readings and x a small motion of the platform, (v, ω) at o in {B}, the inverse
    Jacobian is q_x - q_b F_b⁻¹ F_x. F_b is singular at inverse singularities.

    Returns
    -------
    casadi.Function
        ``leg_jacobian(b, rotation, translation) -> closure_b, closure_x, readings_b, readings_x`` of shapes (9, 9),
        (9, 6), (6, 9) and (6, 6); derivatives with respect to an angle are in metres.
    """
    b, rotation, translation = state = _symbols(machine)
    motion = ca.SX.sym("x", 6)
    # Around zero motion, R + [ω] R is the rotation to first order, and only that is differentiated.
    moved = rotation + ca.skew(motion[3:]) @ rotation
    position = translation + motion[:3]
    at_rest = {
        f"{name}_{variable}": ca.densify(ca.substitute(ca.jacobian(value, by), motion, ca.SX.zeros(6)))
        for name, value in (
            ("closure", equations(machine, b, moved, position)),
            ("readings", readings_of_legs(machine, b, moved, position)),
        )
        for variable, by in (("b", b), ("x", motion))
    }
    return _function("leg_jacobian", state, **at_rest)


def inverse_jacobian(derivatives: Sequence[npt.ArrayLike | ca.DM]) -> FloatArray:
    """Return the inverse Jacobian (6, 6), q_x - q_b F_b⁻¹ F_x, from the four outputs of `leg_jacobian`.

    It takes the twist (v, ω) at o in {B} [m/s, rad/s] to the leg rates. Where F_b is singular, it raises
    `SingularConfigurationError` as "inverse".
    """
    expected = "the four outputs of leg_jacobian, of shapes (9, 9), (9, 6), (6, 9), (6, 6)"
    if not isinstance(derivatives, Sequence) or len(derivatives) != len(_SHAPES):
        raise ArgumentError("derivatives", expected, type_and_value(derivatives))
    closure_b, closure_x, readings_b, readings_x = (
        real_array(part, "derivatives", shape, "an output of leg_jacobian")
        for part, shape in zip(derivatives, _SHAPES, strict=True)
    )
    try:
        motion = np.linalg.solve(closure_b, closure_x)
    except np.linalg.LinAlgError:
        raise SingularConfigurationError("inverse", 0.0) from None
    return np.asarray(readings_x - readings_b @ motion)


def _symbols(machine: Manipulator) -> tuple[ca.SX, ca.SX, ca.SX]:
    check_manipulator(machine)
    return ca.SX.sym("b", 9), ca.SX.sym("R", 3, 3), ca.SX.sym("o", 3)


def _function(name: str, state: tuple[ca.SX, ca.SX, ca.SX], **values: ca.SX) -> ca.Function:
    return ca.Function(name, list(state), list(values.values()), ["b", "rotation", "translation"], list(values))


def _points(b: ca.SX) -> list[ca.SX]:
    return [b[3 * i : 3 * i + 3] for i in range(3)]
