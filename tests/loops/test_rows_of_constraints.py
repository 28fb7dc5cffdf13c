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
from spm_pin.loops.following import Follower
from spm_pin.loops.state_kinematics import StateKinematics
from spm_pin.loops.tree_kernel import aim, linearised, moved, residual, tree_of
from tests.finite_differences import extrapolated
from tests.loops.robots import add, at, closure, ends_of, four_bar, hinge, pose_of

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
    kinematics = StateKinematics(chain)
    kinematics.evaluate(q)
    jacobian = kinematics.jacobian
    for k, unit in enumerate(np.diag(chain.rows.units)):

        def change(h: float, unit: Any = unit) -> Any:
            sides = []
            for sign in (1.0, -1.0):
                kinematics.evaluate(pin.integrate(chain.model, q, sign * h * unit))
                sides.append(kinematics.residual)
            return (sides[0] - sides[1]) / (2.0 * h)

        assert_allclose(jacobian[:, k] * chain.rows.units[k], extrapolated(change, 0.02), atol=1e-10)


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("kind", KINDS)
def test_tree_of_the_kernel_is_that_of_pinocchio(kind: ClosureKind, joint: str) -> None:
    chain = loop_of(kind, JOINTS[joint])
    model, random = chain.model, np.random.default_rng(4)
    q = pin.integrate(model, chain.q0, random.uniform(-1.0, 1.0, model.nv))
    kinematics, every = StateKinematics(chain), np.arange(model.nv)
    tree = tree_of(chain.rows, every, chain.actuated_in_q, chain.actuated_in_v)
    x = random.uniform(-0.3, 0.3, model.nv)
    for place in (q, moved(tree, q, 1.0, x)):
        kinematics.evaluate(place)
        c, jacobian, levers = linearised(tree, place, 0.0)
        assert_allclose(c, kinematics.residual / chain.rows.row_units, atol=1e-14)
        assert_allclose(residual(tree, place, 0.0), c, atol=1e-15)
        assert_allclose(jacobian, kinematics.scaled_jacobian, atol=1e-13)
        assert_allclose(levers, speeds_of_points(chain, place), atol=1e-13)
    # Steps of free and planar joints are alike to second order.
    tolerance = 5e-3 if joint in ("free", "planar") else 1e-14
    assert_allclose(moved(tree, q, 1.0, x), pin.integrate(model, q, x * chain.rows.units), atol=tolerance)


def speeds_of_points(chain: ClosedChain, q: Any) -> Any:
    """Return the speeds of the closures' points on frames 2 (1, nv), by each velocity of the loop, as levers."""
    data = chain.model.createData()
    pin.computeJointJacobians(chain.model, data, q)
    tip = ends_of(chain.model, q, chain.closures[0])[1].translation
    speeds = np.linalg.norm(data.J[:3] + np.cross(data.J[3:], tip, axisa=0, axisc=0), axis=0)
    return speeds * np.abs(chain.rows.signs) * chain.rows.units * chain.rows.lever_scales


def test_pose_moves_in_proportion_to_the_share() -> None:
    chain, random = loop_of("hinge", JOINTS["ball"]), np.random.default_rng(4)
    q = pin.integrate(chain.model, chain.q0, random.uniform(-1.0, 1.0, chain.model.nv))
    follower = Follower(chain, "b2", (0, 2, 3, 4, 5))
    start, end = pose_of(chain.model, q, "b2"), at(*random.uniform(-1.0, 1.0, 3), turned=random.uniform(-2.0, 2.0, 3))
    aim(follower.tree, q, end.homogeneous.ravel())
    for share in (0.0, 0.3, 1.0):
        sides = residual(follower.tree, q, share) * follower.rows.row_units
        way = (start.translation - end.translation) * share
        target = pin.exp3(share * pin.log3(end.rotation @ start.rotation.T)) @ start.rotation
        turned = target.T @ start.rotation
        assert_allclose(sides[5:10], [way[0], way[2], *(0.5 * pin.unSkew(turned - turned.T))], atol=1e-14)
        jacobian = linearised(follower.tree, q, share)[1]
        for column, unit in zip(jacobian.T, np.eye(jacobian.shape[1]), strict=True):

            def change(h: float, share: float = share, unit: Any = unit) -> Any:
                ahead, back = (
                    residual(follower.tree, moved(follower.tree, q, share, s * h * unit), share) for s in (1.0, -1.0)
                )
                return (ahead - back) / (2.0 * h)

            assert_allclose(column, extrapolated(change, 0.02), atol=1e-10)


def test_reversed_axis_is_no_closed_loop() -> None:
    chain = four_bar("hinge")
    turned = Closure("hinge", Anchor("coupler", at(0.35)), Anchor("rocker", at(0.25, turned=(np.pi, 0.0, 0.0))), "tip")
    wrong = ClosedChain(chain.model, [turned], ["crank"], q0=chain.q0)
    assert np.abs(wrong.state(chain.q0).gap()).max() < 1e-12
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
