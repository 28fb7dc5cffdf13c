"""The leg lengths that limits allow, the states with such lengths, and samples of these states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.mechanism.arguments import BoolArray, FloatArray, check_instance, first_offender
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.leg_limits import LEGS, LegLimits
from spm_pin.workspace.reachability.coarse_distance import CoarseDistance
from spm_pin.workspace.reachability.position_map import PositionMap
from spm_pin.workspace.reachability.stage_set import StageSet

_EPS = float(np.finfo(np.float64).eps)
_SAMPLE = 20_000
"""Number of states in `LegLengthBox.sample`."""
_SEED = 20_140_131
"""Seed of the samples, fixed so that results repeat."""


@dataclass(frozen=True, eq=False)
class LegLengthBox:
    """The leg lengths that limits allow, and the states and positions that belong to them."""

    geometry: Geometry
    limits: LegLimits
    minimum: FloatArray
    """Least leg lengths (6,) [m], none of them zero."""
    maximum: FloatArray
    """Largest leg lengths (6,) [m]."""
    family: str = "TT"
    """The family of the states."""
    sides: tuple[float, float] = (1.0, 1.0)
    """On which side of its forward singularities each stage is: 1 for the side of the home."""

    @property
    def size(self) -> float:
        """E + C + d + the longest legs [m]: what lengths are compared with."""
        g = self.geometry
        return float(g.base_radius + g.platform_radius + g.middle_side + self.maximum.max())

    @cached_property
    def map(self) -> PositionMap:
        """The states of the family by the coordinates of their stages."""
        return PositionMap(self.geometry, self.family)

    @cached_property
    def stages(self) -> tuple[StageSet, StageSet]:
        """The physical states of the lower and of the upper stage."""
        lower, upper = (
            StageSet(self.map, k, *(x[3 * k : 3 * k + 3] for x in (self.minimum, self.maximum))) for k in range(2)
        )
        return lower, upper

    def lengths(self, coordinates: FloatArray) -> FloatArray:
        """Return the leg lengths (N, 6) [m] of states (N, 2, 3), those within rounding of a limit at it."""
        lengths, tolerance = self.map.lengths(coordinates), 64.0 * _EPS * self.size
        lengths = np.where(lengths <= self.minimum + tolerance, self.minimum, lengths)
        return np.where(lengths >= self.maximum - tolerance, self.maximum, lengths)

    def confirm(self, lengths: FloatArray, expected: FloatArray, tolerance: float) -> tuple[BoolArray, FloatArray]:
        """Test whether `lengths` (N, 6) in the physical mode put o where it is `expected` (N, 3) [m], (N,); and where.

        To within `tolerance`, as a share of the machine's size.
        """
        position = forward_physical(self.geometry, lengths).translation
        with np.errstate(invalid="ignore"):
            missed = np.abs(position - expected).max(axis=-1, initial=0.0)
            return np.asarray(missed <= tolerance * self.size), position

    def draw(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Draw states uniformly in the coordinates of both stages, (count, 2, 3); and estimate their volume."""
        lower, upper = (stage.draw(count, rng) for stage in self.stages)
        return np.stack([lower[0], upper[0]], axis=1), lower[1] * upper[1]

    @cached_property
    def sample(self) -> FloatArray:
        """States within the limits, (n, 2, 3), always the same."""
        return self.draw(_SAMPLE, np.random.default_rng(_SEED))[0]

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the positions of o at the samples."""
        return KDTree(self.map.points(self.sample)[0])

    @cached_property
    def coarse(self) -> CoarseDistance:
        """Coarse distances from the reachable positions, by samples that are always the same."""
        return CoarseDistance(*self.stages, np.random.default_rng(_SEED))


def leg_length_box(geometry: Geometry, limits: LegLimits | None = None) -> LegLengthBox:
    """Return the box of leg lengths within `limits`, or within those of `geometry`.

    Raises
    ------
    ArgumentError
        If there are no limits or one is infinite, or no lengths within them belong to a configuration.
    """
    check_instance(geometry, Geometry, "geometry")
    limits = geometry.limits if limits is None else limits
    if not isinstance(limits, LegLimits):
        cause = "The geometry has none of its own" if limits is None else ""
        raise ArgumentError("limits", "LegLimits(minimum, maximum) in metres", repr(limits), cause)
    if not np.isfinite(limits.maximum).all():
        leg = LEGS[first_offender(~np.isfinite(limits.maximum))[0]]
        raise ArgumentError(
            "limits", "a finite maximum for every leg", f"infinity for {leg}", "The set has no end then"
        )
    return _checked(geometry, limits)


@lru_cache(maxsize=8)
def _checked(geometry: Geometry, limits: LegLimits) -> LegLengthBox:
    # A leg of no length has no direction.
    maximum = np.array(limits.maximum)
    box = LegLengthBox(geometry, limits, np.maximum(limits.minimum, 1e-6 * maximum), maximum)
    if not all(len(stage.draw(1, np.random.default_rng(_SEED))[0]) for stage in box.stages):
        received = f"limits from {min(limits.minimum):g} to {max(limits.maximum):g} m, which reach no pose"
        cause = "Too short to join the platforms, too different from each other, or in another unit?"
        raise ArgumentError("limits", "leg limits within which the machine can be assembled", received, cause)
    return box
