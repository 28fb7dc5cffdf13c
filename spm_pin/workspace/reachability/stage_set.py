"""The states of one stage within leg limits, as a set of its three coordinates, and uniform samples of it.

Leg lengths determine a state only where the stage can be assembled, and badly near forward singularities. The
coordinates (x1, x2, Z/r) of `spm_pin.workspace.reachability.position_map` have neither defect: every state is a point,
and lengths are smooth functions of it. The set is covered by small boxes, none of which is left out as long as the
lengths at its centre are nearer to the limits than any ball joint can move within the box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from spm_pin.mechanism.arguments import BoolArray, FloatArray
from spm_pin.workspace.reachability.position_map import PositionMap

_BOXES = 20_000
"""Boxes of the cover with which its refinement ends."""
_HALVINGS = 12
"""Refinements of the cover at most, each of which halves the boxes' sides."""
_PORTION = 50_000
"""States drawn together, at most."""
_MOST_TRIED = 1_000_000
"""States drawn at least, before a set is taken for one that is too small to be hit."""


@dataclass(frozen=True)
class StageSet:
    """The physical states of one stage within its leg limits."""

    map: PositionMap  # of the family TT
    stage: int  # 0 for the lower stage, 1 for the upper
    minimum: FloatArray  # of its legs (3,) [m]
    maximum: FloatArray

    def contains(self, coordinates: FloatArray) -> BoolArray:
        """Test which coordinates (N, 3) are states of the set."""
        lengths = self._lengths(coordinates)
        with np.errstate(invalid="ignore"):
            inside = np.asarray(((lengths >= self.minimum) & (lengths <= self.maximum)).all(axis=-1))
        place = np.flatnonzero(inside)
        inside[place] = self.map.home_aspect(coordinates[place], self.stage)
        return inside

    def _lengths(self, coordinates: FloatArray) -> FloatArray:
        return np.asarray(np.hypot(*self.map.in_leg_planes(coordinates, self.stage)))

    @cached_property
    def _cover(self) -> tuple[FloatArray, FloatArray]:
        """The centres (n, 3) of equal boxes that cover the set, and their half sides (3,)."""
        # Z is the mean height of the ball joints, none of which is higher than its leg is long.
        top = float(self.maximum.mean()) / self.map.geometry.middle_radius
        half = np.array([1.0, 1.0, 0.5 * top])
        centres = np.array([[0.0, 0.0, (0.5 - self.stage) * top]])
        corners = 2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0
        for _ in range(_HALVINGS):
            half = 0.5 * half
            centres = self._near((centres[:, None] + half * corners).reshape(-1, 3), half)
            if not 0 < len(centres) < _BOXES:
                break
        return centres, half

    def _near(self, centres: FloatArray, half: FloatArray) -> FloatArray:
        """Return the centres of those boxes (n, 3) in which lengths within the limits cannot be excluded."""
        r = self.map.geometry.middle_radius
        across = np.abs(centres[:, :2])
        centres = centres[(np.maximum(across - half[:2], 0.0) ** 2).sum(axis=-1) < 1.0]
        across = np.abs(centres[:, :2])
        nearest, farthest = ((np.maximum(across + way * half[:2], 0.0) ** 2).sum(axis=-1) for way in (-1.0, 1.0))
        # Beyond the unit circle there are no states; lengths are taken at a point inside.
        radius = np.hypot(across[:, 0], across[:, 1])
        inner = np.minimum(radius, 1.0 - 1e-9)
        point = centres.copy()
        point[:, :2] *= (inner / np.maximum(radius, 1e-300))[:, None]
        shift = np.hypot(half[0], half[1]) + radius - inner
        x0 = np.sqrt(1.0 - inner * inner)
        ends = np.sqrt(1.0 - nearest), np.sqrt(1.0 - np.minimum(farthest, 1.0))
        chord = np.sqrt(shift**2 + np.maximum(ends[0] - x0, x0 - ends[1]) ** 2)
        # Quaternions q and q' turn a point at the distance r to places at most 2r |q - q'| apart.
        bound = 2.0 * r * np.minimum(chord, 1.0) + r * shift * (2.0 * inner + shift) + r * half[2]
        lengths = self._lengths(point)
        outside = np.maximum(self.minimum - lengths, lengths - self.maximum).max(axis=-1)
        return np.asarray(centres[outside <= bound + 1e-12])

    def draw(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Draw `count` states uniformly: coordinates (count, 3), and an unbiased estimate of the set's volume.

        Fewer, or none, where the set is empty or too small to be hit. The relative variance of the volume is at most
        1/count.
        """
        centres, half = self._cover
        parts, found, tried = [np.empty((0, 3))], 0, 0
        while found < count and len(centres) and tried < max(_MOST_TRIED, 1000 * count):
            portion = min(_PORTION, 8 * count + 100)
            drawn = centres[rng.integers(len(centres), size=portion)] + half * rng.uniform(-1.0, 1.0, (portion, 3))
            place = np.flatnonzero(self.contains(drawn))[: count - found]
            parts.append(drawn[place])
            found += len(place)
            # Counted up to the last that is needed: that makes the estimate of the share unbiased.
            tried += int(place[-1]) + 1 if found == count else portion
        share = (found - 1) / (tried - 1) if found == count > 1 else found / max(tried, 1)
        return np.concatenate(parts), share * float(len(centres) * (2.0 * half).prod())
