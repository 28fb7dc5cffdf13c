"""The equations of closures and their derivatives, by Pinocchio and by the compiled tree, against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from spm_pin.errors import ArgumentError
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, Closure, ClosureKind, JointEquality
from spm_pin.loops.constraint_rows import LoopKinematics
from spm_pin.loops.following import Follower, linearised, moved, residual
from tests.finite_differences import extrapolated
from tests.loops.robots import add, at, closure, four_bar, hinge

KINDS: tuple[ClosureKind, ...] = ("point", "hinge", "planar", "weld")
JOINTS = {
    "hinge": pin.JointModelRY(),
    "oblique hinge": pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
    "unbounded": pin.JointModelRUBZ(),
    "slide": pin.JointModelPX(),
    "oblique slide": pin.JointModelPrismaticUnaligned(np.array([0.8, 0.6, 0.0])),
    "ball": pin.JointModelSpherical(),
    "translation": pin.JointModelTranslation(),
    "planar": pin.JointModelPlanar(),
    "free": pin.JointModelFreeFlyer(),
}


def loop_of(kind: ClosureKind, joint: Any) -> ClosedChain:
    """Return two branches, one with a joint of any kind, that a closure holds together, and a joint equality."""
    model = pin.Model()
    hinge(model, "universe", "base", at(0.1, 0.2, 0.3, turned=(0.1, 0.2, 0.3)), "y")
    hinge(model, "base", "a1", at(0.1, turned=(0.3, -0.4, 0.2)), "x")
    add(model, "a1", "a2", at(0.3, 0.1, turned=(-0.3, 0.5, 0.1)), joint)
    hinge(model, "base", "b1", at(-0.2, 0.1, turned=(1.0, 0.4, 0.2)), "z", slides=True)
    hinge(model, "b1", "b2", at(0.2, turned=(0.0, -0.4, 0.9)), "z")
    loop = closure(kind, "a2", at(0.1, 0.2, 0.1, turned=(0.3, 0.1, 0.8)), "b2", at(0.4, turned=(-0.3, 0.6, 0.0)))
    gear = JointEquality("b2", "a1", (0.1, 0.5, -0.3, 0.2), 0.2, -0.1)
    return ClosedChain(model, [loop], [], equalities=[gear], q0=pin.neutral(model))


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_differences(kind: ClosureKind, joint: str) -> None:
    chain = loop_of(kind, JOINTS[joint])
    random = np.random.default_rng(3)
    q = pin.integrate(chain.model, chain.q0, random.uniform(-1.0, 1.0, chain.model.nv))
    kinematics = LoopKinematics(chain.rows)
    found = kinematics.linearised(q)
    for k, unit in enumerate(np.diag(chain.rows.units)):

        def change(h: float, unit: Any = unit) -> Any:
            ahead, back = (kinematics.residual(pin.integrate(chain.model, q, s * h * unit)) for s in (1.0, -1.0))
            return (ahead - back) / (2.0 * h)

        assert_allclose(found.jacobian[:, k], extrapolated(change, 0.02), atol=1e-10)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("kind", KINDS)
def test_compiled_tree_is_that_of_pinocchio(kind: ClosureKind, joint: str) -> None:
    from spm_pin.loops import tree_kernel

    chain = loop_of(kind, JOINTS[joint])
    random = np.random.default_rng(4)
    q = pin.integrate(chain.model, chain.q0, random.uniform(-1.0, 1.0, chain.model.nv))
    problem = Follower(chain, "b2", (0, 2, 3, 4, 5)).problem()
    tree = tree_kernel.tree_of(problem)
    target = pin.SE3(pin.exp3(random.uniform(-2.0, 2.0, 3)), random.uniform(-1.0, 1.0, 3))
    problem.aim(q, target.homogeneous)
    tree_kernel._aim(tree, q, target.homogeneous.ravel())
    x = random.uniform(-0.3, 0.3, len(problem.columns))
    for share in (0.0, 0.3, 1.0):
        assert_allclose(tree_kernel._residual(tree, q, share), residual(problem, q, share), atol=1e-14)
        for ours, other in zip(tree_kernel._linearised(tree, q, share), linearised(problem, q, share), strict=True):
            assert_allclose(ours, other, atol=1e-13)
        # Steps of free and planar joints are alike to second order.
        tolerance = 5e-3 if joint in ("free", "planar") else 1e-14
        assert_allclose(tree_kernel._moved(tree, q, share, x), moved(problem, q, share, x), atol=tolerance)


def test_reversed_axis_is_no_closed_loop() -> None:
    chain = four_bar("hinge")
    turned = Closure("hinge", Anchor("coupler", at(0.35)), Anchor("rocker", at(0.25, turned=(np.pi, 0.0, 0.0))), "tip")
    wrong = ClosedChain(chain.model, [turned], ["crank"], q0=chain.q0)
    kinematics = LoopKinematics(wrong.rows)
    assert np.abs(kinematics.residual(chain.q0)).max() < 1e-12
    with pytest.raises(Exception, match="wrong way round"):
        wrong.close(chain.q0)


def test_wrong_loops_are_named() -> None:
    model = four_bar().model
    with pytest.raises(ArgumentError, match="nowhere"):
        ClosedChain(model, [closure("point", "coupler", at(), "nowhere", at(), "tip")], ["crank"])
    with pytest.raises(ArgumentError) as caught:
        ClosedChain(model, [closure("point", "coupler", at(), "coupler", at(0.1), "tip")], ["crank"])
    assert "tip" in caught.value.argument
    composite = pin.JointModelComposite(pin.JointModelRX())
    bad = pin.Model()
    bad.addJoint(0, composite, pin.SE3.Identity(), "two in one")
    with pytest.raises(ArgumentError) as caught:
        ClosedChain(bad, [], [])
    assert "two in one" in caught.value.received
