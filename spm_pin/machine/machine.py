"""The base class of `Stage` and `Manipulator`: legs, their parameters and limits, files, and checks of proportions."""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import numpy.typing as npt
import yaml

from spm_pin.errors import ArgumentError, GeometryError, raised_as
from spm_pin.formulas.operations import on_arrays
from spm_pin.formulas.planar_legs import MOST_TURNED, crank_middle
from spm_pin.machine.leg_kinds import RPS, LegKind
from spm_pin.machine.legs import LegLimits, Legs, nominal_legs
from spm_pin.support.arguments import FloatArray, frozen, type_and_value
from spm_pin.support.files import file_path, read_yaml, write_files

M = TypeVar("M")

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
"""Units of length, and their number per metre."""
_PROPORTION = 10.0
"""Lengths this many times the machine's size are assumed to be in a wrong unit."""
_LARGE, _UNLIKE, _LONG_CRANK = 5.0, 100.0, 1.5
"""Dimensions larger than this [m], this many times another one, or cranks this many times their rods, are unusual."""
_USUAL = 0.4
"""Share of the machine's size that heights, readings and positions usually have."""
_crank_middle = on_arrays(crank_middle)


class Machine(ABC):
    """A `Stage`, or a `Manipulator` of two stages: dimensions and legs, nominal or calibrated."""

    base_radius: float
    legs: Legs
    limits: LegLimits | None
    is_stage: ClassVar[bool] = False
    """True for one stage, False for a manipulator of two."""
    file_stem: ClassVar[str]
    """First part of the names of its files and models: "stage" or "spm"."""
    _heading: ClassVar[str]
    """First line of its files."""
    _least_share: ClassVar[float]
    """Limits of lengths above this, relative to the machine's size, are in the unit of its dimensions."""

    @property
    @abstractmethod
    def architecture(self) -> str:
        """Name of the mechanism in the literature, such as "3RPS-3SPR" or "3-RRS"."""

    @property
    @abstractmethod
    def size(self) -> float:
        """Approximate height [m]."""

    @property
    def ball_side(self) -> float:
        """Side of the nominal triangle of balls [m]."""
        return math.sqrt(3.0) * self.stage_radii[0][1]

    @property
    @abstractmethod
    def dimensions(self) -> tuple[float, ...]:
        """Nominal radii of the pivots of each stage, and the size of the triangle of balls [m]."""

    @property
    @abstractmethod
    def stage_radii(self) -> tuple[tuple[float, float], ...]:
        """Radii of the nominal triangles of each stage, of its pivots and of its balls [m]."""

    @abstractmethod
    def as_data(self) -> dict[str, Any]:
        """Return the data that `to_yaml` writes."""

    @classmethod
    @abstractmethod
    def from_data(cls, data: Any, argument: str = "data") -> Self:
        """Return the machine of `as_data`; errors name the wrong key, or `argument` for the whole."""

    def _set_legs(self, legs: Legs | tuple[LegKind, ...]) -> None:
        """Set the legs: kinds, and legs that are nominal for other dimensions, are replaced by nominal legs."""
        kinds, count = legs.kinds if isinstance(legs, Legs) else legs, len(self.stage_radii)
        if not (isinstance(kinds, tuple) and len(kinds) == count and all(isinstance(kind, LegKind) for kind in kinds)):
            own = "RPS(), PRS(rod=…) or RRS(crank=…, rod=…), or the Legs of three"
            expected = own if count == 1 else "a pair such as (RPS(), RRS(crank=…, rod=…)), or the Legs of six"
            received = (
                f"Legs of {'three' if len(kinds) == 1 else 'six'}" if isinstance(legs, Legs) else type_and_value(legs)
            )
            raise GeometryError("legs", expected, received)
        drawn = nominal_legs(self.stage_radii, kinds)
        # Legs with different numbers are those of a calibrated machine.
        if not isinstance(legs, Legs) and not all(kind.has_equal_legs for kind in kinds):
            legs = Legs(*drawn.arrays, kinds)
        is_built = isinstance(legs, Legs) and not legs.is_nominal and legs != drawn
        object.__setattr__(self, "legs", legs if is_built else drawn)

    def check_limits(self, limits: LegLimits | Sequence[Any]) -> LegLimits:
        """Return limits, or raise `GeometryError` if no readings of this machine have them or their unit is another.

        A pair (minimum, maximum) is taken too, each one number or one for each leg.
        Readings of cranks are nearest to the middle of the machine's own limits, so that limits of another turn have
        to be those of the machine itself.
        """
        return self._checked_limits(limits, are_own=False)

    def _checked_limits(self, given: Any, *, are_own: bool) -> LegLimits:
        """Return limits, the machine's own or others, or raise `GeometryError`."""
        legs = self.legs
        limits = self._limits_of_legs(given)
        without_offsets = limits.ends - legs.offsets
        ends = np.where(np.isfinite(without_offsets), np.abs(without_offsets), 0.0)
        middles = _crank_middle(*limits.ends, legs.offsets) if are_own else self.crank_middles
        beyond = np.abs(without_offsets - middles) - math.pi - limits.rounding
        is_beyond_turn = np.isfinite(beyond) & (beyond > 0.0)
        for leg, name in enumerate(legs.names):
            kind, low, high = legs.kinds[leg // 3], limits.minimum[leg], limits.maximum[leg]
            received = f"[{low:g}, {high:g}] for {name}"
            # A minimum of zero stays when a calibration gives the leg an offset.
            if isinstance(kind, RPS) and low < min(0.0, legs.offsets[leg]):
                offset, expected = legs.offsets[leg], "limits of lengths, 0 <= minimum < maximum, in metres"
                cause = f"Readings exceed the lengths by the leg's offset, {offset:g} m" if offset else ""
                raise GeometryError("limits", expected, received, cause)
            if kind.unit == "rad" and ends[:, leg].max() > MOST_TURNED:
                raise GeometryError("limits", f"angles in radians, within ±{MOST_TURNED:g}", received, "In degrees?")
            if kind.unit == "rad" and is_beyond_turn[:, leg].any():
                first, last = middles[leg] + legs.offsets[leg] + np.array([-math.pi, math.pi])
                expected = f"angles of a crank within one turn, here from {first:.4g} to {last:.4g} rad"
                cause = (
                    "Readings are the angles nearest to the middle of the machine's own limits, or to pi/2 without two"
                )
                raise GeometryError("limits", expected, received, cause)
        lengths = ends[:, np.array(legs.units) == "m"]
        longest = float(lengths.max(initial=0.0))
        cause = f"is it {longest:g} {unit}?" if (unit := likely_unit(self, longest)) else ""
        if lengths[1].any() and longest < self._least_share * self.size:
            cause = f"is base_radius {self.base_radius:g} mm or cm?"
        if cause:
            expected = f"limits in proportion to a machine about {self.size:.3g} m high, or infinity for none"
            cause = f"Lengths are in metres: {cause}"
            raise GeometryError("limits", expected, f"lengths of up to {longest:g} m", cause)
        return limits

    def _limits_of_legs(self, limits: Any) -> LegLimits:
        """Return limits of all legs, given as such, for one leg, or as a pair (minimum, maximum)."""
        count = len(self.legs.names)
        read: LegLimits = limits
        if not isinstance(limits, LegLimits):
            if not (isinstance(limits, list | tuple | np.ndarray) and len(limits) == 2):
                expected = f"LegLimits, or a pair (minimum, maximum), each one number or {count}"
                raise GeometryError("limits", expected, type_and_value(limits))
            try:
                are_numbers = all(np.ndim(end) == 0 for end in limits)
                read = LegLimits(*([end] * count if are_numbers else end for end in limits))
            except GeometryError as error:
                raise error.replaced(argument="limits") from None
        ends = read.minimum, read.maximum
        if len(ends[0]) != count:
            if any(len(set(end)) > 1 for end in ends):
                raise GeometryError("limits", f"limits of {count} legs, or one for all", f"limits of {len(ends[0])}")
            read = LegLimits(*([end[0]] * count for end in ends))
        return read

    def _warn_of_dimensions(self, lengths: dict[str, float]) -> None:
        """Warn if dimensions or links are unusual, and may be in another unit or exchanged."""
        lengths = dict(lengths)
        for kind in self.legs.kinds:
            own = {name: float(np.mean(getattr(kind, name))) for name in ("crank", "rod") if hasattr(kind, name)}
            lengths |= {f"{name} of {kind.name}": length for name, length in own.items()}
            if own.get("crank", 0.0) > _LONG_CRANK * own.get("rod", math.inf):
                warnings.warn(f"{kind!r}: the crank is longer than the rod. Are they exchanged?", stacklevel=4)
        (short, shortest), (long, longest) = (f(lengths.items(), key=lambda x: x[1]) for f in (min, max))
        text = f"{long} is {longest:g} m" + f" and {short} {shortest:g} m" * (longest > _UNLIKE * shortest)
        if longest > _LARGE or longest > _UNLIKE * shortest:
            cause = "Lengths are read as metres; are these in another unit?"
            warnings.warn(f"{text}. {cause}", stacklevel=4)

    def _repr_end(self) -> str:
        """Return limits, and the differences from the nominal legs, as the end of the machine's text."""
        limits = "" if self.limits is None else f", limits={self.limits!r}"
        if self.is_nominal:
            return f"{limits})"
        angles, pivots, balls, offsets = self.legs.deviations(self.nominal.legs)
        first = 9 * len(offsets)
        numbers = np.abs(self.parameters - self.nominal.parameters)[first:]
        turns, turned = (
            np.array(units, dtype=str) == "rad" for units in (self.legs.units, self.parameter_units[first:])
        )
        length = max(x.max(initial=0.0) for x in (pivots, balls, offsets[~turns], numbers[~turned]))
        angle = max(x.max(initial=0.0) for x in (angles, offsets[turns], numbers[turned]))
        return f"{limits}, legs differ from nominal by up to {length:.3g} m, {angle:.3g} rad)"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    @cached_property
    def nominal(self) -> Self:
        """The nominal machine with the same dimensions and limits."""
        return self if self.is_nominal else self._with_legs(nominal_legs(self.stage_radii, self.legs.kinds))

    @property
    def is_nominal(self) -> bool:
        """True if the legs are those that follow from the dimensions."""
        return self.legs.is_nominal

    @property
    def parameters(self) -> FloatArray:
        """The parameters of the legs, named in `parameter_names`: per leg direction (2), pivot, ball (3 each), offset.

        Then the fixed numbers of PRS and RRS legs, leg by leg. The direction is the rotation of the
        axis from the nominal one about the two directions perpendicular to it [rad]: the tangent coordinates of the
        shortest arc. Units are in `parameter_units`.
        """
        return self.legs.parameters

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the `parameters`: `PARAMETERS` for a manipulator; PRS and RRS legs add names such as `r_b1.rod`."""
        return self.legs.parameter_names

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the `parameters`, "m" or "rad"."""
        return self.legs.parameter_units

    @cached_property
    def crank_middles(self) -> FloatArray:
        """Angles to which readings of cranks, offsets aside, are nearest, (legs,): of their limits, or π/2 [rad]."""
        return frozen(np.asarray(_crank_middle(*self.reading_limits, self.legs.offsets)))

    @property
    def reading_limits(self) -> FloatArray:
        """Smallest and largest readings (2, legs), infinite without limits."""
        if self.limits is None:
            return np.tile([[-np.inf], [np.inf]], len(self.legs.names))
        return self.limits.ends

    def from_parameters(self, parameters: npt.ArrayLike) -> Self:
        """Return the machine of the same dimensions and limits whose legs have these `parameters`."""
        return self._with_legs(self.legs.from_parameters(parameters))

    def perturbed(self, rng: Any = None, *, length: float = 1e-4, angle: float = 1e-4) -> Self:
        """Return a machine with independent normal errors added to all parameters of the legs.

        Their standard deviations are `length` for each coordinate of pivots and balls and for the offsets [m], up to
        1e7, and `angle` for the rotation of each axis about either direction perpendicular to it [rad], up to 0.2.
        """
        return self._with_legs(self.legs.perturbed(rng, length=length, angle=angle))

    def _with_legs(self, legs: Legs) -> Self:
        return replace(self, legs=legs)  # type: ignore[type-var]  # both are dataclasses

    def to_yaml(self, path: str | Path) -> None:
        """Write the machine to a YAML file that `from_yaml` reads, every number with all its digits."""
        with raised_as(GeometryError):
            path = file_path(path)
            text = yaml.safe_dump(self.as_data(), sort_keys=False, default_flow_style=None, width=120)
            write_files({path: self._heading + text})

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read a machine from a YAML file, in metres and radians; `docs/howto/machine_files.md` describes it.

        A `GeometryError` names the key of an entry that does not describe a machine.
        """
        with raised_as(GeometryError, file=str(path)):
            return cls.from_data(read_yaml(path), "")


ALONE = "This is for manipulators only; Manipulator.of_stages joins two stages"
"""Cause of an error where a manipulator or its state is required and a stage or its state was given."""


def check_machine(value: M, argument: str = "machine") -> M:
    """Return `value` if it is a `Manipulator` or a `Stage`."""
    if not isinstance(value, Machine):
        raise ArgumentError(argument, "a Manipulator or a Stage", type(value).__name__)
    return value


def likely_unit(machine: Machine, length: float, unit: str = "m") -> str | None:
    """Return the unit in which a length [m], if it was typed in `unit`, would be in proportion; None if it is."""

    def disproportion(tried: str, share: float = _USUAL) -> float:
        return abs(math.log(length * PER_METRE[unit] / PER_METRE[tried] / (share * machine.size)))

    if not (np.isfinite(length) and length > 0.0) or disproportion(unit, 1.0) < math.log(_PROPORTION):
        return None
    better = min(PER_METRE, key=disproportion)
    return better if better != unit else None


def unit_hint(machine: Machine, lengths: npt.ArrayLike) -> str:
    """Return a sentence on the unit of the largest of these lengths [m]; empty if it is in proportion."""
    length = float(np.abs(lengths).max())
    unit = likely_unit(machine, length)
    if unit is None:
        return ""
    return f"Lengths are in metres, and {length:g} m is out of proportion to this machine; is it {length:g} {unit}?"
