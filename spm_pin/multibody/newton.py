"""Closing the loops: Newton's method on the gaps, with the shortest step."""

from __future__ import annotations

import numpy as np

from spm_pin.errors import ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.placement import Placement

__all__ = ["close", "rounding"]

SHORTEST_SHARE = 2.0**-10
"""Share of a Newton step below which the search gives up."""


def close(
    q: FloatArray,
    placement: Placement,
    constraints: ClosureConstraints,
    workspace: Workspace,
    hold_legs: bool,
    max_iterations: int,
) -> FloatArray:
    """Return closed joint values near q (18,), or raise `ClosureError`; see `ClosedChain.project`."""
    free = np.ones(q.shape, dtype=bool)
    free[placement.legs] = not hold_legs
    units = np.ones(q.shape)
    units[placement.legs] = placement.geometry.middle_side
    tolerance = rounding(q, placement)
    cause = "No assembly mode of these leg lengths nearby?" if hold_legs else "Too far from any closed q?"

    gap, jacobian = constraints.evaluate(q, workspace)
    for iteration in range(max_iterations + 1):
        residual = float(np.linalg.norm(gap, axis=-1).max())
        if residual <= tolerance:
            return q
        if iteration == max_iterations:
            break
        shortest = np.linalg.lstsq(jacobian[:, free] * units[free], -gap.ravel(), rcond=None)[0]
        step = np.zeros(q.shape)
        step[free] = units[free] * shortest
        # To first order a share of the step shrinks the gap by that share: a quarter of it is asked for.
        share, size = 1.0, float(np.linalg.norm(gap))
        while True:
            tried = q + share * step
            if (placement.leg_lengths(tried) >= 0.0).all():
                gap, jacobian = constraints.evaluate(tried, workspace)
                if np.linalg.norm(gap) <= (1.0 - 0.25 * share) * size:
                    break
            share *= 0.5
            if share < SHORTEST_SHARE:
                raise ClosureError(residual, iteration, cause)
        q = tried
    raise ClosureError(residual, max_iterations, cause)


def rounding(q: FloatArray, placement: Placement) -> float:
    """Return what rounding may leave of a closed gap [m]: some eps times the way around the loops."""
    geometry = placement.geometry
    way = geometry.base_radius + geometry.middle_side + geometry.platform_radius + placement.leg_lengths(q).sum()
    return 16.0 * float(np.finfo(np.float64).eps) * float(way)
