from __future__ import annotations

import spm_pin as spm


def overlap(first: spm.workspace.Estimate, second: spm.workspace.Estimate) -> bool:
    """Test whether the intervals of two estimates have a number in common."""
    return first.low <= second.high and second.low <= first.high
