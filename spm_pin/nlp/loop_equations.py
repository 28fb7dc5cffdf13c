"""The loop equations in task space, as CasADi functions made from the geometry alone.

The unknowns are the nine coordinates of the ball joints b_1, b_2, b_3 in {B}. Each joint moves in the plane of
its lower leg and in that of its upper leg, Eqs. (5b) and (5c), and the joints are d apart, Eq. (12): nine
equations. Nothing is eliminated.

A `casadi.Function` can be called with numbers or symbols, saved with `Function.save`, and turned into C with
`Function.generate`: https://web.casadi.org/docs/#generating-c-code.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, GeometryError, SingularConfigurationError
from spm_pin.mechanism.arguments import FloatArray, check_instance, real_array, type_and_value
from spm_pin.mechanism.geometry import Geometry

_SHAPES = (9, 9), (9, 6), (6, 9), (6, 6)
"""Shapes of the derivatives that `leg_jacobian` returns."""


def check_drawn(geometry: Geometry) -> None:
    """Raise a GeometryError for a machine as built: the equations are those of the drawing."""
    if not check_instance(geometry, Geometry, "geometry").is_nominal:
        cause = "spm.symbolic has the equations of any machine; its drawing is geometry.nominal"
        raise GeometryError("geometry", "a machine as drawn", "one as built", cause)


def _vector(value: npt.ArrayLike) -> ca.DM:
    """Return a NumPy array as a dense CasADi matrix."""
    return ca.DM(np.asarray(value, dtype=np.float64))


def placed_platform(geometry: Geometry, rotation: ca.SX, translation: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """Return c_1..c_3 [m] and the unit axes of their revolute joints, in {B}. Eqs. (2) and (4b)."""
    joints = [translation + rotation @ _vector(point) for point in geometry.platform_joints]
    axes = [rotation @ _vector(axis) for axis in geometry.revolute_axes]
    return joints, axes


def equations(geometry: Geometry, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
    """Return the nine loop equations [m] as an expression (9,).

    They are the distances of the b_i, b (9,) in {B} [m], from the planes of the lower legs, then of the upper legs; and
    for the sides 12, 23, 31, (|b_i - b_j|² - d²)/(2d), which is the side's error to first order and smooth everywhere.
    `rotation` (3, 3) and `translation` (3,) are the pose of {m} in {B}.
    """
    points = _points(b)
    joints, axes = placed_platform(geometry, rotation, translation)
    lower = [ca.dot(_vector(axis), point) for axis, point in zip(geometry.revolute_axes, points, strict=True)]
    upper = [ca.dot(axis, point - joint) for axis, point, joint in zip(axes, points, joints, strict=True)]
    d = geometry.middle_side
    sides = [(ca.sumsqr(points[i] - points[(i + 1) % 3]) - d * d) / (2.0 * d) for i in range(3)]
    return ca.vertcat(*lower, *upper, *sides)


def leg_vectors(geometry: Geometry, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> list[ca.SX]:
    """Return a_i to b_i of the lower legs, then b_i to c_i of the upper legs, as expressions in {B} [m]."""
    points = _points(b)
    joints, _ = placed_platform(geometry, rotation, translation)
    lower = [point - _vector(joint) for joint, point in zip(geometry.base_joints, points, strict=True)]
    return lower + [joint - point for joint, point in zip(joints, points, strict=True)]


def closure(geometry: Geometry) -> ca.Function:
    """Make ``closure(b, rotation, translation) -> residual, jacobian``.

    b (9,) [m] and the pose of {m} in {B}; residual (9,) [m] as in `equations`, and its dense Jacobian (9, 9) with
    respect to b, dimensionless with entries of at most one where the sides are right.
    """
    b, rotation, translation = state = _symbols(geometry)
    residual = equations(geometry, b, rotation, translation)
    return _function("closure", state, residual=residual, jacobian=ca.densify(ca.jacobian(residual, b)))


def leg_lengths(geometry: Geometry) -> ca.Function:
    """Make ``leg_lengths(b, rotation, translation) -> lengths``: r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m]. Eq. (20)."""
    state = _symbols(geometry)
    return _function("leg_lengths", state, lengths=ca.vertcat(*map(ca.norm_2, leg_vectors(geometry, *state))))


def leg_jacobian(geometry: Geometry) -> ca.Function:
    """Make the derivatives from which the inverse Jacobian follows by the implicit function theorem.

    With F the loop equations, l the leg lengths and x a small motion of the platform, (v, ω) at o in {B}, the
    inverse Jacobian is l_x - l_b F_b⁻¹ F_x. F_b is singular at inverse singularities.

    Returns
    -------
    casadi.Function
        ``leg_jacobian(b, rotation, translation) -> closure_b, closure_x, lengths_b, lengths_x`` of shapes (9, 9),
        (9, 6), (6, 9) and (6, 6); derivatives with respect to an angle are in metres.
    """
    b, rotation, translation = state = _symbols(geometry)
    motion = ca.SX.sym("x", 6)
    # Around zero motion, R + [ω] R is the rotation to first order, and only that is differentiated.
    moved = rotation + ca.skew(motion[3:]) @ rotation
    position = translation + motion[:3]
    residual = equations(geometry, b, moved, position)
    lengths = ca.vertcat(*(ca.norm_2(leg) for leg in leg_vectors(geometry, b, moved, position)))
    at_rest = {
        f"{name}_{variable}": ca.densify(ca.substitute(ca.jacobian(value, by), motion, ca.SX.zeros(6)))
        for name, value in (("closure", residual), ("lengths", lengths))
        for variable, by in (("b", b), ("x", motion))
    }
    return _function("leg_jacobian", state, **at_rest)


def inverse_jacobian(derivatives: Sequence[npt.ArrayLike | ca.DM]) -> FloatArray:
    """Return the inverse Jacobian (6, 6), l_x - l_b F_b⁻¹ F_x, from the four outputs of `leg_jacobian`.

    It takes the twist (v, ω) at o in {B} [m/s, rad/s] to the leg rates [m/s]. Where F_b is singular, it raises
    `SingularConfigurationError` as "inverse".
    """
    expected = "the four outputs of leg_jacobian, of shapes (9, 9), (9, 6), (6, 9), (6, 6)"
    if not isinstance(derivatives, Sequence) or len(derivatives) != len(_SHAPES):
        raise ArgumentError("derivatives", expected, type_and_value(derivatives))
    closure_b, closure_x, lengths_b, lengths_x = (
        real_array(part, "derivatives", shape, "an output of leg_jacobian")
        for part, shape in zip(derivatives, _SHAPES, strict=True)
    )
    try:
        motion = np.linalg.solve(closure_b, closure_x)
    except np.linalg.LinAlgError:
        raise SingularConfigurationError("inverse", 0.0) from None
    return np.asarray(lengths_x - lengths_b @ motion)


def _symbols(geometry: Geometry) -> tuple[ca.SX, ca.SX, ca.SX]:
    check_drawn(geometry)
    return ca.SX.sym("b", 9), ca.SX.sym("R", 3, 3), ca.SX.sym("o", 3)


def _function(name: str, state: tuple[ca.SX, ca.SX, ca.SX], **values: ca.SX) -> ca.Function:
    return ca.Function(name, list(state), list(values.values()), ["b", "rotation", "translation"], list(values))


def _points(b: ca.SX) -> list[ca.SX]:
    return [b[3 * i : 3 * i + 3] for i in range(3)]
