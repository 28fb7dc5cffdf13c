"""Three quadrics in the projective space of quaternions, of the inverse displacement of a machine as built.

The six leg planes n_i · (R p_i + t) = h_i are linear in t. The left null space of the 6 x 3 matrix of the n_i leaves
three equations in R alone, quadratic forms xᵀ Q x of the quaternion x, scalar last: `docs/theory/as_built.md`.
"""

from __future__ import annotations

from typing import NamedTuple

from spm_pin.kinematics.formulas.vectors import Rows, Vector, combined, dot, scaled, weighted

Form = tuple[float, float, float, float, float, float, float, float, float, float]
"""xx, yy, zz, ww, xy, xz, yz, xw, yw, zw of a symmetric matrix."""


class StagePlanes(NamedTuple):
    """Planes of the three legs of a stage."""

    normals: Rows  # in {B}
    heights: Vector
    balls: Rows  # points of the middle platform that lie in them, in its frame


def quadric(lower_weights: Vector, upper_weights: Vector, lower: StagePlanes, upper: StagePlanes) -> Form:
    """Return the form of the planes' equations with weights under which t drops out."""
    moments = _moments(lower_weights, lower), _moments(upper_weights, upper)
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = (
        combined(moments[0][0], 1.0, moments[1][0]),
        combined(moments[0][1], 1.0, moments[1][1]),
        combined(moments[0][2], 1.0, moments[1][2]),
    )
    c = dot(lower_weights, lower.heights) + dot(upper_weights, upper.heights)
    return (
        m00 - m11 - m22 - c,
        m11 - m00 - m22 - c,
        m22 - m00 - m11 - c,
        m00 + m11 + m22 - c,
        m01 + m10,
        m02 + m20,
        m12 + m21,
        m21 - m12,
        m02 - m20,
        m10 - m01,
    )


def _moments(weights: Vector, planes: StagePlanes) -> Rows:
    """Return the sum of the products n_i p_iᵀ with these weights."""
    first, second, third = (
        scaled(weights[0], planes.normals[0]),
        scaled(weights[1], planes.normals[1]),
        scaled(weights[2], planes.normals[2]),
    )
    return (
        _row(first[0], second[0], third[0], planes.balls),
        _row(first[1], second[1], third[1], planes.balls),
        _row(first[2], second[2], third[2], planes.balls),
    )


def _row(x: float, y: float, z: float, balls: Rows) -> Vector:
    return weighted((x, y, z), balls)


def rotation(x: float, y: float, z: float, w: float) -> Rows:
    """Return the rotation of a quaternion of any length, scalar last."""
    scale = 1.0 / (x * x + y * y + z * z + w * w)
    return (
        scaled(scale, (x * x - y * y - z * z + w * w, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w))),
        scaled(scale, (2.0 * (x * y + z * w), y * y - x * x - z * z + w * w, 2.0 * (y * z - x * w))),
        scaled(scale, (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), z * z - x * x - y * y + w * w)),
    )
