"""Peers at the start: prepared, or listed with the reason why they are not there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.peers.contests import OURS
from benchmarks.peers.peer import Peer, Unavailable
from benchmarks.report import Section, count, spread_of_seconds, table, times
from benchmarks.timing import Contestant, Pace, Timing, race

__all__ = ["Field", "compare", "enter", "failure", "items_of"]

Progress = Callable[[str], None]


@dataclass
class Field:
    """Contestants, and who is missing."""

    contestants: list[Contestant] = field(default_factory=list)
    computes: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    def add(self, other: Field) -> None:
        """Let others join."""
        self.contestants += other.contestants
        self.computes |= other.computes
        self.missing |= other.missing


def items_of(peer: Peer, pace: Pace) -> int:
    """Return how many problems a peer gets per call."""
    return max(1, peer.items // 10) if pace.quick else peer.items


def failure(error: Exception) -> str:
    """Say why a peer is left out: other people's packages change, and the rest of a run is still worth having."""
    return f"failed: {type(error).__name__}: {' '.join(str(error).split())[:200]}"


def enter(peers: Sequence[Peer], problem: Callable[[int], Any], pace: Pace, progress: Progress) -> Field:
    """Prepare all peers; `problem` makes the contest's problem of a given size.

    A peer that cannot take part is listed with its reason. Ours must.
    """
    entered = Field()
    for peer in peers:
        progress(f"preparing {peer.name}")
        items = items_of(peer, pace)
        try:
            prepared = peer.prepare(problem(items))
            prepared.call()
        except Unavailable as reason:
            entered.missing[peer.name] = str(reason)
            continue
        except Exception as error:
            if peer.name == OURS:
                raise
            entered.missing[peer.name] = failure(error)
            continue
        entered.contestants.append(Contestant(peer.name, prepared.call, items))
        entered.computes[peer.name] = peer.computes
    return entered


def compare(
    section: Section, entered: Field, pace: Pace, progress: Progress, *, item: str = "pose"
) -> dict[str, Timing]:
    """Race the contestants and add a table of times and ratios to ours."""
    timings = race(entered.contestants, pace, progress)
    ours = timings[OURS]
    rows = []
    for contestant in entered.contestants:
        timing = timings[contestant.name]
        ratio = ["1", ""] if contestant.name == OURS else times(timing.over(ours))
        told = [contestant.name, entered.computes[contestant.name], count(contestant.items)]
        rows.append([*told, *spread_of_seconds(timing.spread), *ratio])
    rows += [[name, f"*missing: {reason}*", *[""] * 5] for name, reason in entered.missing.items()]
    header = ["", "on the clock", f"{item}s a call", f"per {item}", "quartiles", f"× {OURS}", "quartiles"]
    section.add(table(header, rows, left=2))
    return timings
