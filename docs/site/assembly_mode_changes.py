"""Assembly modes of one stage joined without a singularity, for docs/theory/literature_checks.md.

A state in mode T is (x, y, Z/r), as in `spm_pin.proofs.stage_proof`: the vector part of the middle platform's
quaternion and its height in units of r. Mode F is mode T with -E for E.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval
from spm_pin.proofs.stage_proof import StageRegion

Array = npt.NDArray[np.float64]
Shape = tuple[float, float, float]


@dataclass(frozen=True)
class NonsingularChange:
    """Two assembly modes of a stage of equal leg lengths, joined by a path on which its determinant keeps its sign."""

    stage: str
    hips: float
    legs: str
    apart: float
    lengths_differ: float
    boxes: int
    least: float


RANGES = ((0.166, 0.3, (0.1435, 0.3605, 0.7788)), (0.3, 0.5, (0.18, 0.18, 0.45)))
"""Ranges of E/r in mode T, with the path between states of equal legs: p at its ends, p and Z/r in its middle."""

POLYGON = np.array([[0.349559, 0.847166, -1.216897], [0.316326, 0.838279, -1.126552], [-0.957473, 0.138829, -1.185849]])
"""A path (x, y, Z/r) in mode F for E = r/2, its legs not equal; the end is corrected to the lengths of the start."""


def nonsingular_changes(machine: spm.Manipulator) -> list[NonsingularChange]:
    """Return certified paths for the paper's stages and for other radii of the hips."""
    r = machine.middle_radius
    lower, upper = machine.base_radius / r, machine.platform_radius / r
    rows = [("the paper's lower, mode T", lower, circle(lower)), ("the paper's upper, mode T", upper, circle(upper))]
    rows += [
        ("the paper's lower, mode F", -lower, circle(-lower)),
        ("the paper's upper, mode F", -upper, circle(-upper)),
    ]
    rows += [("mode T", epsilon, circle(epsilon)) for epsilon in (0.1, 0.6, 1.0, 3.0, 10.0)]
    rows += [("mode T", 0.5 * (low + high), curve(0.5 * (low + high), *shape)) for low, high, shape in RANGES]
    rows += [("mode F", epsilon, circle(epsilon)) for epsilon in (-0.1, -1.0, -10.0)]
    rows += [("mode F", -0.5, corrected(POLYGON, -0.5))]
    return [_certified(*row) for row in rows]


def circle(epsilon: float) -> Array:
    """Return a path (M, 3) of constant tilt and height, between two states with equal legs a third of a turn apart.

    Among the tilts whose determinant keeps its sign, a large one of a low stage is used, whose determinant does not
    come near zero.
    """
    p = np.linspace(0.01, 0.99, 99)
    along = reduced_determinant(p[:, None], epsilon, np.linspace(-1.0, 1.0, 41))
    least = np.where((along > 0.0).all(axis=1) | (along < 0.0).all(axis=1), np.abs(along).min(axis=1), 0.0)
    heights = np.array([equal_legs_height(value, epsilon) for value in p])
    chosen = np.argmax(least / np.abs(along).max(axis=1) * p / (1.0 + heights**2))
    return curve(epsilon, p[chosen], p[chosen], heights[chosen])


def curve(epsilon: float, p_end: float, p_middle: float, z_middle: float, vertices: int = 49) -> Array:
    """Return a path (M, 3) on which p and Z are linear in cos 3ψ, from equal legs to equal legs."""
    psi = np.linspace(0.0, 2.0 * np.pi / 3.0, vertices)
    towards = 0.5 * (1.0 - np.cos(3.0 * psi))
    p = p_end + (p_middle - p_end) * towards
    z_end = equal_legs_height(p_end, epsilon)
    return np.stack([np.sqrt(p) * np.cos(psi), np.sqrt(p) * np.sin(psi), z_end + (z_middle - z_end) * towards], axis=1)


def equal_legs_height(p: float, epsilon: float) -> float:
    """Return Z/r of the state with equal legs at ψ = 0."""
    return float(-(2.0 * epsilon - 1.0 + 2.0 * p) * np.sqrt(p) / (2.0 * np.sqrt(1.0 - p)))


def reduced_determinant(p: Array, epsilon: float, u: Array) -> Array:
    """Return Q(u), u = cos 3ψ: D = 27 p^(3/2) Q / (32 √(1 - p)) r⁶ on the circle through states with equal legs."""
    e = epsilon
    linear = 4 * e**3 * p + 4 * e**2 * p**2 - 12 * e**2 * p + 8 * e**2 - 16 * e * p**3 + 12 * e * p**2 + 5 * e * p
    linear = 4 * (linear - 4 * e - 16 * p**4 + 24 * p**3 - 7 * p**2 - 2 * p)
    shared = 2 * e - 1 + 2 * p
    constant = shared * (-8 * e**2 * p + 12 * e**2 + 8 * e * p - 4 * e + 16 * p**3 - 16 * p**2 - 2 * p + 3)
    return np.asarray(-16 * p**2 * (1 - p) * shared * u**2 + linear * u + constant)


@dataclass(frozen=True)
class ProvedRange:
    """Radii E/r of the hips for all of which a path is proved to be free of singularities."""

    least: float
    most: float
    boxes: int


def proved_ranges() -> list[ProvedRange]:
    """Return ranges of E/r in mode T, 1/2 excluded, on which D < 0 is proved along `RANGES`, and the boxes.

    At E = r/2 D vanishes at equal legs, u = 1. Before it D is negative there, Q(1) = 3 κ (κ + 2)², and increases with u
    near u = 1, so it is negative for smaller u as well.
    """
    (low, middle, first), (_, high, second) = RANGES
    boxes = negative(first, determinant_on_curve, (low, middle), (-1.0, 1.0))
    near = high - 1e-3
    others = negative(second, determinant_on_curve, (middle, near), (-1.0, 1.0))
    others += negative(second, determinant_on_curve, (near, high), (-1.0, 0.9))
    others += negative(second, falling_on_curve, (near, high), (0.9, 1.0))
    return [ProvedRange(low, middle, boxes), ProvedRange(middle, high, others)]


def negative(
    shape: Shape,
    function: Callable[[Interval, Interval, Shape], Interval],
    epsilon: tuple[float, float],
    u: tuple[float, float],
    most: int = 20_000,
) -> int:
    """Return the number of boxes of (ε, u) that prove a function to be negative; an error if it is not."""
    boxes, count = np.array([[epsilon, u]]), 0
    while len(boxes):
        count += len(boxes)
        value = function(*(Interval(boxes[:, i, 0], boxes[:, i, 1]) for i in (0, 1)), shape)
        if count > most or (value.low > 0.0).any():
            raise ValueError("the function is not proved to be negative")
        boxes = boxes[value.high >= 0.0]
        for i in (0, 1):
            halves = boxes.copy(), boxes.copy()
            halves[0][:, i, 1] = halves[1][:, i, 0] = boxes[:, i].mean(axis=1)
            boxes = np.concatenate(halves)
    return count


def determinant_on_curve(epsilon: Interval, u: Interval, shape: Shape) -> Interval:
    """Return 4 D / (27 √(1 - p) r⁶) on the path of `curve`, over boxes of ε and u = cos 3ψ."""
    square, linear, constant, *_ = _coefficients(epsilon, u, shape)
    return square * u.square() + linear * u + constant


def falling_on_curve(epsilon: Interval, u: Interval, shape: Shape) -> Interval:
    """Return minus the derivative of `determinant_on_curve` with u, where p is constant."""
    square, linear, _, p, z, rise = _coefficients(epsilon, u, shape)
    lever, power = (1.0 - p).root(), p.root() * p
    by_height = 4.0 * (lever * p.square() * p) * u.square() + 4.0 * (power * z * (epsilon - 3.0 * p + 2.0)) * u
    by_height += lever * (3.0 * z.square() * (1.0 - 2.0 * p) + _level(epsilon, p))
    return -(2.0 * square * u + linear + by_height * rise)


def _coefficients(epsilon: Interval, u: Interval, shape: Shape) -> tuple[Interval, ...]:
    """Return the coefficients of u², u and 1, then p, Z and dZ/du."""
    p_end, p_middle, z_middle = (Interval.from_numbers(value) for value in shape)
    towards = 0.5 * (1.0 - u)
    p = p_end + towards * (p_middle - p_end)
    z_end = -0.5 * ((2.0 * epsilon - 1.0 + 2.0 * p_end) * p_end.root() * (1.0 - p_end).root().reciprocal())
    z, rise = z_end + towards * (z_middle - z_end), -0.5 * (z_middle - z_end)
    lever, left, z_2 = (1.0 - p).root(), 1.0 - p, z.square()
    linear = (
        z_2 * (epsilon - 3.0 * p + 2.0)
        + 2.0 * (epsilon.square() * left)
        - epsilon * left.square()
        - p * (1.0 - p.square())
    )
    constant = z * lever * (z_2 * (1.0 - 2.0 * p) + _level(epsilon, p))
    return 4.0 * (z * lever * p.square() * p), 2.0 * (p.root() * p * linear), constant, p, z, rise


def _level(epsilon: Interval, p: Interval) -> Interval:
    return p * (2.0 * p.square() + p - 1.0 + 2.0 * epsilon - 4.0 * (epsilon * p) - 4.0 * epsilon.square())


def stage_region(epsilon: float) -> StageRegion:
    """Return the functions of a stage in units of r; those of mode F have ε = -E/r. Leg limits play no part."""
    return StageRegion(epsilon, math.sqrt(3.0), np.zeros(3), np.ones(3))


def squared_lengths(epsilon: float, states: Array) -> Array:
    """Return the squared leg lengths (..., 3) of states (..., 3), in units of r²."""
    squares = stage_region(epsilon).evaluate(*(Interval.from_numbers(states[..., i]) for i in range(3))).squares
    return np.stack([0.5 * (square.low + square.high) for square in squares], axis=-1)


def corrected(path: Array, epsilon: float) -> Array:
    """Return the path with an end that has the lengths of its start, by Newton's method."""
    wanted, end = squared_lengths(epsilon, path[0]), path[-1].copy()
    for _ in range(8):
        slope = differences(lambda x: squared_lengths(epsilon, x), end, 1e-6)
        end -= np.linalg.solve(slope.T, squared_lengths(epsilon, end) - wanted)
    return np.concatenate([path[:-1], end[None]])


def certificate(epsilon: float, path: Array, most: int = 100_000) -> tuple[int, float]:
    """Return the number of boxes that prove D ≠ 0 along a polygon (M, 3), and the proved lower bound of |D| / r⁶.

    Segments are halved until interval arithmetic excludes zero; all boxes have the same sign. Also proved: no vertex is
    at or beyond a half turn, x² + y² < 1, so no point of the polygon is.
    """
    if not ((Interval.from_numbers(path[:, 0]).square() + Interval.from_numbers(path[:, 1]).square()).high < 1.0).all():
        raise ValueError("the path reaches a half turn")
    region, pairs, bounds, boxes = stage_region(epsilon), np.stack([path[:-1], path[1:]]), [], 0
    while pairs.shape[1]:
        boxes += pairs.shape[1]
        if boxes > most:
            raise ValueError("the sign of the determinant is not proved along the path")
        low, high = pairs.min(axis=0), pairs.max(axis=0)
        found = region.evaluate(*(Interval(low[:, i], high[:, i]) for i in range(3))).determinant
        bounds += [*found.low[found.low > 0.0], *found.high[found.high < 0.0]]
        start, end = pairs[:, (found.low <= 0.0) & (found.high >= 0.0)]
        middle = 0.5 * (start + end)
        pairs = np.concatenate([[start, middle], [middle, end]], axis=1)
    signs = {float(np.sign(bound)) for bound in bounds}
    if len(signs) != 1:
        raise ValueError("the determinant changes its sign along the path")
    return boxes, float(np.abs(bounds).min())


def _certified(stage: str, epsilon: float, path: Array) -> NonsingularChange:
    lengths = np.sqrt(squared_lengths(epsilon, path[[0, -1]]))
    differ = float(np.abs(lengths[1] - lengths[0]).max())
    apart = float(np.linalg.norm(path[-1] - path[0]))
    boxes, least = certificate(epsilon, path)
    legs = ", ".join(f"{length:.4f}" for length in (lengths[0] if np.ptp(lengths[0]) > 1e-9 else lengths[0, :1]))
    return NonsingularChange(stage, abs(epsilon), legs, apart, differ, boxes, least)


def differences(function: Callable[[Array], Array], at: Array, step: float = 1e-5) -> Array:
    """Return the Jacobian of a function of rows, by central differences."""
    ends = np.concatenate([at + step * np.eye(len(at)), at - step * np.eye(len(at))])
    values = function(ends)
    return np.asarray((values[: len(at)] - values[len(at) :]) / (2.0 * step))
