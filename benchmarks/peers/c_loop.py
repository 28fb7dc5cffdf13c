"""The C loop of the four quadratics, `inverse.c`."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.compiled import address, library
from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin import Manipulator


@dataclass(frozen=True)
class Arrays:
    """Poses (n, 4, 4), ball joints (n, 8, 3, 3) [m], leg lengths (n, 8, 6) [m] and status (n,)."""

    poses: FloatArray
    joints: FloatArray
    lengths: FloatArray
    status: npt.NDArray[np.int8]

    @classmethod
    def of(cls, poses: RigidTransform) -> Arrays:
        """Allocate the results of poses."""
        matrices = np.ascontiguousarray(poses.as_matrix())
        n = len(matrices)
        return cls(matrices, np.empty((n, 8, 3, 3)), np.empty((n, 8, 6)), np.empty(n, dtype=np.int8))


def run(loaded: ctypes.CDLL, machine: Manipulator, arrays: Arrays) -> Arrays:
    """Solve all poses."""
    loaded.inverse_displacement(
        ctypes.c_int64(len(arrays.poses)),
        address(arrays.poses),
        *map(ctypes.c_double, (machine.base_radius, machine.platform_radius, machine.middle_radius)),
        *map(address, (arrays.joints, arrays.lengths, arrays.status)),
    )
    return arrays


def real_branches(joints: FloatArray) -> list[FloatArray]:
    """Return the branches of each pose, (k, 3, 3), without those that are NaN."""
    return [branches[~np.isnan(branches[:, 1, 0])] for branches in joints]


def answered(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the C loop, which writes into the same arrays at every call."""
    machine, poses = problem
    loaded, arrays = library("inverse.c"), Arrays.of(poses)
    return Prepared(lambda: run(loaded, machine, arrays), _read)


def fresh(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the C loop with newly allocated arrays at every call."""
    machine, poses = problem
    loaded = library("inverse.c")
    return Prepared(lambda: run(loaded, machine, Arrays.of(poses)), _read)


def _read(arrays: Any) -> list[FloatArray]:
    return real_branches(arrays.joints)
