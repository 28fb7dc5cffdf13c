"""Random starts of the multi-start, and the probability that they missed a branch.

A start is a middle platform of the right size in a random orientation, placed where it violates the six leg planes
least. Orientations are uniform on SO(3), which is compact, and every solution is itself such a start: every branch has
a neighbourhood of starts that lead to it, and no box has to be chosen to search in.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry

__all__ = ["MOST_BRANCHES", "random_starts", "unseen_probability"]

MOST_BRANCHES = 8
"""Largest number of branches of a pose: the degree of Eq. (19)."""


def random_starts(geometry: Geometry, matrix: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw starts b (count, 9) [m] for a pose (4, 4)."""
    axes = geometry.revolute_axes
    platform_axes = axes @ matrix[:3, :3].T
    local = geometry.middle_radius * geometry.radial_directions
    turned = local @ np.swapaxes(Rotation.random(count, rng=rng).as_matrix(), -1, -2)
    # Relative to the point half way between the platforms: a direction that the normals leave free keeps that value.
    half = matrix[:3, 3] / 2.0
    normals = np.concatenate([axes, platform_axes])
    wanted = np.concatenate([-axes @ half, platform_axes @ half])
    offsets = np.concatenate([(turned * axes).sum(axis=-1), (turned * platform_axes).sum(axis=-1)], axis=-1)
    centre = half + (wanted - offsets) @ np.linalg.pinv(normals).T
    return np.asarray((turned + centre[:, None, :]).reshape(count, 9))


def unseen_probability(branches: int, starts: int) -> float:
    """Return the probability that a pose has branches that no start has found, of `starts` made, failed ones included.

    The posterior probability after Boender and Rinnooy Kan, Bayesian stopping rules for multistart global optimization
    methods, Math. Program. 37 (1987): each number of branches equally likely beforehand, and then every division of the
    starts among the branches and failures. They allow any number; here it is 0, 2, 4, 6 or 8, because the non-real
    roots of a real polynomial come in pairs. K branches of which w are found in n starts weigh
    K!/(K - w)! · K!/(n + K)!; the hits of each do not matter.
    """
    if branches % 2 or branches > MOST_BRANCHES:
        return 1.0
    weights = [
        math.exp(
            2.0 * math.lgamma(k + 1)
            - math.lgamma(k - branches + 1)
            - math.lgamma(starts + k + 1)
            + math.lgamma(starts + branches + 1)
        )
        for k in range(branches, MOST_BRANCHES + 1, 2)
    ]
    return math.fsum(weights[1:]) / math.fsum(weights)
