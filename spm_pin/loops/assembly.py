"""Closing of loops from a guess: Newton's method with the damping of Levenberg and Marquardt.

Equations may depend on each other. Close to a closed configuration such rows have singular values as small as the gaps,
and a plain Newton step would divide rounding errors by them. A damping proportional to the squared error keeps the
convergence quadratic (Fan and Yuan, 2005).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from spm_pin.errors import ClosureError
from spm_pin.loops.continuation import CLOSED
from spm_pin.loops.state_kinematics import StateKinematics
from spm_pin.support.arguments import FloatArray, IntArray

MOST_STEPS, LONGEST_STEP = 200, 0.5
"""Steps of one search, and the largest in any joint, dimensionless."""
SEARCHES, DISTURBANCE = 8, 0.05
"""Number of searches, and the disturbance of the guess of search k over k, dimensionless."""
ROUNDING = 4e-16
LEAST_DAMPING = 1e-16
"""Smallest damping, relative to the squared largest singular value, so that dependent rows are not divided by zero."""


def assemble(kinematics: StateKinematics, guess: FloatArray, free: IntArray) -> FloatArray:
    """Return closed joint values near a guess (nq,), moving only the velocities `free`, or raise `ClosureError`."""
    rows, random = kinematics.rows, np.random.default_rng(0)
    nearest, least, steps, is_reversed = guess, np.inf, 0, [""]
    for search in range(SEARCHES):
        q = guess
        if search:
            # At a singular guess, as with all links in line, Newton's step may be zero: a random disturbance leaves it.
            away = np.zeros(rows.model.nv)
            away[free] = random.uniform(-1.0, 1.0, len(free)) * DISTURBANCE * search
            q = pin.integrate(rows.model, guess, away * rows.units)
        q, size, taken = _search(kinematics, q, free)
        steps += taken
        kinematics.evaluate(q)
        turned = rows.is_reversed(kinematics.placed[2])
        if size <= CLOSED and not turned:
            return q
        if size < least:
            nearest, least, is_reversed = q, size, turned
    kinematics.evaluate(nearest)
    gap, unit, loop = rows.widest(kinematics.residual)
    cause = f"{loop!r} stays open: no closed configuration near the guess, or links of lengths that cannot close"
    if least <= CLOSED:
        cause = (
            f"The closure {is_reversed[0]!r} is closed the wrong way round, turned by 180°: start from another guess"
        )
    raise ClosureError(gap, steps, cause, loop, unit)


def _search(kinematics: StateKinematics, q: FloatArray, free: IntArray) -> tuple[FloatArray, float, int]:
    """Return the end of a search, the largest error there, dimensionless, and the number of steps."""
    rows, damping, away = kinematics.rows, 1.0, np.zeros(kinematics.rows.model.nv)
    c, steps = _residual(kinematics, q), 0
    while steps < MOST_STEPS:
        steps += 1
        size = float(np.linalg.norm(c))
        if size <= ROUNDING:
            break
        u, sigma, vt = np.linalg.svd(kinematics.scaled_jacobian[:, free], full_matrices=False)
        along, decreased = u.T @ c, False
        while damping < 1e8:
            least = LEAST_DAMPING * sigma.max(initial=0.0) ** 2 + 1e-300
            move = -vt.T @ (along * sigma / (sigma**2 + max(damping * size**2, least)))
            move *= min(1.0, LONGEST_STEP / max(np.abs(move).max(initial=0.0), 1e-300))
            away[free] = move * rows.units[free]
            tried = pin.integrate(rows.model, q, away)
            at_tried = _residual(kinematics, tried)
            if np.linalg.norm(at_tried) < (1.0 - 1e-4) * size:
                decreased = True
                break
            if np.abs(move).max(initial=0.0) < ROUNDING:
                break
            damping *= 8.0
        if not decreased:
            break
        q, c, damping = tried, at_tried, max(damping / 8.0, 1e-3)
    return q, float(np.abs(c).max(initial=0.0)), steps


def _residual(kinematics: StateKinematics, q: FloatArray) -> FloatArray:
    """Return the left sides (m,) at q, dimensionless."""
    kinematics.evaluate(q)
    return np.asarray(kinematics.residual / kinematics.row_units)
