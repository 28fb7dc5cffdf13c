"""Which positions are reachable in some orientation, the nearest ones that are, and how much volume they fill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism import Geometry, LegLimits
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    Progress,
    choice,
    generator,
    real_array,
    real_number,
    whole_number,
)
from spm_pin.workspace.boundary import reachable_boundary
from spm_pin.workspace.search import RESOLUTION, nearest_points, search_states, start_table
from spm_pin.workspace.states import states_within

_OPTIMALITY_TOLERANCE = 1e-6
"""Violation of the conditions of a nearest point, dimensionless, above which the search has not converged."""


@dataclass(frozen=True)
class PositionReach:
    """Which positions of shape (...) can be reached in some orientation."""

    reachable: BoolArray
    """Whether o can be there, to within `tolerance`, shape (...)."""
    distance: FloatArray
    """Distance to the nearest reachable position that was found [m], shape (...); zero where reachable."""
    nearest: FloatArray
    """The nearest reachable position that was found, in {B} [m], shape (..., 3)."""
    readings: FloatArray
    """Readings within the limits that put o there [m], shape (..., 6); there may be others."""
    optimality: FloatArray
    """How far `nearest` is from obeying the conditions of a nearest point, shape (...), Eq. (1) of
    `docs/theory/reachable_set.md`; rounding, unless the search has not converged and `distance` is only an upper
    bound."""
    tolerance: float
    """Tolerance of the positions [m]: one nearer than this counts as reached."""

    @property
    def undecided(self) -> BoolArray:
        """Points where no state was found, and no nearest one either, shape (...)."""
        return np.asarray(~self.reachable & (self.optimality > _OPTIMALITY_TOLERANCE))


@dataclass(frozen=True)
class Estimate:
    """A number and an interval for it."""

    value: float
    """The best estimate, in `unit`."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    confidence: float
    """How probable it is that such an interval holds the truth; NaN where the interval is an extrapolation's error."""
    samples: int
    """How many points the estimate is made from."""
    method: str
    """The method of the estimate."""
    unit: str
    """Unit of the value and both ends; empty for a share."""

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}] {self.unit}".rstrip()

    def times(self, factor: float, unit: str) -> Estimate:
        """Return the estimate of a multiple."""
        low, high = sorted((self.low * factor, self.high * factor))
        return Estimate(self.value * factor, low, high, self.confidence, self.samples, self.method, unit)

    @classmethod
    def from_hits(
        cls, hits: int, samples: int, whole: float, confidence: float, method: str, unit: str, undecided: int = 0
    ) -> Estimate:
        """Return a part of `whole` from how many of its uniform samples hit it: Clopper and Pearson's interval.

        Of `undecided` samples it is not known whether they hit: the lower end counts none of them, the upper end all.
        """
        from scipy import stats  # takes as long to load as all the rest

        low = stats.binomtest(hits, samples).proportion_ci(confidence, method="exact").low
        high = stats.binomtest(hits + undecided, samples).proportion_ci(confidence, method="exact").high
        ends = whole * float(low), whole * float(high)
        return cls(whole * hits / samples, *ends, confidence, samples, method, unit)

    @classmethod
    def from_mean(
        cls,
        values: FloatArray,
        whole: float,
        confidence: float,
        method: str,
        unit: str,
        relative_variance: float = 0.0,
    ) -> Estimate:
        """Return an integral over a region of size `whole` from uniform samples (N,) of it: Student's interval.

        The size may be an independent estimate, unbiased and with the given relative variance.
        """
        from scipy import stats

        mean = float(values.mean())
        variance = float(values.var(ddof=1)) / len(values) + mean**2 * relative_variance
        error = float(stats.t.ppf(0.5 + 0.5 * confidence, len(values) - 1)) * np.sqrt(variance)
        ends = whole * max(mean - error, 0.0), whole * (mean + error)
        return cls(whole * mean, *ends, confidence, len(values), method, unit)


def check_confidence(confidence: float) -> float:
    """Return `confidence` if it is a probability."""
    return real_number(confidence, "confidence", "a probability between 0 and 1", above=0.0, below=1.0)


def reachable_position(geometry: Geometry, points: npt.ArrayLike, limits: LegLimits | None = None) -> PositionReach:
    """Find which positions o can reach in some orientation, in the physical mode, and the nearest it can.

    Parameters
    ----------
    geometry : Geometry
        The manipulator.
    points : array_like, shape (..., 3)
        In {B} [m].
    limits : LegLimits, optional
        Leg limits; the geometry's own if not given.

    Notes
    -----
    "Reachable" is proved: `readings` put o there. "Not reachable" is the outcome of a search; where it has not found
    the nearest position either, `undecided` says so.
    """
    array = real_array(points, "points", (3,), "positions in metres")
    states = states_within(geometry, limits)
    flat, shape = array.reshape(-1, 3), array.shape[:-1]
    result = nearest_points(states, flat)
    tolerance = RESOLUTION * states.size
    reached = result.distance <= tolerance
    return PositionReach(
        reached.reshape(shape),
        np.where(reached, 0.0, result.distance).reshape(shape),
        states.positions(result.coordinates).reshape(*shape, 3),
        result.readings.reshape(*shape, 6),
        np.where(reached, 0.0, result.optimality).reshape(shape),
        tolerance,
    )


def reachable_volume(
    geometry: Geometry,
    limits: LegLimits | None = None,
    *,
    method: Literal["sampling", "mesh"] = "sampling",
    samples: int = 20_000,
    spacing: float = 0.1,
    confidence: float = 0.95,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the volume of the positions that o can reach in the physical mode, in m³.

    Parameters
    ----------
    geometry, limits, progress
        As for `reachable_boundary`.
    method : str
        "sampling": the share of uniform points that are reachable, with Clopper and Pearson's interval, whose upper end
        counts undecided points as reachable. "mesh": the volume enclosed by `reachable_boundary` at `spacing` and half
        of it, extrapolated; the error is the extrapolated part, and the interval has no confidence.
    samples : int
        Points for "sampling".
    spacing : float
        Of the coarser grid for "mesh" [m].
    confidence : float
        Of the interval, for "sampling".
    rng : Generator or int, optional
        Source of randomness, or its seed.
    """
    check_confidence(confidence)
    if choice(method, "method", ("sampling", "mesh")) == "mesh":
        coarse = reachable_boundary(geometry, limits, spacing=spacing, progress=progress)
        fine = reachable_boundary(geometry, limits, spacing=0.5 * spacing, progress=progress)
        # A mesh with vertices on a surface is off by the square of its spacing.
        added = (fine.volume - coarse.volume) / 3.0
        value, error = fine.volume + added, abs(added)
        how = f"meshes of spacing {spacing:g} and {0.5 * spacing:g} m, extrapolated"
        return Estimate(value, value - error, value + error, float("nan"), len(fine.vertices), how, "m³")
    count = whole_number(samples, "samples", least=2)
    states, rng = states_within(geometry, limits), generator(rng)
    points, region = start_table(states).draw_around(count, rng)
    member = search_states(states, points, what="reachable points", progress=progress)
    hits, undecided = int(member.reached.sum()), int(member.undecided.sum())
    return Estimate.from_hits(hits, count, region, confidence, "share of uniform points", "m³", undecided)
