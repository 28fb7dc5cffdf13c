"""Preparation of the peers of one task, and the table of their times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.peers.peer import Peer, Unavailable
from benchmarks.peers.peers_by_task import OURS
from benchmarks.report import Section, count, spread_of_seconds, table, times
from benchmarks.timing import Pace, TimedCall, Timing, time_in_turns

Progress = Callable[[str], None]


@dataclass
class PreparedPeers:
    """Peers ready to be timed, and the reasons why others are missing."""

    timed_calls: list[TimedCall] = field(default_factory=list)
    computes: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    def add(self, other: PreparedPeers) -> None:
        """Add the peers of `other`."""
        self.timed_calls += other.timed_calls
        self.computes |= other.computes
        self.missing |= other.missing


def items_of(peer: Peer, pace: Pace) -> int:
    """Return the number of problems that a peer solves per call."""
    return max(1, peer.items // 10) if pace.quick else peer.items


def failure(error: Exception) -> str:
    """Return the reason why a peer that raised `error` is left out; the run goes on without it."""
    return f"failed: {type(error).__name__}: {' '.join(str(error).split())[:200]}"


def prepare_peers(
    peers: Sequence[Peer], problem: Callable[[int], Any], pace: Pace, progress: Progress
) -> PreparedPeers:
    """Prepare all peers; `problem(n)` returns the task's problem with n items.

    A peer that cannot be prepared is listed with the reason; a failure of this package is raised.
    """
    ready = PreparedPeers()
    for peer in peers:
        progress(f"preparing {peer.name}")
        items = items_of(peer, pace)
        try:
            prepared = peer.prepare(problem(items))
            prepared.call()
        except Unavailable as reason:
            ready.missing[peer.name] = str(reason)
            continue
        except Exception as error:
            if peer.name == OURS:
                raise
            ready.missing[peer.name] = failure(error)
            continue
        ready.timed_calls.append(TimedCall(peer.name, prepared.call, items))
        ready.computes[peer.name] = peer.computes
    return ready


def compare(
    section: Section, peers: PreparedPeers, pace: Pace, progress: Progress, *, item: str = "pose"
) -> dict[str, Timing]:
    """Time the peers in turns; add a table of times and of ratios to this package."""
    timings = time_in_turns(peers.timed_calls, pace, progress)
    ours = timings[OURS]
    rows = []
    for timed in peers.timed_calls:
        timing = timings[timed.name]
        ratio = ["1", ""] if timed.name == OURS else times(timing.over(ours))
        labels = [timed.name, peers.computes[timed.name], count(timed.items)]
        rows.append([*labels, *spread_of_seconds(timing.spread), *ratio])
    rows += [[name, f"*missing: {reason}*", *[""] * 5] for name, reason in peers.missing.items()]
    header = ["", "on the clock", f"{item}s a call", f"per {item}", "quartiles", f"× {OURS}", "quartiles"]
    section.add(table(header, rows, left=2))
    return timings
