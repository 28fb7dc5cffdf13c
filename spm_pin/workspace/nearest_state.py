"""The state whose platform joints are nearest to given points, within leg limits or without, by SciPy's SLSQP.

The unknowns of a stage are the rotation vector of its tilt, in the plane of x and y, and its height over r. A state
exists for all of them, also beyond half a turn, where the coordinates of a stage end. Limits of the readings and both
determinants are inequalities, so that the result is within the limits and physical.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np

from spm_pin.support.arguments import FloatArray
from spm_pin.workspace.search import SINGULARITY_MARGIN
from spm_pin.workspace.state_set import StateSet

_RIM = 1.0 - 1e-12
"""Largest x² + y² of a stage at which a state is evaluated: derivatives by x and y are infinite at half a turn."""
_SMALL_TILT = 1e-4
"""Tilt [rad] below which the second term of a series is used."""
_FAR = 1e6
"""The objective for missing states."""
_STEPS, _KEPT, _FINE = 30, 8, (200, 1e-16)
"""Largest number of steps of a first search, and number of ends kept; and the steps of a last search and its tolerance
of half the squared distance over the machine's size squared."""
_COARSE = 1e-6
"""This tolerance in the first searches."""
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
    places: list[FloatArray] = []
    for _, place in sorted(map(problem.coarse_end, _tilts(starts).reshape(-1, 6)), key=lambda end: end[0]):
        if len(places) < _KEPT and all(np.abs(place - other).max() > _SAME for other in places):
            places.append(place)
    best, least = np.asarray(starts[0]), np.inf
    for place in places:
        end = problem.search(place, *_FINE)
        distance = problem.objective(end)[0]
        if distance < least and problem.is_state(end):
            best, least = _coordinates(end)[0], distance
    return best


def _tilts(coordinates: FloatArray) -> FloatArray:
    """Return the unknowns (..., 2, 3) of a search at the coordinates (..., 2, 3) of both stages."""
    sine = np.linalg.norm(coordinates[..., :2], axis=-1, keepdims=True)
    factor = np.where(sine > 0.0, 2.0 * np.arcsin(np.minimum(sine, 1.0)) / np.where(sine > 0.0, sine, 1.0), 2.0)
    return np.concatenate([factor * coordinates[..., :2], coordinates[..., 2:]], axis=-1)


def _coordinates(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coordinates (2, 3) of both stages at the unknowns x (6,), and their derivatives (6, 6)."""
    coordinates, slopes = x.reshape(2, 3).copy(), np.eye(6)
    for stage, tilt in enumerate(x.reshape(2, 3)[:, :2]):
        angle = math.hypot(*tilt)
        # Use the quaternion with a positive scalar part, of q and -q.
        sign = 1.0 if math.cos(0.5 * angle) >= 0.0 else -1.0
        factor, slope = 0.5, -1.0 / 24.0
        if angle > _SMALL_TILT:
            factor = math.sin(0.5 * angle) / angle
            slope = (0.5 * math.cos(0.5 * angle) - factor) / angle**2
        place, own = sign * factor * tilt, slice(3 * stage, 3 * stage + 2)
        coordinates[stage, :2] = place * min(1.0, math.sqrt(_RIM / max(float(place @ place), _RIM)))
        slopes[own, own] = sign * (factor * np.eye(2) + slope * np.outer(tilt, tilt))
    return coordinates, slopes


class _Problem:
    """Half the squared distance and the room to all limits, in units of the machine's size, with their derivatives."""

    def __init__(self, states: StateSet, target: FloatArray, body: FloatArray) -> None:
        rows = 3 * len(body)
        self._states, self._constants = states, states.constants(body, SINGULARITY_MARGIN)
        self._target, self._size = target / np.sqrt(len(body)), states.size
        # Rows of limited quantities, in units of the size: see `state_search.Problem`.
        low, high, metres = np.asarray(self._constants[6])
        units = metres / states.size
        below, above = np.isfinite(low), np.isfinite(high)
        self._bounds = np.concatenate([(low * units)[below], -(high * units)[above]])
        self._rows = np.concatenate([np.flatnonzero(below), np.flatnonzero(above)])
        self._scale = np.concatenate([units[below], -units[above]])
        self._points, self._moved = np.empty(rows), np.empty((rows, 6))
        self._values, self._rates, self._places = np.empty(len(low)), np.empty((len(low), 6)), np.empty(2, np.int64)
        self._slopes, self._at = np.empty((6, 6)), b""

    def search(self, start: FloatArray, steps: int, tolerance: float) -> FloatArray:
        """Return where SLSQP ends (6,) from a start (6,)."""
        # Not at the top: SciPy's optimisers take longer to import than the rest of a command.
        scipy: Any = import_module("scipy.optimize")
        room = {"type": "ineq", "fun": self.room, "jac": self.room_slopes} if len(self._rows) else ()
        options = {"maxiter": steps, "ftol": tolerance}
        return np.asarray(
            scipy.minimize(self.objective, start, jac=True, method="SLSQP", constraints=room, options=options).x
        )

    def coarse_end(self, start: FloatArray) -> tuple[float, FloatArray]:
        """Return how good the end of a first search is, the less the better, and where it is (6,)."""
        end = self.search(start, _STEPS, _COARSE)
        return self.objective(end)[0] + _VIOLATED * max(0.0, -float(self.room(end).min(initial=0.0))), end

    def is_state(self, x: FloatArray) -> bool:
        """Return whether x (6,) is a state of the set: within its limits, and both stages in their aspects."""
        from spm_pin.kinematics.kernels.stage_states import INSIDE

        return bool(self.room(x).min(initial=0.0) >= -_ROUNDING and (self._places == INSIDE).all())

    def _evaluate(self, x: FloatArray) -> bool:
        """Compute the state at x (6,); return False if missing."""
        from spm_pin.kinematics.kernels.stage_states import BEYOND
        from spm_pin.kinematics.kernels.state_search import state_terms

        if x.tobytes() != self._at:
            self._at = x.tobytes()
            results = self._points, self._moved, self._values, self._rates, self._places
            coordinates, self._slopes = _coordinates(x)
            state_terms(coordinates, self._constants, *results)
        return bool((self._places >= BEYOND).all())

    def objective(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return half the squared distance, and its gradient (6,)."""
        if not self._evaluate(x):
            return _FAR, np.zeros(6)
        gap = (self._points - self._target) / self._size
        return 0.5 * float(gap @ gap), gap @ self._moved @ self._slopes / self._size

    def room(self, x: FloatArray) -> FloatArray:
        """Return the distances of all limited quantities from their limits, (n,)."""
        exists = self._evaluate(x)
        room = self._scale * self._values[self._rows] - self._bounds
        return room if exists else np.full(len(room), -1.0)

    def room_slopes(self, x: FloatArray) -> FloatArray:
        """Return the derivatives of `room`, (n, 6)."""
        self._evaluate(x)
        return np.asarray(self._scale[:, None] * (self._rates[self._rows] @ self._slopes))
