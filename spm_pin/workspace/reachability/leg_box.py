"""The leg lengths that limits allow, with a sample of them and of where they put the platform."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from spm_pin.closed_form.forward_displacement import forward_physical
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, first_offender
from spm_pin.mechanism.geometry import LEGS, Geometry, LegLimits
from spm_pin.workspace.reachability.position_map import PositionMap, stage_coordinates

__all__ = ["LegBox", "leg_box"]

_EPS = float(np.finfo(np.float64).eps)
_TABLE = 20_000
_SEED = 20_140_131  # of the sample: any number, but always the same


@dataclass(frozen=True)
class LegBox:
    """The leg lengths that limits allow, and where a sample of them puts the platform.

    Attributes
    ----------
    geometry : Geometry
        The manipulator.
    limits : LegLimits
        Of its legs.
    minimum, maximum : ndarray, shape (6,)
        The same [m].
    lengths : ndarray, shape (n, 6)
        A sample of the box and of its faces of all dimensions, without those that belong to no configuration [m].
    positions : ndarray, shape (n, 3)
        Where o is then, in {B} [m].
    coordinates : ndarray, shape (n, 2, 3)
        The same states for `spm_pin.workspace.reachability.position_map`.
    tree : KDTree
        Of `positions`.
    """

    geometry: Geometry
    limits: LegLimits
    minimum: FloatArray
    maximum: FloatArray
    lengths: FloatArray
    positions: FloatArray
    coordinates: FloatArray
    tree: KDTree

    @property
    def size(self) -> float:
        """E + C + d + the longest legs [m]: what lengths are compared with."""
        g = self.geometry
        return float(g.base_radius + g.platform_radius + g.middle_side + self.maximum.max())

    def snapped(self, lengths: FloatArray) -> FloatArray:
        """Return `lengths` (N, 6) within the limits, those within rounding of a limit at it."""
        tolerance = 64.0 * _EPS * self.size
        lengths = np.where(lengths <= self.minimum + tolerance, self.minimum, lengths)
        return np.where(lengths >= self.maximum - tolerance, self.maximum, lengths)

    @property
    def map(self) -> PositionMap:
        """The map from lengths to positions."""
        return PositionMap(self.geometry)


def leg_box(geometry: Geometry, limits: LegLimits | None = None) -> LegBox:
    """Sample the box of leg lengths within `limits`, or within those of `geometry`.

    Raises
    ------
    ArgumentError
        If there are no limits or one is infinite, or no lengths within them belong to a configuration.
    """
    if not isinstance(geometry, Geometry):
        raise ArgumentError("geometry", "a Geometry", type(geometry).__name__)
    limits = geometry.limits if limits is None else limits
    if not isinstance(limits, LegLimits):
        cause = "The geometry has none of its own" if limits is None else ""
        raise ArgumentError("limits", "LegLimits(minimum, maximum) in metres", repr(limits), cause)
    if not np.isfinite(limits.maximum).all():
        leg = LEGS[first_offender(~np.isfinite(limits.maximum))[0]]
        raise ArgumentError(
            "limits", "a finite maximum for every leg", f"infinity for {leg}", "The set has no end then"
        )
    return _sampled(geometry, limits)


@lru_cache(maxsize=8)
def _sampled(geometry: Geometry, limits: LegLimits) -> LegBox:
    rng = np.random.default_rng(_SEED)
    # A leg of no length has no direction.
    low, high = np.maximum(limits.minimum, 1e-6 * np.array(limits.maximum)), np.array(limits.maximum)
    share = rng.uniform(size=(_TABLE, 6))
    ends = rng.uniform(size=share.shape) < rng.uniform(size=(_TABLE, 1))
    lengths = low + np.where(ends, np.round(share), share) * (high - low)
    states = forward_physical(geometry, lengths)
    found = states.exists
    if not found.any():
        received = f"limits from {min(limits.minimum):g} to {max(limits.maximum):g} m, which reach no pose"
        cause = "Too short to join the platforms, too different from each other, or in another unit?"
        raise ArgumentError("limits", "leg limits within which the machine can be assembled", received, cause)
    states = states[found]
    coordinates, positions = stage_coordinates(states), states.translation
    return LegBox(geometry, limits, low, high, lengths[found], positions, coordinates, KDTree(positions))
