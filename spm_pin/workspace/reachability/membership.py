"""Which points are reachable: a search for a state within the limits at each.

The search begins at states that `CoarseDistance.nearby` finds by going through all of the set. One that it finds is a
proof, see `spm_pin.workspace.reachability.state_search`.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from spm_pin.mechanism.arguments import BoolArray, FloatArray, Progress
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox
from spm_pin.workspace.reachability.portions import in_portions
from spm_pin.workspace.reachability.state_search import RESOLUTION, StateSearch

_OTHERS, _SPREAD = 7, 24
"""Starts after the best one: the next best, and different ones, as near the rim all good states may be elsewhere."""


class Membership(NamedTuple):
    """Which of N points are reachable."""

    reached: BoolArray
    """Points with a state, which proves it, (N,)."""
    undecided: BoolArray
    """Points (N,) without one for which a search failed: it ended in another assembly mode, or stalled just short of a
    state."""
    coordinates: FloatArray
    """The states (N, 2, 3); where there is none, those found with the smallest residual norm."""
    distance: FloatArray
    """How far the reachable set is, to about two spacings of the box's table (N,) [m]; zero where reached."""


def search_states(
    box: LegLengthBox,
    points: FloatArray,
    starts: FloatArray | None = None,
    *,
    what: str = "",
    progress: Progress | None = None,
) -> Membership:
    """Search for states within the limits that put o at `points` (N, 3), in {B} [m].

    With `starts` (N, 2, 3) the search begins at one state for each point, instead of those of `CoarseDistance.nearby`,
    and `distance` is that of the start. `what` says what is being done, for `progress`.
    """
    return Membership(*in_portions(partial(_searched, box), what, progress, points, starts))


def _searched(box: LegLengthBox, points: FloatArray, near: FloatArray | None) -> Membership:
    counts: tuple[int, ...] = (1, _OTHERS, _SPREAD)
    if near is None:
        distance, starts = box.coarse.nearby(points)
        left = np.flatnonzero(distance <= box.coarse.margin)
    else:
        distance, starts = np.linalg.norm(box.map.points(near)[0] - points, axis=-1), near[:, None]
        counts, left = (1,), np.arange(len(points))
    coordinates, undecided = starts[:, 0].copy(), np.zeros(len(points), dtype=bool)
    least, tolerance = np.full(len(points), np.inf), RESOLUTION * box.size
    # The best start by itself, as it is enough for most; then others for the points that are left.
    for count in counts:
        chosen = starts[left]
        if count > 1:
            chosen = box.coarse.nearby(points[left], count + 1, spread=count == _SPREAD)[1][:, 1:]
        search = StateSearch(box, np.repeat(points[left], count, axis=0), chosen.reshape(-1, 2, 3))
        search.iterate()
        good, doubtful = (mask.reshape(-1, count) for mask in search.proved())
        norm = np.where(good, 0.0, search.residual_norm.reshape(-1, count) + tolerance)
        best = np.arange(len(left)), norm.argmin(axis=1)
        better = norm[best] < least[left]
        coordinates[left[better]] = search.coordinates.reshape(-1, count, 2, 3)[best][better]
        least[left[better]] = norm[best][better]
        undecided[left] |= doubtful.any(axis=1)
        left = left[~good.any(axis=1)]
    reached = least == 0.0
    return Membership(reached, undecided & ~reached, coordinates, np.where(reached, 0.0, np.maximum(distance, 0.0)))
