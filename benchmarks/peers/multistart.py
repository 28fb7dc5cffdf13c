"""Common parts of the searches from random starts: starts, convergence test, separation of branches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin import Manipulator
from spm_pin.crosscheck.nlp.branch_search import random_starts

STARTS = 100
"""Starts per pose, for every search."""
CLOSED = 1e-11
"""Largest loop residual of a converged search, in units of d."""
APART = 1e-5
"""Smallest distance of two branches, in units of d."""

Solve = Callable[[FloatArray, FloatArray], FloatArray]


def starts(machine: Manipulator, poses: RigidTransform) -> list[FloatArray]:
    """Return random starts b (STARTS, 9) [m] for each pose, the same for every search."""
    rng = np.random.default_rng(0)
    return [random_starts(machine, matrix, STARTS, rng) for matrix in poses.as_matrix()]


def residuals(machine: Manipulator, matrix: FloatArray, joints: FloatArray) -> FloatArray:
    """Return the largest violation of the nine loop equations [m] at b (n, 9), (n,)."""
    b = joints.reshape(-1, 3, 3)
    lower, rotation, position = machine.revolute_axes, matrix[:3, :3], matrix[:3, 3]
    upper = lower @ rotation.T
    sides = np.sqrt(((b - np.roll(b, -1, axis=1)) ** 2).sum(axis=-1)) - machine.middle_side
    planes = [(b * lower).sum(axis=-1), ((b - position) * upper).sum(axis=-1)]
    return np.asarray(np.abs(np.concatenate([*planes, sides], axis=-1)).max(axis=-1))


def branches(machine: Manipulator, matrix: FloatArray, ends: FloatArray) -> FloatArray:
    """Return the different branches (k, 3, 3) among the ends (n, 9) of a search."""
    with np.errstate(invalid="ignore", over="ignore"):
        closed = residuals(machine, matrix, ends) <= CLOSED * machine.middle_side
    ends = ends[closed]
    found = []
    while len(ends):
        found.append(ends[0])
        ends = ends[np.abs(ends - ends[0]).max(axis=-1) > APART * machine.middle_side]
    return np.array(found).reshape(-1, 3, 3)


def search(problem: tuple[Manipulator, RigidTransform], solve: Solve) -> Prepared:
    """Solve from all starts at every pose: `solve` takes starts (n, 9) and a pose (4, 4), and returns ends (n, 9)."""
    machine, poses = problem
    tasks = list(zip(starts(machine, poses), poses.as_matrix(), strict=True))

    def read(answers: list[FloatArray]) -> list[FloatArray]:
        return [branches(machine, matrix, ends) for (_, matrix), ends in zip(tasks, answers, strict=True)]

    return Prepared(lambda: [solve(points, matrix) for points, matrix in tasks], read)
