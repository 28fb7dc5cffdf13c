"""Proof by subdivision that a stage meets no forward singularity between limits of its leg lengths.

The cube of the states (x, y, Z) of a `StageRegion` is divided into eight again and again: what has no
lengths within the limits goes; what keeps the sign of D is proved; of the rest only what is joined to a given state,
through touching boxes, is divided further. Derivation and theorem: `docs/theory/proofs.md`.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spm_pin.closed_form.intervals import Interval
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.proofs.singular_states import singular_state
from spm_pin.proofs.stage_region import StageRegion
from spm_pin.proofs.unique_state import has_one_state

__all__ = ["StageProof", "prove_stage"]

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

FIRST_LEVEL = 4
"""The subdivision begins with cells of 1/16 of the cube's edge."""

SEARCH = 30_000
"""Boxes after which a singular state is looked for; then again whenever four times as many have been seen."""

ROUNDING = 1e-9
"""Uncertainty of the start, in units of the cube's edges."""


@dataclass(frozen=True)
class StageProof:
    """Outcome of the subdivision of one stage.

    Attributes
    ----------
    bound : float
        Proved lower bound of |det J| [m³] over the component of the start; 0 where something is undecided.
    least : float
        Smallest |det J| [m³] at the centre of a box, within the limits: the minimum lies between `bound` and this.
    undecided : ndarray, shape (N, 3, 2)
        Boxes of (x, y, Z) [-, -, m] joined to the start in which D may be zero: low and high ends.
    proved : ndarray, shape (M, 3, 2)
        Boxes that hold the rest of the component of the start; D is positive in each.
    singular : ndarray, shape (3,), or None
        A forward singular state (x, y, Z) within the limits, in a box joined to the start; None if none was found.
    boxes : int
        Boxes looked at.
    """

    bound: float
    least: float
    undecided: FloatArray
    proved: FloatArray
    singular: FloatArray | None
    boxes: int


@dataclass(frozen=True)
class _Boxes:
    """Dyadic boxes of the cube: level of division (N,), integer position (N, 3), lower bound of |det J| (N,)."""

    level: IntArray
    position: IntArray
    bound: FloatArray

    def take(self, which: BoolArray) -> _Boxes:
        return _Boxes(self.level[which], self.position[which], self.bound[which])

    def join(self, other: _Boxes) -> _Boxes:
        return _Boxes(*(np.concatenate(pair) for pair in zip(self._fields(), other._fields(), strict=True)))

    def _fields(self) -> tuple[IntArray, IntArray, FloatArray]:
        return self.level, self.position, self.bound

    def children(self) -> tuple[IntArray, IntArray]:
        """Return level and position of the eight halves of each box."""
        return np.repeat(self.level + 1, 8), (2 * self.position[:, None, :] + _CORNERS).reshape(-1, 3)


_CORNERS = np.array(list(product((0, 1), repeat=3)))
_NEIGHBOURS = np.array(list(product((-1, 0, 1), repeat=3)))


def prove_stage(region: StageRegion, start: FloatArray, *, most: int = 300_000, deepest: int = 14) -> StageProof:
    """Divide the cube of states until D is proved positive on the component of `start`, or `most` boxes were seen.

    Parameters
    ----------
    region : StageRegion
        Dimensions and limits.
    start : ndarray, shape (3,)
        A state (x, y, Z) within the limits, known to rounding.
    most : int
        Boxes to look at, at most.
    deepest : int
        Levels of division, at most; a box of the last one has 2⁻ⁿ of the cube's edge.

    Returns
    -------
    StageProof
    """
    scale = np.array([1.0, 1.0, 2.0 ** np.ceil(np.log2(region.height))])
    side = np.arange(1 << FIRST_LEVEL)
    position = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    kept, least = _examine(region, scale, np.full(len(position), FIRST_LEVEL), position)
    seen, singular, search_at = len(position), None, SEARCH
    while True:
        kept = kept.take(_joined(scale, kept, start))
        # A proved box is divided again while its bound is far below the least value met: a bound is to be of use.
        unfinished = kept.bound <= 0.5 * least if np.isfinite(least) else kept.bound <= 0.0
        unfinished &= kept.level < deepest
        count = int(unfinished.sum())
        if seen >= search_at or not count or seen + 8 * count > most:
            open_boxes = kept.take(kept.bound <= 0.0)
            singular = singular_state(region, _ends(scale, open_boxes.level, open_boxes.position))
            search_at = 4 * seen
        if singular is not None or not count or seen + 8 * count > most:
            break
        halves, smallest = _examine(region, scale, *kept.take(unfinished).children())
        kept, least, seen = kept.take(~unfinished).join(halves), min(least, smallest), seen + 8 * count
    positive = kept.bound > 0.0
    proved = _ends(scale, kept.level[positive], kept.position[positive])
    complete = len(proved) > 0 and bool(positive.all()) and has_one_state(region, proved)
    return StageProof(
        bound=float(kept.bound.min()) if complete else 0.0,
        least=least,
        undecided=_ends(scale, kept.level[~positive], kept.position[~positive]),
        proved=proved,
        singular=singular,
        boxes=seen,
    )


def _ends(scale: FloatArray, level: IntArray, position: IntArray) -> FloatArray:
    """Return the low and high ends of boxes, shape (N, 3, 2): exact, so that neighbours share theirs."""
    size = np.ldexp(1.0, 1 - level)[:, None]
    return np.stack([(position * size - 1.0) * scale, ((position + 1) * size - 1.0) * scale], axis=-1)


def _examine(region: StageRegion, scale: FloatArray, level: IntArray, position: IntArray) -> tuple[_Boxes, float]:
    """Return the boxes that may hold lengths within the limits, and the smallest |det J| met at a centre of one."""
    ends = _ends(scale, level, position)
    x, y, z = (Interval(ends[:, i, 0], ends[:, i, 1]) for i in range(3))
    tilt = x.square() + y.square()
    squares, determinant = region.evaluate(x, y, z)
    limits = [length.square() for length in region.lengths]
    outside = tilt.low > 1.0
    for square, limit in zip(squares, limits, strict=True):
        outside |= square.misses(limit)
    # |det J| is |D| over the product of the lengths, and these do not exceed their limits.
    longest = _product([Interval.of(length.high) for length in region.lengths]).high
    # Where x0² + x3² exceeds twice the bound of |x0 x3|, x0² and x3² differ.
    straight = (1.0 - tilt).low > 2.0 * region.spread.torsion
    bound = np.where(straight, np.nextafter(determinant.low / longest, -np.inf), 0.0)
    kept = ~outside
    boxes = _Boxes(level[kept], position[kept], np.maximum(bound[kept], 0.0))

    centre = [Interval.of(0.5 * ends[kept, i].sum(axis=-1)) for i in range(3)]
    squares, determinant = region.evaluate(*centre)
    within = np.all([~square.misses(limit) for square, limit in zip(squares, limits, strict=True)], axis=0)
    values = np.maximum(determinant.low, 0.0) / np.sqrt(_product(squares).high)
    return boxes, float(values[within & (boxes.bound > 0.0)].min(initial=np.inf))


def _product(factors: Sequence[Interval]) -> Interval:
    return reduce(operator.mul, factors)


def _joined(scale: FloatArray, boxes: _Boxes, start: FloatArray) -> BoolArray:
    """Return which boxes are joined, through boxes that touch, to one that may hold `start`."""
    if not len(boxes.level):
        return np.zeros(0, dtype=np.bool_)
    pairs = _touching(boxes)
    graph = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=(len(boxes.level),) * 2)
    component = connected_components(graph, directed=False)[1]
    ends = _ends(scale, boxes.level, boxes.position)
    near = ROUNDING * scale
    holds = ((ends[..., 0] <= start + near) & (ends[..., 1] >= start - near)).all(axis=-1)
    return np.isin(component, component[holds])


def _touching(boxes: _Boxes) -> IntArray:
    """Return the pairs of boxes that have a point in common, shape (N, 2)."""
    found = [np.empty((0, 2), dtype=np.int64)]
    levels = np.unique(boxes.level)
    ordered = {}
    for level in levels:
        members = np.flatnonzero(boxes.level == level)
        keys = _keys(boxes.position[members], level)
        order = np.argsort(keys)
        ordered[level] = members[order], keys[order]
    for fine in levels:
        members = ordered[fine][0]
        around = boxes.position[members][:, None, :] + _NEIGHBOURS
        inside = ((around >= 0) & (around < 1 << int(fine))).all(axis=-1)
        sources = np.broadcast_to(members[:, None], inside.shape)[inside]
        for coarse in levels[levels <= fine]:
            targets, keys = ordered[coarse]
            wanted = _keys(around[inside] >> int(fine - coarse), coarse)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = keys[place] == wanted
            found.append(np.stack([sources[hit], targets[place[hit]]], axis=-1))
    return np.concatenate(found)


def _keys(position: IntArray, level: int) -> IntArray:
    return np.asarray((position[..., 0] << 2 * int(level)) + (position[..., 1] << int(level)) + position[..., 2])
