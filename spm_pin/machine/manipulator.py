"""The dimensions and parameters of a manipulator, nominal or calibrated, and its files.

Frames (Fig. 1 and Eq. (1) of the paper): {B} at the centre O of the base triangle, Z up; {m} at the centre o of the
terminal platform, z up; {n} at the centre of the middle platform's triangle, x along b_3 b_1 and z normal to it. Legs
1, 2, 3 are at the azimuths -30, 90 and 210 degrees in all three.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from spm_pin.errors import GeometryError, raised_as
from spm_pin.machine.leg_kinds import RPS, LegKind
from spm_pin.machine.legs import (
    AXES,
    COMPONENTS,
    LEGS,
    RADIAL,
    LegLimits,
    Legs,
)
from spm_pin.machine.machine import ALONE, Machine
from spm_pin.machine.machine_files import (
    legs_as_data,
    limits_as_data,
    read_kind,
    read_legs,
    read_limits,
    read_mapping,
)
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import FloatArray, check_instance, dimension
from spm_pin.support.files import read_yaml

PARAMETERS = tuple(f"{leg}.{component}" for leg in LEGS for component in COMPONENTS)
"""Names of the 54 parameters of RPS legs, nine for each, in the order of `Manipulator.parameters`."""

_SAME = 1e-9
"""Machines with smaller relative differences, divided by the middle side, count as the same."""

_DIMENSIONS = {"E": "base_radius", "C": "platform_radius", "d": "middle_side"}
_SYMBOLS = _DIMENSIONS | {"limits": "a key of a stage's file, which spm_pin.Stage.from_yaml reads, and spm-pin stage"}
_KIND_KEYS = "lower_legs", "upper_legs"


def config_directory() -> Path:
    """Return the folder of the YAML files of the description, in an installed package or in a checkout."""
    package = Path(str(resources.files("spm_pin")))
    installed = package / "share" / "spm_description" / "config"
    return installed if installed.is_dir() else package.parent / "urdf" / "config"


@dataclass(frozen=True, init=False, repr=False)
class Manipulator(Machine):
    """Dimensions of a manipulator, and its legs, nominal or calibrated.

    Parameters
    ----------
    base_radius, platform_radius : float
        E and C, from the centres O and o of base and terminal platform to their revolute joints a_i and c_i [m].
    middle_side : float
        d, side of the middle platform's triangle b_1 b_2 b_3 [m].
    limits : (minimum, maximum) or LegLimits, optional
        Limits of the encoders' readings, which in a nominal machine are the leg lengths. None means unlimited.
    legs : (LegKind, LegKind) or Legs, optional
        Kinds of the lower and of the upper legs, `RPS` if not given; or the legs of a calibrated machine, whose
        branches have the names of the nominal machine's.

    Notes
    -----
    A dimension is a number from 1e-9 to 1e9 m: then no product of lengths in this package over- or underflows. Six of
    the 54 parameters of the legs are a choice of {n} and do not change readings.
    """

    base_radius: float
    platform_radius: float
    middle_side: float
    limits: LegLimits | None
    legs: Legs

    file_stem = "spm"
    _least_share = 0.01
    _heading = "# A manipulator of two stages, lengths in metres and angles in radians: see Manipulator of spm_pin.\n"

    @raised_as(GeometryError)
    def __init__(
        self,
        base_radius: float,
        platform_radius: float,
        middle_side: float,
        limits: LegLimits | Sequence[Any] | None = None,
        legs: tuple[LegKind, LegKind] | Legs | None = None,
    ) -> None:
        for name, value in zip(_DIMENSIONS.values(), (base_radius, platform_radius, middle_side), strict=True):
            object.__setattr__(self, name, dimension(value, name))
        self._set_legs((RPS(), RPS()) if legs is None else legs)
        object.__setattr__(self, "limits", None if limits is None else self._checked_limits(limits, are_own=True))
        if not isinstance(legs, Legs):
            self._warn_of_dimensions({name: getattr(self, name) for name in _DIMENSIONS.values()})

    def __repr__(self) -> str:
        sizes = ", ".join(f"{name}={getattr(self, name):.6g}" for name in _DIMENSIONS.values())
        legs = "" if self.legs.are_rps else f", legs={self.legs.kinds!r}"
        return f"Manipulator({sizes}{legs}{self._repr_end()}"

    @classmethod
    @raised_as(GeometryError)
    def of_stages(cls, lower: Stage, upper: Stage) -> Manipulator:
        """Return the machine of two stages, each with legs of any kind, whose platforms are one triangle of balls.

        The upper stage is turned over about its y axis, its base is the terminal platform, and it is mounted on the
        same balls: its legs 3, 2, 1 are `r_c1` to `r_c3`. The platforms' frames of calibrated stages become one, {n}.
        """
        check_instance(lower, Stage, "lower")
        check_instance(upper, Stage, "upper")
        if not math.isclose(lower.platform_radius, upper.platform_radius, rel_tol=_SAME):
            expected = (
                f"the platform_radius of the lower stage, {lower.platform_radius:g} m: both share one triangle of balls"
            )
            raise GeometryError("upper", expected, f"{upper.platform_radius:g} m")
        dimensions = lower.base_radius, upper.base_radius, math.sqrt(3.0) * lower.platform_radius
        low, high = (x.limits or x.legs.free_limits for x in (lower, upper))
        limits = LegLimits(low.minimum + high.minimum[::-1], low.maximum + high.maximum[::-1])
        kinds = lower.kind, upper.kind.turned_over
        legs: Legs | tuple[LegKind, LegKind] = kinds
        if not (lower.is_nominal and upper.is_nominal):
            pairs = zip(lower.legs.arrays, upper.legs.turned_over.arrays, strict=True)
            axes, pivots, balls, offsets = map(np.concatenate, pairs)
            legs = Legs(axes, pivots, balls, offsets, kinds)
        return cls(*dimensions, limits if lower.limits or upper.limits else None, legs)

    @classmethod
    @cache
    def paper(cls) -> Manipulator:
        """Return the paper's manipulator: E = 1.2/√3 m, C = 0.6/√3 m, d = 0.8 m, legs from 1.10 to 1.50 m.

        The paper prints no leg limits; these are this project's own, see `urdf/config/geometry.yaml`.
        """
        return cls.from_yaml(config_directory() / "geometry.yaml")

    @classmethod
    def from_data(cls, data: Any, argument: str = "data") -> Manipulator:
        """Return the machine of `as_data`; a `GeometryError` names a wrong key, or `argument` for the whole."""
        sizes = {f"{triangle}_{size}" for triangle in ("base", "platform") for size in ("side", "radius")}
        own = {"leg_limits", "legs", *_KIND_KEYS}
        read = read_mapping(data, argument, {"middle_side"}, sizes | own, _SYMBOLS)
        lengths = {key: dimension(read[key], key) for key in read.keys() - own}
        radii = []
        for triangle in ("base", "platform"):
            keys = [key for key in (f"{triangle}_side", f"{triangle}_radius") if key in lengths]
            if len(keys) != 1:
                expected = f"exactly one of the keys {triangle}_side and {triangle}_radius"
                raise GeometryError(argument, expected, " and ".join(keys) or "neither")
            radii.append(lengths[keys[0]] / (math.sqrt(3.0) if keys[0].endswith("_side") else 1.0))
        limits = read_limits(read["leg_limits"], "leg_limits", LEGS) if "leg_limits" in read else None
        lower, upper = (read_kind(read[key], key) if key in read else RPS() for key in _KIND_KEYS)
        legs = read_legs(read["legs"], "legs", (lower, upper)) if "legs" in read else (lower, upper)
        return cls(radii[0], radii[1], lengths["middle_side"], limits, legs)

    def as_data(self) -> dict[str, Any]:
        """Return the data that `to_yaml` writes."""
        data: dict[str, Any] = dict(zip(_DIMENSIONS.values(), self.dimensions, strict=True))
        if self.limits is not None:
            data["leg_limits"] = limits_as_data(self.limits)
        if not self.legs.are_rps:
            data |= {key: kind.as_data() for key, kind in zip(_KIND_KEYS, self.legs.kinds, strict=True)}
        if not self.is_nominal:
            data["legs"] = legs_as_data(self.legs)
        return data

    @property
    def dimensions(self) -> tuple[float, float, float]:
        """E, C and d [m]."""
        return self.base_radius, self.platform_radius, self.middle_side

    @property
    def ball_side(self) -> float:
        """D [m]."""
        return self.middle_side

    @property
    def architecture(self) -> str:
        """Name of the mechanism, such as "3RPS-3SPR"."""
        lower, upper = (kind.name for kind in self.legs.kinds)
        return f"3{lower}-3{upper[::-1]}"

    @property
    def size(self) -> float:
        """E + C + 2 d [m], the approximate height of a machine."""
        return self.base_radius + self.platform_radius + 2.0 * self.middle_side

    @property
    def stage_radii(self) -> tuple[tuple[float, float], ...]:
        """Radii of the nominal triangles of the lower and of the upper stage, of pivots and of balls [m]."""
        return (self.base_radius, self.middle_radius), (self.platform_radius, self.middle_radius)

    @property
    def middle_radius(self) -> float:
        """Radius r = d/√3 of the nominal middle platform, from its centre to a ball joint b_i [m]."""
        return self.middle_side / math.sqrt(3.0)

    @property
    def base_joints(self) -> FloatArray:
        """Lower revolute joints a_1..a_3 of the nominal machine as rows (3, 3) [m] in {B}. Eq. (1a)."""
        return self.base_radius * RADIAL

    @property
    def platform_joints(self) -> FloatArray:
        """Upper revolute joints c_1..c_3 of the nominal machine as rows (3, 3) [m] in {m}. Eq. (1b)."""
        return self.platform_radius * RADIAL

    @property
    def radial_directions(self) -> FloatArray:
        """Unit vectors from O towards the nominal a_i in {B}, equally from o towards c_i in {m}, as rows (3, 3)."""
        return RADIAL.copy()

    @property
    def revolute_axes(self) -> FloatArray:
        """Unit revolute axes of the nominal legs 1..3 as rows (3, 3): in {B} at the a_i, in {m} at the c_i. Eq. (4)."""
        return AXES.copy()


def machine_from_data(data: Any, argument: str = "data") -> Manipulator | Stage:
    """Return the machine of `as_data`: a stage if there are legs but no side of the middle platform."""
    is_stage = isinstance(data, dict) and "legs" in data and "middle_side" not in data
    return (Stage if is_stage else Manipulator).from_data(data, argument)


def machine_from_yaml(path: str | Path) -> Manipulator | Stage:
    """Read a machine of either kind from a YAML file."""
    with raised_as(GeometryError, file=str(path)):
        return machine_from_data(read_yaml(path), "")


def check_manipulator(value: Any, argument: str = "machine", *, for_stage: str = ALONE) -> Manipulator:
    """Return `value` if it is a manipulator; `for_stage` is the cause that an error states for a stage."""
    return check_instance(value, Manipulator, argument, for_stage * isinstance(value, Stage))


def check_same_machine(machine: Machine, expected: Machine, argument: str, owner: str) -> None:
    """Raise `GeometryError` unless both have the same dimensions and legs; limits only choose the tree's zero."""
    if machine.dimensions == expected.dimensions and machine.legs == expected.legs:
        return
    cause = "Computed for another machine?"
    if type(machine) is not type(expected):
        raise GeometryError(argument, f"a state of {owner}, a {type(expected).__name__}", repr(machine), cause)
    for kind, wanted in zip(machine.legs.kinds, expected.legs.kinds, strict=True):
        if type(kind) is not type(wanted) or getattr(kind, "sign", 0) != getattr(wanted, "sign", 0):
            raise GeometryError(argument, f"the kinds of {owner}, {wanted!r}", repr(kind), cause)
    sizes = [name for name in _DIMENSIONS.values() if hasattr(expected, name)]
    names, units = (*sizes, *expected.parameter_names), ("m",) * len(sizes) + expected.parameter_units
    own, others = ([*each.dimensions, *each.parameters.tolist()] for each in (machine, expected))
    for name, unit, received, number in zip(names, units, own, others, strict=True):
        if abs(received - number) > _SAME * (1.0 if unit == "rad" else expected.ball_side):
            raise GeometryError(
                argument, f"the {name} of {owner}, {number:.9g} {unit}", f"{received:.9g} {unit}", cause
            )


def check_rps(machine: Machine, what: str) -> None:
    """Raise a `GeometryError` unless all legs are RPS, which `what` is known for alone."""
    if not machine.legs.are_rps:
        names = [kind.name for kind in machine.legs.kinds]
        received = "{} below and {} above".format(*names) if len(names) == 2 else names[0]
        cause = "What takes PRS and RRS legs is listed in docs/howto/other_legs.md"
        raise GeometryError("machine", f"a machine of RPS legs for {what}", received, cause)
