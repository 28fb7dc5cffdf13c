"""Timing side by side: contestants take turns, so that what disturbs the machine disturbs all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Contestant", "Pace", "Spread", "Timing", "duration", "race"]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Pace:
    """How thoroughly to measure.

    Attributes
    ----------
    rounds : int
        Turns of each contestant.
    turn : float
        Length of a turn [s]; one call, where that takes longer.
    quick : bool
        Smaller batches, and fewer of them.
    full : bool
        The largest batches too.
    """

    rounds: int
    turn: float
    quick: bool = False
    full: bool = False


@dataclass(frozen=True)
class Contestant:
    """A call that handles `items` things."""

    name: str
    call: Callable[[], object]
    items: int


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of a sample."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, sample: npt.ArrayLike) -> Spread:
        """Summarise a sample."""
        low, median, high = np.quantile(np.asarray(sample, dtype=np.float64), [0.25, 0.5, 0.75])
        return cls(float(median), float(low), float(high))


@dataclass(frozen=True)
class Timing:
    """Seconds per item in each round."""

    seconds: npt.NDArray[np.float64]

    @property
    def spread(self) -> Spread:
        """Median and quartiles [s]."""
        return Spread.of(self.seconds)

    def over(self, other: Timing) -> Spread:
        """Return how many times as long as `other` this takes, from the ratios within each round."""
        return Spread.of(self.seconds / other.seconds)


def duration(call: Callable[[], object]) -> float:
    """Return the time of one call [s]."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def race(contestants: Sequence[Contestant], pace: Pace, progress: Progress) -> dict[str, Timing]:
    """Let all contestants take `pace.rounds` turns, each round begun by another one.

    Every contestant is called once before, so that nothing is compiled or read from disk on the clock, and a second
    time to see how many calls fill a turn.
    """
    calls: list[int] = []
    for contestant in contestants:
        progress(f"warming up {contestant.name}")
        first = duration(contestant.call)
        calls.append(1 if first > pace.turn else max(1, round(pace.turn / max(duration(contestant.call), 1e-7))))
    seconds = np.empty((pace.rounds, len(contestants)))
    for k in range(pace.rounds):
        for step in range(len(contestants)):
            at = (k + step) % len(contestants)
            contestant = contestants[at]
            progress(f"round {k + 1} of {pace.rounds}: {contestant.name}")
            begin = time.perf_counter()
            for _ in range(calls[at]):
                contestant.call()
            seconds[k, at] = (time.perf_counter() - begin) / (calls[at] * contestant.items)
    return {contestant.name: Timing(seconds[:, at]) for at, contestant in enumerate(contestants)}
