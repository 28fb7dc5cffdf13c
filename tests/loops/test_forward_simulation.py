"""Motion of closed chains in time: energy, closed loops, known motions, and how runs end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from loops.mechanisms import MAKERS, Array, mechanism, states
from scipy.integrate import solve_ivp

from spm_pin.errors import ArgumentError
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import ClosureKind
from spm_pin.loops.forward_simulation import SimulationEnd, simulate
from tests.loops.robots import four_bar


@pytest.mark.parametrize("name", MAKERS)
def test_a_fall_keeps_its_energy_and_its_loops_closed(name: str) -> None:
    chain = mechanism(name)
    (q, v), *_ = states(name)
    motion = chain.simulate(q, v, None, np.linspace(0.0, 0.2, 5))
    assert motion.complete
    assert np.abs(motion.energy_error).max() <= 1e-8 * (motion.kinetic.max() + np.ptp(motion.potential))
    assert motion.gap.max() <= 1e-12
    for q, v, a in zip(motion.q, motion.v, motion.a, strict=True):
        assert a == pytest.approx(chain.state(q, v).forward_dynamics(np.zeros(len(chain.actuated))))


def test_forces_and_wrenches_do_their_work() -> None:
    chain = mechanism("Stewart")
    (q, v), *_ = states("Stewart")
    wrenches = {"platform": lambda t, q, v: [10.0 * np.sin(9.0 * t), 0.0, -5.0, 0.0, 1.0, 0.0]}

    def tau(t: float, q: Array, v: Array) -> Any:
        return 30.0 + 10.0 * np.cos(20.0 * t + np.arange(6)) - 5.0 * v[chain.actuated_in_v]

    motion = simulate(chain, q, v, tau, np.linspace(0.0, 0.3, 4), wrenches=wrenches)
    assert abs(motion.work[-1]) > 1.0
    assert np.abs(motion.energy_error).max() <= 1e-7 * np.abs(motion.work).max()


def test_a_four_bar_moves_as_its_equation_of_one_coordinate() -> None:
    """With θ the crank, m(θ) θ'' + m'(θ) θ'²/2 + V'(θ) = 0, from energies of `forward` alone."""
    chain = mechanism("four-bar")
    model, data = chain.model, chain.model.createData()
    (start, _), *_ = states("four-bar")

    def energies(crank: float) -> tuple[float, float]:
        q = chain.forward([crank], near=start)
        ends = [chain.forward([crank + s], near=q) for s in (-1e-4, 1e-4, -2e-4, 2e-4)]
        slope = (8.0 * (ends[1] - ends[0]) - (ends[3] - ends[2])) / 12e-4
        return 2.0 * pin.computeKineticEnergy(model, data, q, slope), pin.computePotentialEnergy(model, data, q)

    def rate(t: float, y: Array) -> list[float]:
        (m0, v0), (m1, v1) = energies(y[0] - 1e-3), energies(y[0] + 1e-3)
        mass = energies(y[0])[0]
        return [y[1], -((m1 - m0) / 2e-3 * y[1] ** 2 / 2.0 + (v1 - v0) / 2e-3) / mass]

    v = chain.state(start).joint_rates([2.0])
    motion = simulate(chain, start, v, None, [0.0, 0.1, 0.2])
    expected = solve_ivp(rate, (0.0, 0.2), [start[0], 2.0], t_eval=[0.0, 0.1, 0.2], rtol=1e-7, atol=1e-9).y[0]
    assert motion.q[:, 0] == pytest.approx(expected, abs=2e-6)


def test_a_controller_is_called_once_in_each_period() -> None:
    chain, calls = mechanism("ankle"), []
    (q, v), *_ = states("ankle")

    def tau(t: float, q: Array, v: Array) -> Any:
        calls.append(t)
        return -0.1 * v[chain.actuated_in_v]

    motion = chain.simulate(q, v, tau, [0.0, 0.05], period=0.01)
    assert motion.complete
    assert calls == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])


def test_progress_may_interrupt() -> None:
    chain, seen = mechanism("ankle"), []
    (q, v), *_ = states("ankle")

    def progress(what: str, done: int, total: int) -> None:
        seen.append((done, total))
        if len(seen) == 3:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        simulate(chain, q, v, None, [0.0, 1.0], progress=progress)
    assert all(0 <= done <= total for done, total in seen)


def test_the_error_is_that_of_the_tolerance_also_between_steps() -> None:
    chain, times = mechanism("ankle"), np.linspace(0.0, 0.3, 7)
    (q, v), *_ = states("ankle")
    exact, *others = (chain.simulate(q, v, None, times, tolerance=tol).q for tol in (1e-13, 1e-5, 1e-8, 1e-11))
    errors = [np.abs(other - exact).max() for other in others]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-9
    for k in (2, 5):
        assert chain.simulate(q, v, None, times[[0, k]], tolerance=1e-13).q[-1] == pytest.approx(exact[k], abs=1e-10)


@pytest.mark.parametrize("begin", [0.0, 1.0])
@pytest.mark.parametrize(
    ("force", "detail"),
    [(lambda v: 1e3 * v[:1] ** 3, ""), (lambda v: [1e99], ""), (lambda v: [1e200], "above 1e100")],
)
def test_a_run_ends_where_nothing_is_bounded(force: Callable[[Array], Any], detail: str, begin: float) -> None:
    """A force that grows with the velocity's cube blows up in finite time."""
    chain = mechanism("four-bar")
    (q, _), *_ = states("four-bar")
    v = chain.state(q).joint_rates([1.0])
    motion = simulate(chain, q, v, lambda t, q, v: force(v), [begin, begin + 10.0])
    assert motion.end is SimulationEnd.STALLED
    assert motion.times.tolist() == [begin]
    assert motion.detail
    assert detail in motion.detail


def test_a_parallelogram_becomes_flat() -> None:
    """There it could go on in two ways: a run ends if it looks there, and else goes straight on in its mode.

    Without gravity in its plane it moves at a constant rate, and is flat after 0.1 s.
    """
    chain = mechanism("parallelogram")
    q = chain.close([0.3, -0.3, 0.3, 0.3])
    v = chain.state(q).joint_rates([-3.0] * 3)
    motion = simulate(chain, q, v, None, [0.0, 0.05, 0.1, 0.2])
    assert motion.end is SimulationEnd.SINGULARITY
    assert motion.times.tolist() == [0.0, 0.05]
    assert "singularity" in motion.detail
    motion = simulate(chain, q, v, None, [0.0, 0.13, 0.2])
    assert motion.complete
    assert motion.q[:, 2] == pytest.approx(0.3 - 3.0 * motion.times, abs=1e-8)
    assert np.abs(motion.energy_error).max() <= 1e-8 * motion.kinetic.max()


def test_the_first_of_several_events_ends_a_run() -> None:
    """A parallelogram that moves at a constant rate."""
    chain = mechanism("parallelogram")
    q = chain.close([0.3, -0.3, 0.3, 0.3])
    v = chain.state(q).joint_rates([-3.0] * 3)
    events = {"later": lambda q: q[2] - 0.1, "half": lambda q: q[2] - 0.15, "never": lambda q: q[2] + 1.0}
    motion = simulate(chain, q, v, None, [0.0, 0.03, 0.06], events=events)
    assert (motion.end, motion.detail) == (SimulationEnd.EVENT, "half")
    assert motion.times == pytest.approx([0.0, 0.03, 0.05], abs=1e-9)
    assert motion.q[:, 2] == pytest.approx([0.3, 0.21, 0.15], abs=1e-9)
    assert motion.gap.max() <= 1e-12
    begun = simulate(chain, motion.q[-1], v, None, [0.0, 0.03], events={"half": lambda q: q[2] - 0.16})
    assert (begun.end, begun.times.tolist()) == (SimulationEnd.EVENT, [0.0])


def test_bad_input_is_refused() -> None:
    chain = mechanism("ankle")
    (q, v), *_ = states("ankle")
    good: dict[str, Any] = {"q": q, "v": v, "tau": None, "times": [0.0, 1.0]}
    for argument, *values in (
        ("times", [0.0, 0.0]),
        ("tau", [1.0], lambda t, q, v: [np.nan, 0.0]),
        ("v", np.ones(8)),
        ("q", q[None]),
        ("period", -1.0, 1e-300),
        ("tolerance", 1e-16),
        ("events", [lambda q: 1.0], {"nan": lambda q: np.nan}, {"two": lambda q: q[:2]}),
        ("wrenches", [np.zeros(6)], {"nowhere": np.zeros(6)}),
    ):
        for value in values:
            with pytest.raises(ArgumentError, check=with_fields(argument=argument)):
                simulate(chain, **{**good, argument: value})
    with pytest.raises(ArgumentError, check=with_fields(received="0.5 after 1")):
        simulate(chain, **{**good, "times": [0.0, 1.0, 0.5]})


@pytest.mark.parametrize(("kind", "force"), [("hinge", 1e3), ("planar", 1e5)])
def test_force_that_sets_in_after_a_rest_is_met_by_shorter_steps(kind: ClosureKind, force: float) -> None:
    """At rest steps are long; the first within which the crank is driven leads to places with open or no loops."""
    linkage = four_bar(kind)
    model = linkage.model.copy()
    model.gravity.linear = np.zeros(3)
    chain = ClosedChain(model, linkage.closures, ["crank"], q0=linkage.q0)
    q, times = chain.close(), [0.0, 1.02]
    motion = simulate(chain, q, np.zeros(3), lambda t, q, v: [force if t >= 1.0 else 0.0], times, tolerance=1e-6)
    assert motion.complete
    # Work is force times angle: the crank turns about its axis alone.
    turned = motion.q[-1, 0] - motion.q[0, 0]
    assert motion.energy[-1] - motion.energy[0] == pytest.approx(force * turned, rel=1e-4)
