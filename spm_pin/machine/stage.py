"""A stage: three planar legs of one kind on a plate, and the triangle of balls on them.

It is a machine of its own (a ball balancer, a tripod head, a mirror mount), and half of a `Manipulator`. Its
base has the frame {B} at the centre of the pivots, z towards the platform; the platform has {n} at the centre of the
balls. Legs 1, 2, 3 are at the azimuths -30, 90 and 210 degrees in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.errors import GeometryError, raised_as
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.machine.leg_kinds import PRS, RPS, RRS, LegKind
from spm_pin.machine.legs import AZIMUTHS, STAGE_LEGS, LegLimits, Legs
from spm_pin.machine.machine import Machine
from spm_pin.machine.machine_files import (
    legs_as_data,
    limits_as_data,
    read_kind,
    read_legs,
    read_limits,
    read_mapping,
)
from spm_pin.support.arguments import FloatArray, dimension, real_array

_LENGTHS = RPS()
_SAME_ANGLE = 1e-14
_LEVEL = 1e-9
"""Sine of the rise of a slide up to which it counts as level."""


@dataclass(frozen=True, init=False, repr=False)
class Stage(Machine):
    """Three planar legs of one kind on a base, and a platform on their balls, nominal or calibrated.

    Parameters
    ----------
    base_radius, platform_radius : float
        Distances from the centre of the base to the pivots, and from the centre of the platform to the balls [m].
    legs : LegKind or Legs
        For a nominal stage `RPS()`, `PRS(rod=…)` or `RRS(crank=…, rod=…)`; for a calibrated one `Legs` of three, with
        their axes, pivots, balls and offsets.
    limits : (minimum, maximum) or LegLimits, optional
        Limits of the readings, each one number or three: [m], for RRS legs [rad]. None means unlimited.
    azimuths : sequence of three floats, optional
        Directions of legs 1, 2, 3, counterclockwise, from x towards y [rad]: of the pivot, the ball and the
        plane of each leg. Their mean must be within a quarter turn of -30°, 90° and 210°, the default; leg 1 is
        the one nearest to -30°. `Legs` have their own directions.

    Notes
    -----
    Two stages on one triangle of balls are a `Manipulator`. A stage whose platform hangs is described upside down, z
    downwards. `spm_pin.multibody.read_stage` measures a stage in an MJCF, URDF or SDF file.

    Examples
    --------
    >>> import spm_pin as spm
    >>> balancer = spm.Stage(base_radius=0.08, platform_radius=0.09, legs=spm.RRS(crank=0.05, rod=0.11))
    >>> state = spm.inverse_physical(balancer, height=0.12, tilt=0.2, azimuth=0.0)
    >>> state.readings.round(4)
    array([0.0547, 0.3299, 0.6472])
    """

    base_radius: float
    platform_radius: float
    legs: Legs
    limits: LegLimits | None

    is_stage = True
    file_stem = "stage"
    _least_share = 0.0
    _heading = "# A stage of three planar legs, lengths in metres and angles in radians: see Stage of spm_pin.\n"

    @raised_as(GeometryError)
    def __init__(
        self,
        base_radius: float,
        platform_radius: float,
        legs: LegKind | Legs = _LENGTHS,
        limits: LegLimits | Sequence[Any] | None = None,
        *,
        azimuths: Sequence[float] | None = None,
    ) -> None:
        for name, value in (("base_radius", base_radius), ("platform_radius", platform_radius)):
            object.__setattr__(self, name, dimension(value, name))
        self._set_legs((legs,) if isinstance(legs, LegKind) else legs)
        if azimuths is not None:
            if isinstance(legs, Legs):
                raise GeometryError("azimuths", "None together with Legs of three, which have their own axes", azimuths)
            angles = real_array(azimuths, "azimuths", (3,), "of legs 1, 2, 3 in radians")
            if np.shape(angles) != (3,) or (np.abs(angles) > MOST_TURNED).any():
                expected = f"three angles in radians, within ±{MOST_TURNED:g}"
                raise GeometryError("azimuths", expected, np.array2string(angles), "Are they in degrees?")
            turns = np.mod(angles - AZIMUTHS + np.pi, 2.0 * np.pi) - np.pi
            # Directions that differ from the default by rounding only are nominal.
            if (np.abs(turns) > _SAME_ANGLE).any():
                try:
                    self._set_legs(self.legs.turned_about_z(turns))
                except GeometryError as error:
                    raise _azimuths_error(angles) from error
        self._check_reach()
        object.__setattr__(self, "limits", None if limits is None else self._checked_limits(limits, are_own=True))
        if isinstance(legs, LegKind):
            self._warn_of_dimensions({"base_radius": self.base_radius, "platform_radius": self.platform_radius})

    def _check_reach(self) -> None:
        """Raise `GeometryError` for a leg that does not reach its ball at any height of the level platform."""
        pivots, balls = self.legs.pivots, self.legs.balls
        outward, _ = self.legs.planes
        x = ((balls - pivots) * outward).sum(axis=-1)
        kind, numbers = self.kind, self.kind.numbers
        if isinstance(kind, RRS):
            reach, needed = numbers[:, 0] + numbers[:, 1], np.abs(x)
        elif isinstance(kind, PRS):
            # Along a slide that rises the carriage follows the ball; otherwise the height is free and the rod spans z.
            vertical = np.abs(np.cos(numbers[:, 1])) < _LEVEL
            reach, needed = numbers[:, 0], np.where(vertical, np.abs(x), 0.0)
        else:
            return
        if (short := reach <= needed).any():
            leg, cause = int(short.argmax()), "In another unit?"
            if reach[leg] > 0.5 * needed[leg]:
                cause = "In another unit, or diameters for radii?"
            what = "crank and rod" if isinstance(kind, RRS) else "a rod"
            expected = (
                f"{what} longer than {needed[leg]:.4g} m, the radial distance from pivot to ball of the level platform"
            )
            raise GeometryError("legs", expected, f"{reach[leg]:.4g} m for {self.legs.names[leg]}", cause)

    def __repr__(self) -> str:
        radii = f"base_radius={self.base_radius:.6g}, platform_radius={self.platform_radius:.6g}"
        return f"Stage({radii}, legs={self.kind!r}{self._repr_end()}"

    @property
    def kind(self) -> LegKind:
        """Kind of the three legs, with their fixed numbers."""
        return self.legs.kinds[0]

    @property
    def unit(self) -> str:
        """Unit of the readings, "m" or "rad"."""
        return self.kind.unit

    @property
    def architecture(self) -> str:
        """Name of the mechanism, such as "3-RRS"."""
        return f"3-{self.kind.name}"

    @property
    def size(self) -> float:
        """Approximate height of the stage [m]."""
        own = [float(np.max(getattr(self.kind, name))) for name in ("crank", "rod") if hasattr(self.kind, name)]
        return self.base_radius + self.platform_radius + sum(own)

    @property
    def dimensions(self) -> tuple[float, float]:
        """Radii of base and platform [m]."""
        return self.base_radius, self.platform_radius

    @property
    def stage_radii(self) -> tuple[tuple[float, float], ...]:
        """Radii of the nominal triangles, of the pivots and of the balls [m]."""
        return ((self.base_radius, self.platform_radius),)

    @classmethod
    def from_data(cls, data: Any, argument: str = "data") -> Stage:
        """Return the stage of `as_data`; a `GeometryError` names a wrong key, or `argument` for the whole."""
        keys = {"base_radius", "platform_radius", "legs"}
        other = {"middle_side": "a key of a robot's file, which spm_pin.Manipulator.from_yaml reads"}
        read = read_mapping(data, argument, keys, {"limits", "as_built"}, other)
        kind = read_kind(read["legs"], "legs")
        legs = read_legs(read["as_built"], "as_built", (kind,)) if "as_built" in read else kind
        limits = read_limits(read["limits"], "limits", STAGE_LEGS) if "limits" in read else None
        return cls(read["base_radius"], read["platform_radius"], legs, limits)

    def as_data(self) -> dict[str, Any]:
        """Return the data that `to_yaml` writes."""
        data: dict[str, Any] = {"base_radius": self.base_radius, "platform_radius": self.platform_radius}
        data["legs"] = self.kind.as_data()
        if self.limits is not None:
            data["limits"] = limits_as_data(self.limits)
        if not self.is_nominal:
            data["as_built"] = legs_as_data(self.legs)
        return data


def _azimuths_error(angles: FloatArray) -> GeometryError:
    """Return the error for azimuths in a wrong order, or of legs that form no triangle."""
    order = np.argsort(np.mod(angles, 2.0 * np.pi))
    best = max((np.roll(order, k) for k in range(3)), key=lambda x: float(np.cos(angles[x] - AZIMUTHS).sum()))
    expected = "three azimuths in radians, counterclockwise from the one nearest to -30 degrees, for legs in a triangle"
    cause = "" if (best == np.arange(3)).all() else f"In this order they are {np.array2string(angles[best])}"
    return GeometryError("azimuths", expected, np.array2string(angles), cause)
