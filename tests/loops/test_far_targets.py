"""Far targets of five robots: reached in the assembly mode of 2,000 small steps, or refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from spm_pin.errors import ClosureError
from spm_pin.loops.closed_chain import ClosedChain
from tests.loops.robots import ROBOTS

TARGETS, STEPS, FINER = 100, 2000, 20
"""Targets of each robot, small steps to each, and how many times as many decide where the result differs."""


def make_judge() -> Any:
    """Return a compiled function: Newton's method at equal small steps, without any of the tests of `continuation`."""
    import numba

    from spm_pin.loops import continuation
    from spm_pin.loops import tree_kernel as kernel

    @numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def judge(tree, start, target, steps):  # type: ignore[no-untyped-def]
        """Return q after the last step, and the share of the way that was possible."""
        kernel.aim(tree, start, target)
        q, none = start, np.zeros(len(tree.columns))
        for k in range(1, steps + 1):
            q, moved, change = kernel.moved(tree, q, k / steps, none), np.zeros(len(none)), np.ones(1)
            for _ in range(8):
                c, jacobian, _ = kernel.linearised(tree, q, k / steps)
                inverse, regular = continuation.left_inverse(jacobian)
                if not regular:
                    break
                change = -continuation.product(inverse, c)
                q, moved = kernel.moved(tree, q, k / steps, change), moved + np.abs(change)
                if np.abs(change).max() < 1e-11:
                    break
            if not (np.abs(change).max() < 1e-9 and moved.max() < 0.1):
                return q, (k - 1) / steps
        return q, 1.0

    return judge


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_no_far_target_is_reached_in_another_mode(name: str) -> None:
    pytest.importorskip("numba")
    chain: ClosedChain = ROBOTS[name]()
    chain.compile()
    tree, judge, lost, reached = chain._follower(None, ()).tree, make_judge(), 0, 0
    change = np.random.default_rng(11).uniform(-1.0, 1.0, (TARGETS, len(chain.actuated)))
    for target in chain.q0[chain.actuated_in_q] + change * chain.rows.units[chain.actuated_in_v]:
        try:
            q = chain.forward(target, chain.q0)
        except ClosureError:
            q = None
        judged, share = judge(tree, chain.q0, target, STEPS)
        if q is None:
            lost += share == 1.0
            continue
        if share < 1.0 or np.abs(pin.difference(chain.model, judged, q)).max() > 1e-8:
            # Steps that are too long for a path close to a singularity.
            judged, share = judge(tree, chain.q0, target, FINER * STEPS)
        assert share == 1.0, target
        assert np.abs(pin.difference(chain.model, judged, q)).max() <= 1e-8, target
        reached += 1
    print(f"{name}: {reached} of {len(change)} reached, {lost} refused that small steps reach")
    assert reached > 0
    assert lost == 0
