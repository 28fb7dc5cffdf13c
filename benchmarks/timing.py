"""Timing of several calls in turns, so that a disturbance of the machine concerns all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Pace:
    """Number and length of the measurements.

    Attributes
    ----------
    rounds : int
        Turns of each call.
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
class TimedCall:
    """A call to be timed; it processes `items` items."""

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


def time_in_turns(timed_calls: Sequence[TimedCall], pace: Pace, progress: Progress) -> dict[str, Timing]:
    """Time all calls in `pace.rounds` rounds, each begun by another call.

    Each is called once before, so that nothing is compiled or read from disk while it is timed, and a second time to
    find how many calls fill a turn.
    """
    calls: list[int] = []
    for timed in timed_calls:
        progress(f"warming up {timed.name}")
        first = duration(timed.call)
        calls.append(1 if first > pace.turn else max(1, round(pace.turn / max(duration(timed.call), 1e-7))))
    seconds = np.empty((pace.rounds, len(timed_calls)))
    for k in range(pace.rounds):
        for step in range(len(timed_calls)):
            at = (k + step) % len(timed_calls)
            timed = timed_calls[at]
            progress(f"round {k + 1} of {pace.rounds}: {timed.name}")
            begin = time.perf_counter()
            for _ in range(calls[at]):
                timed.call()
            seconds[k, at] = (time.perf_counter() - begin) / (calls[at] * timed.items)
    return {timed.name: Timing(seconds[:, at]) for at, timed in enumerate(timed_calls)}
