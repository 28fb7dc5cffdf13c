"""Vectors of three numbers."""

from __future__ import annotations

from spm_pin.closed_form.kernels.compilation import jit_inline

__all__ = ["Vector", "combined", "cross", "dot", "minus", "scaled"]

Vector = tuple[float, float, float]
"""A vector as three scalars, which compiled code keeps in registers."""


@jit_inline
def dot(a: Vector, b: Vector) -> float:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit_inline
def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit_inline
def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit_inline
def scaled(factor: float, a: Vector) -> Vector:
    """Return factor · a."""
    return factor * a[0], factor * a[1], factor * a[2]


@jit_inline
def combined(a: Vector, x: float, b: Vector) -> Vector:
    """Return a + x b."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]
