"""Results of a comparison: per-method scores, and the differences of every pair of methods."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import scipy

__all__ = ["MethodScore", "PairDifference", "Quantity"]

UNLIKELY = 1e-6
"""A number of missed branches less probable than this at a method's stated rate counts as a fault."""


class Quantity(enum.StrEnum):
    """Quantities that are compared."""

    POSITIONS = "middle joints"
    ASSEMBLY = "assembly"
    JACOBIAN = "inverse Jacobian"
    FORCES = "leg forces"

    @property
    def unit(self) -> str:
        """Unit of the differences."""
        return {"inverse Jacobian": "", "leg forces": "N"}.get(self.value, "m")


@dataclass(frozen=True)
class PairDifference:
    """Difference of two methods in one quantity, over all poses.

    Those of Jacobians are norms with angles times d.
    """

    quantity: Quantity
    first: str
    second: str  #: names of the methods
    compared: int  #: states at which both answered
    disagreements: int  #: those at which they differ by more than the tolerance
    worst: float  #: difference and tolerance where their ratio is largest
    tolerance: float
    pose: int  #: where that is, counted as in the report
    branch: str

    @property
    def ratio(self) -> float:
        """The largest difference in units of its tolerance."""
        return self.worst / self.tolerance if self.compared else 0.0

    def combined(self, other: PairDifference) -> PairDifference:
        """Return the difference over the states of both; the pair and the quantity must be the same."""
        larger = max(self, other, key=lambda pair: pair.ratio)
        return replace(
            larger,
            compared=self.compared + other.compared,
            disagreements=self.disagreements + other.disagreements,
        )


@dataclass
class MethodScore:
    """Counts of one method: branches found, invented and missed, comparisons lost."""

    name: str
    allowed: float = 0.0  #: share of poses at which it may miss a branch, as it states
    solved: int = 0  #: poses it was given
    unsolved: int = 0  #: those at which it reported that it cannot solve them
    branches: int = 0  #: that it found
    invented: int = 0  #: those of them whose loops do not close
    missed: int = 0  #: poses at which it lacks a branch that another method proved, those left unsolved included
    outvoted: int = 0  #: comparisons at which a majority of the methods contradicts it
    residual: float = 0.0  #: largest closure residual in units of what it states
    invented_at: int = -1  #: pose of the first branch invented, and of the first missed; -1 if there is none
    missed_at: int = -1

    @property
    def pose(self) -> int:
        """Pose of the first branch invented, else of the first missed, else -1."""
        return self.invented_at if self.invented else self.missed_at

    @property
    def misses_too_often(self) -> bool:
        """True if the misses are more than the stated rate makes likely."""
        return self.missed > 0 and float(scipy.stats.binom.sf(self.missed - 1, self.solved, self.allowed)) < UNLIKELY

    @property
    def faults(self) -> int:
        """Number of wrong answers."""
        return self.invented + self.outvoted + (self.missed if self.misses_too_often else 0)
