"""A grid around the reachable set: which of its nodes are reachable, and where its edges leave the set."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, Progress, real_number
from spm_pin.workspace.reachability.leg_length_box import LegLengthBox
from spm_pin.workspace.reachability.membership import search_states
from spm_pin.workspace.reachability.portions import in_portions
from spm_pin.workspace.reachability.state_search import SINGULARITY_MARGIN, StateSearch

_STRIDES = (8, 4, 2, 1)
"""Spacings of the grids searched one after the other, in units of the final spacing."""
_MOST_NODES = 5_000_000
"""Nodes of the grid at most."""
_STEPS = 40
"""Steps of Newton's method along an edge at most."""
_CROSSING_TOLERANCE = 1e-7
"""Tolerance of the place where an edge leaves the set, as a share of the edge."""
_HALVINGS = 24
"""Halvings of the interval where Newton's method has failed."""
_UNDERSHOOT = 0.02
"""Share of each Newton step that is left out, so that the iteration stays outside the set."""
_CHECK_DISTANCE = 1e-4
"""Distance beyond the place found, as a share of the edge, at which nothing must be reachable."""
_POSITION_TOLERANCE = 1e-7
"""Distance of a vertex from the position of o at its leg lengths, over the machine's size, that is accepted."""


class ReachabilityGrid:
    """The nodes of a grid wide enough to begin and to end outside the reachable set, and which of them are in it.

    Parameters
    ----------
    box : LegLengthBox
        The leg lengths.
    spacing : float
        Distance of neighbouring nodes [m].
    progress : callable, optional
        As for `reachable_boundary`.

    Raises
    ------
    ArgumentError
        If the spacing is not positive, or so small that there would be too many nodes.
    """

    def __init__(self, box: LegLengthBox, spacing: float, progress: Progress | None = None) -> None:
        self.box, self.progress = box, progress
        self.spacing = spacing = real_number(spacing, "spacing", "a positive length in metres", above=0.0)
        low, high = box.coarse.extent
        pad = 0.02 * (high - low) + 1.5 * spacing
        with np.errstate(over="ignore"):
            numbers = np.ceil((high - low + 2.0 * pad) / spacing) + 1.0
        if numbers.prod() > _MOST_NODES:
            expected = f"a spacing in metres that makes at most {_MOST_NODES:.0e} nodes"
            raise ArgumentError(
                "spacing", expected, f"{spacing:g}, which makes {numbers.prod():.0e}", "In millimetres?"
            )
        self.origin = 0.5 * (low + high - (numbers - 1.0) * spacing)
        self.inside, self.states = self._classified(tuple(numbers.astype(int)))

    def _classified(self, shape: tuple[int, ...]) -> tuple[BoolArray, FloatArray]:
        """Return which nodes are reachable, shape `shape`, and states there, shape `shape` + (2, 3).

        The farther away, the coarser the grid that is searched.
        """
        index = np.indices(shape).reshape(3, -1).T
        nodes = self._place(index)
        inside, known = np.zeros(len(nodes), dtype=bool), np.zeros(len(nodes), dtype=bool)
        states = np.full((len(nodes), 2, 3), np.nan)

        def search(what: str, chosen: IntArray, starts: FloatArray | None) -> FloatArray:
            found = search_states(self.box, nodes[chosen], starts, what=what, progress=self.progress)
            states[chosen] = found.coordinates
            known[chosen] = True
            inside[chosen] |= found.reached
            return found.distance

        for stride in _STRIDES:
            chosen = np.flatnonzero(~known & (index % stride == 0).all(axis=-1))
            distance = (
                search(f"reachable nodes, every {stride * self.spacing:g} m", chosen, None) - self.box.coarse.margin
            )
            # Nothing within that distance is reachable.
            remote = distance > self.spacing
            if remote.any() and not known.all():
                unknown = np.flatnonzero(~known)
                around = KDTree(nodes[unknown]).query_ball_point(nodes[chosen[remote]], (1.0 - 1e-9) * distance[remote])
                for members in around:
                    known[unknown[members]] = True
        # What a search has overlooked beside a reachable node is found from there.
        steps = [way * stride for stride in (1, shape[2], shape[1] * shape[2]) for way in (1, -1)]
        fresh = np.flatnonzero(inside)
        while len(fresh):
            before = inside.copy()
            for step in steps:
                # No reachable node is at the end of a row: around the set there is room.
                beside = fresh[~inside[fresh + step]] + step
                search("nodes beside reachable ones", beside, states[beside - step])
            fresh = np.flatnonzero(inside & ~before)
        return inside.reshape(shape), states.reshape(*shape, 2, 3)

    def _place(self, index: npt.NDArray[Any]) -> FloatArray:
        """Return the positions [m] of points in units of the grid."""
        return np.asarray(self.origin + self.spacing * index)

    def crossings(self, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Move vertices of marching cubes (V, 3), in units of the grid, to the boundary [m]; and leg lengths there."""
        first, last = np.floor(corners).astype(int), np.ceil(corners).astype(int)
        a, b = self.inside[tuple(first.T)], self.inside[tuple(last.T)]
        nodes = np.where(a[:, None], first, last)
        inner, outer = nodes.astype(np.float64), np.where(a[:, None], last, first).astype(np.float64)
        known = self.states[tuple(nodes.T)]
        # A vertex in the middle of a cube, which some ambiguous ones have, is on no edge.
        for k in np.flatnonzero((a == b) | ((last - first).sum(axis=-1) != 1)):
            cube = np.floor(corners[k]).astype(int) + np.indices((2, 2, 2)).reshape(3, -1).T
            reached = self.inside[tuple(cube.T)]
            centre = search_states(self.box, self._place(corners[k : k + 1]))
            if centre.reached[0]:
                inner[k], outer[k], known[k] = corners[k], cube[~reached][0], centre.coordinates[0]
            else:
                inner[k], outer[k], known[k] = cube[reached][0], corners[k], self.states[tuple(cube[reached][0])]
        ends = self._place(inner), self._place(outer)
        vertices, lengths = in_portions(partial(_crossing, self.box), "vertices", self.progress, *ends, known)
        return vertices, lengths


def _crossing(
    box: LegLengthBox, inner: FloatArray, outer: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the points (N, 3) [m] at which segments leave the reachable set, and leg lengths (N, 6) [m] there.

    They go from reachable points `inner` to unreachable ones `outer`, (N, 3) [m]; `states` (N, 2, 3) put o at `inner`.

    Outside the reachable set the residual norm of a search for a state falls towards the boundary, and the error of o
    along the segment is its derivative. So from the outer end the segment is followed inwards by Newton's method, to
    1e-7 of its length. Where that has overlooked reachable points farther out, or no lengths put o where it ends, the
    interval is halved instead.
    """
    along = outer - inner
    at, low, within, outermost = _follow_inwards(box, inner, along, states)
    # In the outermost state, legs are beyond limits by what is left of the residual.
    lengths = np.clip(box.map.lengths(outermost), box.minimum, box.maximum)
    proved, _ = box.confirm(lengths, inner + at[:, None] * along, _POSITION_TOLERANCE)
    # Following one state inwards, another may be overlooked: just outside nothing must be reachable.
    high = np.minimum(at + _CHECK_DISTANCE, 1.0)
    beyond = search_states(box, inner + high[:, None] * along)
    farther = beyond.reached & (high < 1.0)
    low, within = np.where(farther, high, low), np.where(farther[:, None, None], beyond.coordinates, within)
    high = np.where(farther, 1.0, high)
    left = np.flatnonzero(farther | ~proved)
    for _ in range(_HALVINGS if len(left) else 0):
        middle = 0.5 * (low[left] + high[left])
        found = search_states(box, inner[left] + middle[:, None] * along[left], within[left])
        good = found.reached
        within[left[good]] = found.coordinates[good]
        low[left], high[left] = np.where(good, middle, low[left]), np.where(good, high[left], middle)
    at[left], lengths[left] = low[left], box.lengths(within[left])
    return inner + at[:, None] * along, lengths


def _follow_inwards(
    box: LegLengthBox, inner: FloatArray, along: FloatArray, states: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the shares of `along` (N, 3) at which segments leave the set, and the largest found within it, (N,) each.

    And the states (N, 2, 3) at the latter, and those at which the last searches ended.
    """
    low, high, at = np.zeros(len(along)), np.ones(len(along)), np.ones(len(along))
    within, outermost = states.copy(), states.copy()
    going = np.arange(len(along))
    for _ in range(_STEPS):
        if not len(going):
            break
        here = at[going]
        search = StateSearch(
            box, inner[going] + here[:, None] * along[going], outermost[going], singularity_margin=SINGULARITY_MARGIN
        )
        search.iterate()
        reached, _ = search.proved()
        within[going[reached]] = search.coordinates[reached]
        outermost[going] = search.coordinates
        low[going] = np.where(reached, here, low[going])
        high[going] = np.where(reached, high[going], here)
        towards = -(search.error * along[going]).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = here - np.where(towards > 0.0, search.residual_norm**2 / towards, 2.0)
        ahead = ~reached & (plane > low[going])
        done = (ahead & (here - plane <= _CROSSING_TOLERANCE)) | (high[going] - low[going] <= _CROSSING_TOLERANCE)
        # A slightly shorter step ends outside the set, where the next tangent plane is.
        at[going] = np.where(ahead, plane + _UNDERSHOOT * (here - plane), 0.5 * (low[going] + high[going]))
        going = going[~done]
    return at, low, within, outermost
