"""Numbers known from samples, each with an interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray

__all__ = ["Estimate", "check_confidence", "check_count", "from_hits", "from_mean"]


@dataclass(frozen=True)
class Estimate:
    """A number and an interval for it.

    Attributes
    ----------
    value : float
        The best estimate, in `unit`.
    low, high : float
        The interval.
    confidence : float
        How probable it is that such an interval holds the truth; NaN where the interval is an extrapolation's error.
    samples : int
        How many points the estimate is made from.
    method : str
        Where it comes from.
    unit : str
        Of the three numbers; empty for a share.
    """

    value: float
    low: float
    high: float
    confidence: float
    samples: int
    method: str
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.4g} [{self.low:.4g}, {self.high:.4g}] {self.unit}".rstrip()

    def agrees_with(self, other: Estimate) -> bool:
        """Whether the two intervals have a number in common."""
        return self.low <= other.high and other.low <= self.high

    def times(self, factor: float, unit: str) -> Estimate:
        """Return the estimate of a multiple."""
        low, high = sorted((self.low * factor, self.high * factor))
        return Estimate(self.value * factor, low, high, self.confidence, self.samples, self.method, unit)


def from_hits(hits: int, samples: int, whole: float, confidence: float, method: str, unit: str) -> Estimate:
    """Return a part of `whole` from how many of its uniform samples hit it: Clopper and Pearson's interval."""
    from scipy import stats  # takes as long to load as all the rest

    interval = stats.binomtest(hits, samples).proportion_ci(confidence, method="exact")
    ends = whole * float(interval.low), whole * float(interval.high)
    return Estimate(whole * hits / samples, *ends, confidence, samples, method, unit)


def from_mean(values: FloatArray, whole: float, confidence: float, method: str, unit: str) -> Estimate:
    """Return an integral over a region of size `whole` from uniform samples (N,) of it: Student's interval."""
    from scipy import stats

    mean = float(values.mean())
    error = float(stats.t.ppf(0.5 + 0.5 * confidence, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    ends = whole * max(mean - error, 0.0), whole * (mean + error)
    return Estimate(whole * mean, *ends, confidence, len(values), method, unit)


def check_confidence(confidence: float) -> float:
    """Return `confidence` if it is a probability."""
    if not (isinstance(confidence, int | float) and 0.0 < confidence < 1.0):
        raise ArgumentError("confidence", "a probability between 0 and 1", repr(confidence))
    return float(confidence)


def check_count(count: int, argument: str, least: int = 2) -> int:
    """Return `count` if it is a whole number of at least `least`."""
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < least:
        raise ArgumentError(argument, f"a whole number of at least {least}", repr(count))
    return int(count)
