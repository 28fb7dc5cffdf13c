"""Units in which commands read and print the numbers of a machine: lengths in --unit, angles in degrees."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np

from spm_pin.cli.outputs import note
from spm_pin.display.writing import fixed
from spm_pin.errors import ArgumentError
from spm_pin.machine.machine import PER_METRE, likely_unit
from spm_pin.support.arguments import BoolArray, FloatArray


class LengthUnit(enum.StrEnum):
    """Units of length on the command line."""

    M = "m"
    CM = "cm"
    MM = "mm"

    @property
    def per_metre(self) -> float:
        """Number of units in a metre."""
        return PER_METRE[self.value]

    @property
    def option(self) -> str:
        """The end of a command line with lengths in this unit."""
        return "" if self is LengthUnit.M else f" --unit {self}"

    def text(self, length: float, more: int = 0) -> str:
        """Return a length in this unit for a table, to hundredths of a millimetre, or with more decimals."""
        return fixed(length, {"m": 5, "cm": 3, "mm": 2}[self.value] + more)


@dataclass(frozen=True)
class MachineInUnits:
    """The machine of a command, a manipulator or a stage, and the units of its numbers."""

    machine: Any
    """Manipulator or Stage."""
    unit: LengthUnit = LengthUnit.M
    given: tuple[str, ...] = ()
    """Options that describe the machine; empty for the paper's."""
    file: Any = None
    """Path of the machine's file, if it is in one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the legs."""
        names: tuple[str, ...] = self.machine.legs.names
        return names

    @property
    def are_angles(self) -> BoolArray:
        """True for the legs whose readings are angles, shape (6,), for a stage (3,)."""
        return np.asarray(np.array(self.machine.legs.units) == "rad")

    @property
    def scale(self) -> FloatArray:
        """Number of units in a metre, or of degrees in a radian, shape as `are_angles`."""
        return np.where(self.are_angles, 180.0 / np.pi, self.unit.per_metre)

    @property
    def heading(self) -> str:
        """Unit of the readings, or the units of both stages."""
        return self.stages(str(self.unit), "degrees")

    def stages(self, length: str, angle: str) -> str:
        """Return `length` or `angle` if all legs have the same, otherwise one for each stage."""
        units = [angle if is_angle else length for is_angle in self.are_angles[::3]]
        return units[0] if len(set(units)) == 1 else "{} (r_b1 to r_b3) and {} (r_c1 to r_c3)".format(*units)

    def content(self) -> dict[str, Any]:
        """Return the JSON content that names the units."""
        units = ["deg" if is_angle else str(self.unit) for is_angle in self.are_angles]
        return {"unit": self.unit, "reading_units": units}

    def read(self, option: str, typed: Any) -> FloatArray:
        """Return typed readings in [m, rad], one for all legs or one each; cranks turn by at most one turn."""
        readings = np.broadcast_to(typed, self.are_angles.shape)
        angles = np.abs(readings[self.are_angles & np.isfinite(readings)])
        if (angles > 360.0).any():
            raise ArgumentError(option, "angles of cranks in degrees, of at most one turn", f"{angles.max():g}")
        return np.asarray(readings / self.scale)

    def read_limits(self, option: str, minimum: Any, maximum: Any) -> list[list[float]]:
        """Return typed limits in [m, rad], with a note on their unit if another one is likely."""
        if hint := self.readings_hint(option, maximum):
            note(hint, "yellow")
        if (wrong := np.ravel(np.greater_equal(minimum, maximum))).any():
            low, high = (np.ravel(x)[wrong][0] for x in np.broadcast_arrays(minimum, maximum))
            raise ArgumentError(option, "minimum < maximum", f"{low:g} {high:g}", "Minimum and maximum exchanged?")
        return [self.read(option, end).tolist() for end in (minimum, maximum)]

    def text(self, reading: float, leg: int) -> str:
        """Return a reading, in its unit, for a table."""
        return fixed(reading, 3) if self.are_angles[leg] else self.unit.text(reading)

    def columns(self) -> dict[str, Any]:
        """Return the columns of readings in a table of records, with a star after those beyond their limits."""
        # The space in the heading is for the star.
        return {
            f"{name} ": lambda row, leg=leg: self.text(row["readings"][leg], leg) + " *"[leg in row["beyond_limits"]]
            for leg, name in enumerate(self.names)
        }

    def hint(self, option: str, length: float) -> str:
        """Return a hint on the unit if a typed length is out of proportion; otherwise empty."""
        better = likely_unit(self.machine, length / self.unit.per_metre, self.unit)
        if better is None:
            return ""
        size = float(f"{self.machine.size * self.unit.per_metre:.3g}")
        return (
            f"{option} was read in {self.unit}: {length:g} {self.unit}, on a machine of {size:g} {self.unit}. "
            f"In {better} it would be in proportion: --unit {better}, for all lengths."
        )

    def readings_hint(self, option: str, typed: Any) -> str:
        """Return the `hint` for the lengths among typed readings."""
        lengths = np.abs(np.broadcast_to(typed, self.are_angles.shape)[~self.are_angles])
        return self.hint(option, float(lengths.max())) if lengths.size else ""
