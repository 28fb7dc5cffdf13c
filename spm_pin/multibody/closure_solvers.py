"""Closed joint values by Newton's method: from an open q nearby, and by continuation from another closed one.

Continuation leads to six leg lengths, or to a pose of the platform: eighteen equations for eighteen joints. The first
Newton step from a point of the path is the path's tangent; where the corrections after it are no small part of it, the
step is shortened. So it is, too, where the determinant of the equations changes its sign or too much over the step or
half of it. The determinant is zero at a fold, where a path ends, and its sign is another on the other side: steps
become shorter in proportion to what is left, and none passes the fold or leads to another assembly mode or branch.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from spm_pin.errors import ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.constrained_model import TreeKinematics
from spm_pin.multibody.joint_layout import JointLayout

SHORTEST_NEWTON_SHARE = 2.0**-10
"""Share of a Newton step below which the projection ends without a solution."""
LONGEST_STEP = 0.25
"""Largest step of the continuation in any joint: angles [rad], slides in units of the middle platform's side."""
CORRECTION = 0.25
"""Largest sum of corrections, as a share of the step they correct."""
DETERMINANT_CHANGE = 2.0
"""Largest ratio of the determinants of the equations at both ends of a step, either way; the sign must be the same."""
SHORTEST_SHARE = 2.0**-22
"""Share of the path below which the continuation ends."""
SHORTEST_STEP = 1e-6
"""In the units of `LONGEST_STEP`: nearer to a singularity, rounding moves a solution by no small part of a step."""
MOST_CORRECTIONS = 8

NewtonStep = Callable[[FloatArray, float], tuple[FloatArray, float]]
"""Takes q and a share of the path; returns the Newton step towards there, and the error at q in units of d."""


def project_to_closure(
    q: FloatArray, kinematics: TreeKinematics, hold_legs: bool = False, max_iterations: int = 10
) -> FloatArray:
    """Return closed joint values near q (18,), or raise `ClosureError`; see `ClosedChain.project`.

    `kinematics`, of the chain by itself, is left at the joint values returned.
    """
    layout = kinematics.layout
    free = np.ones(q.shape, dtype=bool)
    free[layout.legs] = not hold_legs
    tolerance = _rounding(q, layout)
    cause = "No assembly mode of these leg lengths nearby?" if hold_legs else "Too far from any closed q?"

    kinematics.evaluate(q)
    for iteration in range(max_iterations + 1):
        residual, gap = kinematics.widest_gap(), kinematics.gap
        if residual <= tolerance:
            return q
        if iteration == max_iterations:
            break
        jacobian = kinematics.constraint_jacobian[:, free] * layout.units[free]
        step = np.zeros(q.shape)
        step[free] = layout.units[free] * np.linalg.lstsq(jacobian, -gap.ravel(), rcond=None)[0]
        # To first order a share of the step shrinks the gap by that share: a quarter of that is required.
        share, size = 1.0, float(np.linalg.norm(gap))
        while True:
            tried = q + share * step
            if (layout.distances(tried) >= 0.0).all():
                kinematics.evaluate(tried)
                if np.linalg.norm(kinematics.gap) <= (1.0 - 0.25 * share) * size:
                    break
            share *= 0.5
            if share < SHORTEST_NEWTON_SHARE:
                raise ClosureError(residual, iteration, cause)
        q = tried
    raise ClosureError(residual, max_iterations, cause)


def _rounding(q: FloatArray, layout: JointLayout) -> float:
    """Return the widest gap of closed loops that is rounding [m]: a few eps times the loop length."""
    return 16.0 * float(np.finfo(np.float64).eps) * float(layout.platform_sizes + layout.distances(q).sum())


class ContinuationSolver:
    """Solves for the joints of one chain by itself from nearby solutions."""

    def __init__(self, kinematics: TreeKinematics) -> None:
        self.kinematics, self.layout = kinematics, kinematics.layout

    def to_leg_lengths(self, q: FloatArray, lengths: FloatArray) -> FloatArray:
        """Return q of other leg lengths (6,), all six changed in proportion; raises at a forward singularity."""
        kinematics, layout = self.kinematics, self.layout
        begin = layout.leg_lengths(q)

        def step(q: FloatArray, share: float) -> tuple[FloatArray, float]:
            kinematics.evaluate(q)
            # At the end the target itself, not what adding up makes of it.
            target = lengths if share == 1.0 else begin + share * (lengths - begin)
            short, gap = target - layout.leg_lengths(q), kinematics.gap.ravel()
            move = kinematics.velocities_of_legs(short, gap)
            return move, max(float(np.abs(short).max()), float(np.abs(gap).max())) / layout.side

        cause = "a forward singularity, or the end of this assembly mode?"
        return self._follow(q, step, kinematics.forward_determinant, cause)

    def to_pose(self, q: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return q of another pose of m, turned and moved in proportion; raises at an inverse singularity."""
        kinematics, side = self.kinematics, self.layout.side
        kinematics.evaluate(q)
        start, place = kinematics.terminal_pose()
        turn = pin.log3(rotation @ start.T)

        def step(q: FloatArray, share: float) -> tuple[FloatArray, float]:
            kinematics.evaluate(q)
            now, at = kinematics.terminal_pose()
            goal = rotation if share == 1.0 else pin.exp3(share * turn) @ start
            wanted = translation if share == 1.0 else place + share * (translation - place)
            error = np.concatenate([(wanted - at) / side, pin.log3(goal @ now.T), -kinematics.gap.ravel() / side])
            return kinematics.inverse_factors.solve(error), float(np.abs(error).max())

        return self._follow(q, step, kinematics.inverse_determinant, "an inverse singularity, or out of reach?")

    def _follow(self, q: FloatArray, step: NewtonStep, determinant: Callable[[], float], cause: str) -> FloatArray:
        """Return q at the end of a path, or raise `ClosureError`.

        `determinant` is of the equations at the q of the last `step`.
        """
        done, share, attempts = 0.0, 1.0, 0
        while done < 1.0:
            tried, change, size = self._tried(q, step, determinant, done + share)
            attempts += 1
            if tried is not None:
                q, done = tried, done + share
                # The change grows with the step: the next one is to use most of what is allowed.
                share = min(share * min(2.0, 0.8 / max(change, 0.1)), 1.0 - done)
                continue
            share *= 0.5
            if share < SHORTEST_SHARE or size < SHORTEST_STEP:
                where = f"No further than {100.0 * done:.3g} % of the way from the start: {cause}"
                raise ClosureError(step(q, 1.0)[1] * self.layout.side, attempts, where)
        return q

    def _tried(
        self, q: FloatArray, step: NewtonStep, determinant: Callable[[], float], share: float
    ) -> tuple[FloatArray | None, float, float]:
        """Return q at a share of the path, or None if it is too far for one step.

        And the change of the determinant as a share of what is allowed, and the size of the step.
        """
        layout = self.layout
        tolerance = 4.0 * _rounding(q, layout) / layout.side
        allowed, begin, start, first = np.inf, 0.0, q, np.inf
        for iteration in range(MOST_CORRECTIONS + 1):
            move, error = step(q, share)
            if error <= tolerance:
                if iteration == 0:
                    return q, 0.0, 0.0
                ends = [determinant()]
                # Two factors that change their sign together, as at a constraint singularity, show in the middle.
                self.kinematics.evaluate(0.5 * (start + q))
                ends.append(determinant())
                change = max(_change(value / begin) for value in ends)
                return (q if change <= 1.0 else None), change, first
            size = float(np.abs(move / layout.units).max())
            if iteration == 0:
                if size > LONGEST_STEP:
                    break
                begin, first = determinant(), size
                # A step of rounding's size corrects nothing but rounding.
                allowed = max(CORRECTION * size, 1e-9)
            else:
                allowed -= size
            q = q + move
            if allowed < 0.0 or (layout.distances(q) < 0.0).any():
                break
        return None, math.inf, first


def _change(ratio: float) -> float:
    """Return the ratio of two determinants as a share of the change allowed."""
    return abs(math.log(ratio)) / math.log(DETERMINANT_CHANGE) if ratio > 0.0 else math.inf
