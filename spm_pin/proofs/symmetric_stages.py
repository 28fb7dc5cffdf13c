"""Many machines at once: which are proved free of forward singularities, where a stage's legs have equal limits.

Such a stage is the same after a turn by 120° about its axis, and in a mirror, which exchanges legs. Of its states
a sixth, 0 <= y <= √3 x, stands for all: a path in the others, mirrored wherever it leaves the sixth, stays within
it. Derivation: `docs/theory/proofs.md`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

from spm_pin.errors import SpmError
from spm_pin.mechanism import Geometry
from spm_pin.mechanism.arguments import BoolArray
from spm_pin.proofs.certificate import certify, stage_regions
from spm_pin.proofs.stage_proof import DEEPEST, Boxes, Int64Array, edges, examine, first_boxes, halves, joined
from spm_pin.proofs.stage_region import StageRegion

_FIRST_LEVEL = 3
_SLOPE = 1.7320508075689
"""A little more than √3, so that rounding leaves no box out."""
_FLAT = 1e-10
"""Least Z² of a level state over its legs' length squared: above this it exists, and is known to `joined`."""


def free_of_singularities(machines: Sequence[Geometry], boxes: int) -> BoolArray:
    """Return which machines (N,) are proved free of forward singularities within their limits.

    At most `boxes` are looked at for a stage; where its limits are equal, these lie in a sixth of its states. Other
    machines are given to `certify`.
    """
    regions = [stage_regions(machine, machine.limits) for machine in machines if machine.limits is not None]
    symmetric = [
        machine.is_nominal and all(np.ptp(ends) == 0.0 for region in pair for ends in (region.minimum, region.maximum))
        for machine, pair in zip(machines, regions, strict=True)
    ]
    free = np.zeros(len(machines), dtype=np.bool_)
    stages = [region for pair, equal in zip(regions, symmetric, strict=True) if equal for region in pair]
    if stages:
        free[symmetric] = _stages_free(stages, boxes).reshape(-1, 2).all(axis=-1)
    for index, (machine, equal) in enumerate(zip(machines, symmetric, strict=True)):
        if not equal:
            with contextlib.suppress(SpmError):
                free[index] = certify(machine, boxes=boxes).holds
    return free


def _stages_free(stages: Sequence[StageRegion], most: int) -> BoolArray:
    """Return which stages (S,) have no singular state joined to the level one with the lengths in the middle."""
    every = StageRegion(
        np.array([stage.leg_base_radius for stage in stages]),
        np.array([stage.side for stage in stages]),
        np.stack([stage.minimum for stage in stages], axis=-1),
        np.stack([stage.maximum for stage in stages], axis=-1),
        margin=np.array([stage.margin for stage in stages]),
    )
    scale, length = edges(every), 0.5 * (every.minimum[0] + every.maximum[0])
    square = length**2 - (every.side / np.sqrt(3.0) - every.leg_base_radius) ** 2
    start = np.stack(
        [0.0 * square, 0.0 * square, np.sqrt(np.where(square > _FLAT * length**2, square, np.nan))], axis=-1
    )
    boxes = np.tile(first_boxes(_FIRST_LEVEL), len(stages))
    boxes["stage"] = np.repeat(np.arange(len(stages)), len(boxes) // len(stages))
    seen, free = np.full(len(stages), 8**_FIRST_LEVEL), np.zeros(len(stages), dtype=np.bool_)
    kept = boxes[:0]
    while len(boxes):
        boxes = boxes[_in_sixth(boxes)]
        stage = boxes["stage"]
        kept = np.concatenate([kept, examine(_each(every, stage), scale[stage], boxes)])
        kept = kept[joined(scale[kept["stage"]], kept, start[kept["stage"]])]
        stage, undecided = kept["stage"], ~(kept["bound"] > 0.0)
        count = np.bincount(stage[undecided], minlength=len(stages))
        free |= (count == 0) & (np.bincount(stage, minlength=len(stages)) > 0)
        seen += 8 * count
        going_on = (count > 0) & (seen <= most)
        going_on[stage[undecided & (kept["level"] == DEEPEST)]] = False
        boxes = halves(kept[undecided & going_on[stage]])
        kept = kept[~undecided & going_on[stage]]
    return free


def _each(every: StageRegion, stage: Int64Array) -> StageRegion:
    """Return the regions of boxes, of the stages (N,)."""
    radius, side, margin = (np.asarray(numbers)[stage] for numbers in (every.leg_base_radius, every.side, every.margin))
    return StageRegion(radius, side, every.minimum[:, stage], every.maximum[:, stage], margin=margin)


def _in_sixth(boxes: Boxes) -> BoolArray:
    """Return which boxes may have a point with 0 <= y <= √3 x."""
    size, (x, y, _) = np.ldexp(1.0, 1 - boxes["level"]), boxes["position"].T
    most_x, most_y = (x + 1) * size - 1.0, (y + 1) * size - 1.0
    return np.asarray((most_y >= 0.0) & (most_x >= 0.0) & (most_y - size <= _SLOPE * most_x))
