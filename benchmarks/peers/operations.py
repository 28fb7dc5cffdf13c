"""Operations of one inverse displacement, counted by running the C loop with a number that counts."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from benchmarks.peers.c_loop import Arrays, run
from benchmarks.peers.compiled import library
from spm_pin import Manipulator


@dataclass(frozen=True)
class Operations:
    """Means per pose."""

    additions: float
    multiplications: float
    divisions: float
    square_roots: float

    @property
    def arithmetic(self) -> float:
        """Additions and multiplications."""
        return self.additions + self.multiplications


def count_operations(machine: Manipulator, poses: RigidTransform) -> Operations:
    """Count on poses (n,), or raise `Unavailable` where there is no C++ compiler."""
    counted = library("inverse.c", ("-O2", "-x", "c++", "-DCOUNT_OPERATIONS"), "c++")
    totals = (ctypes.c_int64 * 4).in_dll(counted, "operations")
    before = list(totals)
    arrays = Arrays.of(poses)
    run(counted, machine, arrays)
    return Operations(*((after - earlier) / len(arrays.poses) for after, earlier in zip(totals, before, strict=True)))
