"""The machine, its ends and the paths that tests of motions share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import spm_pin as spm
from spm_pin.motion import LegPath

PAPER = spm.Manipulator.paper()
CHAIN = spm.ClosedChain.from_urdf()
LEGS = CHAIN.leg_indices
START = [1.20, 1.20, 1.40, 1.25, 1.20, 1.50]
GOAL = [1.40, 1.20, 1.20, 1.20, 1.50, 1.25]
LINE = LegPath([START, GOAL])
CURVE = LegPath([START, [1.3, 1.4, 1.2, 1.3, 1.3, 1.3], GOAL])


def pose_line(times: Sequence[float] = (0.0, 1.0)) -> spm.PlatformPath:
    """Return a short path of the platform between two times."""
    ends = spm.forward_physical(PAPER, [START, [1.22, 1.22, 1.42, 1.3, 1.2, 1.45]])
    return spm.PlatformPath(times, ends.pose)


def shares(motion: spm.multibody.JointTrajectory, limits: dict[str, object]) -> np.ndarray:
    """How much of each limit is used at each row, shape (n, kinds)."""
    legs = {"leg_rates": motion.velocities, "leg_accelerations": motion.accelerations, "leg_forces": motion.efforts}
    columns = [np.abs(legs[name][:, LEGS]).max(axis=-1) / limits[name] for name in legs if name in limits]
    if "twist" in limits:
        jacobian = np.linalg.inv(CHAIN.state(motion.positions).inverse_jacobian())
        twist = (jacobian @ motion.velocities[:, LEGS, None])[..., 0]
        columns += [np.linalg.norm(twist[:, 3 * k : 3 * k + 3], axis=-1) / limits["twist"][k] for k in range(2)]
    return np.stack(columns, axis=-1)


def jerks(motion: spm.multibody.JointTrajectory) -> np.ndarray:
    """Mean jerks of the legs between rows, shape (n - 1, 6)."""
    return np.diff(motion.accelerations[:, LEGS], axis=0) / np.diff(motion.times)[:, None]
