"""Times of every single call of the exported C: a controller must wait for the slowest."""

from __future__ import annotations

import numpy as np

import spm_pin as spm
from benchmarks.peers.exported import CALLS, call_times
from benchmarks.peers.peer import Unavailable
from benchmarks.poses import GEOMETRY, leg_space
from benchmarks.report import Facts, Section, count, seconds, table
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace

__all__ = ["measure"]

_CHANGE = 1e-3
_STATES = 10_000


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time each call of the exported functions."""
    del facts
    section = Section("The exported C, call by call")
    calls = 100_000 if pace.quick else 1_000_000
    progress(f"{count(calls)} calls of each exported function")
    states = spm.inverse_physical(GEOMETRY, leg_space(_STATES))
    try:
        times, failed = call_times(states, _CHANGE, calls)
    except Unavailable as reason:
        section.add(f"Not timed: {reason}.")
        return section
    section.add(
        f"`spm-pin export c`, `cc -std=c99 -O2`, {count(calls)} calls of each function on states of leg lengths drawn "
        "uniformly from the limits, each between two readings of the clock; a state `near` is up to "
        f"{1e3 * _CHANGE:g} mm a leg, or in each direction, away. The worst calls are those that the system "
        "interrupted, as the row of the clock shows; the slowest state is the one whose calls have the largest median."
    )
    rows = []
    for name, seconds_of_calls, none in zip(CALLS, times, failed, strict=True):
        slowest = np.median(seconds_of_calls.reshape(-1, _STATES), axis=0).max()
        numbers = *np.quantile(seconds_of_calls, [0.5, 0.999, 1.0]), slowest
        rows.append([name, *(seconds(float(x)) for x in numbers), count(none)])
    section.add(table(["", "median", "99.9 %", "worst", "slowest state", "not found"], rows))
    return section
