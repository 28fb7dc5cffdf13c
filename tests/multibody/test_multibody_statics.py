"""Forces of the closed tree: four ways to the same numbers, and the equilibrium of the tree."""

from __future__ import annotations

from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import (
    EPS,
    NAMES,
    Array,
    chain,
    closure_jacobian,
    frame_jacobian,
    placed,
    six_branches,
    wrench_conditions,
)

import spm_pin as spm
from spm_pin.description.source_files import URDF, description_file
from spm_pin.paper import jacobian as paper

pinocchio = pytest.importorskip("pinocchio")

WRENCHES = [*np.eye(6), np.concatenate(paper.load())]


def weightless() -> Any:
    model = pinocchio.buildModelFromUrdf(str(description_file(URDF)))
    model.gravity = pinocchio.Motion.Zero()
    return model


def external_forces(model: Any, q: Array, wrench: Array, cuts: Array) -> Any:
    """The wrench on m and the cut forces on both sides, per joint and in its frame."""
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    total = {i: pinocchio.Force.Zero() for i in range(model.njoints)}

    def push(frame: str, force: Array, moment: Array) -> None:
        index = model.getFrameId(frame)
        at = data.oMf[index].translation
        in_world = pinocchio.Force(force, moment + np.cross(at, force))
        joint = model.frames[index].parentJoint
        total[joint] = total[joint] + data.oMi[joint].actInv(in_world)

    push("terminal_platform", wrench[:3], wrench[3:])
    for closure, force in zip(chain().closures, cuts, strict=True):
        push(closure.frame_b, force, np.zeros(3))
        push(closure.frame_a, -force, np.zeros(3))
    forces = pinocchio.StdVec_Force()
    for i in range(model.njoints):
        forces.append(total[i])
    return forces


def rounding(robot: Any, q: Array, wrench: Array) -> float:
    """Return the error of forces from a solve with [S; Jc]: eps / σ², times the load at the distance of o."""
    d = robot.geometry.middle_side
    load = np.linalg.norm(wrench / np.array([1, 1, 1, d, d, d]))
    reach = 1.0 + robot.leg_lengths(q).sum() / d
    return float(64 * EPS * reach * load / robot.singular_values(q).forward ** 2)


@pytest.mark.parametrize("branch", range(6))
def test_the_closed_form_and_rnea_at_the_six_branches(branch: int) -> None:
    robot, state = chain(), six_branches()[branch]
    q, model = robot.joint_values(state), weightless()
    data, rest = model.createData(), np.zeros(18)
    for wrench in WRENCHES:
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        expected = spm.leg_forces(state, wrench)
        assert np.linalg.norm(legs - expected) <= 1e-11 * (np.linalg.norm(expected) + np.linalg.norm(wrench))
        # With all these forces acting, only the actuators are needed to stand still.
        torques = pinocchio.rnea(model, data, q, rest, rest, external_forces(model, q, wrench, cuts))
        torques[robot.leg_indices] -= legs
        size = np.linalg.norm(legs) + np.linalg.norm(cuts) + np.linalg.norm(wrench)
        reach = 1.0 + robot.leg_lengths(q).sum()
        assert np.abs(torques).max() <= 64 * EPS * reach * size + rounding(robot, q, wrench)


@pytest.mark.parametrize("branch", range(6))
def test_equilibrium_has_no_acceleration(branch: int) -> None:
    robot, model = chain(), weightless()
    q = robot.joint_values(six_branches()[branch])
    constraints = pinocchio.StdVec_RigidConstraintModel()
    for closure in robot.closures:
        a, b = (model.frames[model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b))
        ends = (a.parentJoint, a.placement, b.parentJoint, b.placement, pinocchio.LOCAL)
        constraints.append(pinocchio.RigidConstraintModel(pinocchio.ContactType.CONTACT_3D, model, *ends))
    state = pinocchio.StdVec_RigidConstraintData()
    for constraint in constraints:
        state.append(constraint.createData())
    data, rest = model.createData(), np.zeros(18)
    pinocchio.initConstraintDynamics(model, data, constraints, state)
    platform = frame_jacobian(robot, q, "terminal_platform")
    half = pinocchio.crba(model, model.createData(), q)
    mobility = np.linalg.norm(np.linalg.inv(np.triu(half) + np.triu(half, 1).T), 2)
    for wrench in WRENCHES:
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        load = platform.T @ wrench
        held = load.copy()
        held[robot.leg_indices] += legs
        settings = pinocchio.ProximalSettings(1e-14, 0.0, 1)
        let_go, still = (
            np.linalg.norm(pinocchio.constraintDynamics(model, data, q, rest, torque, constraints, state, settings))
            for torque in (load, held)
        )
        # What rounding leaves of the forces accelerates the lightest body of the tree, as far as the closures allow.
        size = np.linalg.norm(legs) + np.linalg.norm(cuts) + np.linalg.norm(wrench)
        assert still <= 8 * EPS * mobility * size / robot.singular_values(q).constraint
        assert still <= 1e-6 * let_go


@pytest.mark.parametrize("name", NAMES)
def test_the_closed_form_in_every_family(name: str) -> None:
    check_forces(name, 125, seed=111)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_closed_form_a_hundred_thousand_times(name: str) -> None:
    check_forces(name, 7000, seed=112)


def check_forces(name: str, count: int, seed: int) -> None:
    robot, rng = chain(name), np.random.default_rng(seed)
    d = robot.geometry.middle_side
    for state, q in placed(name, count, seed):
        wrench = rng.normal(size=6) * [1, 1, 1, d, d, d]
        error = np.linalg.norm(robot.leg_forces(q, wrench) - spm.leg_forces(state, wrench))
        load = np.linalg.norm(wrench / [1, 1, 1, d, d, d])
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        smallest = min(robot.singular_values(q).forward, wrench_conditions(state)[0])
        assert error <= 32 * EPS * reach * load / smallest**2


@pytest.mark.parametrize("name", NAMES)
def test_the_tree_is_in_equilibrium(name: str) -> None:
    """Legs, cut balls and the load leave no generalized force, and the Jacobian's transpose is how they act."""
    robot, rng = chain(name), np.random.default_rng(113)
    for _, q in placed(name, 10, seed=114):
        wrench = rng.normal(size=6)
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        total = frame_jacobian(robot, q, "terminal_platform").T @ wrench + closure_jacobian(robot, q).T @ cuts.ravel()
        total[robot.leg_indices] += legs
        assert np.abs(total).max() <= rounding(robot, q, wrench) * (1.0 + robot.leg_lengths(q).sum())
        again = robot.constraint_jacobian(q).T @ cuts.ravel()
        assert np.allclose(again, closure_jacobian(robot, q).T @ cuts.ravel(), atol=rounding(robot, q, wrench))


@pytest.mark.parametrize("name", NAMES)
def test_virtual_powers_balance(name: str) -> None:
    robot, rng = chain(name), np.random.default_rng(115)
    d = robot.geometry.middle_side
    for _, q in placed(name, 20, seed=116):
        twist, wrench = rng.normal(size=6) * [d, d, d, 1, 1, 1], rng.normal(size=6) * [1, 1, 1, d, d, d]
        rates, forces = robot.inverse_jacobian(q) @ twist, robot.leg_forces(q, wrench)
        reach = 1.0 + robot.leg_lengths(q).sum() / d
        values = robot.singular_values(q)
        in_rates = 32 * EPS * reach * np.linalg.norm(twist / [d, d, d, 1, 1, 1]) * d / values.inverse**2
        allowed = np.linalg.norm(forces) * in_rates + np.linalg.norm(rates) * rounding(robot, q, wrench)
        assert abs(forces @ rates + wrench @ twist) <= allowed


def test_cut_forces_act_onto_the_tips() -> None:
    """Along its leg, what the ball gives the tip is what the actuator takes: it pushes the tip outwards.

    Across the leg the ball gives what the hip takes, along its axis alone.
    """
    robot = chain()
    wrench = np.concatenate(paper.load())
    for state in six_branches():
        q = robot.joint_values(state)
        legs, cuts = robot.leg_forces(q, wrench), robot.cut_forces(q, wrench)
        directions = state.leg_vectors / state.leg_lengths[:, None]
        axes = np.concatenate([state.geometry.revolute_axes, state.platform_axes])
        names = [closure.name for closure in robot.closures]
        allowed = rounding(robot, q, wrench)
        for leg, name in enumerate(("b1", "b2", "b3", "c1", "c2", "c3")):
            if f"closure_{name}" in names:
                # Outwards from the hip: b - a, and b - c.
                outwards = directions[leg] if leg < 3 else -directions[leg]
                assert cuts[names.index(f"closure_{name}")] @ outwards == pytest.approx(-legs[leg], abs=allowed)
                axis = axes[leg]
                left = cuts[names.index(f"closure_{name}")] + legs[leg] * outwards
                assert np.linalg.norm(left - (left @ axis) * axis) <= allowed


def test_positive_forces_push() -> None:
    robot = chain()
    legs = 1.3 + 0.02 * np.random.default_rng(117).uniform(-1, 1, size=(20, 6))
    for state in problems.in_leg_space(robot.geometry, 20, seed=0, legs=legs).configuration:
        assert (robot.leg_forces(robot.joint_values(state), [0, 0, -100.0, 0, 0, 0]) > 0).all()
