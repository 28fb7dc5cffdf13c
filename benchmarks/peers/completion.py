"""All joints of six slides by Levenberg and Marquardt's method, as publishers of joint states for closed loops do it.

MINPACK by SciPy, on the gaps of the four closures and their Jacobian by Pinocchio, from the joints of the last slides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.one_state import PlainPinocchio
from benchmarks.peers.peer import FloatArray

TOLERANCE = 1e-5
"""All three tolerances of MINPACK: on the change of the sum of squares, on the step and on the gradient."""


def completions(chain: Any, readings: FloatArray) -> Callable[[], tuple[FloatArray, int]]:
    """Return a call that completes readings (n, 6) one after the other, the first from its joints.

    It returns the joints (n, 18) and how many times the closures were evaluated.
    """
    plain, first = PlainPinocchio(chain), chain.forward_kinematics(readings[0])

    def call() -> tuple[FloatArray, int]:
        q, joints, evaluations = first, [], 0

        def with_passive(x: FloatArray) -> FloatArray:
            moved = q.copy()
            moved[plain.passive] = x
            return moved

        for now in readings:
            q = chain.with_readings(q, now)
            found = least_squares(
                lambda x: plain.gaps(with_passive(x)),
                q[plain.passive],
                lambda x: plain.closures(with_passive(x))[:, plain.passive],
                method="lm",
                xtol=TOLERANCE,
                ftol=TOLERANCE,
                gtol=TOLERANCE,
            )
            q = with_passive(found.x)
            joints.append(q)
            evaluations += found.nfev + found.njev
        return np.array(joints), evaluations

    return call
