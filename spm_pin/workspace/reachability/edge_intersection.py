"""Intersection of the boundary with a segment from a reachable to an unreachable point.

From its outer end it is followed inwards, each time as far as the plane through the nearest reachable point, square to
the shortest way there. Where that has overlooked reachable points farther out, the interval is halved instead.
"""

from __future__ import annotations

import numpy as np

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.nearest import merged, nearest_in_box
from spm_pin.workspace.reachability.state_search import RESOLUTION, search_states

__all__ = ["crossing"]

_STEPS = 60
_SHARP = 1e-7
_HALVINGS = 24
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
    at, lengths = _followed(box, inner, along)
    # Following one nearest point inwards, another may be overlooked: just outside nothing must be reachable.
    low, high = at + _BEYOND, np.ones(len(along))
    found = search_states(box, inner + low[:, None] * along)
    wrong = np.flatnonzero(found.reached & (low < 1.0))
    legs, states = found.lengths, found.coordinates
    for _ in range(_HALVINGS if len(wrong) else 0):
        middle = 0.5 * (low[wrong] + high[wrong])
        found = search_states(box, inner[wrong] + middle[:, None] * along[wrong], states[wrong])
        reached = wrong[found.reached]
        low[wrong], high[wrong] = (
            np.where(found.reached, middle, low[wrong]),
            np.where(found.reached, high[wrong], middle),
        )
        legs[reached], states[reached] = found.lengths[found.reached], found.coordinates[found.reached]
    at[wrong], lengths[wrong] = low[wrong], legs[wrong]
    return inner + at[:, None] * along, lengths


def _followed(box: LegBox, inner: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at which share of `along` (N, 3) the set is left, (N,), and leg lengths (N, 6)."""
    low, high, at = np.zeros(len(along)), np.ones(len(along)), np.ones(len(along))
    inside = search_states(box, inner)
    within_reach, lengths = inside.coordinates, inside.lengths.copy()
    starts = within_reach.copy()
    size = np.sqrt((along**2).sum(axis=-1))
    going = np.arange(len(along))
    for _ in range(_STEPS):
        if not len(going):
            break
        here = at[going]
        points = inner[going] + here[:, None] * along[going]
        found = nearest_in_box(box, points, starts)
        # A reachable point on the segment is nearer than that: the search has to begin there.
        wrong = np.flatnonzero(found.distance > (here - low[going]) * size[going] + RESOLUTION * box.size)
        found = merged(found, wrong, nearest_in_box(box, points[wrong], within_reach[going[wrong]]))
        reached = found.distance <= RESOLUTION * box.size
        within_reach[going[reached]] = found.coordinates[reached]
        low[going] = np.where(reached, here, low[going])
        high[going] = np.where(reached, high[going], here)
        # Of the outermost state: its legs are at limits to the last bit.
        lengths[going] = np.where(reached[:, None], lengths[going], found.lengths)
        towards = ((points - found.position) * along[going]).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = here - np.where(towards > 0.0, found.distance**2 / towards, 2.0)
        within = ~reached & (plane > low[going])
        done = (within & (here - plane <= _SHARP)) | (high[going] - low[going] <= _SHARP)
        # Not quite as far, to arrive from outside: there the next plane is.
        at[going] = np.where(within, plane + _SHY * (here - plane), 0.5 * (low[going] + high[going]))
        going, starts = going[~done], found.coordinates[~done]
    return at, lengths
