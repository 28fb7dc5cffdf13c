"""Volumes of meshes of growing resolution, extrapolated to the surface itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Convergence"]


@dataclass(frozen=True)
class Convergence:
    """The volume that meshes of growing resolution enclose, extrapolated.

    A mesh's error is a series in even powers of 1/n, so a polynomial in 1/n² through the values leads to its limit.
    """

    resolutions: tuple[int, ...]  # growing; the last one is the shell's
    volumes: tuple[float, ...]  # what their meshes enclose [m³]

    @property
    def limit(self) -> float:
        """The polynomial at 1/n = 0 [m³]."""
        return _extrapolated(self.resolutions, self.volumes)

    @property
    def error(self) -> float:
        """Change of the limit without the coarsest or the finest mesh [m³], a bound on the limit's error."""
        parts = (slice(1, None), slice(None, -1))
        return max(abs(self.limit - _extrapolated(self.resolutions[part], self.volumes[part])) for part in parts)

    @property
    def order(self) -> float:
        """Power of 1/n with which the error falls from the last mesh but one to the last; 2 in theory."""
        coarse, fine = (abs(volume - self.limit) for volume in self.volumes[-2:])
        if fine == 0.0:
            return float("inf")
        return float(np.log(coarse / fine) / np.log(self.resolutions[-1] / self.resolutions[-2]))


def _extrapolated(resolutions: Sequence[int], volumes: Sequence[float]) -> float:
    """Return at h = 0 the polynomial in h² = 1/n² through the values: Lagrange's form."""
    squares = 1.0 / np.array(resolutions, dtype=np.float64) ** 2
    limit = 0.0
    for k, volume in enumerate(volumes):
        others = np.delete(squares, k)
        limit += volume * float(np.prod(others / (others - squares[k])))
    return limit
