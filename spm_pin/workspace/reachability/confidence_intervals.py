"""Estimates from samples, each with its confidence interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spm_pin.mechanism.arguments import FloatArray, real_number


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


def from_hits(
    hits: int, samples: int, whole: float, confidence: float, method: str, unit: str, undecided: int = 0
) -> Estimate:
    """Return a part of `whole` from how many of its uniform samples hit it: Clopper and Pearson's interval.

    Of `undecided` samples it is not known whether they hit: the lower end counts none of them, the upper end all.
    """
    from scipy import stats  # takes as long to load as all the rest

    low = stats.binomtest(hits, samples).proportion_ci(confidence, method="exact").low
    high = stats.binomtest(hits + undecided, samples).proportion_ci(confidence, method="exact").high
    ends = whole * float(low), whole * float(high)
    return Estimate(whole * hits / samples, *ends, confidence, samples, method, unit)


def from_mean(
    values: FloatArray, whole: float, confidence: float, method: str, unit: str, relative_variance: float = 0.0
) -> Estimate:
    """Return an integral over a region of size `whole` from uniform samples (N,) of it: Student's interval.

    The size may be an independent estimate, unbiased and with the given relative variance.
    """
    from scipy import stats

    mean = float(values.mean())
    variance = float(values.var(ddof=1)) / len(values) + mean**2 * relative_variance
    error = float(stats.t.ppf(0.5 + 0.5 * confidence, len(values) - 1)) * np.sqrt(variance)
    ends = whole * max(mean - error, 0.0), whole * (mean + error)
    return Estimate(whole * mean, *ends, confidence, len(values), method, unit)


def check_confidence(confidence: float) -> float:
    """Return `confidence` if it is a probability."""
    return real_number(confidence, "confidence", "a probability between 0 and 1", above=0.0, below=1.0)
