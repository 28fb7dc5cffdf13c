"""A way between two sets of leg lengths that keeps rules: two trees that grow towards each other, made smooth.

RRT-Connect: Kuffner and LaValle, IEEE International Conference on Robotics and Automation (2000).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.motion.leg_path import LegPath
from spm_pin.motion.path_states import PathRules, line_states, spaced_parameters, states_along

_REACH = 0.25
"""Longest step of a tree, in units of d."""
_SHORTCUTS = 100
"""Shortcuts between two corners that are tried."""


@dataclass
class _Tree:
    """Leg lengths joined by straight lines that keep the rules."""

    points: list[FloatArray]
    parents: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, point: FloatArray) -> int:
        return int(np.linalg.norm(np.array(self.points) - point, axis=-1).argmin())

    def add(self, point: FloatArray, parent: int) -> int:
        self.points.append(point)
        self.parents.append(parent)
        return len(self.points) - 1

    def way(self, node: int) -> list[FloatArray]:
        """Return the points from the root to a node."""
        points = []
        while node >= 0:
            points.append(self.points[node])
            node = self.parents[node]
        return points[::-1]


def find_corners(
    rules: PathRules,
    start: FloatArray,
    goal: FloatArray,
    tries: int,
    rng: np.random.Generator,
) -> tuple[list[FloatArray] | None, str]:
    """Return the corners of a way from start to goal, None if none was found; and what is wrong with the line."""
    reason = rules.explain_line(line_states(rules.geometry, start, goal))
    if not reason:
        return [start, goal], ""
    trees = [_Tree([start]), _Tree([goal])]
    low, high = 0.5 * np.minimum(start, goal), 1.5 * np.maximum(start, goal)
    if rules.limits is not None:
        low, high = np.array(rules.limits.minimum), np.array(rules.limits.maximum)
    for k in range(tries):
        new = _grow(rules, trees[0], rng.uniform(low, high))
        if new is not None:
            target = trees[0].points[new]
            while (near := _grow(rules, trees[1], target)) is not None:
                if np.array_equal(trees[1].points[near], target):
                    corners = trees[0].way(new) + trees[1].way(near)[-2::-1]
                    return _shortened(rules, corners if k % 2 == 0 else corners[::-1], rng), reason
        trees.reverse()
    return None, f"{reason}; no way around was found in {tries} steps"


def _grow(rules: PathRules, tree: _Tree, target: FloatArray) -> int | None:
    """Add a step towards `target` to a tree; return the new node, None if the step breaks a rule."""
    reach = _REACH * rules.geometry.nominal.middle_side
    parent = tree.nearest(target)
    origin = tree.points[parent]
    distance = float(np.linalg.norm(target - origin))
    if distance == 0.0:
        return parent
    point = target if distance <= reach else origin + (reach / distance) * (target - origin)
    return None if rules.broken(line_states(rules.geometry, origin, point)).any() else tree.add(point, parent)


def _shortened(rules: PathRules, corners: list[FloatArray], rng: np.random.Generator) -> list[FloatArray]:
    """Return a way with fewer corners."""
    for _ in range(_SHORTCUTS):
        if len(corners) <= 2:
            break
        i, j = sorted(rng.choice(len(corners), 2, replace=False).tolist())
        if j > i + 1 and not rules.broken(line_states(rules.geometry, corners[i], corners[j])).any():
            corners = corners[: i + 1] + corners[j:]
    return corners


def smooth_path(rules: PathRules, points: list[FloatArray]) -> tuple[LegPath, Configuration] | None:
    """Return a smooth path near the straight lines between points, and its states; None if it breaks a rule.

    Points are added in between until it keeps the rules as the lines do.
    """
    rows = np.array(points)
    for _ in range(7):
        path = LegPath(rows)
        states = states_along(rules.geometry, path, spaced_parameters(rules.geometry, rows))
        if not rules.broken(states).any():
            return path, states
        middle = 0.5 * (rows[:-1] + rows[1:])
        rows = np.insert(rows, range(1, len(rows)), middle, axis=0)
    return None
