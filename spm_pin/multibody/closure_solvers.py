"""Closed joint values by Newton's method: from an open q nearby, and by continuation from another closed one.

The target of the continuation is a set of readings, or a pose of the platform (normal and height for a stage): as many
equations as joints. The first Newton step from a point of the path is along the path's tangent; if the corrections
after it are large compared with it, the step is shortened. The step is also shortened if the determinant of the
equations changes its sign, or changes too much, over the step or half of it. The determinant is zero at a fold, where a
path ends, and has the opposite sign beyond it: steps become shorter in proportion to the remaining distance, and none
passes the fold or leads to another assembly mode or branch.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from spm_pin.errors import ClosureError
from spm_pin.loops.state_kinematics import largest
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.support.arguments import FloatArray

SHORTEST_NEWTON_SHARE = 2.0**-10
"""Share of a Newton step below which the projection ends without a solution."""
LONGEST_STEP = 0.25
"""Largest step of the continuation in any joint: angles [rad], lengths in units of the middle platform's side."""
CORRECTION = 0.25
"""Largest sum of corrections, as a share of the step they correct."""
DETERMINANT_CHANGE = 1.5
"""Largest ratio of the determinants of the equations at both ends of a step, either way; the sign must be the same."""
SHORTEST_SHARE = 2.0**-22
"""Share of the path below which the continuation ends."""
SHORTEST_STEP = 1e-6
"""Smallest step, in units of `LONGEST_STEP`: closer to a singularity, rounding errors are comparable to the step."""
MOST_CORRECTIONS = 8

Equations = Callable[[float, FloatArray], tuple[FloatArray, Callable[[], FloatArray]]]
"""Function of a share of the path, from 0 to 1, and q: returns the residual [m], and a function for the Newton step."""


def close_loops(kinematics: TreeKinematics, q: FloatArray, most: int = 10) -> FloatArray:
    """Return closed joint values near q, or raise `ClosureError`; see `ClosedChain.project`.

    The kinematics are left at the result.
    """
    constrained = kinematics.constrained
    tolerance, cause = constrained.rounding(q), "Too far from any closed q?"
    kinematics.evaluate(q)
    for iteration in range(most + 1):
        gap = kinematics.residual
        if widest(gap) <= tolerance:
            return q
        if iteration == most:
            break
        share, size, units = 1.0, np.linalg.norm(gap), constrained.units
        move = units * np.linalg.lstsq(kinematics.jacobian * units, -gap, rcond=None)[0]
        while True:
            tried = q + share * move
            if (constrained.readings(tried) >= constrained.least_readings).all():
                kinematics.evaluate(tried)
                # To first order a share of the step shrinks the gaps by that share: a quarter of that is required.
                if np.linalg.norm(kinematics.residual) <= (1.0 - 0.25 * share) * size:
                    break
            share *= 0.5
            if share < SHORTEST_NEWTON_SHARE:
                raise ClosureError(widest(gap), iteration, cause)
        q = tried
    raise ClosureError(widest(gap), most, cause)


def widest(gap: FloatArray) -> float:
    """Return the largest distance of two points that a closure holds together [m]."""
    return float(np.linalg.norm(gap.reshape(-1, 3), axis=-1).max())


def follow_legs(kinematics: TreeKinematics, q: FloatArray, readings: FloatArray) -> FloatArray:
    """Return q of other readings (legs,), offsets aside, all changed in proportion; raises at a forward singularity."""
    constrained = kinematics.constrained
    begin = constrained.readings(q)

    def equations(share: float, q: FloatArray) -> tuple[FloatArray, Callable[[], FloatArray]]:
        kinematics.evaluate(q)
        # Use the exact target at the end, which avoids accumulated rounding.
        target = readings if share == 1.0 else begin + share * (readings - begin)
        missing, gap = target - constrained.readings(q), kinematics.residual
        return np.concatenate([missing, gap]), lambda: kinematics.velocities_of_legs(missing, -gap)

    cause = "a forward singularity, or the end of this assembly mode?"
    return _follow(kinematics, q, equations, kinematics.forward_determinant, cause)


def follow_pose(kinematics: TreeKinematics, q: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return q of another pose of m, turned and moved in proportion; raises at an inverse singularity.

    For a stage only the normal and the height of the pose are used.
    """
    side = kinematics.constrained.side
    between = _turn_of_normals if kinematics.constrained.is_stage else _turn
    kinematics.evaluate(q)
    start, origin = kinematics.terminal_pose()
    turn = between(start, rotation)

    def equations(share: float, q: FloatArray) -> tuple[FloatArray, Callable[[], FloatArray]]:
        kinematics.evaluate(q)
        target = rotation if share == 1.0 else pin.exp3(share * turn) @ start
        place = translation if share == 1.0 else origin + share * (translation - origin)
        now, here = kinematics.terminal_pose()
        error, gap = np.concatenate([place - here, between(now, target)]), kinematics.residual
        size = np.concatenate([side * kinematics.nondimensional(error), gap])
        return size, lambda: kinematics.velocities_along(error, -gap)

    cause = "an inverse singularity, or out of reach?"
    return _follow(kinematics, q, equations, kinematics.inverse_determinant, cause)


def _turn(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotation vector from one rotation to another."""
    return np.asarray(pin.log3(end @ start.T))


def _turn_of_normals(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotation vector of the smallest turn from the normal of one rotation to that of another."""
    a, b = start[:, 2], end[:, 2]
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    return np.asarray(axis * (math.atan2(sine, float(a @ b)) / sine if sine else 1.0))


def _follow(
    kinematics: TreeKinematics, q: FloatArray, equations: Equations, determinant: Callable[[], float], cause: str
) -> FloatArray:
    """Return q at the end of a path, or raise `ClosureError`; `determinant` is that of the equations."""
    done, share, attempts = 0.0, 1.0, 0
    while done < 1.0:
        following, change, size = _step(kinematics, q, done + share, equations, determinant)
        attempts += 1
        if following is not None:
            q, done = following, done + share
            # The change grows with the step: the next one is to use most of what is allowed.
            share = min(share * min(2.0, 0.8 / max(change, 0.1)), 1.0 - done)
            continue
        share *= 0.5
        if share < SHORTEST_SHARE or size < SHORTEST_STEP:
            where = f"No further than {100.0 * done:.3g} % of the way from the start: {cause}"
            raise ClosureError(largest(equations(1.0, q)[0]), attempts, where)
    return q


def _step(
    kinematics: TreeKinematics, start: FloatArray, share: float, equations: Equations, determinant: Callable[[], float]
) -> tuple[FloatArray | None, float, float]:
    """Return q at the end of one step, or None if it is too far for one.

    And the change of the determinant as a share of what is allowed, and the size of the step.
    """
    constrained = kinematics.constrained
    q, allowed, begin, first = start, math.inf, 0.0, math.inf
    for iteration in range(MOST_CORRECTIONS + 1):
        residual, step = equations(share, q)
        if largest(residual) <= 2.0 * constrained.rounding(start):
            if iteration == 0:
                return start, 0.0, 0.0
            # Two factors that change their sign together, as at a constraint singularity, show in the middle.
            change = _change(determinant() / begin)
            kinematics.evaluate(0.5 * (start + q))
            change = max(change, _change(determinant() / begin))
            return (q if change <= 1.0 else None), change, first
        move = step()
        size = largest(move / constrained.units)
        if iteration == 0:
            if size > LONGEST_STEP:
                break
            # The floor of 1e-9 allows steps that correct rounding errors only.
            begin, first, allowed = determinant(), size, max(CORRECTION * size, 1e-9)
        else:
            allowed -= size
        q = q + move
        if allowed < 0.0 or (constrained.readings(q) < constrained.least_readings).any():
            break
    return None, math.inf, first


def _change(ratio: float) -> float:
    """Return the ratio of two determinants as a share of the change allowed."""
    return abs(math.log(ratio)) / math.log(DETERMINANT_CHANGE) if ratio > 0.0 else math.inf
