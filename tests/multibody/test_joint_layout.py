"""From configurations to joint values and back, of machines drawn and as built, and which joint is where in q."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import problems
import pytest
from error_fields import with_fields
from multibody.chains import EPS, PAPER, chain, placed, random_q, six_branches

import spm_pin as spm
from spm_pin.description import actuated_joints, urdf_text
from spm_pin.errors import ArgumentError, DescriptionError, GeometryError
from spm_pin.machine.joint_angles import JOINTS

pinocchio = pytest.importorskip("pinocchio")


from spm_pin.multibody.chain import ClosedChain  # noqa: E402

HOME = np.zeros(18)


@pytest.mark.parametrize("name", ["paper", "millimetres"])
@pytest.mark.parametrize("family", spm.machine.FAMILIES)
def test_round_trip_in_every_family(name: str, family: str) -> None:
    robot = chain(name)
    slides, lower, upper = robot.leg_indices, robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    states = problems.random_branches(robot.machine, family, 50, seed=71).configuration
    q = robot.joint_values(states)
    assert np.abs(robot.state(q).closure_gap()).max() <= 1e-13
    others = np.setdiff1d(np.arange(18), slides)
    assert (lower[others] <= q[:, others]).all()
    assert (q[:, others] <= upper[others]).all()
    found = robot.state(q).configuration()
    # Ten joints lie between {B} and m, each with a rounding of a rotation and of a position.
    rounding = 32 * EPS * (1.0 + robot.leg_lengths(q).max(axis=-1))
    for ours, theirs in (
        (found.pose.as_matrix(), states.pose.as_matrix()),
        (found.middle_joints, states.middle_joints),
        (robot.leg_lengths(q), states.leg_lengths),
        (found.leg_lengths, states.leg_lengths),
        (found.closure_residual, 0.0),
    ):
        assert (np.abs(ours - theirs).reshape(50, -1).max(axis=-1) <= rounding).all()


def test_an_open_q_is_an_open_configuration() -> None:
    robot = chain()
    q = random_q(robot, np.random.default_rng(72))
    state = robot.state(q).configuration()
    assert state.closure_residual > 1e-2
    # Leg b2 ends beside the middle platform's corner, and q has the length of the leg.
    gap = np.linalg.norm(robot.state(q).closure_gap()[0])
    assert 0.0 < abs(state.leg_lengths[1] - robot.leg_lengths(q)[1]) <= gap


def test_names_and_places() -> None:
    robot = chain()
    assert sorted(robot.joint_names) == sorted(JOINTS)
    for place, name in enumerate(robot.joint_names):
        joint = robot.model.joints[robot.model.getJointId(name)]
        assert joint.idx_q == joint.idx_v == place == robot.joint_indices(name)[0]
    assert np.array_equal(robot.leg_indices, robot.joint_indices(*actuated_joints()))
    with pytest.raises(ArgumentError, check=with_fields(argument="names")):
        robot.joint_indices("leg_b1_hip", "leg_b4_hip")
    assert not robot.leg_indices.flags.writeable


def test_leg_lengths() -> None:
    robot = chain()
    assert np.allclose(robot.leg_lengths(HOME), 1.3, rtol=4 * EPS)
    lengths = np.array([1.1, 1.2, 1.3, 1.4, 1.5, 0.0])
    q = robot.with_readings(np.full(18, 0.1), lengths)
    assert np.allclose(robot.leg_lengths(q), lengths, atol=4 * EPS)
    passive = np.setdiff1d(np.arange(18), robot.leg_indices)
    assert (q[passive] == 0.1).all()
    with pytest.raises(ArgumentError, check=with_fields(argument="readings")):
        robot.with_readings(HOME, [1.1, 1.2, 1.3, -0.2, 1.5, -0.1])


def test_configurations_without_joint_values_are_refused() -> None:
    branches = spm.inverse_displacement(PAPER, six_branches()[0].pose)
    state = six_branches()[0]
    assert np.array_equal(np.isnan(chain().joint_values(branches.configurations)).all(axis=-1), ~branches.exists)
    torn = spm.Configuration(PAPER, state.pose, state.middle_joints + 1e-6 * PAPER.middle_side)
    for wrong in (branches.configurations[~branches.exists][0], branches, torn):
        with pytest.raises(ArgumentError, check=with_fields(argument="configuration")):
            chain().joint_values(wrong)
    for name in ("base_radius", "platform_radius", "middle_side"):
        other = replace(PAPER, **{name: 1.001 * getattr(PAPER, name)})
        with pytest.raises(GeometryError, check=with_fields(argument="configuration")) as caught:
            chain().joint_values(spm.Configuration(other, state.pose, state.middle_joints))
        assert name in caught.value.expected


def test_results_of_a_state_do_not_change_with_later_updates() -> None:
    """Pinocchio hands out views of its data; the state does not."""
    robot = chain()
    (_, first), (_, second), *_ = placed("paper", 3, seed=74)
    state = robot.state(first)
    parts = [lambda name=name: getattr(state.configuration(), name) for name in ("rotation", "translation")]
    parts += [lambda: state.configuration().middle_joints, lambda: state.q]
    for call in (state.closure_gap, state.constraint_jacobian, state.inverse_jacobian, *parts):
        kept = call()
        copy = np.array(kept)
        state.update(second)
        assert not np.array_equal(call(), copy)
        assert np.array_equal(kept, copy)
        if kept.flags.writeable:
            kept[...] = 0.0
        state.update(first)
        assert np.array_equal(call(), copy)


def test_arguments_are_not_changed() -> None:
    robot = chain()
    q = random_q(robot, np.random.default_rng(73))
    before = q.copy()
    robot.with_readings(q, np.ones(6))
    robot.state(q).closure_gap()
    closed = robot.joint_values(six_branches()[0]) + 1e-3
    start = closed.copy()
    assert not np.array_equal(robot.project(closed), start)
    assert np.array_equal(closed, start)
    assert np.array_equal(q, before)
    state = robot.state(q)
    q += 1.0
    assert np.array_equal(state.q, before)


@cache
def built() -> tuple[Any, spm.Configuration]:
    machine = problems.as_built(PAPER, 1e-3)
    readings = machine.legs.offsets + np.random.default_rng(4).uniform(1.15, 1.45, (3, 6))
    return ClosedChain.from_urdf(machine=machine), spm.forward_physical(machine, readings)


def test_offsets_change_readings_and_nothing_else() -> None:
    plain, state = built()
    machine = plain.machine
    shift = np.array([0.5, -0.05, 0.02, 0.0, 0.03, 0.01])
    shifted = ClosedChain.from_urdf(
        machine=replace(machine, legs=replace(machine.legs, offsets=machine.legs.offsets + shift))
    )
    q = plain.joint_values(state)
    np.testing.assert_allclose(shifted.readings(q) - plain.readings(q), np.broadcast_to(shift, (3, 6)), atol=1e-15)
    np.testing.assert_array_equal(shifted.leg_lengths(q), plain.leg_lengths(q))
    np.testing.assert_allclose(shifted.forward_kinematics(plain.readings(q) + shift), q, atol=1e-12)
    np.testing.assert_allclose(shifted.with_readings(q, plain.readings(q) + shift), q, atol=1e-15)
    with pytest.raises(ArgumentError, check=with_fields(argument="readings")):
        shifted.forward_kinematics([0.05, 1.3, 1.3, 1.3, 1.3, 1.3], near=q[0])


def test_files_and_geometries_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    machine = problems.as_built(PAPER, 1e-3)
    limited = spm.LegLimits(1.2, 1.5)
    larger = [replace(PAPER, **{name: 1.01 * getattr(PAPER, name)}) for name in ("base_radius", "middle_side")]
    moved = problems.as_built(PAPER, 1e-3, seed=4), machine.from_parameters(machine.parameters + 1e-8)
    others = {
        machine: (None, PAPER, *moved, replace(machine, limits=limited)),
        PAPER: (machine, *larger, replace(PAPER, limits=limited)),
    }
    file = tmp_path / "robot.urdf"
    for written, machines in others.items():
        file.write_text(urdf_text(written), encoding="utf-8")
        for machine in machines:
            with pytest.raises(DescriptionError, check=with_fields(argument=str(file))):
                ClosedChain.from_urdf(file, machine)


def test_states_of_other_machines_are_refused() -> None:
    (robot, state), nominal = built(), six_branches()[0]
    for own, wrong in ((robot, nominal), (chain(), state)):
        with pytest.raises(GeometryError, check=with_fields(argument="configuration")) as caught:
            own.joint_values(wrong)
        assert "r_b1.direction_1" in caught.value.expected
    other = problems.as_built(PAPER, 1e-3)
    moved = replace(other, legs=replace(other.legs, offsets=other.legs.offsets + 2e-6 * (np.arange(6) == 4)))
    with pytest.raises(GeometryError, check=with_fields(argument="configuration")) as caught:
        robot.joint_values(spm.Configuration(moved, state.pose, state.middle_joints))
    assert "r_c2.offset" in caught.value.expected
    # Limits of the legs play no part.
    same = spm.Configuration(replace(other, limits=None), state.pose, state.middle_joints)
    np.testing.assert_array_equal(robot.joint_values(same), robot.joint_values(state))
