"""The state within leg limits whose platform joints are nearest to given points, by SciPy's SLSQP.

The unknowns are the coordinates of both stages, in which a state exists everywhere within the unit circles; limits of
the readings and both determinants are inequalities, so that what is found is within the limits and physical.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.states import StateSet

_LEAST_DETERMINANT = 3e-7
"""Of a stage, about 1 at home: nearer to a forward singularity rounding of the readings moves the platform farther."""
_RIM = 1e-9
"""Least of 1 - x² - y² of a stage."""
_COARSE, _FINE, _POLISHED = {"maxiter": 10, "ftol": 1e-6}, {"maxiter": 200, "ftol": 1e-16}, 2
"""Steps of a search at most, and the change of half the squared distance over the machine's size squared at its end;
and how many of the nearest ends of coarse searches are finished."""
_ROUNDING = 1e-9
"""By how much a result may be beyond its limits, over the machine's size, and is moved to them."""


def nearest_state(states: StateSet, target: FloatArray, starts: FloatArray, body: FloatArray) -> FloatArray:
    """Return the coordinates (2, 3) of the state with points `body` (K, 3) nearest to `target` (3K,).

    The searches begin at `starts` (M, 2, 3), states within the limits; the first of them where none ends there.
    """
    problem = _Problem(states, target, body)
    coarse = [problem.search(start.ravel(), _COARSE) for start in starts]
    # Searches that end at one place are one.
    ends = sorted({(round(float(end.fun), 9), *end.x.tolist()) for end in coarse})
    best, least = starts[0], np.inf
    for _, *place in ends[:_POLISHED]:
        found = problem.search(np.array(place), _FINE)
        distance = problem.objective(found.x)[0]
        if distance < least and problem.room(found.x).min() >= -_ROUNDING:
            best, least = found.x.reshape(2, 3), distance
    return best


class _Problem:
    """Half the squared distance and the room to all limits, in units of the machine's size, with their derivatives."""

    def __init__(self, states: StateSet, target: FloatArray, body: FloatArray) -> None:
        self._states, self._target, self._body = states, target, body
        self._limited = np.isfinite(states.minimum), np.isfinite(states.maximum)
        self._at: bytes = b""
        self._parts: Any = ()

    def search(self, start: FloatArray, options: dict[str, float]) -> scipy.optimize.OptimizeResult:
        """Return the end of SLSQP from a start (6,)."""
        room = {"type": "ineq", "fun": self.room, "jac": self.room_slopes}
        return scipy.optimize.minimize(
            self.objective, start, jac=True, method="SLSQP", constraints=room, options=options
        )

    def _evaluate(self, x: FloatArray) -> Any:
        """Return points and room, and their derivatives by the six coordinates, at x (6,)."""
        if x.tobytes() != self._at:
            self._at, self._parts = x.tobytes(), self._states.with_slopes(x.reshape(2, 3), self._body)
        return self._parts

    def objective(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return half the squared distance, and its gradient (6,)."""
        points, slopes, *_ = self._evaluate(x)
        gap, size = (points - self._target) / self._states.size, self._states.size
        if not np.isfinite(gap).all():
            return np.inf, np.zeros(6)
        return 0.5 * float(gap @ gap), gap @ slopes / size

    def room(self, x: FloatArray) -> FloatArray:
        """Return how far readings, determinants and coordinates are within their limits, (n,)."""
        _, _, readings, _, determinants, _ = self._evaluate(x)
        below, above = self._limited
        room = [
            (readings - self._states.minimum)[below] / self._states.size,
            (self._states.maximum - readings)[above] / self._states.size,
            determinants - _LEAST_DETERMINANT,
            1.0 - _RIM - (x.reshape(2, 3)[:, :2] ** 2).sum(axis=-1),
        ]
        return np.nan_to_num(np.concatenate(room), nan=-1.0)

    def room_slopes(self, x: FloatArray) -> FloatArray:
        """Return the derivatives of `room`, (n, 6)."""
        _, _, _, rates, _, slopes = self._evaluate(x)
        below, above = self._limited
        rim = np.zeros((2, 6))
        rim[0, :2], rim[1, 3:5] = -2.0 * x[:2], -2.0 * x[3:5]
        rows = [rates[below] / self._states.size, -rates[above] / self._states.size, slopes, rim]
        return np.nan_to_num(np.concatenate(rows))
