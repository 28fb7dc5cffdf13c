"""Results of a comparison: per-method scores, and the differences of every pair of methods."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import scipy

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
    """The quantity compared."""
    first: str
    """Name of the first method."""
    second: str
    """Name of the second method."""
    compared: int
    """Number of states at which both answered."""
    disagreements: int
    """Number of those at which they differ by more than the tolerance."""
    worst: float
    """Difference where its ratio to the tolerance is largest, in the quantity's unit."""
    tolerance: float
    """Tolerance there, in the same unit."""
    pose: int
    """Number of the pose where that is, counted as in the report."""
    branch: str
    """Branch of that pose, one of `BRANCHES`."""

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
    """The method's name."""
    allowed: float = 0.0
    """Share of poses at which it may miss a branch, as it states."""
    solved: int = 0
    """Number of poses it was given."""
    unsolved: int = 0
    """Number of those that it reported as unsolved."""
    branches: int = 0
    """Number of branches it found."""
    invented: int = 0
    """Number of those whose loops do not close."""
    missed: int = 0
    """Number of poses at which it lacks a branch that another method proved, those left unsolved included."""
    outvoted: int = 0
    """Number of comparisons in which a majority of the methods contradicts it."""
    residual: float = 0.0
    """Largest closure residual in units of the one it states."""
    invented_at: int = -1
    """Pose of the first branch invented; -1 if there is none."""
    missed_at: int = -1
    """Pose of the first branch missed; -1 if there is none."""

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
