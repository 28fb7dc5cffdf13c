"""The state within leg limits whose platform joints are nearest to given points, by SciPy's SLSQP.

The unknowns are the coordinates of both stages, in which a state exists everywhere within the unit circles; limits of
the readings and both determinants are inequalities, so that the result is within the limits and physical.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from spm_pin.support.arguments import FloatArray
from spm_pin.workspace.search import SINGULARITY_MARGIN
from spm_pin.workspace.states import StateSet

_LEAST_ROOM = 1e-7
"""Smallest room of a PRS or RRS leg relative to the machine's size: at the end of its reach a leg is singular."""
_RIM = 1e-9
"""Smallest 1 - x² - y² of a stage."""
_FAR = 1e6
"""The objective for missing states."""
_ROUNDS, _FINE = ((10, 12), (15, 4)), {"maxiter": 200, "ftol": 1e-16}
"""Largest number of steps of each search in a round, and number of ends kept after it; and the same for the last
search, with the tolerance of half the squared distance over the machine's size squared."""
_COARSE = 1e-6
"""This tolerance in the searches before the last."""
_VIOLATED, _SAME = 0.1, 0.05
"""Weight of the excess over the limits beside the objective; and the distance in the coordinates below which two ends
are considered the same."""
_ROUNDING = 1e-9
"""Largest excess of a result beyond its limits, relative to the machine's size, that is moved to them."""


def nearest_state(states: StateSet, target: FloatArray, starts: FloatArray, body: FloatArray) -> FloatArray:
    """Return the coordinates (2, 3) of the state with points `body` (K, 3) nearest to `target` (3K,).

    The searches begin at `starts` (M, 2, 3), states within the limits; the first of them is the result if all fail.
    """
    problem = _Problem(states, target, body)
    places = [start.ravel() for start in starts]
    for steps, count in _ROUNDS:
        ends = sorted((problem.coarse_end(place, steps) for place in places), key=lambda end: end[0])
        places = []
        for _, place in ends:
            if len(places) < count and all(np.abs(place - other).max() > _SAME for other in places):
                places.append(place)
    best, least = np.asarray(starts[0]), np.inf
    for place in places:
        found = problem.search(place, _FINE)
        distance = problem.objective(found.x)[0]
        if distance < least and problem.is_state(found.x):
            best, least = np.array(found.x).reshape(2, 3), distance
    return best


class _Problem:
    """Half the squared distance and the room to all limits, in units of the machine's size, with their derivatives."""

    def __init__(self, states: StateSet, target: FloatArray, body: FloatArray) -> None:
        rows = 3 * len(body)
        self._states, self._constants = states, states.constants(body)
        self._target, self._size = target / np.sqrt(len(body)), states.size
        # Rows of limited quantities, in units of the size: see `state_search.Problem`.
        low, high, metres = np.asarray(self._constants[6])
        low[6:8], low[8:] = SINGULARITY_MARGIN, _LEAST_ROOM * states.size
        units = metres / states.size
        below, above = np.isfinite(low), np.isfinite(high)
        self._bounds = np.concatenate([(low * units)[below], -(high * units)[above]])
        self._rows = np.concatenate([np.flatnonzero(below), np.flatnonzero(above)])
        self._scale = np.concatenate([units[below], -units[above]])
        self._points, self._moved = np.empty(rows), np.empty((rows, 6))
        self._values, self._rates, self._places = np.empty(len(low)), np.empty((len(low), 6)), np.empty(2, np.int64)
        self._at: bytes = b""

    def search(self, start: FloatArray, options: dict[str, float]) -> Any:
        """Return the end of SLSQP from a start (6,)."""
        room = {"type": "ineq", "fun": self.room, "jac": self.room_slopes}
        # Not at the top: SciPy's optimisers take longer to import than the rest of a command.
        minimize: Any = import_module("scipy.optimize").minimize
        return minimize(self.objective, start, jac=True, method="SLSQP", constraints=room, options=options)

    def coarse_end(self, start: FloatArray, steps: int) -> tuple[float, FloatArray]:
        """Return how good the end of a search of a few steps is, the less the better, and where it is (6,)."""
        end = self.search(start, {"maxiter": steps, "ftol": _COARSE})
        return float(end.fun) + _VIOLATED * max(0.0, -float(self.room(end.x).min())), end.x

    def is_state(self, x: FloatArray) -> bool:
        """Return whether x (6,) is a state of the set: within its limits, and both stages in their aspects."""
        from spm_pin.kinematics.kernels.stage_states import INSIDE

        return bool(self.room(x).min() >= -_ROUNDING and (self._places == INSIDE).all())

    def _evaluate(self, x: FloatArray) -> bool:
        """Compute the state at x (6,); return False if missing."""
        from spm_pin.kinematics.kernels.stage_states import BEYOND
        from spm_pin.kinematics.kernels.state_search import state_terms

        if x.tobytes() != self._at:
            self._at = x.tobytes()
            results = self._points, self._moved, self._values, self._rates, self._places
            state_terms(x.reshape(2, 3).copy(), self._constants, *results)
        return bool((self._places >= BEYOND).all())

    def objective(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return half the squared distance, and its gradient (6,)."""
        if not self._evaluate(x):
            return _FAR, np.zeros(6)
        gap = (self._points - self._target) / self._size
        return 0.5 * float(gap @ gap), gap @ self._moved / self._size

    def room(self, x: FloatArray) -> FloatArray:
        """Return the distances of all quantities from their limits, and of x² + y² of each stage from 1, (n,)."""
        exists = self._evaluate(x)
        rim = 1.0 - _RIM - (x.reshape(2, 3)[:, :2] ** 2).sum(axis=-1)
        room = np.concatenate([self._scale * self._values[self._rows] - self._bounds, rim])
        return room if exists else np.full(len(room), -1.0)

    def room_slopes(self, x: FloatArray) -> FloatArray:
        """Return the derivatives of `room`, (n, 6)."""
        self._evaluate(x)
        rim = np.zeros((2, 6))
        rim[0, :2], rim[1, 3:5] = -2.0 * x[:2], -2.0 * x[3:5]
        return np.concatenate([self._scale[:, None] * self._rates[self._rows], rim])
