"""The states nearest to given points or poses: least squares in the box of the leg lengths.

In one assembly mode the six lengths l determine where points of the platform are. For the platform's centre o alone, in
the mode of a real machine, the reachable positions are the image W of the box of the limits under that map p(l). The
point of W nearest to y minimises |p(l) - y|² over the box. Where that is zero y is reachable; elsewhere
n = (y - p)/|y - p| is an outward normal of W, and with the gradient q_i = n·∂p/∂l_i

    q_i = 0 for a free leg,    q_i ≥ 0 for one at its maximum,    q_i ≤ 0 for one at its minimum.            (1)

So a leg is at a limit, or n annihilates the whole 3 x 6 Jacobian of the position, which then has lost its rank; or a
stage is at a forward singularity, where p has no derivative. In the coordinates c of the stages all these are the
conditions of Karush, Kuhn and Tucker, with q as the multipliers of the limits. They are found by the method of
multipliers (Bertsekas, "Constrained Optimization and Lagrange Multiplier Methods", 1982, chapter 3): what is outside
limits counts in the least squares, and limits are shifted against it until nothing is.

For three points, the platform's joints c_1, c_2, c_3, the same finds the nearest pose; n and q are those of all nine
coordinates over √3.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox
from spm_pin.workspace.reachability.state_search import RESOLUTION, StateSearch, in_portions, search_states

__all__ = ["CLEAR", "Nearest", "approach", "merged", "nearest_in_box", "settle"]

IntArray = npt.NDArray[np.intp]

CLEAR = 1e-6
"""How far from forward singularities states are kept: nearer, rounding of the lengths moves o farther than that."""
_ROUNDS, _ANEW = 30, 10
_WEIGHTS, _REMOTE = (1.0, 3.0, 10.0), 1000.0
_STEPS, _PROGRESS = 200, 1e-6
_SHIFTED = 1e-13
_FLAT = 1e-9
"""Slope at which no change of the state makes the distance shorter."""
_STARTS, _REMOTE_STARTS = 1, 3
_STRAYED = 1e-6


class Nearest(NamedTuple):
    """Points of the reachable set, arrays over N."""

    position: FloatArray  # the points (N, 3), in {B} [m]
    lengths: FloatArray  # (N, 6), which put o there [m]; a leg at a limit has that limit to the last bit
    distance: FloatArray  # (N,), from the given point [m]
    gradient: FloatArray  # q of Eq. (1), (N, 6), with n towards the given point; zero where that is reachable
    optimality: FloatArray
    """By how much n and q miss the conditions of a nearest point, (N,); zero where the point is reachable. Infinite
    where the search has left the mode of a real machine; then the state is the one it began with."""
    coordinates: FloatArray
    """The states (N, 2, 3) for `spm_pin.workspace.reachability.position_map`, to begin another search with."""

    def part(self, index: IntArray) -> Nearest:
        """Return some of the N."""
        return Nearest(*(array[index] for array in self))


def merged(whole: Nearest, index: IntArray, part: Nearest) -> Nearest:
    """Return `whole` with `part` in the places `index`."""
    arrays = [array.copy() for array in whole]
    for array, values in zip(arrays, part, strict=True):
        array[index] = values
    return Nearest(*arrays)


def nearest_in_box(box: LegLengthBox, points: FloatArray, starts: FloatArray | None = None) -> Nearest:
    """Return the points of the reachable set nearest to `points` (N, 3) [m].

    The search begins at `starts` (N, 2, 3), as in `Nearest.coordinates`. If not given, `search_states` says which
    points are reachable, and the others begin at the best states of `LegLengthBox.nearby`.
    """
    given = [points] if starts is None else [points, starts]
    return Nearest(*in_portions(partial(_nearest, box), "nearest points", None, *given))


def _nearest(box: LegLengthBox, points: FloatArray, starts: FloatArray | None = None) -> Nearest:
    if starts is not None:
        first, choice = starts, starts[:, None]
    else:
        found = search_states(box, points)
        first = found.coordinates
        # Far away what misses least is not the nearest.
        choice = np.repeat(first[:, None], 1 + _STARTS + _REMOTE_STARTS, axis=1)
        left = np.flatnonzero(~found.reached)
        choice[left, 1 : 1 + _STARTS] = box.nearby(points[left], _STARTS)[1]
        choice[left, 1 + _STARTS :] = box.sample[box.tree.query(points[left], _REMOTE_STARTS)[1]]
    search = approach(box, points, choice, clear=CLEAR)
    settle(search)
    return _result(box, points, first, search)


def approach(box: LegLengthBox, targets: FloatArray, starts: FloatArray, **options: Any) -> StateSearch:
    """Go from all `starts` (N, M, 2, 3) by Gauss-Newton, with limits that give way, and return a search at the best.

    `options` are those of `StateSearch`.
    """
    count, members = starts.shape[1], np.arange(len(targets))
    search = StateSearch(box, np.repeat(targets, count, axis=0), starts.reshape(-1, 2, 3), **options)
    everywhere = np.arange(len(search.targets))
    _weigh(search, everywhere, _WEIGHTS[0])
    search.iterate(everywhere)
    best = search.gap.reshape(-1, count).argmin(axis=1)
    return StateSearch(box, targets, search.coordinates.reshape(-1, count, 2, 3)[members, best], **options)


def settle(search: StateSearch) -> None:
    """Go from there to the nearest state within the limits, by Newton's method."""
    active = np.flatnonzero(search.distance > RESOLUTION * search.box.size)
    for count in range(_ROUNDS):
        if not len(active):
            break
        # Members that stall on the way begin anew with limits that give way more.
        _weigh(search, active, _WEIGHTS[min(count % _ANEW, len(_WEIGHTS) - 1)])
        search.iterate(active, exact=True, flat=_FLAT, progress=_PROGRESS, steps=_STEPS)
        before = search.shifts[active]
        search.shifts[active] = search.residual[active, -8:] / search.weights[active, None]
        search.refresh(active)
        change = np.abs(search.shifts[active] - before).max(axis=-1)
        active = active[~(search.flat[active] & (change <= _SHIFTED * search.box.size))]


def _weigh(search: StateSearch, members: IntArray, weight: float) -> None:
    """Set what legs outside limits weigh: more where the target is remote. Forces of the limits stay what they are."""
    before = search.weights[members, None]
    search.weights[members] = weight * np.sqrt(np.maximum(1.0, _REMOTE * search.distance[members] / search.box.size))
    search.shifts[members] *= (before / search.weights[members, None]) ** 2
    search.refresh(members)


def _result(box: LegLengthBox, points: FloatArray, first: FloatArray, search: StateSearch) -> Nearest:
    """Return what was found by a search for o, each state checked against the mode of a real machine.

    One that has left it is replaced by the state that it began with.
    """
    lengths = box.snapped(box.map.lengths(search.coordinates))
    lengths = np.where(search.shifts[:, :6] > 0.0, box.maximum, lengths)
    lengths = np.where(search.shifts[:, :6] < 0.0, box.minimum, lengths)
    states = forward_physical(box.geometry, lengths)
    position, coordinates = states.translation.copy(), search.coordinates
    with np.errstate(invalid="ignore"):
        strayed = ~(np.abs(position - search.position).max(axis=-1, initial=0.0) <= _STRAYED * box.size)
    coordinates[strayed] = first[strayed]
    position[strayed], lengths[strayed] = (
        array[strayed] for array in (box.map.points(first)[0], box.map.lengths(first))
    )
    distance = np.sqrt(((points - position) ** 2).sum(axis=-1))
    remote = distance > RESOLUTION * box.size
    scale = np.where(remote, distance, np.inf)
    gradient = search.weights[:, None] ** 2 * search.shifts[:, :6] / scale[:, None]
    slope = np.einsum("nij,ni->nj", search.jacobian, search.residual)
    optimality = np.abs(slope).max(axis=-1, initial=0.0) / scale
    gradient[strayed], optimality[strayed] = 0.0, np.inf
    return Nearest(position, box.snapped(lengths), distance, gradient, optimality, coordinates)
