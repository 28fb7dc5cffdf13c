"""The machine, its ends and the paths that tests of motions share."""

from __future__ import annotations

from collections.abc import Sequence

import spm_pin as spm
from spm_pin.motion import LegPath

PAPER = spm.Geometry.paper()
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
