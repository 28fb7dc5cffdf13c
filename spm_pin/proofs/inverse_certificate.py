"""Certificates that leg limits hold no inverse singularity: lower bounds of |det K|.

det K depends on the tilts of the two stages alone. Seen from the middle platform, leg i has its ball at r u_i and its
revolute axes along

    v = (2ξη, 1 - 2ξ², ∓2 x0 ξ)

in the directions u_i, z × u_i and z, minus in the lower stage, plus in the upper, where ξ and η are the components of a
stage's (x, y) along the first two. With w_i the vector product of the lower axis and the upper one,

    det K = -r³ [Π (3/2 w_iu - √3/2 w_ia) + Π (3/2 w_iu + √3/2 w_ia)].

The squares of the four tilts (x, y) of both stages are divided into sixteen again and again: what has no
lengths within the limits goes, what keeps the sign of det K is proved. Derivation: `docs/theory/proofs.md`.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.legs import LegLimits
from spm_pin.machine.manipulator import Manipulator, check_manipulator, check_rps
from spm_pin.proofs.certificate import Certificate, certify, stage_regions
from spm_pin.proofs.stage_proof import Int64Array, StageProof, StageRegion, columns, rounded_down
from spm_pin.support.arguments import BoolArray, FloatArray, check_instance, whole_number

Cells = tuple[Interval, Interval]
"""x and y of cells of one stage."""

_SAMPLES = 2_000
"""Number of states among which a singular one, and the least |det K|, are looked for."""
_PAIRS = 100
"""Pairs of samples between which a singular one is looked for."""
_DEEPEST = 20
"""Largest level of division."""
_GRID = 5
"""Level of division to begin with; a cell of level n has 2¹⁻ⁿ of the unit disc's radius."""
_CORNERS = np.array(list(product((0, 1), repeat=4))).reshape(16, 2, 2)


@dataclass(frozen=True)
class InverseCertificate:
    """Result of a proof about det K, which vanishes at inverse singularities."""

    machine: Manipulator
    """Dimensions of the manipulator."""
    region: str
    """Description of the limits that were searched."""
    bound: float
    """Proved lower bound of |det K| / d³; 0 where something is undecided, infinity if the region holds no state."""
    least: float
    """Smallest |det K| / d³ of states sampled in the region: the minimum lies between `bound` and this."""
    undecided: FloatArray
    """Boxes in which det K may be zero, low and high ends, shape (N, 4, 2).

    Coordinates are x and y of the lower and the upper stage.
    """
    witness: Configuration | None
    """A configuration of the region with det K = 0 to rounding, where one was found."""
    boxes: int
    """Boxes looked at."""

    @property
    def holds(self) -> bool:
        """True if it is proved that no configuration of the region is inverse singular."""
        return self.bound > 0.0

    def explain(self) -> str:
        """Return what is proved, the counterexample, or the number of undecided boxes, in a few lines."""
        lines = [f"{self.region}, {self.boxes:,} boxes."]
        if np.isinf(self.bound):
            lines.append("Proved: there is no configuration without torsion in both stages.")
        elif self.holds:
            lines.append(
                f"Proved: no inverse singularity, |det K| >= {rounded_down(self.bound)} d³; "
                f"sampled: {self.least:.3g} d³."
            )
        elif self.witness is not None:
            lengths = ", ".join(f"{length:.6f}" for length in self.witness.leg_lengths)
            lines.append(f"Disproved: inverse singular with legs ({lengths}) m.")
        else:
            lines.append(f"Undecided in {len(self.undecided):,} boxes; no singular configuration was found.")
        return "\n".join(lines)


def certify_inverse(
    machine: Manipulator, limits: LegLimits | None = None, *, boxes: int = 300_000, forward: Certificate | None = None
) -> InverseCertificate:
    """Prove that no configuration joined to the home within leg limits is inverse singular.

    Parameters
    ----------
    machine, limits, boxes
        As for `spm_pin.certify`, without errors; `boxes` for the pairs of stages as well.
    forward : Certificate, optional
        Result of `spm_pin.certify` for the same arguments; computed if not given.

    Returns
    -------
    InverseCertificate
        With a witness for limits in which det K changes its sign, as between 1.1 and 1.5 m of the paper's machine.
    """
    check_manipulator(machine)
    check_rps(machine, "certificates of poses")
    if not machine.is_nominal:
        cause = "Use its nominal machine, machine.nominal, or the file without its legs"
        raise GeometryError("machine", "a nominal machine", "a calibrated machine", cause)
    whole_number(boxes, "boxes", least=1)
    if forward is None:
        forward = certify(machine, limits, boxes=boxes)
    elif any(check_instance(forward, Certificate, "forward").errors):
        raise ArgumentError(
            "forward", "a certificate of the nominal machine alone", "a certificate with dimensional errors"
        )
    elif forward.machine.dimensions != machine.dimensions or forward.limits != (limits or machine.limits):
        raise ArgumentError("forward", "a certificate of the same machine and limits", "a certificate of others")
    limits = forward.limits
    stages = [
        _StageCells(region, proof) for region, proof in zip(stage_regions(machine, limits), forward.stages, strict=True)
    ]
    low, high = limits.ends
    legs = np.random.default_rng(0).uniform(low, high, (_SAMPLES, 6))
    legs[0] = 0.5 * (low + high)
    legs = legs[forward_physical(machine, legs).exists]

    values = _scaled_determinant(machine, legs)
    witness = _zero_between(machine, legs[values <= 0.0], legs[values > 0.0])
    name = f"Leg lengths from {low.min():g} m to {high.max():g} m"
    least = float(np.abs(values).min())
    if witness is not None:
        return InverseCertificate(machine, name, 0.0, 0.0, np.empty((0, 4, 2)), witness, 0)
    bound, undecided, seen = _divide(stages, 0.5 * least, boxes)
    return InverseCertificate(machine, name, bound, least, undecided, None, seen)


def _scaled_determinant(machine: Manipulator, legs: FloatArray) -> FloatArray:
    """Return det K / d³ of the physical states of leg lengths (..., 6); NaN if missing."""
    return np.asarray(determinants(forward_physical(machine, legs))[..., 2] / machine.middle_side**3)


def _zero_between(machine: Manipulator, low: FloatArray, high: FloatArray) -> Configuration | None:
    """Return an inverse singular state between leg lengths (n, 6) and (m, 6), with det K of opposite signs.

    Not every straight way from one to another has states all along: pairs are tried, the nearest first.
    """

    def value(share: float, start: FloatArray, step: FloatArray) -> float:
        return float(_scaled_determinant(machine, start + share * step))

    for k in scipy.spatial.distance.cdist(low, high).argsort(axis=None)[:_PAIRS]:
        start, step = low[k // len(high)], high[k % len(high)] - low[k // len(high)]
        with contextlib.suppress(ValueError):  # of a value that is NaN
            share = scipy.optimize.brentq(value, 0.0, 1.0, args=(start, step), xtol=1e-15)
            return forward_physical(machine, start + share * step)
    return None


class _StageCells:
    """Cells (x, y) of one stage that may hold a state joined to the home within the leg limits."""

    def __init__(self, region: StageRegion, proof: StageProof) -> None:
        boxes = np.concatenate([proof.proved, proof.undecided])
        self._region = region
        # Above the legs' bases the sign of a corner's height is known, unless a box contradicts it.
        heights = region.corners(*columns(boxes))[1]
        self._upward = all((height.low > 0.0).all() for height in heights)
        side = 1 << _GRID
        ends = (boxes[:, :2] + 1.0) * (side / 2)
        first, last = np.floor(ends[..., 0]).astype(int), np.ceil(ends[..., 1]).astype(int)
        self._occupied = np.zeros((side, side), dtype=np.bool_)
        for (i, j), (k, m) in zip(np.maximum(first, 0), last, strict=True):
            self._occupied[i:k, j:m] = True

    def contain(self, level: int, position: Int64Array) -> BoolArray:
        """Return a mask of cells (N, 2) of a level with a possible height for lengths within the limits."""
        cell = position >> (level - _GRID)
        region, (x, y) = self._region, _ends(level, position)
        radii, rises = region.corners(x, y, Interval.from_numbers(0.0))
        lowest, highest = np.full(len(position), -np.inf), np.full(len(position), np.inf)
        for radius, rise, length in zip(radii, rises, region.radii, strict=True):
            across = (radius - Interval.from_numbers(region.leg_base_radius)).square()
            room = Interval.from_numbers(length.high).square() - across
            top = np.where(room.high < 0.0, -np.inf, room.root().high)
            bottom = (Interval.from_numbers(length.low).square() - across).root().low if self._upward else -top
            heights = Interval(bottom, np.maximum(top, bottom)) - rise
            lowest = np.maximum(lowest, heights.low)
            highest = np.minimum(highest, np.where(top < bottom, -np.inf, heights.high))
        inside = (x.square() + y.square()).low <= 1.0
        return np.asarray(self._occupied[cell[:, 0], cell[:, 1]] & inside & (lowest <= highest))


def _ends(level: int, position: Int64Array) -> Cells:
    """Return x and y of cells (N, 2): exact, so that neighbours share theirs."""
    size = 2.0 ** (1 - level)
    x, y = (Interval(column * size - 1.0, (column + 1) * size - 1.0) for column in position.T)
    return x, y


def _axes(cells: Cells, upward: float) -> list[tuple[Interval, Interval, Interval]]:
    """Return the directions v of a stage's three revolute axes, seen from the middle platform."""
    x, y = cells
    x0 = (1.0 - (x.square() + y.square())).root()
    across = 0.5 * SQRT_3
    side, half = across * x, 0.5 * y
    lift, back = across * y, 0.5 * x
    axes = []
    for xi, eta in ((side - half, back + lift), (y, -x), (-(side + half), back - lift)):
        axes.append((2.0 * (xi * eta), 1.0 - 2.0 * xi.square(), upward * (x0 * xi)))
    return axes


def structure_determinant(lower: Cells, upper: Cells) -> Interval:
    """Return enclosures of det K / d³ over pairs of cells."""
    minus = plus = Interval.from_numbers(1.0)
    for (a, b, c), (d, e, f) in zip(_axes(lower, -2.0), _axes(upper, 2.0), strict=True):
        first, second = 1.5 * (b * f - c * e), 0.5 * SQRT_3 * (c * d - a * f)
        minus, plus = minus * (first - second), plus * (first + second)
    return -(minus + plus) * (SQRT_3.reciprocal() * Interval.from_numbers(3.0).reciprocal())


def _divide(stages: list[_StageCells], target: float, most: int) -> tuple[float, FloatArray, int]:
    """Return the proved bound of |det K| / d³, the undecided boxes of tilts (N, 4, 2), and how many were looked at."""
    level, seen, bound = _GRID, 0, np.inf
    side = np.arange(1 << level)
    cells = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    first, second = (cells[stage.contain(level, cells)] for stage in stages)
    pairs = np.stack([np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))], axis=1)
    while True:
        seen += len(pairs)
        value = structure_determinant(_ends(level, pairs[:, 0]), _ends(level, pairs[:, 1]))
        least = value.least()
        bound = min(bound, float(least[least > target].min(initial=np.inf)))
        pairs, least = pairs[least <= target], least[least <= target]
        if not len(pairs) or level == _DEEPEST or seen + 16 * len(pairs) > most:
            ends = [np.stack([x.low, x.high], axis=-1) for k in range(2) for x in _ends(level, pairs[least <= 0.0, k])]
            return min(bound, float(least.min(initial=np.inf))), np.stack(ends, axis=1), seen
        halves = (2 * pairs[:, None] + _CORNERS).reshape(-1, 2, 2)
        level += 1
        pairs = halves[stages[0].contain(level, halves[:, 0]) & stages[1].contain(level, halves[:, 1])]
