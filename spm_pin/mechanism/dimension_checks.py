"""The dimensions of a manipulator that are accepted."""

from __future__ import annotations

from typing import Any

from spm_pin.errors import GeometryError
from spm_pin.mechanism.arguments import real_number

__all__ = ["LARGEST", "SMALLEST", "dimension"]

SMALLEST, LARGEST = 1e-9, 1e9
"""Dimensions accepted [m]. Every result was found to scale to rounding from 1e-52 to 1e60 m."""


def dimension(value: Any, argument: str) -> float:
    """Read a radius or a side [m]; see `spm_pin.mechanism.arguments`."""
    return real_number(
        value,
        argument,
        f"a positive length in metres, from {SMALLEST:g} to {LARGEST:g}",
        least=SMALLEST,
        most=LARGEST,
        error=GeometryError,
        cause="Given in another unit?" if isinstance(value, float | int) and value > 0 else "",
    )
