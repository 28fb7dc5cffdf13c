"""Table 6 read as data: the 24 sub-workspaces as faces of the box of leg lengths.

Where the legs are limited to [min, max], their six lengths fill a box. A sub-workspace fixes four of them at limits and
lets two vary: it is one of the 240 square faces of that box. Neighbours share an edge, where a single leg varies, and
this is combinatorics, settled before any position is computed.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism.arguments import IntArray
from spm_pin.paper import published

Corner = tuple[int, ...]

ERRATA = {("St3", "r_b1"): "mmax", ("Sm3", "r_b3"): "min", ("Sm5", "r_b3"): "bmin~mmax"}
"""Misprinted cells of Table 6, by surface and leg, as printed. The stage's letter is missing or another; the column
has it. A missing "~" needs no mention: two limits in one cell can mean nothing else."""


class Setting(enum.Enum):
    """Setting of a leg in Table 6; the value is the text of the table."""

    MINIMUM = "min"
    MAXIMUM = "max"
    VARIES = "min~max"


@dataclass(frozen=True)
class SubWorkspace:
    """A row of Table 6."""

    name: str
    """The paper's name: St1 to St3, Sc1 to Sc9, Sm1 to Sm9, Sl1 to Sl3."""
    settings: tuple[Setting, ...]
    """The setting of each leg, in the order of `LEGS`; two legs vary."""

    @property
    def family(self) -> str:
        """The name without its number: St, Sc, Sm or Sl."""
        return self.name.rstrip("0123456789")

    @property
    def varying(self) -> tuple[int, int]:
        """The two legs that vary, counted as in `LEGS`."""
        first, second = (leg for leg, setting in enumerate(self.settings) if setting is Setting.VARIES)
        return first, second

    def increments(self, resolution: int) -> IntArray:
        """Return the increments of the six legs above their minima, (resolution + 1, resolution + 1, 6).

        The first varying leg changes along the first axis, the other along the second.
        """
        at = {Setting.MINIMUM: 0, Setting.MAXIMUM: resolution, Setting.VARIES: 0}
        steps = np.empty((resolution + 1, resolution + 1, 6), dtype=np.intp)
        steps[:] = [at[setting] for setting in self.settings]
        first, second = self.varying
        steps[..., first] = np.arange(resolution + 1)[:, None]
        steps[..., second] = np.arange(resolution + 1)
        return steps

    @property
    def corners(self) -> tuple[Corner, ...]:
        """The four corners, 0 at a minimum and 1 at a maximum, going round: first leg out, second out, both back."""
        square = self.increments(1)
        return tuple(tuple(int(x) for x in square[at]) for at in ((0, 0), (1, 0), (1, 1), (0, 1)))

    @property
    def sides(self) -> tuple[tuple[Corner, Corner], ...]:
        """The four edges in the same sense, each from one corner to the next."""
        ring = self.corners
        return tuple(zip(ring, (*ring[1:], ring[0]), strict=True))


def sub_workspaces() -> tuple[SubWorkspace, ...]:
    """Return the rows of Table 6."""
    return tuple(SubWorkspace(name, tuple(map(_setting, cells))) for name, *cells in published.TABLE_6)


def _setting(cell: str) -> Setting:
    """Return the setting in a cell of the table: the limit is legible, whatever letter stands before it."""
    first, *last = cell.replace("~", " ").split()
    return Setting.VARIES if last else Setting(first[-3:])


def orientations(rows: Sequence[SubWorkspace]) -> tuple[int, ...]:
    """Return for each row 1 or -1, such that neighbours run along their common edge in opposite senses.

    The rows join to a closed surface: every edge is shared by exactly two. The first row has 1. All of them times -1 is
    the other possibility; which one points outwards is for the positions to say.
    """
    shared: dict[frozenset[Corner], list[tuple[int, int]]] = {}
    for k, row in enumerate(rows):
        for start, end in row.sides:
            shared.setdefault(frozenset((start, end)), []).append((k, 1 if start < end else -1))
    sense = {0: 1}
    for _ in rows:
        for (i, along), (j, across) in shared.values():
            if i in sense:
                sense.setdefault(j, -along * across * sense[i])
            elif j in sense:
                sense[i] = -along * across * sense[j]
    return tuple(sense[k] for k in range(len(rows)))
