"""Mechanisms of several kinds of loops, many of dependent equations, with closed random states."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import JointEquality
from tests.loops.robots import ankle, at, closure, delta, four_bar, hinge, stewart

Array = npt.NDArray[np.float64]


def parallelogram() -> ClosedChain:
    """Two parallel cranks and a third between them, each driven: three actuators of one freedom."""
    model = pin.Model()
    for parent, name, x in (("universe", "crank0", 0.0), ("crank0", "coupler", 0.4), ("universe", "crank1", 0.5)):
        hinge(model, parent, name, at(x))
    hinge(model, "universe", "crank2", at(1.0))
    closures = [closure("hinge", "coupler", at(0.5 * k), f"crank{k}", at(0.4), f"pin{k}") for k in (1, 2)]
    return ClosedChain(model, closures, ["crank0", "crank1", "crank2"], q0=[0.8, -0.8, 0.8, 0.8])


def bennett() -> ClosedChain:
    """The spatial four-bar of Bennett, a / sin α = b / sin β: mobile although Grübler counts -2."""
    a, b, alpha = 0.5, 0.8, 0.6
    beta = np.arcsin(b / a * np.sin(alpha))
    model, parent, placement = pin.Model(), "universe", at()
    links = [at(a, turned=(alpha, 0.0, 0.0)), at(b, turned=(beta, 0.0, 0.0))] * 2
    for k, link in enumerate(links[:3]):
        parent, placement = hinge(model, parent, f"axis{k}", placement), link
    last = closure("hinge", parent, placement, "universe", links[3].inverse(), "last")
    return ClosedChain(model, [last], ["axis0"], q0=[0.9, 1.2, -0.9])


def sarrus() -> ClosedChain:
    """Two chains of three parallel hinges, at a right angle: the platform moves up and down without turning."""
    model = pin.Model()
    bases = [at(turned=(0.0, 0.0, turn)) * at(1.0, turned=(-np.pi / 2, 0.0, 0.0)) for turn in (0.0, np.pi / 2)]
    for k, base in enumerate(bases):
        hinge(model, "universe", f"low{k}", base)
        hinge(model, f"low{k}", f"middle{k}", at(0.6))
        if k == 0:
            hinge(model, "middle0", "platform", at(0.6))
    # In the platform's frame at its hinge of the first chain, the hinge of the second one.
    last = closure("hinge", "middle1", at(0.6), "platform", bases[0].actInv(bases[1]), "second chain")
    return ClosedChain(model, [last], ["low0"], q0=[-0.3, 1.1, -0.8, -0.3, 1.1])


def welded() -> ClosedChain:
    """Seven hinges in general places, closed by a weld, and a slide geared to the first by a cubic."""
    model, parent, rng = pin.Model(), "universe", np.random.default_rng(5)
    for k in range(7):
        place = at(*rng.uniform(0.2, 0.5, 3), turned=rng.normal(size=3))
        parent = hinge(model, parent, f"axis{k}", place if k else at())
    hinge(model, "universe", "slide", at(0.0, 2.0), "x", slides=True)
    q0 = np.append(rng.uniform(-1.0, 1.0, 7), 0.0)
    data = model.createData()
    pin.forwardKinematics(model, data, q0)
    weld = closure("weld", "universe", data.oMi[7].copy(), parent, at(), "weld")
    gear = JointEquality("slide", "axis0", (0.1, 0.2, 0.3, 0.1), -0.1, 0.4, "gear")
    q0[-1] = np.polynomial.polynomial.polyval(q0[0] - 0.4, gear.coefficients) - 0.1
    return ClosedChain(model, [weld], ["axis0"], equalities=[gear], q0=q0)


MAKERS: dict[str, Callable[[], ClosedChain]] = {
    "four-bar": lambda: four_bar(lengths=(1.0, 0.3, 1.1, 0.7)),
    "planar four-bar": lambda: four_bar("planar", lengths=(1.0, 0.3, 1.1, 0.7)),
    "parallelogram": parallelogram,
    "Bennett": bennett,
    "Sarrus": sarrus,
    "Stewart": stewart,
    "Delta": lambda: delta(held=False),
    "Delta without spins": delta,
    "ankle": ankle,
    "free ankle": lambda: ankle(base=True),
    "weld and gear": welded,
}


@cache
def mechanism(name: str) -> ClosedChain:
    return MAKERS[name]()


@cache
def states(name: str, count: int = 4, seed: int = 0) -> list[tuple[Array, Array]]:
    """Closed q away from each other, and velocities v that keep them so, of plain linear algebra."""
    chain, rng = mechanism(name), np.random.default_rng(seed)
    q, result = chain.close(), []
    for _ in range(count):
        step = admissible(chain, q) @ rng.normal(size=chain.model.nv)
        q = chain.close(pin.integrate(chain.model, q, 0.1 * step / np.abs(step).max()))
        v = admissible(chain, q) @ rng.normal(size=chain.model.nv)
        result.append((q, v / np.abs(v).max()))
    return result


def admissible(chain: ClosedChain, q: Array) -> Array:
    """The projection (nv, nv) onto the kernel of the closures' Jacobian, by singular values."""
    held = np.eye(chain.model.nv)[chain.indices_in_v(*chain.held)]
    jacobian = np.concatenate([chain.state(q).constraint_jacobian(), held])
    return np.eye(chain.model.nv) - np.linalg.pinv(jacobian, rcond=1e-9) @ jacobian
