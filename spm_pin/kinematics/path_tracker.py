"""Keeping to one of several solutions while a parameter grows.

At every parameter all solutions are known in closed form, so there is nothing to integrate and nothing drifts: the
solution nearest to where the last two lead is taken, and the step is halved until it is clearly the nearest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spm_pin.kinematics.path_events import Event, EventKind
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism.configuration import Configuration, compared_points
from spm_pin.mechanism.solutions import SolutionSet

PathSolver = Callable[[float], SolutionSet]
"""The solutions at a parameter of the path."""

CLEARLY = 0.25
"""A solution is clearly the nearest to the predicted one if its error is at most this share of the next one's."""
SHORTEST_STEP = 1e-11
"""Shortest step in the path's parameter; solutions that it does not separate are taken to meet."""
MOST_UNCLEAR = 100
"""Number of successive shortest steps after which two solutions are taken to coincide."""


class Tracker:
    """The solution followed so far."""

    def __init__(self, solve: PathSolver, place: int, longest_move: float, *, legs: bool) -> None:
        solutions = solve(0.0)
        self.solve = solve
        self.longest_move = longest_move
        self.legs = legs
        self.parameters = [0.0]
        self.states: list[Configuration] = [solutions.configurations[place]]
        self.labels = [solutions.labels[place]]
        self.events: list[Event] = []
        self._step = 1e-6
        self._unclear = 0  # shortest steps in a row that did not tell solutions apart

    def configurations(self) -> Configuration:
        """Return the states as one batch."""
        return Configuration.from_arrays(
            self.states[0].geometry,
            np.stack([state.rotation for state in self.states]),
            np.stack([state.translation for state in self.states]),
            np.stack([state.middle_joints for state in self.states]),
        )

    def advance(self, stop: float) -> bool:
        """Follow the solution to `stop`; False where it ends before."""
        while self.parameters[-1] < stop:
            here = self.parameters[-1]
            ahead = min(stop, here + self._step)
            # What a step of rounding would leave before the stop is not worth one.
            ahead = stop if stop - ahead < 0.1 * SHORTEST_STEP else ahead
            solutions = self.solve(ahead)
            place, clear = self._nearest(solutions, ahead)
            shortest = ahead - here <= SHORTEST_STEP
            # Two solutions that nearly meet look like two that cross, except for their labels: labels are exchanged
            # only where the shortest step confirms it.
            same = place is not None and solutions.labels[place] == self.labels[-1]
            if place is not None and ((clear and same) or (shortest and self._unclear < MOST_UNCLEAR)):
                self._unclear = 0 if clear else self._unclear + 1
                self._accept(ahead, solutions, place)
                self._step = 2.0 * (ahead - here)
            elif not shortest:
                self._step = 0.5 * (ahead - here)
            else:
                self._end(here)
                return False
        return True

    def _nearest(self, solutions: SolutionSet, ahead: float) -> tuple[int | None, bool]:
        """Return the solution nearest to the predicted one, if any is near, and whether it clearly is."""
        here = compared_points(self.states[-1])
        predicted = here
        if len(self.states) > 1:
            last = self.parameters[-1] - self.parameters[-2]
            predicted = here + (here - compared_points(self.states[-2])) * (ahead - self.parameters[-1]) / last
        points = compared_points(solutions.configurations)
        error = np.linalg.norm(points - predicted, axis=-1).max(axis=-1)
        error = np.where(solutions.exists, error, np.inf)
        order = error.argsort()
        nearest = int(order[0])
        move = float(np.linalg.norm(points[nearest] - here, axis=-1).max())
        if not np.isfinite(error[nearest]) or move > self.longest_move:
            return None, False
        rounding = 1e-12 * float(np.abs(here).max())
        return nearest, bool(error[nearest] <= CLEARLY * error[order[1]] + rounding and error[order[1]] > 4 * rounding)

    def _accept(self, parameter: float, solutions: SolutionSet, place: int) -> None:
        label = solutions.labels[place]
        if label != self.labels[-1]:
            self.events.append(Event(EventKind.SWITCH, parameter, f"{self.labels[-1]} becomes {label}"))
        self.parameters.append(parameter)
        self.states.append(solutions.configurations[place])
        self.labels.append(label)

    def _end(self, parameter: float) -> None:
        if self._unclear >= MOST_UNCLEAR:
            what = f"{self.labels[-1]}, which coincides with another solution"
            self.events.append(Event(EventKind.END, parameter, what))
            return
        # Given leg lengths end at a forward singularity of a stage, given poses at an inverse one.
        lower, upper, _ = np.abs(determinants(self.states[-1]))
        meets = ("forward, lower stage" if lower < upper else "forward, upper stage") if self.legs else "inverse"
        self.events.append(Event(EventKind.END, parameter, f"{self.labels[-1]}, at a singularity: {meets}"))

    def state(self, parameter: float) -> Configuration:
        """Return the followed solution anywhere between two places where it is known."""
        k = int(np.clip(np.searchsorted(self.parameters, parameter), 1, len(self.parameters) - 1))
        low, high = self.parameters[k - 1], self.parameters[k]
        share = (parameter - low) / (high - low)
        between = (1.0 - share) * compared_points(self.states[k - 1]) + share * compared_points(self.states[k])
        solutions = self.solve(parameter)
        error = np.linalg.norm(compared_points(solutions.configurations) - between, axis=-1).max(axis=-1)
        state: Configuration = solutions.configurations[int(np.where(solutions.exists, error, np.inf).argmin())]
        return state
