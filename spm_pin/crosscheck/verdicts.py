"""What a cross-check says of a pair of witnesses, and of each of them."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from scipy.stats import binom

__all__ = ["Comparison", "Quantity", "Standing"]

UNLIKELY = 1e-6
"""More branches missed than this probability allows at a witness' stated rate are no accident."""


class Quantity(enum.StrEnum):
    """What is compared."""

    POSITIONS = "middle joints"
    ASSEMBLY = "assembly"
    JACOBIAN = "inverse Jacobian"
    FORCES = "leg forces"

    @property
    def unit(self) -> str:
        """Unit of the differences."""
        return {"inverse Jacobian": "", "leg forces": "N"}.get(self.value, "m")


@dataclass(frozen=True)
class Comparison:
    """One pair of witnesses and one quantity over all poses.

    Attributes
    ----------
    quantity : Quantity
        What was compared. Differences of Jacobians are norms with angles times d.
    first, second : str
        Names of the witnesses.
    compared, disagreements : int
        States at which both answered, and at which they differ by more than the tolerance.
    worst, tolerance : float
        Difference and tolerance where their ratio is largest.
    pose : int
        The pose of that, an index into those of the report.
    branch : str
        Its branch.
    """

    quantity: Quantity
    first: str
    second: str
    compared: int
    disagreements: int
    worst: float
    tolerance: float
    pose: int
    branch: str

    @property
    def ratio(self) -> float:
        """The largest difference in units of its tolerance."""
        return self.worst / self.tolerance if self.compared else 0.0


@dataclass(frozen=True)
class Standing:
    """What one witness' branches are worth.

    Attributes
    ----------
    name : str
        The witness.
    solved, abstained : int
        Poses it was asked to solve, and at which it said that it cannot.
    branches, invented : int
        Branches it showed, and those of them whose loops do not close.
    missed : int
        Poses at which it lacks a branch that another witness proved, those it abstained from included.
    allowed : float
        Share of poses at which it may miss one, as it states.
    residual : float
        Largest closure residual in units of what it states.
    pose : int
        Pose of the first branch invented or else missed; -1 if there is none.
    blame : int
        Comparisons that it lost to a majority.
    """

    name: str
    solved: int = 0
    abstained: int = 0
    branches: int = 0
    invented: int = 0
    missed: int = 0
    allowed: float = 0.0
    residual: float = 0.0
    pose: int = -1
    blame: int = 0

    @property
    def misses_too_often(self) -> bool:
        """Whether the misses are more than the stated rate makes likely."""
        return self.missed > 0 and float(binom.sf(self.missed - 1, self.solved, self.allowed)) < UNLIKELY

    @property
    def faults(self) -> int:
        """What counts against it."""
        return self.invented + self.blame + (self.missed if self.misses_too_often else 0)
