"""Assembly of closed chains from guesses: to rounding, or an error that says which loop stays open."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from numpy.testing import assert_allclose, assert_array_equal

from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.loops.closed_chain import ClosedChain
from tests.loops.mechanisms import mechanism
from tests.loops.robots import ROBOTS, ankle, at, closure, five_bar, four_bar, hinge


@pytest.mark.parametrize("robot", ROBOTS)
def test_random_guesses_close_to_rounding(robot: str) -> None:
    chain, random = ROBOTS[robot](), np.random.default_rng(5)
    for _ in range(8):
        guess = pin.integrate(chain.model, chain.q0, random.uniform(-0.3, 0.3, chain.model.nv) * chain.rows.units)
        q = chain.close(guess)
        assert np.abs(chain.state(q).gap() / chain.rows.row_units).max() < 5e-15


def test_loop_that_cannot_close_is_named() -> None:
    chain = five_bar()
    far = closure("point", "left_rod", at(0.3), "universe", at(1.0, 1.0), "far")
    with pytest.raises(ClosureError) as caught:
        ClosedChain(chain.model, [far], ["left"], q0=chain.q0).close()
    # The arm of 0.5 m reaches from (-0.1, 0) as far as it can.
    assert caught.value.residual == pytest.approx(np.hypot(1.1, 1.0) - 0.5, abs=1e-3)
    assert caught.value.loop == "far"


def test_links_in_line_close_after_all() -> None:
    """Newton's method does not lead on from links in line: its step has no part across them."""
    model = pin.Model()
    hinge(model, "universe", "first", at())
    hinge(model, "first", "second", at(0.3))
    chain = ClosedChain(model, [closure("planar", "second", at(0.3), "universe", at(0.4), "tip")], [])
    q = chain.close([0.0, 0.0])
    assert_allclose(np.cos(q[1]), (0.4**2 - 2 * 0.3**2) / (2 * 0.3**2), atol=1e-14)


def test_dependent_rows_close_to_rounding() -> None:
    """A Bennett linkage: four rows of a hinge depend on each other only if the loop is closed."""
    chain = mechanism("Bennett")
    for change in ([0.3, -0.2, 0.1], [-0.2, 0.1, 0.2], [0.1, 0.3, -0.3]):
        q = chain.close(chain.q0 + change)
        assert np.abs(chain.state(q).gap() / chain.rows.row_units).max() < 1e-14
        followed = chain.forward([q[0] + 0.4], q)
        assert np.abs(chain.state(followed).gap() / chain.rows.row_units).max() < 1e-14


def test_held_joints_and_a_free_base_stay() -> None:
    chain = ankle(base=True)
    guess = chain.q0 + np.r_[np.zeros(7), np.full(chain.model.nq - 7, 0.1)]
    assert_array_equal(chain.close(guess)[:7], guess[:7])
    held = ClosedChain(chain.model, chain.closures, ["left_crank"], held=["pitch", "roll"], q0=chain.q0)
    q = held.close(guess)
    assert_array_equal(q[7:9], guess[7:9])


def test_wrong_guesses_are_refused() -> None:
    chain, floating = four_bar(), ankle(base=True)
    guesses = ([0.0], [0.0, 0.0, np.nan], "abc", [[0.0, 0.0, 0.0]])
    # The last has a quaternion of length 2.
    for own, wrong in (*((chain, guess) for guess in guesses), (floating, floating.q0 * 2.0)):
        with pytest.raises(ArgumentError, check=with_fields(argument="q_guess")):
            own.close(wrong)


def test_a_result_is_an_array_of_its_own() -> None:
    """A guess that is closed already, and the default one, are not handed out."""
    chain = four_bar()
    q = chain.close()
    again = chain.close(q)
    assert q.flags.writeable
    assert not np.shares_memory(again, q)
