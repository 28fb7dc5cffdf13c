"""Tracking one of the solutions of a problem that depends on a parameter, and the events on the way.

At every parameter all solutions are known, so there is nothing to integrate and nothing drifts: the solution nearest
to where the last two lead is taken, and the step is halved until it is clearly the nearest. Singularities and leg
limits on the way are zeros of functions of the solution, found by root finding on the solutions themselves.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy

from spm_pin.errors import ArgumentError
from spm_pin.machine.configuration import Configuration, check_configuration, stacked
from spm_pin.machine.machine import Machine
from spm_pin.machine.solutions import SolutionSet
from spm_pin.support.arguments import BoolArray, FloatArray, whole_number

Solver = Callable[[float], SolutionSet]
"""The solutions at a parameter of the path."""

_LONGEST_MOVE = 0.1
"""A joint moves at most this share of d in a step, so that no turn is missed."""
_EXCHANGED = 1e-4
"""The same where the label changes: more is another solution, where the one followed has ended in a fold."""
_CLEARLY = 0.25
"""A solution is clearly the nearest to the predicted one if its error is at most this share of the next one's."""
_SHORTEST_STEP = 1e-11
"""Shortest step in the path's parameter; solutions that it does not separate are taken to meet."""
_MOST_UNCLEAR = 100
"""Number of successive shortest steps after which two solutions are taken to coincide."""
_AT_END = 1e-4
"""Share of its largest value below which κ of a leg shows that a path ends at the edge of the leg's reach."""
_MOST_EVENTS = 4
"""Maximum number of events in the text of a path."""


class EventKind(enum.StrEnum):
    """Kinds of events along a path."""

    INVERSE_SINGULARITY = "inverse singularity"
    FORWARD_SINGULARITY = "forward singularity"
    LIMIT = "leg limit"
    SWITCH = "label changes"
    END = "solution ends"


@dataclass(frozen=True)
class Event:
    """An event at one parameter."""

    kind: EventKind
    """Kind of the event: a singularity, a limit, a new label, or the end."""
    parameter: float
    """Parameter of the path at which it happens, from 0 to 1."""
    detail: str
    """The stage, the leg and which limit, or the labels before and after."""


class CertifiedLimits(Protocol):
    """The part of a `Certificate` that `follow` uses; `proofs` is above this package and cannot be imported here."""

    def covers(self, configuration: Any) -> BoolArray:
        """Return which configurations (...) are proved to be the only one of their leg lengths, shape (...)."""


class Watch(NamedTuple):
    """Functions of a machine's states whose zeros are the events of a path, and the length to compare moves with."""

    length: float  # with which moves are compared [m]: a side of the balls' triangle
    determinants: Callable[[Any], FloatArray]  # of states (...), dimensionless, (..., n): zero at singularities
    singularities: tuple[tuple[EventKind, str], ...]  # what the n zeros are, and their details
    has_labels: bool = True  # whether a solution keeps its label until it meets another; otherwise the first is kept


@dataclass(frozen=True, repr=False)
class FollowedPath:
    """A solution along a path."""

    parameters: FloatArray
    """Parameters at which the path was solved, from 0 to 1, or up to the end of the solution, shape (n,)."""
    configurations: Configuration
    """The solution there, batch of shape (n,)."""
    labels: tuple[str, ...]
    """Label of the solution at each parameter, n of them."""
    events: tuple[Event, ...]
    """Events, in the order of their parameters."""
    certified: BoolArray | None = None
    """True for each configuration that the certificate covers, if one was given, shape (n,).

    A path of straight lines between leg lengths is within the certified limits if both ends of each line are.
    """

    def __repr__(self) -> str:
        labels = ", ".join(dict.fromkeys(self.labels))
        ends = "complete" if self.complete else f"ends at {self.parameters[-1]:.4g}"
        events = ", ".join(f"{event.kind} at {event.parameter:.4g}" for event in self.events[:_MOST_EVENTS])
        more = f", … {len(self.events)} in all" if len(self.events) > _MOST_EVENTS else ""
        inside = "" if self.certified is None else f"; {self.certified.sum()} states in certified limits"
        return (
            f"<FollowedPath: {ends}, {len(self.parameters)} states of {labels}; {events or 'no events'}{more}{inside}>"
        )

    @property
    def complete(self) -> bool:
        """True if the solution lasts to the end of the path."""
        return bool(self.parameters[-1] == 1.0)


def followed(
    watch: Watch,
    solve: Solver,
    knots: FloatArray,
    start: Configuration | str | None,
    samples: int,
    *,
    has_legs: bool,
) -> FollowedPath:
    """Follow the solution that `start` names, or the nearest to it; `solve` returns all at a parameter."""
    count, solutions = whole_number(samples, "samples", least=1, most=10**9), solve(0.0)
    tracker = Tracker(watch, solve, solutions, _start(solutions, start), has_legs=has_legs)
    stops = np.unique(np.concatenate([np.linspace(0.0, 1.0, count + 1), knots]))
    for stop in stops[1:]:
        if not tracker.advance(float(stop)):
            break
    states = stacked(tracker.states)
    events = find_events(watch, tracker.parameters, states, tracker.state) + tracker.events
    ordered = tuple(sorted(events, key=lambda e: e.parameter))
    return FollowedPath(np.array(tracker.parameters), states, tuple(tracker.labels), ordered)


def _start(solutions: SolutionSet, start: Configuration | str | None) -> int:
    """Return the index of the solution to follow."""
    if isinstance(start, str):
        if start not in solutions.labels or not solutions[start].exists:
            real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
            received = f"{start!r}, while real are {', '.join(real[:8]) or 'none'}{' …' * (len(real) > 8)}"
            raise ArgumentError("start", "the label of a solution that is real where the path begins", received)
        return solutions.labels.index(start)
    if start is not None:
        check_configuration(start, "start", single=True, existing=True, of=type(solutions.machine))
    chosen = solutions.physical() if start is None else solutions.nearest(start)
    if not chosen.exists:
        reason = f"{chosen.missing_reason}. A solution that is not physical is named by its label"
        cause = reason if start is None else ""
        raise ArgumentError("start", "a solution that exists at the first point of the path", "NaN", cause)
    gap = np.abs(solutions.configurations.compared_points - chosen.compared_points).max(axis=(-1, -2))
    return int(np.where(solutions.exists, gap, np.inf).argmin())


class Tracker:
    """The solution followed so far."""

    def __init__(
        self,
        watch: Watch,
        solve: Solver,
        solutions: SolutionSet,
        place: int,
        *,
        has_legs: bool,
    ) -> None:
        self.watch, self.solve, self.has_legs = watch, solve, has_legs
        self.parameters = [0.0]
        self.states: list[Configuration] = [solutions.configurations[place]]
        self.labels = [solutions.labels[place]]
        self.events: list[Event] = []
        self._step = 1e-6
        self._unclear = 0  # shortest steps in a row that did not tell solutions apart

    def advance(self, stop: float) -> bool:
        """Follow the solution to `stop`; False where it ends before."""
        while self.parameters[-1] < stop:
            here = self.parameters[-1]
            ahead = min(stop, here + self._step)
            # A remainder of the size of rounding before the stop is not worth a step.
            ahead = stop if stop - ahead < 0.1 * _SHORTEST_STEP else ahead
            solutions = self.solve(ahead)
            place, clear = self._nearest(solutions, ahead)
            shortest = ahead - here <= _SHORTEST_STEP
            # Two solutions that nearly meet look like two that cross, except for their labels: labels are exchanged
            # only where the shortest step confirms it.
            same = place is not None and self._is_same(solutions.labels[place])
            if place is not None and ((clear and same) or (shortest and self._unclear < _MOST_UNCLEAR)):
                self._unclear = 0 if clear else self._unclear + 1
                if not same:
                    detail = f"{self.labels[-1]} becomes {solutions.labels[place]}"
                    self.events.append(Event(EventKind.SWITCH, ahead, detail))
                self.parameters.append(ahead)
                self.states.append(solutions.configurations[place])
                self.labels.append(self.labels[-1] if same else solutions.labels[place])
                self._step = 2.0 * (ahead - here)
            elif not shortest:
                self._step = 0.5 * (ahead - here)
            else:
                self._end(here)
                return False
        return True

    def _is_same(self, label: str) -> bool:
        return label == self.labels[-1] or not self.watch.has_labels

    def _nearest(self, solutions: SolutionSet, ahead: float) -> tuple[int | None, bool]:
        """Return the solution nearest to the predicted one, if any is near, and whether it clearly is."""
        here = self.states[-1].compared_points
        predicted = here
        if len(self.states) > 1:
            last = self.parameters[-1] - self.parameters[-2]
            predicted = here + (here - self.states[-2].compared_points) * (ahead - self.parameters[-1]) / last
        points = solutions.configurations.compared_points
        error = np.linalg.norm(points - predicted, axis=-1).max(axis=-1)
        error = np.where(solutions.exists, error, np.inf)
        order = error.argsort()
        nearest, others = int(order[0]), error[order[1:]].min(initial=np.inf)
        move = float(np.linalg.norm(points[nearest] - here, axis=-1).max())
        is_same = self._is_same(solutions.labels[nearest])
        longest = (_LONGEST_MOVE if is_same else _EXCHANGED) * self.watch.length
        if not np.isfinite(error[nearest]) or move > longest:
            return None, False
        rounding = 1e-12 * float(np.abs(here).max())
        return nearest, bool(error[nearest] <= _CLEARLY * others + rounding and others > 4 * rounding)

    def _end(self, parameter: float) -> None:
        reason = "which coincides with another solution"
        if self._unclear < _MOST_UNCLEAR:
            # Given leg lengths end at a forward singularity of a stage, given poses at an inverse one.
            state: Any = self.states[-1]
            sizes, details = np.abs(self.watch.determinants(state)), []
            for size, (kind, detail) in zip(sizes, self.watch.singularities, strict=True):
                if kind is EventKind.FORWARD_SINGULARITY:
                    details.append((float(size), f"forward, {detail}"))
            size, forward = min(details)
            reason = f"at a singularity: {forward if self.has_legs else 'inverse'}"
            legs = state.machine.legs
            slopes = np.abs(state.slopes) / legs.largest_slopes
            if not legs.are_rps and slopes.min() < (size if self.has_legs else _AT_END):
                leg = legs.names[int(slopes.argmin())]
                reason = f"at a singularity: of {leg}, whose actuator no longer moves its ball"
        self.events.append(Event(EventKind.END, parameter, f"{self.labels[-1]}, {reason}"))

    def state(self, parameter: float) -> Configuration:
        """Return the followed solution anywhere between two places where it is known."""
        k = int(np.clip(np.searchsorted(self.parameters, parameter), 1, len(self.parameters) - 1))
        low, high = self.parameters[k - 1], self.parameters[k]
        share = (parameter - low) / (high - low)
        between = (1.0 - share) * self.states[k - 1].compared_points + share * self.states[k].compared_points
        solutions = self.solve(parameter)
        error = np.linalg.norm(solutions.configurations.compared_points - between, axis=-1).max(axis=-1)
        return solutions.configurations[int(np.where(solutions.exists, error, np.inf).argmin())]


def find_events(watch: Watch, parameters: list[float], states: Any, state_at: Callable[[float], Any]) -> list[Event]:
    """Find the singularities and leg limits that a solution, `states` (n,) at the n parameters, meets."""
    values, events, limits, first = _monitored(watch, states), [], states.machine.limits, len(watch.singularities)
    rounding = np.zeros(values.shape[-1])
    if limits is not None:
        rounding[first:] = np.tile(limits.rounding, 2)
    values[np.abs(values) <= rounding] = 0.0
    for which in range(values.shape[-1]):
        column = values[:, which]

        def value(s: float, which: int = which) -> float:
            return float(_monitored(watch, state_at(s))[which])

        for k in range(len(parameters) - 1):
            low, high = parameters[k], parameters[k + 1]
            before, after = column[k : k + 2]
            if which >= first and min(before, after) < 0.0 == max(before, after):
                events.append(_event(watch, states.machine, which, high if before < 0.0 else low, after - before))
            brackets = [(low, high)]
            if before * after >= 0.0:
                brackets = _dip(value, parameters, column, k, -float(rounding[which]))
            for left, right in brackets:
                root = float(scipy.optimize.brentq(value, left, right, xtol=1e-13, rtol=8.9e-16))
                events.append(_event(watch, states.machine, which, root, value(right)))
    return events


def _monitored(watch: Watch, states: Any) -> FloatArray:
    """Return the functions whose zeros are events: of singularities, and with limits two of each leg, (..., n)."""
    scaled, limits = watch.determinants(states), states.machine.limits
    if limits is None:
        return scaled
    lengths, (minimum, maximum) = states.readings, states.machine.reading_limits
    # Where there is no limit, a number that is never zero.
    below = np.where(np.isfinite(minimum), lengths - minimum, 1.0)
    return np.concatenate([scaled, below, np.where(np.isfinite(maximum), maximum - lengths, 1.0)], axis=-1)


def _event(watch: Watch, machine: Machine, which: int, parameter: float, after: float) -> Event:
    if which < len(watch.singularities):
        kind, detail = watch.singularities[which]
        return Event(kind, parameter, detail)
    bound, leg = divmod(which - len(watch.singularities), len(machine.legs.names))
    verb = "comes back within" if after > 0.0 else "goes beyond"
    value = f"{('minimum', 'maximum')[bound]}, {machine.reading_limits[bound, leg]:g} {machine.legs.units[leg]}"
    return Event(EventKind.LIMIT, parameter, f"{machine.legs.names[leg]} {verb} its {value}")


def _dip(
    value: Callable[[float], float], parameters: list[float], column: FloatArray, k: int, deep: float
) -> list[tuple[float, float]]:
    """Return two brackets where a function of one sign at both ends crosses zero twice in between, down to `deep`."""
    if not 0 < k < len(parameters) - 2 or column[k] == 0.0 or column[k + 1] == 0.0:
        return []
    sign = float(np.sign(column[k]))
    slopes = np.diff(sign * column[k - 1 : k + 3]) / np.diff(parameters[k - 1 : k + 3])
    low, high = parameters[k], parameters[k + 1]
    # Tangents from both sides meet below zero only where a dip may reach it.
    deepest = min(sign * column[k] + slopes[0] * (high - low), sign * column[k + 1] - slopes[2] * (high - low))
    if not (slopes[0] < 0.0 < slopes[2] and deepest < 0.0):
        return []
    lowest = scipy.optimize.minimize_scalar(
        lambda s: sign * value(s), bounds=(low, high), method="bounded", options={"xatol": 1e-12}
    )
    return [(low, float(lowest.x)), (float(lowest.x), high)] if lowest.fun < deep else []
