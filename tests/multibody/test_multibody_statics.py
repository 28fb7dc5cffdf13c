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
