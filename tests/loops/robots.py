"""Small robots with closed loops, made as models of Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, ClosureKind, find_frame

_HINGES = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
_SLIDES = {"x": pin.JointModelPX, "y": pin.JointModelPY, "z": pin.JointModelPZ}


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turned: Any = (0.0, 0.0, 0.0)) -> Any:
    """Return a placement: a position and a rotation vector."""
    return pin.SE3(pin.exp3(np.array(turned, dtype=float)), np.array([x, y, z], dtype=float))


def hinge(model: Any, parent: str, name: str, placement: Any, axis: str = "z", slides: bool = False) -> str:
    """Add a hinge, or a slide, to what the joint `parent` carries, and return its name, that of a frame too."""
    kind = (_SLIDES if slides else _HINGES)[axis]()
    return add(model, parent, name, placement, kind)


def add(model: Any, parent: str, name: str, placement: Any, kind: Any, mass: float = 1.0) -> str:
    """Add a joint of any kind with a rod."""
    joint = model.addJoint(model.getJointId(parent), kind, placement, name)
    model.addJointFrame(joint)
    inertia = pin.Inertia(mass, np.array([0.1, 0.02, -0.03]), mass * (np.diag([0.02, 0.03, 0.04]) + 0.004))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return name


def closure(kind: ClosureKind, first: str, at_first: Any, second: str, at_second: Any, name: str = "") -> Closure:
    """Return a closure between what two joints carry."""
    return Closure(kind, Anchor(first, at_first), Anchor(second, at_second), name)


def closed(model: Any, loops: list[Closure], actuated: list[str], guess: Any, held: list[str] | None = None) -> Any:
    """Return a chain whose `q0` is closed, near a guess."""
    q0 = ClosedChain(model, loops, actuated, held=held or [], q0=guess).close()
    return ClosedChain(model, loops, actuated, held=held or [], q0=q0)


def four_bar(kind: ClosureKind = "hinge", lengths: tuple[float, ...] = (0.3, 0.1, 0.35, 0.25)) -> ClosedChain:
    """Return a planar four-bar: the ground's length, the crank's, the coupler's and the rocker's."""
    ground, crank, coupler, rocker = lengths
    model = pin.Model()
    hinge(model, "universe", "crank", at())
    hinge(model, "crank", "coupler", at(crank))
    hinge(model, "universe", "rocker", at(ground))
    loop = closure(kind, "coupler", at(coupler), "rocker", at(rocker), "tip")
    return closed(model, [loop], ["crank"], np.array([0.6, 0.4, 1.2]))


def five_bar() -> ClosedChain:
    """Return a planar five-bar with two driven cranks; its tip is the frame `tip`."""
    model = pin.Model()
    hinge(model, "universe", "left", at(-0.1))
    hinge(model, "left", "left_rod", at(0.2))
    hinge(model, "universe", "right", at(0.1))
    hinge(model, "right", "right_rod", at(0.2))
    model.addFrame(pin.Frame("tip", model.getJointId("left_rod"), at(0.3), pin.FrameType.OP_FRAME))
    loop = closure("point", "left_rod", at(0.3), "right_rod", at(0.3), "tip")
    return closed(model, [loop], ["left", "right"], np.array([2.2, -1.0, 0.9, 1.0]))


def ankle(base: bool = False) -> ClosedChain:
    """Return a foot on two hinges, moved by two cranks and rods with balls at their ends, perhaps on a free base."""
    model = pin.Model()
    shank = add(model, "universe", "shank", at(), pin.JointModelFreeFlyer()) if base else "universe"
    hinge(model, shank, "pitch", at(0.0, 0.0, -0.3), "y")
    hinge(model, "pitch", "roll", at(), "x")
    model.addFrame(pin.Frame("foot", model.getJointId("roll"), at(0.0, 0.0, -0.05), pin.FrameType.OP_FRAME))
    loops, guess = [], [0.0, 0.0]
    for side, y in (("left", 0.04), ("right", -0.04)):
        hinge(model, shank, f"{side}_crank", at(0.0, y, 0.0), "y")
        hinge(model, f"{side}_crank", f"{side}_rod_y", at(-0.05, 0.0, 0.0), "y")
        hinge(model, f"{side}_rod_y", f"{side}_rod_x", at(), "x")
        loops.append(closure("point", f"{side}_rod_x", at(0.0, 0.0, -0.3), "roll", at(-0.05, y, 0.0), f"{side} rod"))
        guess += [0.0, 0.0, 0.0]
    q0 = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *guess] if base else guess)
    return closed(model, loops, ["left_crank", "right_crank"], q0)


def stewart() -> ClosedChain:
    """Return a Stewart platform 6-UPS, whose platform `platform` hangs from a free joint, on six point closures."""
    model = pin.Model()
    add(model, "universe", "platform", at(), pin.JointModelFreeFlyer())
    loops, q0, actuated = [], [0.02, 0.01, 0.55, 0.0, 0.0, 0.0, 1.0], []
    for leg in range(6):
        angle, other = (np.pi / 3 * (leg // 2 * 2) + s * (leg % 2 * 2 - 1) for s in (0.2, 0.85))
        foot, ball = 0.5 * np.array([np.cos(angle), np.sin(angle)]), 0.3 * np.array([np.cos(other), np.sin(other)])
        hinge(model, "universe", f"u{leg}", at(foot[0], foot[1]), "x")
        hinge(model, f"u{leg}", f"v{leg}", at(), "y")
        actuated.append(hinge(model, f"v{leg}", f"leg{leg}", at(), "z", slides=True))
        loops.append(closure("point", actuated[-1], at(), "platform", at(ball[0], ball[1]), f"ball{leg}"))
        x, y, z = np.array([*(ball - foot), 0.0]) + q0[:3]
        length = float(np.linalg.norm([x, y, z]))
        q0 += [float(np.arctan2(-y, z)), float(np.arcsin(x / length)), length]
    return closed(model, loops, actuated, np.array(q0))


def delta(held: bool = True) -> ClosedChain:
    """Return a Delta: three arms, six rods on balls of three hinges whose spins are held; else on balls, which spin."""
    model, loops, actuated, spins = pin.Model(), [], [], []
    add(model, "universe", "platform", at(), pin.JointModelFreeFlyer(), mass=2.0)
    for k in range(3):
        turn = at(turned=(0.0, 0.0, 2.0 * np.pi / 3.0 * k))
        actuated.append(hinge(model, "universe", f"arm{k}", turn * at(0.2), "y"))
        for side, y in (("a", -0.08), ("b", 0.08)):
            rod = f"rod{k}{side}"
            if held:
                hinge(model, f"arm{k}", f"{rod}_x", at(0.4, y), "x")
                hinge(model, f"{rod}_x", f"{rod}_y", at(), "y")
                spins.append(hinge(model, f"{rod}_y", rod, at(), "z"))
            else:
                add(model, f"arm{k}", rod, at(0.4, y), pin.JointModelSpherical())
            loops.append(closure("point", "platform", turn * at(0.08, y), rod, at(z=-0.8), f"ball {rod}"))
    q0 = pin.neutral(model)
    q0[2] = -0.75
    return closed(model, loops, actuated, q0, spins)


def pose_of(model: Any, q: Any, frame: str) -> Any:
    """Return the placement of a frame in the world."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[find_frame(model, frame)].copy()


def ends_of(model: Any, q: Any, closure: Closure) -> list[Any]:
    """Return both anchors of a closure in the world."""
    return [pose_of(model, q, anchor.frame) * anchor.placement for anchor in (closure.first, closure.second)]


ROBOTS = {"four_bar": four_bar, "five_bar": five_bar, "ankle": ankle, "stewart": stewart, "delta": delta}
