"""From one closed q to another by continuation: to six leg lengths, or to a pose of the platform.

Both are eighteen equations for eighteen joints. The first Newton step from where one stands is the tangent of the way;
where the corrections after it are no small part of it, the step is halved. So the way is one that the mechanism can go,
and does not jump to another assembly mode or branch.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from spm_pin.errors import ClosureError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.closures import ClosureConstraints, Workspace
from spm_pin.multibody.newton import rounding
from spm_pin.multibody.placement import Placement
from spm_pin.multibody.velocity import Linearization

__all__ = ["Guide", "legs_to", "pose_to"]

LONGEST_STEP = 0.25
"""In any joint: angles [rad], slides in units of the middle platform's side."""
CORRECTION = 0.25
"""Largest sum of corrections, as a share of the step they correct."""
SHORTEST_SHARE = 2.0**-12
"""Share of the way below which the search gives up."""
MOST_CORRECTIONS = 8

Step = Callable[[FloatArray, float], tuple[FloatArray, float]]
"""Takes q and a share of the way; returns the Newton step towards there, and the error at q in units of d."""


class Guide:
    """Solves for the joints of one chain, in the scaled velocities u of the module `velocity`."""

    def __init__(self, placement: Placement, constraints: ClosureConstraints, workspace: Workspace) -> None:
        self.placement, self.constraints, self.workspace = placement, constraints, workspace
        self.side = placement.geometry.middle_side
        self._units = np.ones(placement.model.nv)
        self._units[placement.legs] = self.side

    def at(self, q: FloatArray) -> tuple[Linearization, FloatArray]:
        """Return the linearization at q and the gaps (12,) in units of d."""
        linear = Linearization.at(q, self.placement, self.constraints, self.workspace)
        return linear, self.constraints.gaps(self.workspace).ravel() / self.side

    def go(self, q: FloatArray, step: Step, cause: str) -> FloatArray:
        """Return q at the end of a way, or raise `ClosureError`."""
        done, share, attempts = 0.0, 1.0, 0
        while done < 1.0:
            tried, error = self._tried(q, step, done + share)
            attempts += 1
            if tried is not None:
                q, done = tried, done + share
                share = min(2.0 * share, 1.0 - done)
                continue
            share *= 0.5
            if share < SHORTEST_SHARE:
                where = f"No further than {100.0 * done:.3g} % of the way from the start: {cause}"
                raise ClosureError(error * self.side, attempts, where)
        return q

    def _tried(self, q: FloatArray, step: Step, share: float) -> tuple[FloatArray | None, float]:
        """Return q at a share of the way, None if it is too far for one step, and the last error."""
        tolerance = 4.0 * rounding(q, self.placement) / self.side
        allowed = np.inf
        for iteration in range(MOST_CORRECTIONS + 1):
            move, error = step(q, share)
            if error <= tolerance:
                return q, error
            size = float(np.abs(move / self._units).max())
            if iteration == 0:
                if size > LONGEST_STEP:
                    return None, error
                # A step of rounding's size corrects nothing but rounding.
                allowed = max(CORRECTION * size, 1e-9)
            else:
                allowed -= size
            q = q + move
            if allowed < 0.0 or (self.placement.leg_lengths(q) < 0.0).any():
                return None, error
        return None, error


def legs_to(q: FloatArray, lengths: FloatArray, guide: Guide) -> FloatArray:
    """Return q of other leg lengths (6,), all six changed in proportion; raises at a forward singularity."""
    begin = guide.placement.leg_lengths(q)

    def step(q: FloatArray, share: float) -> tuple[FloatArray, float]:
        linear, gap = guide.at(q)
        short = (begin + share * (lengths - begin) - guide.placement.leg_lengths(q)) / guide.side
        error = np.concatenate([short, -gap])
        inverse = linear.regular_inverse(linear.held(), "forward")
        return linear.columns @ (inverse @ error), float(np.abs(error).max())

    return guide.go(q, step, "a forward singularity, or the end of this assembly mode?")


def pose_to(q: FloatArray, rotation: FloatArray, translation: FloatArray, guide: Guide) -> FloatArray:
    """Return q of another pose of m, turned and moved in proportion; raises at an inverse singularity."""
    guide.at(q)
    begin = guide.workspace.data.oMf[guide.placement.platform].copy()
    turn = pin.log3(rotation @ begin.rotation.T)

    def step(q: FloatArray, share: float) -> tuple[FloatArray, float]:
        linear, gap = guide.at(q)
        now = guide.workspace.data.oMf[guide.placement.platform]
        # At the end the target itself, not what adding up turns makes of it.
        goal = rotation if share == 1.0 else pin.exp3(share * turn) @ begin.rotation
        place = translation if share == 1.0 else begin.translation + share * (translation - begin.translation)
        left = pin.log3(goal @ now.rotation.T)
        error = np.concatenate([(place - now.translation) / guide.side, left, -gap])
        inverse = linear.regular_inverse(linear.motion(), "inverse")
        return linear.columns @ (inverse @ error), float(np.abs(error).max())

    return guide.go(q, step, "an inverse singularity, or out of reach?")
