"""The outcome of a problem: solved, unreachable, degenerate or unsolved, and what is degenerate."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import BoolArray


class Status(enum.IntEnum):
    """Outcome of one problem."""

    OK = 0
    """At least one real solution, and all solutions are isolated."""
    UNREACHABLE = 1
    """No real solution."""
    DEGENERATE = 2
    """Some solutions form a continuous family, of which none is picked; those of the other families are kept."""
    UNSOLVED = 3
    """The method failed: nothing is known about the problem."""

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Degeneracy:
    """Description of the continuous families of solutions, where there are any."""

    dimension: npt.NDArray[np.int8]
    """Dimension of the family, shape (...); 0 where all solutions are isolated."""
    families: BoolArray
    """Which of TT, TF, FT, FF are continuous, shape (..., 4)."""
    legs: BoolArray
    """Legs whose lower and upper plane coincide, so that b_i is bound to no line, shape (..., 3)."""

    def __getitem__(self, batch: tuple[Any, ...]) -> Degeneracy:
        inner = (*batch, slice(None))
        return Degeneracy(self.dimension[batch], self.families[inner], self.legs[inner])
