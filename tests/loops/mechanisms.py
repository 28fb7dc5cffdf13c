"""Mechanisms of several kinds of loops as `ClosedChain`s of Pinocchio's own joints, with closed random states."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, JointEquality

Array = npt.NDArray[np.float64]


class Tree:
    """A model that grows joint by joint; each joint carries a rod of a length along its x axis."""

    def __init__(self, name: str) -> None:
        self.model = pin.Model()
        self.model.name = name

    def add(self, parent: str, joint: Any, name: str, placement: Any = None, mass: float = 1.0) -> str:
        model = self.model
        index = model.addJoint(model.getJointId(parent), joint, placement or pin.SE3.Identity(), name)
        model.addJointFrame(index)
        spread = np.diag([0.02, 0.03, 0.04]) + 0.004
        model.appendBodyToJoint(
            index, pin.Inertia(mass, np.array([0.1, 0.02, -0.03]), mass * spread), pin.SE3.Identity()
        )
        return name


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, rotation: Any = None) -> Any:
    return pin.SE3(np.eye(3) if rotation is None else rotation, np.array([x, y, z]))


def rotation(axis: str, angle: float) -> Array:
    return np.asarray(pin.exp3(np.eye(3)["xyz".index(axis)] * angle))


def four_bar(ratio: float = 0.7, kind: str = "hinge") -> ClosedChain:
    """Planar: crank 0.3, coupler 1.1, rocker `ratio`, ground 1."""
    tree = Tree("four-bar")
    tree.add("universe", pin.JointModelRZ(), "crank")
    tree.add("crank", pin.JointModelRZ(), "coupler", at(0.3))
    tree.add("universe", pin.JointModelRZ(), "rocker", at(1.0))
    closure = Closure(kind, Anchor("coupler", at(1.1)), Anchor("rocker", at(ratio)), "pin")
    return ClosedChain(tree.model, [closure], ["crank"], q0=[0.7, 0.1, 1.7])


def parallelogram() -> ClosedChain:
    """Two parallel cranks and a third between them, each driven: three actuators of one freedom."""
    tree = Tree("parallelogram")
    tree.add("universe", pin.JointModelRZ(), "crank0")
    tree.add("crank0", pin.JointModelRZ(), "coupler", at(0.4))
    tree.add("universe", pin.JointModelRZ(), "crank1", at(0.5))
    tree.add("universe", pin.JointModelRZ(), "crank2", at(1.0))
    closures = [
        Closure("hinge", Anchor("coupler", at(x)), Anchor(f"crank{k}", at(0.4)), f"pin{k}")
        for k, x in ((1, 0.5), (2, 1.0))
    ]
    return ClosedChain(tree.model, closures, ["crank0", "crank1", "crank2"], q0=[0.8, -0.8, 0.8, 0.8])


def bennett() -> ClosedChain:
    """The spatial four-bar of Bennett, a / sin α = b / sin β: mobile although Grübler counts -2."""
    a, b, alpha = 0.5, 0.8, 0.6
    beta = np.arcsin(b / a * np.sin(alpha))
    tree, parent = Tree("Bennett"), "universe"
    links = [(a, alpha), (b, beta), (a, alpha), (b, beta)]
    placement = at()
    for k, (length, twist) in enumerate(links[:3]):
        tree.add(parent, pin.JointModelRZ(), f"axis{k}", placement)
        parent, placement = f"axis{k}", at(length, rotation=rotation("x", twist))
    length, twist = links[3]
    last = Closure(
        "hinge",
        Anchor(parent, placement),
        Anchor("universe", at(length, rotation=rotation("x", twist)).inverse()),
        "last",
    )
    return ClosedChain(tree.model, [last], ["axis0"], q0=[0.9, 1.2, -0.9])


def sarrus() -> ClosedChain:
    """Two chains of three parallel hinges, at a right angle: the platform moves up and down without turning."""
    tree = Tree("Sarrus")
    for k, turn in enumerate((0.0, np.pi / 2)):
        base = pin.SE3(rotation("z", turn), np.zeros(3)) * at(1.0, rotation=rotation("x", -np.pi / 2))
        tree.add("universe", pin.JointModelRZ(), f"low{k}", base)
        tree.add(f"low{k}", pin.JointModelRZ(), f"middle{k}", at(0.6))
        if k == 0:
            tree.add("middle0", pin.JointModelRZ(), "platform", at(0.6))
    # In the platform's frame at its hinge of the first chain, the hinge of the second one.
    first = pin.SE3(rotation("z", 0.0), np.zeros(3)) * at(1.0, rotation=rotation("x", -np.pi / 2))
    second = pin.SE3(rotation("z", np.pi / 2), np.zeros(3)) * at(1.0, rotation=rotation("x", -np.pi / 2))
    closure = Closure("hinge", Anchor("middle1", at(0.6)), Anchor("platform", first.actInv(second)), "second chain")
    return ClosedChain(tree.model, [closure], ["low0"], q0=[-0.3, 1.1, -0.8, -0.3, 1.1])


def stewart() -> ClosedChain:
    """Six legs of two hinges and a slide, on balls of a platform that is free in the tree: nq = nv + 1."""
    tree = Tree("Stewart")
    tree.add("universe", pin.JointModelFreeFlyer(), "platform", mass=5.0)
    closures, actuated = [], []
    for k in range(6):
        base, top = np.deg2rad(60 * k + (-1) ** k * 22), np.deg2rad(60 * k + (-1) ** k * 8)
        tree.add("universe", pin.JointModelRX(), f"swing{k}", at(np.cos(base), np.sin(base)))
        tree.add(f"swing{k}", pin.JointModelRY(), f"tilt{k}")
        actuated.append(tree.add(f"tilt{k}", pin.JointModelPZ(), f"leg{k}", at(z=1.0)))
        point = at(0.6 * np.cos(top), 0.6 * np.sin(top))
        closures.append(Closure("point", Anchor("platform", point), Anchor(f"leg{k}"), f"ball{k}"))
    q0 = pin.neutral(tree.model)
    q0[:7] = [0.05, 0.02, 1.1, *pin.Quaternion(pin.exp3(np.array([0.1, -0.2, 0.15]))).coeffs()]
    return ClosedChain(tree.model, closures, actuated, q0=q0)


def delta(held: bool = False) -> ClosedChain:
    """Three arms, six rods on balls, whose spins no actuator drives; with `held`, balls of three hinges, spins held."""
    tree = Tree("Delta")
    closures, actuated, spins = [], [], []
    arms = [pin.SE3(rotation("z", turn), np.zeros(3)) for turn in np.deg2rad([0.0, 120.0, 240.0])]
    tree.add("universe", pin.JointModelFreeFlyer(), "platform", mass=2.0)
    for k, turn in enumerate(arms):
        actuated.append(tree.add("universe", pin.JointModelRY(), f"arm{k}", turn * at(0.2)))
        for side in (-1, 1):
            rod, hip = f"rod{k}{'ab'[side > 0]}", at(0.4, 0.08 * side)
            if held:
                tree.add(f"arm{k}", pin.JointModelRX(), f"{rod}_x", hip, mass=0.1)
                tree.add(f"{rod}_x", pin.JointModelRY(), f"{rod}_y", mass=0.1)
                spins.append(tree.add(f"{rod}_y", pin.JointModelRZ(), rod, mass=0.3))
            else:
                tree.add(f"arm{k}", pin.JointModelSpherical(), rod, hip, mass=0.3)
            place = turn * at(0.08, 0.08 * side)
            closures.append(Closure("point", Anchor("platform", place), Anchor(rod, at(z=-0.8)), f"ball {rod}"))
    q0 = pin.neutral(tree.model)
    q0[2] = -0.75
    return ClosedChain(tree.model, closures, actuated, held=spins, q0=q0)


def ankle(free: bool = False, mass: float = 1.0) -> ClosedChain:
    """A foot on pitch and roll, moved by two motors, cranks and rods; with `free`, on a free base."""
    tree, base = Tree("ankle"), "universe"
    if free:
        base = tree.add("universe", pin.JointModelFreeFlyer(), "shank", mass=3.0)
    tree.add(base, pin.JointModelRY(), "pitch", at(z=-0.4))
    tree.add("pitch", pin.JointModelRX(), "roll", mass=mass)
    closures = []
    for name, y, z in (("left", 0.05, -0.1), ("right", -0.05, -0.2)):
        tree.add(base, pin.JointModelRY(), f"{name}_motor", at(0.0, y, z), mass=0.5)
        tree.add(f"{name}_motor", pin.JointModelRX(), f"{name}_x", at(-0.05), mass=0.1)
        tree.add(f"{name}_x", pin.JointModelRY(), f"{name}_y", mass=0.1)
        tip = at(z=-(0.4 + z))
        closures.append(Closure("point", Anchor("roll", at(-0.05, y)), Anchor(f"{name}_y", tip), f"{name} rod"))
    return ClosedChain(tree.model, closures, ["left_motor", "right_motor"])


def welded() -> ClosedChain:
    """Seven hinges in general places, closed by a weld, and a slide geared to the first by a cubic."""
    tree, parent, rng = Tree("seven hinges"), "universe", np.random.default_rng(5)
    for k in range(7):
        place = at(*rng.uniform(0.2, 0.5, 3), rotation=np.asarray(pin.exp3(rng.normal(size=3))))
        parent = tree.add(parent, pin.JointModelRZ(), f"axis{k}", place if k else at())
    tree.add("universe", pin.JointModelPX(), "slide", at(0.0, 2.0))
    q0 = np.append(rng.uniform(-1.0, 1.0, 7), 0.0)
    data = tree.model.createData()
    pin.forwardKinematics(tree.model, data, q0)
    closure = Closure("weld", Anchor("universe", data.oMi[7].copy()), Anchor(parent), "weld")
    gear = JointEquality("slide", "axis0", (0.1, 0.2, 0.3, 0.1), -0.1, 0.4, "gear")
    q0[-1] = np.polynomial.polynomial.polyval(q0[0] - 0.4, gear.coefficients) - 0.1
    return ClosedChain(tree.model, [closure], ["axis0"], equalities=[gear], q0=q0)


MAKERS: dict[str, Callable[[], ClosedChain]] = {
    "four-bar": four_bar,
    "planar four-bar": lambda: four_bar(kind="planar"),
    "parallelogram": parallelogram,
    "Bennett": bennett,
    "Sarrus": sarrus,
    "Stewart": stewart,
    "Delta": delta,
    "Delta without spins": lambda: delta(held=True),
    "ankle": ankle,
    "free ankle": lambda: ankle(free=True),
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
