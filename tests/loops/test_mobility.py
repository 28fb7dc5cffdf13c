"""Mobility: known numbers of freedoms of classical linkages, and the names of what is dependent, loose or locked."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from loops.mechanisms import MAKERS, mechanism, states

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.closed_chain import ClosedChain
from tests.loops.robots import at, closure, hinge

KNOWN = {
    # Degrees of freedom, equations, rank, driven ones.
    "four-bar": (1, 5, 2, 1),
    "planar four-bar": (1, 2, 2, 1),
    "parallelogram": (1, 10, 3, 1),
    "Bennett": (1, 5, 2, 1),
    "Sarrus": (1, 5, 4, 1),
    "Stewart": (6, 18, 18, 6),
    "Delta": (9, 18, 18, 3),
    "Delta without spins": (3, 24, 24, 3),
    "ankle": (2, 6, 6, 2),
    "free ankle": (8, 6, 6, 2),
    "weld and gear": (1, 7, 7, 1),
}


@pytest.mark.parametrize("name", MAKERS)
def test_classical_linkages_have_their_degrees_of_freedom(name: str) -> None:
    chain = mechanism(name)
    for q, _ in states(name, 3):
        found = chain.mobility(q)
        assert (found.dof, found.rows, found.rank, found.actuated_rank) == KNOWN[name]
        assert not found.is_singular
        assert not found.locked or found.locked == chain.held
        # The state's own factorisation agrees.
        assert chain.state(q).kinematics.space.rank == found.rank


def test_dependent_equations_have_names() -> None:
    assert mechanism("Sarrus").mobility(states("Sarrus")[0][0]).dependent == {"second chain": 1}
    found = mechanism("parallelogram").mobility(states("parallelogram")[0][0])
    # Each pin out of the plane and against turns, three equations, and one that the other pin implies.
    assert found.dependent == {"pin1": 4, "pin2": 4}
    assert found.redundant == ("crank0", "crank1", "crank2")
    assert mechanism("Stewart").mobility(states("Stewart")[0][0]).dependent == {}


def test_joints_that_are_not_driven_have_names() -> None:
    found = mechanism("Delta").mobility(states("Delta")[0][0])
    assert found.undriven == tuple(f"rod{k}{side}" for k in range(3) for side in "ab")
    assert not found.is_fully_driven
    assert mechanism("free ankle").mobility(states("free ankle")[0][0]).undriven == ("shank",)
    assert mechanism("Stewart").mobility(states("Stewart")[0][0]).undriven == ()


def test_locked_joints_have_names() -> None:
    """A spatial four-bar of four hinges in general places is a structure; a joint beside it moves."""
    model, parent, rng = pin.Model(), "universe", np.random.default_rng(30)
    for k in range(3):
        place = at(*rng.uniform(0.2, 0.5, 3), turned=(0.5 + k, 0.0, 0.0)) * at(turned=(0.0, 0.4, 0.0))
        parent = hinge(model, parent, f"axis{k}", place)
    hinge(model, "universe", "slide", at(), "x", slides=True)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(4))
    last = closure("hinge", "universe", data.oMi[3] * at(0.3, 0.1), parent, at(0.3, 0.1), "last")
    found = ClosedChain(model, [last], ["axis0", "slide"]).mobility(np.zeros(4))
    assert (found.dof, found.rank, found.actuated_rank) == (1, 3, 1)
    assert found.locked == ("axis0", "axis1", "axis2")
    assert found.redundant == ("axis0",)


def test_a_singularity_of_the_loops_is_told_from_dependent_equations() -> None:
    """A flat parallelogram can go on as one or as the other; away from there it has one degree of freedom."""
    chain = mechanism("parallelogram")
    flat, regular = chain.mobility(np.zeros(4)), chain.mobility(states("parallelogram")[0][0])
    assert (flat.dof, flat.regular_dof, flat.is_singular) == (2, 1, True)
    assert (regular.dof, regular.regular_dof, regular.is_singular) == (1, 1, False)
    with pytest.raises(SingularConfigurationError, check=with_fields(kind="constraint")):
        chain.state(np.zeros(4)).forward_dynamics(np.zeros(3))


def test_open_loops_and_batches_are_refused() -> None:
    chain = mechanism("ankle")
    with pytest.raises(ClosureError):
        chain.mobility(np.full(8, 0.3))
    with pytest.raises(ArgumentError, check=with_fields(argument="q")):
        chain.mobility(np.zeros((2, 8)))
