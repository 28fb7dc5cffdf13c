"""A stage: three planar legs of one kind on a plate, and the triangle of balls that they hold."""

from __future__ import annotations

from dataclasses import dataclass

from spm_pin.errors import GeometryError, raised_as
from spm_pin.mechanism.arguments import check_instance, dimension, number_pair
from spm_pin.mechanism.leg_kinds import RPS, LegKind

_LENGTHS = RPS()


@dataclass(frozen=True)
class Stage:
    """A stage as drawn: two of them, on one triangle of balls, are a `Geometry`.

    Parameters
    ----------
    base_radius, platform_radius : float
        From the centre of the plate to the legs' pivots, and from that of the triangle to its balls [m].
    legs : LegKind
        `RPS()`, `PRS(rod=…)` or `RRS(crank=…, rod=…)`.
    limits : (minimum, maximum), optional
        Of the readings of its legs: [m], of RRS legs [rad].
    """

    base_radius: float
    platform_radius: float
    legs: LegKind = _LENGTHS
    limits: tuple[float, float] | None = None

    @raised_as(GeometryError)
    def __post_init__(self) -> None:
        for name in ("base_radius", "platform_radius"):
            object.__setattr__(self, name, dimension(getattr(self, name), name))
        check_instance(self.legs, LegKind, "legs", "RPS(), PRS(rod=…) or RRS(crank=…, rod=…)")
        if self.limits is not None:
            object.__setattr__(self, "limits", number_pair(self.limits, "limits", self.legs.unit))
