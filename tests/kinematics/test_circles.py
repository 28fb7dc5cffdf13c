"""Formulas of three circles and a triangle, from the coordinates of the balls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from spm_pin.formulas import circles
from spm_pin.formulas.circles import Circles

AXES = np.cross([[1.0, 0.0, 0.0], [-0.5, 0.9, 0.0], [-0.5, -0.8, 0.1]], [0.1, -0.1, 1.0])
AXES /= np.linalg.norm(AXES, axis=1)[:, None]
CENTRES = np.array([[0.9, 0.1, 0.0], [-0.4, 0.7, 0.1], [-0.5, -0.8, -0.1]])
RADII = np.array([1.3, 1.1, 1.2])
ANGLES = np.array([1.4, 1.7, 1.5])


def rows(array: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, array.tolist()))


def balls(angles: np.ndarray) -> np.ndarray:
    first, second = map(np.array, circles.turn_origins(stage([0, 1, 2])))
    return CENTRES + RADII[:, None] * (np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second)


def squared_sides(b: np.ndarray) -> np.ndarray:
    return ((b - np.roll(b, -1, axis=0)) ** 2).sum(axis=1)


def stage(order: list[int]) -> Circles:
    return Circles(rows(AXES[order]), rows(CENTRES[order]), tuple(RADII[order]), tuple(SQUARES[order]))


SQUARES = np.ones(3)
SQUARES = squared_sides(balls(ANGLES))


def test_errors_have_their_derivatives_by_the_angles() -> None:
    forms = circles.pair_forms(stage([0, 1, 2]), *circles.turn_origins(stage([0, 1, 2])))
    angles = ANGLES + np.array([0.02, -0.03, 0.01])
    values, slopes = circles.turn_equations(forms, tuple(np.cos(angles)), tuple(np.sin(angles)))
    np.testing.assert_allclose(values, 0.5 * (squared_sides(balls(angles)) - SQUARES), atol=1e-15)
    # Of the sides 12, 23, 31 by the first of both angles, then by the other.
    for k, leg in enumerate((0, 1, 2, 1, 2, 0)):
        exact = np.imag(0.5 * squared_sides(balls(angles + 1e-30j * np.eye(3)[leg])))[k % 3] / 1e-30
        assert slopes[k] == pytest.approx(exact, rel=1e-13)


def test_the_largest_safe_step_does_not_depend_on_the_order_of_the_legs() -> None:
    """Its bounds are the largest over legs and pairs, which are at another place in each order."""

    def largest(holds: Callable[[float], bool]) -> float:
        low, high = 0.0, 1.0
        for _ in range(45):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if holds(middle) else (low, middle)
        return low

    def turned(angle: float, order: list[int]) -> tuple[tuple[float, ...], ...]:
        return rows(balls(ANGLES + angle * np.array([1.0, -0.5, 0.7]))[order])

    def is_safe(order: list[int], angle: float, change: float) -> bool:
        own, b = stage(order), turned(angle, order)
        return circles.is_safe_step(own, own, b, circles.first_step(own, b), change)

    limits = []
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        change = largest(lambda x, order=order: is_safe(order, 0.0, x))
        angle = largest(lambda x, order=order: is_safe(order, x, 0.0))
        limits.append([change, angle])
    assert np.min(limits) > 1e-4
    np.testing.assert_allclose(limits, limits[:1] * 3, rtol=1e-9)
