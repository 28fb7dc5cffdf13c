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

from spm_pin.kinematics.intervals import Interval
from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.proofs.singular_states import singular_state
from spm_pin.proofs.stage_region import StageRegion
from spm_pin.proofs.unique_state import has_one_state

Int64Array = npt.NDArray[np.int64]

FIRST_LEVEL = 4
"""The subdivision begins with cells of 1/16 of the cube's edge."""

SEARCH = 30_000
"""Boxes after which a singular state is looked for; then again whenever four times as many have been seen."""

ROUNDING = 1e-9
"""Uncertainty of the start, in units of the cube's edges."""


@dataclass(frozen=True)
class StageProof:
    """Outcome of the subdivision of one stage."""

    bound: float
    """Proved lower bound of |det J| [m³] over the component of the start; 0 where something is undecided."""
    least: float
    """Smallest |det J| [m³] at the centre of a box, within the limits: the minimum lies between `bound` and this."""
    undecided: FloatArray
    """Boxes of (x, y, Z) [-, -, m] joined to the start in which D may be zero: low and high ends, (N, 3, 2)."""
    proved: FloatArray
    """Boxes that hold the rest of the component of the start, (M, 3, 2); D is positive in each."""
    singular: FloatArray | None
    """A forward singular state (x, y, Z) within the limits, in a box joined to the start; None if none was found."""
    boxes: int
    """Number of boxes looked at."""


Boxes = npt.NDArray[np.void]
_BOX = np.dtype([("level", np.int64), ("position", np.int64, 3), ("bound", np.float64)])
"""A dyadic box of the cube: its level of division, its integer position and a lower bound of |det J|."""

_CORNERS = np.array(list(product((0, 1), repeat=3)))
_NEIGHBOURS = np.array(list(product((-1, 0, 1), repeat=3)))


def prove_stage(region: StageRegion, start: FloatArray, *, most: int = 300_000, deepest: int = 14) -> StageProof:
    """Divide the cube of states until D is proved positive on the component of `start`, or `most` boxes were seen.

    `start` is a state (x, y, Z) within the limits, known to rounding; a box of the level `deepest` = n, which is not
    divided further, has 2⁻ⁿ of the cube's edge.
    """
    scale = np.array([1.0, 1.0, 2.0 ** np.ceil(np.log2(region.height))])
    side = np.arange(1 << FIRST_LEVEL)
    cells = np.zeros(len(side) ** 3, _BOX)
    cells["level"] = FIRST_LEVEL
    cells["position"] = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    kept, least = _examine(region, scale, cells)
    seen, singular, search_at = len(cells), None, SEARCH
    while True:
        kept = kept[_joined(scale, kept, start)]
        # A proved box is divided again while its bound is far below the least value met: a bound is to be of use.
        unfinished = kept["bound"] <= (0.5 * least if np.isfinite(least) else 0.0)
        unfinished &= kept["level"] < deepest
        count = int(unfinished.sum())
        if seen >= search_at or not count or seen + 8 * count > most:
            singular = singular_state(region, _ends(scale, kept[kept["bound"] <= 0.0]))
            search_at = 4 * seen
        if singular is not None or not count or seen + 8 * count > most:
            break
        halves = np.repeat(kept[unfinished], 8)
        halves["level"] += 1
        halves["position"] = 2 * halves["position"] + np.tile(_CORNERS, (count, 1))
        halves, smallest = _examine(region, scale, halves)
        kept, least, seen = np.concatenate([kept[~unfinished], halves]), min(least, smallest), seen + 8 * count
    positive = kept["bound"] > 0.0
    proved = _ends(scale, kept[positive])
    complete = len(proved) > 0 and bool(positive.all()) and has_one_state(region, proved)
    return StageProof(
        bound=float(kept["bound"].min()) if complete else 0.0,
        least=least,
        undecided=_ends(scale, kept[~positive]),
        proved=proved,
        singular=singular,
        boxes=seen,
    )


def _ends(scale: FloatArray, boxes: Boxes) -> FloatArray:
    """Return the low and high ends of boxes, shape (N, 3, 2): exact, so that neighbours share theirs."""
    size, position = np.ldexp(1.0, 1 - boxes["level"])[:, None], boxes["position"]
    return np.stack([(position * size - 1.0) * scale, ((position + 1) * size - 1.0) * scale], axis=-1)


def _examine(region: StageRegion, scale: FloatArray, boxes: Boxes) -> tuple[Boxes, float]:
    """Return the boxes that may hold lengths within the limits, and the smallest |det J| met at a centre of one."""
    ends = _ends(scale, boxes)
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
    boxes["bound"] = np.maximum(np.where(straight, np.nextafter(determinant.low / longest, -np.inf), 0.0), 0.0)
    boxes = boxes[~outside]

    centre = [Interval.of(0.5 * ends[~outside, i].sum(axis=-1)) for i in range(3)]
    squares, determinant = region.evaluate(*centre)
    within = np.all([~square.misses(limit) for square, limit in zip(squares, limits, strict=True)], axis=0)
    values = np.maximum(determinant.low, 0.0) / np.sqrt(_product(squares).high)
    return boxes, float(values[within & (boxes["bound"] > 0.0)].min(initial=np.inf))


def _product(factors: Sequence[Interval]) -> Interval:
    return reduce(operator.mul, factors)


def _joined(scale: FloatArray, boxes: Boxes, start: FloatArray) -> BoolArray:
    """Return which boxes are joined, through boxes that touch, to one that may hold `start`."""
    if not len(boxes):
        return np.zeros(0, dtype=np.bool_)
    pairs = _touching(boxes)
    graph = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=(len(boxes),) * 2)
    component = connected_components(graph, directed=False)[1]
    ends = _ends(scale, boxes)
    near = ROUNDING * scale
    holds = ((ends[..., 0] <= start + near) & (ends[..., 1] >= start - near)).all(axis=-1)
    return np.isin(component, component[holds])


def _touching(boxes: Boxes) -> Int64Array:
    """Return the pairs of boxes that have a point in common, shape (N, 2)."""
    found = [np.empty((0, 2), dtype=np.int64)]
    level, position = boxes["level"], np.ascontiguousarray(boxes["position"])
    levels = np.unique(level)
    ordered = {}
    for size in levels:
        members = np.flatnonzero(level == size)
        keys = _keys(position[members], size)
        order = np.argsort(keys)
        ordered[size] = members[order], keys[order]
    for fine in levels:
        members = ordered[fine][0]
        around = position[members][:, None, :] + _NEIGHBOURS
        inside = ((around >= 0) & (around < 1 << int(fine))).all(axis=-1)
        sources = np.broadcast_to(members[:, None], inside.shape)[inside]
        for coarse in levels[levels <= fine]:
            targets, keys = ordered[coarse]
            wanted = _keys(around[inside] >> int(fine - coarse), coarse)
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = keys[place] == wanted
            found.append(np.stack([sources[hit], targets[place[hit]]], axis=-1))
    return np.concatenate(found)


def _keys(position: Int64Array, level: int) -> Int64Array:
    return np.asarray((position[..., 0] << 2 * int(level)) + (position[..., 1] << int(level)) + position[..., 2])
