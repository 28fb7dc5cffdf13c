"""The states nearest to given points or poses: least squares within leg limits by an augmented Lagrangian.

The point of the reachable set nearest to one outside obeys Eq. (1) of `docs/theory/reachable_set.md`, n being the
direction to the point outside and q_i = n·∂p/∂l_i. In the coordinates of the stages, with forward singularities as
limits too, these are the conditions of Karush, Kuhn and Tucker, and the q_i are the multipliers of the limits. They are
found by the method of multipliers, or augmented Lagrangian (Bertsekas, "Constrained Optimization and Lagrange
Multiplier Methods", 1982, chapter 3): violations of limits are penalised in the least squares, with a penalty weight
and shifted by the multipliers, which are updated until no limit is violated.

For three points, the platform's joints c_1, c_2, c_3, the same finds the nearest pose; n and q are those of all nine
coordinates over √3.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from spm_pin.mechanism.arguments import FloatArray, IntArray
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox
from spm_pin.workspace.reachability.membership import search_states
from spm_pin.workspace.reachability.portions import in_portions
from spm_pin.workspace.reachability.position_map import CENTRE
from spm_pin.workspace.reachability.state_search import RESOLUTION, SINGULARITY_MARGIN, StateSearch

_PENALTY_WEIGHTS = (1.0, 3.0, 10.0)
"""Penalty weights of the first minimisation, of the second and of the further ones, dimensionless."""
_REMOTE_PENALTY = 1000.0
"""Growth of the squared penalty weight with the distance from the target, per machine's size of distance."""
_UPDATES = 30
"""Updates of the multipliers at most."""
_RESTART = 10
"""Updates after which members that have not converged begin again with the first penalty weight."""
_MULTIPLIER_TOLERANCE = 1e-13
"""Change of the shifts, over the machine's size, at which the multipliers have converged."""
_STARTS = 1
"""Starts from the coarse search, after the state that `search_states` ended in."""
_REMOTE_STARTS = 3
"""Starts at the states of the box's sample whose positions are nearest to the point."""
_MODE_TOLERANCE = 1e-6
"""Distance, over the machine's size, of the position found from that of the lengths in the physical mode,
above which the search has left that mode."""
_ALL = slice(None)


class NearestPoints(NamedTuple):
    """Points of the reachable set, arrays over N."""

    position: FloatArray
    """The points (N, 3), in {B} [m]."""
    lengths: FloatArray
    """Leg lengths (N, 6) that put o there [m]; a leg at a limit has that limit to the last bit."""
    distance: FloatArray
    """Distances from the given points (N,) [m]."""
    gradient: FloatArray
    """The q_i of Eq. (1), (N, 6), with n towards the given point; zero where that is reachable."""
    optimality: FloatArray
    """By how much n and q miss the conditions of a nearest point, (N,); zero where the point is reachable. Infinite
    where the search has left the physical mode; then the state is the one it began with."""
    coordinates: FloatArray
    """The states (N, 2, 3) for `spm_pin.workspace.reachability.position_map`, to begin another search with."""

    def update(self, index: IntArray, other: NearestPoints, chosen: IntArray | slice = _ALL) -> None:
        """Put those points of `other` that are `chosen` in the places `index`."""
        for array, values in zip(self, other, strict=True):
            array[index] = values[chosen]


def nearest_in_box(box: LegLengthBox, points: FloatArray, starts: FloatArray | None = None) -> NearestPoints:
    """Return the points of the reachable set nearest to `points` (N, 3) [m].

    The search begins at `starts` (N, 2, 3), as in `NearestPoints.coordinates`. If not given, `search_states` says which
    points are reachable, and the others begin at the best states of `CoarseDistance.nearby`.
    """
    return NearestPoints(*in_portions(partial(_nearest, box), "nearest points", None, points, starts))


def _nearest(box: LegLengthBox, points: FloatArray, starts: FloatArray | None) -> NearestPoints:
    if starts is not None:
        first, choice = starts, starts[:, None]
    else:
        found = search_states(box, points)
        first = found.coordinates
        # Far away the state with the smallest residual is not the nearest.
        choice = np.repeat(first[:, None], 1 + _STARTS + _REMOTE_STARTS, axis=1)
        left = np.flatnonzero(~found.reached)
        choice[left, 1 : 1 + _STARTS] = box.coarse.nearby(points[left], _STARTS)[1]
        choice[left, 1 + _STARTS :] = box.sample[box.tree.query(points[left], _REMOTE_STARTS)[1]]
    return _result(box, points, first, nearest_states(box, points, choice))


def nearest_states(
    box: LegLengthBox, targets: FloatArray, starts: FloatArray, body: FloatArray = CENTRE
) -> StateSearch:
    """Search for the states within the limits with the points of `body` nearest to `targets`, as in `StateSearch`.

    From all `starts` (N, M, 2, 3) by the Gauss-Newton method, limits penalised; from the best of the M by Newton's
    method and updates of the multipliers.
    """
    count, members = starts.shape[1], np.arange(len(targets))
    search = StateSearch(box, np.repeat(targets, count, axis=0), starts.reshape(-1, 2, 3), body, SINGULARITY_MARGIN)
    _set_penalty(search, search.members, _PENALTY_WEIGHTS[0])
    search.iterate()
    best = search.residual_norm.reshape(-1, count).argmin(axis=1)
    search = StateSearch(
        box, targets, search.coordinates.reshape(-1, count, 2, 3)[members, best], body, SINGULARITY_MARGIN
    )
    active = np.flatnonzero(search.distance > RESOLUTION * box.size)
    for update in range(_UPDATES):
        if not len(active):
            break
        _set_penalty(search, active, _PENALTY_WEIGHTS[min(update % _RESTART, len(_PENALTY_WEIGHTS) - 1)])
        search.iterate(active, "Newton")
        before = search.shifts[active]
        search.shifts[active] = search.residual[active, -8:] / search.weights[active, None]
        search.refresh(active)
        change = np.abs(search.shifts[active] - before).max(axis=-1)
        active = active[~(search.stationary[active] & (change <= _MULTIPLIER_TOLERANCE * box.size))]
    return search


def _set_penalty(search: StateSearch, members: IntArray, weight: float) -> None:
    """Set the penalty weights of `members`, larger where the target is remote; their multipliers do not change."""
    before = search.weights[members, None]
    growth = np.maximum(1.0, _REMOTE_PENALTY * search.distance[members] / search.box.size)
    search.weights[members] = weight * np.sqrt(growth)
    search.shifts[members] *= (before / search.weights[members, None]) ** 2
    search.refresh(members)


def _result(box: LegLengthBox, points: FloatArray, first: FloatArray, search: StateSearch) -> NearestPoints:
    """Return the points at which a search for o ended, each state checked against the physical mode.

    A state that has left that mode is replaced by the one of `first` (N, 2, 3).
    """
    lengths = box.lengths(search.coordinates)
    lengths = np.where(search.shifts[:, :6] > 0.0, box.maximum, lengths)
    lengths = np.where(search.shifts[:, :6] < 0.0, box.minimum, lengths)
    kept, position = box.confirm(lengths, search.position, _MODE_TOLERANCE)
    position = np.where(kept[:, None], position, box.map.points(first)[0])
    lengths = np.where(kept[:, None], lengths, box.lengths(first))
    coordinates = np.where(kept[:, None, None], search.coordinates, first)
    distance = np.linalg.norm(points - position, axis=-1)
    remote = distance > RESOLUTION * box.size
    scale = np.where(remote, distance, np.inf)
    gradient = search.weights[:, None] ** 2 * search.shifts[:, :6] / scale[:, None]
    slope = np.einsum("nij,ni->nj", search.jacobian, search.residual)
    optimality = np.abs(slope).max(axis=-1, initial=0.0) / scale
    gradient[~kept], optimality[~kept] = 0.0, np.inf
    return NearestPoints(position, lengths, distance, gradient, optimality, coordinates)
