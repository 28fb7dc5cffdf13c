"""The loop equations in task space, as CasADi functions made from the machine alone.

The unknowns are the nine coordinates of the lower legs' ball joints b_1, b_2, b_3 in {B}. Each leg moves in a plane,
Eqs. (5b) and (5c), and the joints are as far apart as the middle platform holds them, Eq. (12): nine equations, of any
machine, nominal or calibrated. A stage has three planes less and three equations of its request, which is the height
and the normal of a pose. Nothing is eliminated.

A `casadi.Function` can be called with numbers or symbols, saved with `Function.save`, and turned into C with
`Function.generate`: https://web.casadi.org/docs/#generating-c-code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from spm_pin.crosscheck.ball_states import freedoms
from spm_pin.errors import ArgumentError, SingularConfigurationError
from spm_pin.machine.leg_kinds import PRS, RPS, RRS, LegKind
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.support.arguments import FloatArray, as_array, real_array, type_and_value


def curvature(machine: Machine) -> float:
    """Return the bound q of the equations' quadratic part Q(h) [1/m]: |Q(h)| <= q |h|²."""
    return 1.5 * float(1.0 / machine.legs.sides.min() + np.abs(_weights(machine)[:, 2]).sum())


def _weights(machine: Machine) -> FloatArray:
    """Return (α, β, γ) of α (b_2 - b_1) + β (b_3 - b_1) + γ (b_2 - b_1) x (b_3 - b_1), as rows.

    For a manipulator they are the vectors from lower to upper balls (3, 3), for a stage from b_1 to the origin of the
    platform (1, 3).
    """
    if not machine.is_stage:
        return machine.legs.upper_ball_weights
    b_1, b_2, b_3 = machine.legs.balls
    sides = b_2 - b_1, b_3 - b_1
    return np.linalg.solve(np.stack([*sides, np.cross(*sides)], axis=-1), -b_1)[None]


def legs(machine: Machine, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """Return of each leg the unit revolute axis, and the vector from its pivot to its ball [m], in {B}. Eqs. (2), (4b).

    b (9,) are the lower legs' balls in {B} [m]; `rotation` (3, 3) and `translation` (3,) are the pose of {m} in {B}.
    """
    axes, pivots = ([ca.SX(row) for row in rows] for rows in (machine.legs.axes, machine.legs.pivots))
    axes[3:] = [rotation @ axis for axis in axes[3:]]
    pivots[3:] = [translation + rotation @ pivot for pivot in pivots[3:]]
    # In a calibrated machine the upper legs' balls are beside the lower ones, fixed to their triangle.
    balls = _points(b) + (_beside(machine, b) if len(pivots) > 3 else [])
    return [(axis, ball - pivot) for axis, pivot, ball in zip(axes, pivots, balls, strict=True)]


def _beside(machine: Machine, b: ca.SX) -> list[ca.SX]:
    """Return the upper legs' balls, or the origin of a stage's platform, from the lower legs' balls."""
    b_1, b_2, b_3 = balls = _points(b)
    frame = ca.horzcat(b_2 - b_1, b_3 - b_1, ca.cross(b_2 - b_1, b_3 - b_1))
    return [ball + frame @ ca.SX(row) for ball, row in zip(balls, _weights(machine), strict=False)]


def equations(machine: Machine, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
    """Return the nine loop equations [m] as an expression (9,).

    They are the distances of the legs' balls from the planes of their legs; for a stage its request, which is what
    balls 2 and 3 have along the normal beyond ball 1, and the height of the platform; and for the sides 12, 23, 31 of
    length s, (|b_i - b_j|² - s²)/(2s), which is the side's error to first order and smooth everywhere. Arguments are
    those of `legs`.
    """
    points = _points(b)
    planes = [ca.dot(axis, vector) for axis, vector in legs(machine, b, rotation, translation)]
    if machine.is_stage:
        first, *others = machine.legs.balls.tolist()
        rises = zip(points[1:], others, strict=True)
        planes += [ca.dot(rotation[:, 2], point - points[0]) - (ball[2] - first[2]) for point, ball in rises]
        planes.append(_beside(machine, b)[0][2] - translation[2])
    sides = [
        (ca.sumsqr(points[i] - points[(i + 1) % 3]) - side * side) / (2.0 * side)
        for i, side in enumerate(machine.legs.sides.tolist())
    ]
    return ca.vertcat(*planes, *sides)


def readings_of_legs(machine: Machine, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
    """Return the readings of the legs, in their order, as an expression (6,) or (3,): leg lengths by Eq. (20)."""
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


def closure(machine: Machine) -> ca.Function:
    """Make ``closure(b, rotation, translation) -> residual, jacobian``.

    b (9,) [m] and the pose of {m} in {B}; residual (9,) [m] as in `equations`, and its dense Jacobian (9, 9) with
    respect to b, dimensionless with entries of at most one where the sides are right.
    """
    b, rotation, translation = state = _symbols(machine)
    residual = equations(machine, b, rotation, translation)
    return _function("closure", state, residual=residual, jacobian=ca.densify(ca.jacobian(residual, b)))


def readings(machine: Machine) -> ca.Function:
    """Make ``readings(b, rotation, translation) -> readings``: those of the legs, in their order, (6,) or (3,).

    In metres, for RRS legs in radians; not a number for a ball out of a leg's reach.
    """
    state = _symbols(machine)
    return _function("readings", state, readings=readings_of_legs(machine, *state))


def leg_jacobian(machine: Machine) -> ca.Function:
    """Make the derivatives from which the inverse Jacobian follows by the implicit function theorem.

    With F the loop equations, q the readings and x a small motion of the platform, (v, ω) at o in {B}, for a stage
    (v_z, ω_x, ω_y), the inverse Jacobian is q_x - q_b F_b⁻¹ F_x. F_b is singular at inverse singularities.

    Returns
    -------
    casadi.Function
        ``leg_jacobian(b, rotation, translation) -> closure_b, closure_x, readings_b, readings_x`` of shapes (9, 9),
        (9, n), (n, 9) and (n, n) with n = 6, or 3 for a stage, whose pose is the whole one of a state; derivatives
        with respect to an angle are in metres.
    """
    b, rotation, translation = state = _symbols(machine)
    motion = ca.SX.sym("x", 6)
    # Around zero motion, R + [ω] R is the rotation to first order, and only that is differentiated.
    moved = rotation + ca.skew(motion[3:]) @ rotation
    position = translation + motion[:3]
    closure = equations(machine, b, moved, position)
    if machine.is_stage:
        # The heights of the balls instead of the request: they do not depend on the parasitic v_x, v_y and ω_z.
        balls = zip(_points(b), machine.legs.balls, strict=True)
        heights = [(point - position - moved @ ca.SX(ball))[2] for point, ball in balls]
        closure = ca.vertcat(closure[:3], *heights, closure[6:])
    at_rest = {
        f"{name}_{variable}": ca.densify(ca.substitute(ca.jacobian(value, by)[:, columns], motion, ca.SX.zeros(6)))
        for name, value in (
            ("closure", closure),
            ("readings", readings_of_legs(machine, b, moved, position)),
        )
        for variable, by, columns in (("b", b, slice(None)), ("x", motion, freedoms(machine)))
    }
    return _function("leg_jacobian", state, **at_rest)


def inverse_jacobian(derivatives: Sequence[npt.ArrayLike | ca.DM]) -> FloatArray:
    """Return the inverse Jacobian (6, 6), q_x - q_b F_b⁻¹ F_x, from the four outputs of `leg_jacobian`.

    It takes the twist (v, ω) at o in {B} [m/s, rad/s] to the leg rates; for a stage it is (3, 3) and takes the motion
    (v_z, ω_x, ω_y). Where F_b is singular, it raises `SingularConfigurationError` as "inverse".
    """
    expected = "the four outputs of leg_jacobian, of shapes (9, 9), (9, 6), (6, 9), (6, 6), for a stage 3 instead of 6"
    if not isinstance(derivatives, Sequence) or len(derivatives) != 4:
        raise ArgumentError("derivatives", expected, type_and_value(derivatives))
    n = 3 if getattr(as_array(derivatives[3]), "shape", ()) == (3, 3) else 6
    closure_b, closure_x, readings_b, readings_x = (
        real_array(part, "derivatives", shape, "an output of leg_jacobian")
        for part, shape in zip(derivatives, ((9, 9), (9, n), (n, 9), (n, n)), strict=True)
    )
    try:
        motion = np.linalg.solve(closure_b, closure_x)
    except np.linalg.LinAlgError:
        raise SingularConfigurationError("inverse", 0.0) from None
    return np.asarray(readings_x - readings_b @ motion)


def _symbols(machine: Machine) -> tuple[ca.SX, ca.SX, ca.SX]:
    check_machine(machine)
    return ca.SX.sym("b", 9), ca.SX.sym("R", 3, 3), ca.SX.sym("o", 3)


def _function(name: str, state: tuple[ca.SX, ca.SX, ca.SX], **values: ca.SX) -> ca.Function:
    return ca.Function(name, list(state), list(values.values()), ["b", "rotation", "translation"], list(values))


def _points(b: ca.SX) -> list[ca.SX]:
    return [b[3 * i : 3 * i + 3] for i in range(3)]
