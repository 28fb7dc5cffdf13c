"""Where a segment from a reachable to an unreachable point leaves the reachable set.

From its outer end it is followed inwards, each time as far as the plane through the nearest reachable point, square to
the shortest way there.
"""

from __future__ import annotations

import numpy as np

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.nearest import RESOLUTION, merged, nearest_in_box

__all__ = ["crossing"]

_TRIES = 5
_STEPS = 60
_SHARP = 1e-7
_SHY = 0.02
_BEYOND = 1e-4


def crossing(box: LegBox, inner: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find where segments from reachable to unreachable points leave the reachable set.

    Parameters
    ----------
    box : LegBox
        The leg lengths.
    inner, outer : ndarray, shape (N, 3)
        The ends [m].

    Returns
    -------
    points : ndarray, shape (N, 3)
        On the segments [m], to 1e-7 of their length.
    lengths : ndarray, shape (N, 6)
        Lengths that put o there [m].
    """
    along = outer - inner
    count = len(along)
    at, lengths = np.ones(count), np.empty((count, 6))
    low = np.zeros(count)
    going, followed = np.arange(count), True
    while len(going):
        at[going], lengths[going] = _left(box, inner[going], along[going], low[going], followed=followed)
        # Following one nearest point inwards, another may be overlooked: just outside nothing must be reachable.
        beyond = np.minimum(at[going] + _BEYOND, 1.0)
        found = nearest_in_box(box, inner[going] + beyond[:, None] * along[going], tries=_TRIES)
        again = (found.distance <= RESOLUTION * box.size) & (beyond < 1.0)
        low[going] = np.where(again, beyond, low[going])
        going, followed = going[again], False
    return inner + at[:, None] * along, lengths


def _left(
    box: LegBox, inner: FloatArray, along: FloatArray, low: FloatArray, *, followed: bool
) -> tuple[FloatArray, FloatArray]:
    """Return at which share of `along` (N, 3) the set is left, between `low` and 1, (N,), and leg lengths (N, 6)."""
    low, high, at = low.copy(), np.ones(len(along)), np.ones(len(along))
    lengths = np.empty((len(along), 6))
    going, tries = np.arange(len(along)), _TRIES
    starts = None
    within_reach = nearest_in_box(box, inner, None, _TRIES).coordinates
    size = np.sqrt((along**2).sum(axis=-1))
    for _ in range(_STEPS):
        if not len(going):
            break
        here = at[going]
        asked = inner[going] + here[:, None] * along[going]
        found = nearest_in_box(box, asked, starts, tries)
        # A reachable point on the segment is nearer than that: the search has to begin there.
        wrong = np.flatnonzero(found.distance > (here - low[going]) * size[going] + RESOLUTION * box.size)
        found = merged(found, wrong, nearest_in_box(box, asked[wrong], within_reach[going[wrong]]))
        reached = found.distance <= RESOLUTION * box.size
        within_reach[going[reached]] = found.coordinates[reached]
        low[going] = np.where(reached, here, low[going])
        high[going] = np.where(reached, high[going], here)
        # Of the outermost state: its legs are at limits to the last bit.
        lengths[going] = np.where(reached[:, None], lengths[going], found.lengths)
        towards = ((inner[going] + here[:, None] * along[going] - found.position) * along[going]).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = here - np.where(towards > 0.0, found.distance**2 / towards, 2.0)
        within = ~reached & (plane > low[going])
        done = (within & (here - plane <= _SHARP)) | (high[going] - low[going] <= _SHARP)
        # Not quite as far, to arrive from outside: there the next plane is.
        at[going] = np.where(within, plane + _SHY * (here - plane), 0.5 * (low[going] + high[going]))
        going = going[~done]
        if followed:
            starts, tries = found.coordinates[~done], 1
    return at, lengths
