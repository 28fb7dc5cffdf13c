"""Intersection of the boundary with a segment from a reachable to an unreachable point.

Outside the reachable set the gap that a search for a state leaves falls towards the boundary, as fast as the error of o
along the segment says. So from the outer end the segment is followed inwards by Newton's method. Where that has
overlooked reachable points farther out, or no lengths put o where it ends, the interval is halved instead.
"""

from __future__ import annotations

import numpy as np

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_box import LegBox
from spm_pin.workspace.reachability.nearest import CLEAR
from spm_pin.workspace.reachability.state_search import StateSearch, search_states

__all__ = ["crossing"]

_STEPS = 40
_SHARP = 1e-7
_HALVINGS = 24
_SHY = 0.02
_BEYOND = 1e-4
_EXACT = 1e-7


def crossing(box: LegBox, inner: FloatArray, outer: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where segments leave the reachable set, points (N, 3) [m] to 1e-7 of their length, and leg lengths (N, 6).

    They go from reachable points `inner` to unreachable ones `outer`, (N, 3) [m]; `states` (N, 2, 3) put o at `inner`.
    """
    along = outer - inner
    at, low, within, outermost = _followed(box, inner, along, states)
    # Of the outermost state, legs are beyond limits by what is left of the gap.
    lengths = np.clip(box.map.lengths(outermost), box.minimum, box.maximum)
    there = forward_physical(box.geometry, lengths).translation
    with np.errstate(invalid="ignore"):
        proved = np.abs(there - inner - at[:, None] * along).max(axis=-1, initial=0.0) <= _EXACT * box.size
    # Following one state inwards, another may be overlooked: just outside nothing must be reachable.
    high = np.minimum(at + _BEYOND, 1.0)
    beyond = search_states(box, inner + high[:, None] * along)
    farther = beyond.reached & (high < 1.0)
    low, within = np.where(farther, high, low), np.where(farther[:, None, None], beyond.coordinates, within)
    high = np.where(farther, 1.0, high)
    left = np.flatnonzero(farther | ~proved)
    for _ in range(_HALVINGS if len(left) else 0):
        middle = 0.5 * (low[left] + high[left])
        search = StateSearch(box, inner[left] + middle[:, None] * along[left], within[left])
        search.iterate(np.arange(len(left)))
        good, _ = search.proved()
        within[left[good]] = search.coordinates[good]
        low[left], high[left] = np.where(good, middle, low[left]), np.where(good, high[left], middle)
    at[left], lengths[left] = low[left], box.snapped(box.map.lengths(within[left]))
    return inner + at[:, None] * along, lengths


def _followed(
    box: LegBox, inner: FloatArray, along: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return at which share of `along` (N, 3) the set is left, and where o was found within it before, (N,) each.

    And the states (N, 2, 3) within, and nearest to the end.
    """
    low, high, at = np.zeros(len(along)), np.ones(len(along)), np.ones(len(along))
    within, outermost = states.copy(), states.copy()
    going = np.arange(len(along))
    for _ in range(_STEPS):
        if not len(going):
            break
        here = at[going]
        search = StateSearch(box, inner[going] + here[:, None] * along[going], outermost[going], clear=CLEAR)
        search.iterate(np.arange(len(going)))
        reached, _ = search.proved()
        within[going[reached]] = search.coordinates[reached]
        outermost[going] = search.coordinates
        low[going] = np.where(reached, here, low[going])
        high[going] = np.where(reached, high[going], here)
        towards = -(search.error * along[going]).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = here - np.where(towards > 0.0, search.gap**2 / towards, 2.0)
        ahead = ~reached & (plane > low[going])
        done = (ahead & (here - plane <= _SHARP)) | (high[going] - low[going] <= _SHARP)
        # Not quite as far, to arrive from outside: there the next plane is.
        at[going] = np.where(ahead, plane + _SHY * (here - plane), 0.5 * (low[going] + high[going]))
        going = going[~done]
    return at, low, within, outermost
