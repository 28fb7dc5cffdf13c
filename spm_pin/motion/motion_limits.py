"""Limits of the legs and of the platform along a path, as rows that are linear in s̈ and ṡ²."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, IntArray, as_array, leg_values, real_array
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.motion.path_dynamics import PathDynamics
from spm_pin.multibody.chain import ClosedChain

_LARGEST = 1e12
"""Largest limit of a leg that is accepted, far from overflow."""
_TOLERANCE = 1e-7
"""Share of a limit by which it may be exceeded."""


@dataclass(frozen=True)
class LimitRows:
    """Limits on a grid: lower <= a u + b x + c <= upper of (n, m) rows, and x <= fastest (n,)."""

    a: FloatArray
    """Coefficients of u, shape (n, m)."""
    b: FloatArray
    """Coefficients of x, shape (n, m)."""
    c: FloatArray
    """Constants, shape (n, m)."""
    lower: FloatArray
    """Least values of the rows, shape (m,)."""
    upper: FloatArray
    """Largest values of the rows, shape (m,)."""
    fastest: FloatArray
    """Largest x at each point of the grid, shape (n,)."""

    def feasible_scale(self, x: FloatArray, u: FloatArray, tolerance: float = 0.0) -> FloatArray:
        """Return the largest factor of ṡ² and s̈ (n,) with which all limits hold, to a share of them, shape (n,).

        All rows hold at rest, and therefore with every smaller factor too.
        """
        moved = self.a * u[:, None] + self.b * x[:, None]
        room = np.where(moved > 0.0, self.upper - self.c, self.c - self.lower) + tolerance * (self.upper - self.lower)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(moved != 0.0, room / np.abs(moved), np.inf).min(axis=-1)
            return np.asarray(np.minimum(shares, np.where(x > 0.0, self.fastest * (1.0 + tolerance) / x, np.inf)))

    def __getitem__(self, index: IntArray) -> LimitRows:
        """Return the limits at some points of the grid."""
        a, b, c = self.a[index], self.b[index], self.c[index]
        return LimitRows(a, b, c, self.lower, self.upper, self.fastest[index])


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a motion; None where there is none."""

    leg_rates: FloatArray | None
    """Largest leg rates [m/s], shape (6,)."""
    leg_accelerations: FloatArray | None
    """Largest leg accelerations [m/s²], shape (6,)."""
    leg_jerks: FloatArray | None
    """Largest leg jerks [m/s³], shape (6,)."""
    leg_forces: tuple[FloatArray, FloatArray] | None
    """Least and largest leg forces [N], each of shape (6,)."""
    twist: tuple[float, float] | None
    """Largest speed of o [m/s] and of turning [rad/s]."""

    @classmethod
    def read(cls, leg_rates: Any, leg_accelerations: Any, leg_jerks: Any, leg_forces: Any, twist: Any) -> MotionLimits:
        """Read the limits of `time_optimal`; raises `ArgumentError`."""
        limits = cls(
            _largest(leg_rates, "leg_rates", "m/s"),
            _largest(leg_accelerations, "leg_accelerations", "m/s²"),
            _largest(leg_jerks, "leg_jerks", "m/s³"),
            _forces(leg_forces),
            _speeds(twist),
        )
        if limits.leg_forces is None and limits.leg_accelerations is None:
            expected = "limits of the legs' forces, or leg_accelerations"
            raise ArgumentError("leg_forces", expected, "neither", "Without them the motion would start with a jump")
        return limits

    def rows(self, chain: ClosedChain, along: PathDynamics) -> LimitRows:
        """Return all limits on the grid; raises `ArgumentError` where the forces do not hold the machine at rest."""
        legs = chain.leg_indices
        first, second = along.first[:, legs], along.second[:, legs]
        blocks: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]] = []
        if (acceleration := self.leg_accelerations) is not None:
            blocks.append((first, second, np.zeros_like(first), -acceleration, acceleration))
        if (forces := self.leg_forces) is not None:
            short = np.maximum(along.static - forces[1], forces[0] - along.static)
            if (short > 0.0).any():
                at, leg = np.unravel_index(int(short.argmax()), short.shape)
                holds = f"{LEGS[leg]} from {forces[0][leg]:g} to {forces[1][leg]:g} N"
                received = (
                    f"{along.static[at, leg]:.4g} N needed at rest at parameter {along.parameters[at]:.4g}, {holds}"
                )
                raise ArgumentError("leg_forces", "forces that hold the machine along the path", received, "Too heavy?")
            blocks.append((along.inertial, along.centrifugal, along.static, *forces))
        fastest = np.full(len(first), np.inf)
        with np.errstate(divide="ignore", over="ignore"):
            if (rates := self.leg_rates) is not None:
                fastest = np.minimum(fastest, ((rates / np.abs(first)) ** 2).min(axis=-1))
            for part, speed in enumerate(self.twist or ()):
                turned = np.linalg.norm(along.twist[:, 3 * part : 3 * part + 3], axis=-1)
                fastest = np.minimum(fastest, (speed / turned) ** 2)
        a, b, c = (np.concatenate([block[k] for block in blocks], axis=-1) for k in range(3))
        lower, upper = (np.concatenate([block[k] for block in blocks]) for k in (3, 4))
        return LimitRows(a, b, c, lower, upper, fastest)

    def feasible_scale(
        self, chain: ClosedChain, along: PathDynamics, times: FloatArray, speeds: FloatArray, accelerations: FloatArray
    ) -> FloatArray:
        """Return the largest factor of ṡ² and s̈ (n,), at times (n,), with which all limits hold to 1e-7, shape (n,).

        Of a jerk it is the change of a leg's acceleration from one time to the next.
        """
        scale = self.rows(chain, along).feasible_scale(speeds**2, accelerations, _TOLERANCE)
        if self.leg_jerks is not None:
            first, second = along.first[:, chain.leg_indices], along.second[:, chain.leg_indices]
            changes = np.diff(first * accelerations[:, None] + second * speeds[:, None] ** 2, axis=0)
            used = np.abs(changes / (np.diff(times)[:, None] * self.leg_jerks)).max(axis=-1)
            scale[1:] = np.minimum(scale[1:], ((1.0 + _TOLERANCE) / np.maximum(used, 1e-300)) ** (2.0 / 3.0))
        return scale


def _largest(value: npt.ArrayLike | None, argument: str, unit: str) -> FloatArray | None:
    """Return the positive limits of the legs (6,); None if there are none."""
    if value is None:
        return None
    meaning = f"a limit of each leg or of all in {unit}"
    numbers = leg_values(value, argument, meaning, most=_LARGEST, cause="No limit? Leave it out")
    if numbers.ndim > 1:
        raise ArgumentError(argument, f"shape (6,) or (), {meaning}", f"shape {numbers.shape}")
    return numbers


def _forces(value: npt.ArrayLike | None) -> tuple[FloatArray, FloatArray] | None:
    """Return the least and the largest force of each leg, both (6,)."""
    array = None if value is None else as_array(value)
    if array is None or array.shape != (2, 6):
        if array is not None and array.ndim and array.shape != (6,):
            expected = "largest forces in N of shape () or (6,), or the least and the largest of shape (2, 6)"
            raise ArgumentError("leg_forces", expected, f"shape {array.shape}")
        largest = _largest(value, "leg_forces", "N")
        return None if largest is None else (-largest, largest)
    lower, upper = real_array(array, "leg_forces", (2, 6), "the least and the largest of each leg in N")
    if (lower >= upper).any() or np.abs(array).max() > _LARGEST:
        expected = f"least forces below the largest, of at most {_LARGEST:g} N"
        raise ArgumentError("leg_forces", expected, "others", "Rows exchanged?")
    return lower, upper


def _speeds(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    numbers = real_array(value, "twist", (2,), "the largest speed of o in m/s and of turning in rad/s")
    if numbers.ndim != 1 or (numbers <= 0.0).any():
        raise ArgumentError(
            "twist", "two positive speeds in m/s and rad/s", f"shape {numbers.shape}, {numbers.min():g}"
        )
    return float(numbers[0]), float(numbers[1])
