"""Closing the loops: Newton's method on the gaps, with the shortest step."""

from __future__ import annotations

import numpy as np

from spm_pin.errors import ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.multibody.joint_layout import JointLayout

__all__ = ["project_to_closure", "rounding"]

SHORTEST_SHARE = 2.0**-10
"""Share of a Newton step below which the search ends without a solution."""


def project_to_closure(
    q: FloatArray, kinematics: TreeKinematics, hold_legs: bool = False, max_iterations: int = 10
) -> FloatArray:
    """Return closed joint values near q (18,), or raise `ClosureError`; see `ClosedChain.project`.

    `kinematics`, of the chain by itself, is left at the joint values returned.
    """
    layout = kinematics.layout
    free = np.ones(q.shape, dtype=bool)
    free[layout.legs] = not hold_legs
    tolerance = rounding(q, layout)
    cause = "No assembly mode of these leg lengths nearby?" if hold_legs else "Too far from any closed q?"

    kinematics.evaluate(q)
    for iteration in range(max_iterations + 1):
        residual, gap = kinematics.widest_gap(), kinematics.gap
        if residual <= tolerance:
            return q
        if iteration == max_iterations:
            break
        jacobian = kinematics.closures[:, free] * layout.units[free]
        step = np.zeros(q.shape)
        step[free] = layout.units[free] * np.linalg.lstsq(jacobian, -gap.ravel(), rcond=None)[0]
        # To first order a share of the step shrinks the gap by that share: a quarter of that is required.
        share, size = 1.0, float(np.linalg.norm(gap))
        while True:
            tried = q + share * step
            if (layout.leg_lengths(tried) >= 0.0).all():
                kinematics.evaluate(tried)
                if np.linalg.norm(kinematics.gap) <= (1.0 - 0.25 * share) * size:
                    break
            share *= 0.5
            if share < SHORTEST_SHARE:
                raise ClosureError(residual, iteration, cause)
        q = tried
    raise ClosureError(residual, max_iterations, cause)


def rounding(q: FloatArray, layout: JointLayout) -> float:
    """Return what rounding may leave of a closed gap [m]: a few eps times the loop length."""
    geometry = layout.geometry
    length = geometry.base_radius + geometry.middle_side + geometry.platform_radius + layout.leg_lengths(q).sum()
    return 16.0 * float(np.finfo(np.float64).eps) * float(length)
