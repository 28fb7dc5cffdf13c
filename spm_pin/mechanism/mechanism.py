"""The base class of `Geometry` and `Stage`: parameters of the legs, limits, and files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import yaml

from spm_pin.errors import ArgumentError, GeometryError, raised_as
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.files import file_path, writing
from spm_pin.mechanism.legs import LegLimits, Legs


class Mechanism(ABC):
    """A `Geometry` or a `Stage`: dimensions and legs, as drawn or as built."""

    legs: Legs
    limits: LegLimits | None
    _heading: ClassVar[str]
    """First line of its files."""

    @property
    @abstractmethod
    def size(self) -> float:
        """About its height [m]."""

    @property
    @abstractmethod
    def stage_radii(self) -> tuple[tuple[float, float], ...]:
        """Radii of the drawn triangles of each stage, of its pivots and of its balls [m]."""

    @abstractmethod
    def as_data(self) -> dict[str, Any]:
        """Return what `to_yaml` writes."""

    @property
    def is_nominal(self) -> bool:
        """True if the legs are those of the drawing."""
        return self.legs.is_drawn

    @property
    def parameters(self) -> FloatArray:
        """The parameters of the legs, named in `parameter_names`: per leg direction (2), pivot, ball (3 each), offset.

        After these follow the numbers that are fixed in PRS and RRS legs, leg by leg. The direction is the turn of the
        axis from the drawn one about the two directions perpendicular to it [rad]: the tangent coordinates of the
        shortest arc. Units are in `parameter_units`.
        """
        return self.legs.parameters

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the `parameters`: of a robot `PARAMETERS`, and of PRS and RRS legs numbers such as `r_b1.rod`."""
        return self.legs.parameter_names

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the `parameters`, "m" or "rad"."""
        return self.legs.parameter_units

    @property
    def reading_limits(self) -> FloatArray:
        """Smallest and largest readings (2, legs), infinite where there is no limit."""
        if self.limits is None:
            return np.tile([[-np.inf], [np.inf]], len(self.legs.names))
        return self.limits.ends

    def from_parameters(self, parameters: npt.ArrayLike) -> Self:
        """Return the machine of the same dimensions and limits whose legs have these `parameters`."""
        return self._with_legs(self.legs.from_parameters(parameters))

    def perturbed(self, rng: Any = None, *, length: float = 1e-4, angle: float = 1e-4) -> Self:
        """Return a machine with independent normal errors added to all parameters of the legs.

        Their standard deviations are `length`, of each coordinate of pivots and balls and of the offsets [m], up to
        1e7, and `angle`, of the turn of each axis about either direction perpendicular to it [rad], up to 0.2.
        """
        return self._with_legs(self.legs.perturbed(rng, length=length, angle=angle))

    def _with_legs(self, legs: Legs) -> Self:
        return replace(self, legs=legs)  # type: ignore[type-var]  # both are dataclasses

    def to_yaml(self, path: str | Path) -> None:
        """Write the machine to a YAML file that `from_yaml` reads, every number with all its digits."""
        with raised_as(GeometryError):
            path = file_path(path)
            text = yaml.safe_dump(self.as_data(), sort_keys=False, default_flow_style=None, width=120)
            with writing(path):
                path.write_text(self._heading + text, encoding="utf-8")


def check_mechanism(value: Any, argument: str = "geometry") -> Mechanism:
    """Return `value` if it is a `Geometry` or a `Stage`."""
    if not isinstance(value, Mechanism):
        raise ArgumentError(argument, "a Geometry or a Stage", type(value).__name__)
    return value
