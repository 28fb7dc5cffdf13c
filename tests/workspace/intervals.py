from __future__ import annotations

from spm_pin.workspace.positions import Estimate


def overlap(first: Estimate, second: Estimate) -> bool:
    """Test whether the intervals of two estimates have a number in common."""
    return first.low <= second.high and second.low <= first.high
