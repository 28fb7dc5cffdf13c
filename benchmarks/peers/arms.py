"""EAIK: the inverse kinematics of serial six-joint arms in closed form, on its own problem.

Not the same question, but the yardstick of analytic inverse kinematics: up to eight branches of a pose as well, by the
subproblems of Paden and Kahan, in C++ behind a Python binding.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.peers.peer import FloatArray, Prepared, required

_TURN = math.pi / 2.0
# Denavit-Hartenberg parameters α [rad], a [m], d [m], as their makers and textbooks give them.
ARMS = {
    "UR5": (
        (_TURN, 0.0, 0.0, _TURN, -_TURN, 0.0),
        (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0),
        (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823),
    ),
    "Puma 560": (
        (-_TURN, 0.0, _TURN, -_TURN, _TURN, 0.0),
        (0.0, 0.4318, -0.0203, 0.0, 0.0, 0.0),
        (0.0, 0.1491, 0.0, 0.4331, 0.0, 0.0),
    ),
}


def robot(arm: str) -> Any:
    """Make one of `ARMS`, or raise `Unavailable`."""
    return required("eaik.IK_DH", "eaik").DhRobot(*(np.array(row) for row in ARMS[arm]))


def poses_of(arm: str, joints: FloatArray) -> FloatArray:
    """Return the end's poses (n, 4, 4) at joint angles (n, 6)."""
    made = robot(arm)
    return np.array([made.fwdKin(q) for q in joints])


def solve(problem: tuple[str, FloatArray]) -> Prepared:
    """Prepare all branches of poses (n, 4, 4), one call for all on one thread; read as joint angles (k, 6) per pose."""
    arm, matrices = problem
    made, batch = robot(arm), list(matrices)

    def read(found: list[Any]) -> list[FloatArray]:
        return [np.array(branch.Q)[~np.asarray(branch.is_LS, dtype=bool)].reshape(-1, 6) for branch in found]

    return Prepared(lambda: made.IK_batched(batch, 1), read)
