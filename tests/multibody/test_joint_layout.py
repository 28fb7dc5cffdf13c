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
from multibody.chains import EPS, PAPER, chain, placed, random_q, rounding, six_branches

import spm_pin as spm
from spm_pin.description import actuated_joints, urdf_text
from spm_pin.errors import ArgumentError, DescriptionError, GeometryError
from spm_pin.machine.joint_angles import JOINTS

pinocchio = pytest.importorskip("pinocchio")


from spm_pin.multibody.chain import ClosedChain  # noqa: E402

HOME = np.zeros(18)


@pytest.mark.parametrize("name", problems.MANIPULATORS)
def test_round_trip_in_every_family(name: str) -> None:
    robot = chain(name)
    slides, lower, upper = robot.leg_indices, robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    for family in spm.machine.FAMILIES:
        for state in problems.random_branches(robot.machine, family, 50, seed=71).configuration:
            q = robot.joint_values(state)
            assert np.abs(robot.state(q).closure_gap()).max() <= 1e-13
            assert (np.delete(lower, slides) <= np.delete(q, slides)).all()
            assert (np.delete(q, slides) <= np.delete(upper, slides)).all()
            found = robot.state(q).configuration()
            # Ten joints lie between {B} and m, each with a rounding of a rotation and of a position.
            rounding = 32 * EPS * (1.0 + robot.leg_lengths(q).max())
            assert np.abs(found.pose.as_matrix() - state.pose.as_matrix()).max() <= rounding
            assert np.abs(found.middle_joints - state.middle_joints).max() <= rounding
            assert np.abs(robot.leg_lengths(q) - state.leg_lengths).max() <= rounding
            assert np.abs(found.leg_lengths - state.leg_lengths).max() <= rounding
            assert found.closure_residual <= rounding


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
    with pytest.raises(ArgumentError, match=r"legs of no negative length, got -0\.2 m in r_c1"):
        robot.with_readings(HOME, [1.1, 1.2, 1.3, -0.2, 1.5, -0.1])


def test_configurations_without_joint_values_are_refused() -> None:
    branches = spm.inverse_displacement(PAPER, six_branches()[0].pose)
    state = six_branches()[0]
    assert np.array_equal(np.isnan(chain().joint_values(branches.configurations)).all(axis=-1), ~branches.exists)
    with pytest.raises(ArgumentError, match="expected a configuration that exists, got NaN"):
        chain().joint_values(branches.configurations[~branches.exists][0])
    with pytest.raises(ArgumentError, match=r"a StageConfiguration, got SolutionSet\. .*\.physical\(\)"):
        chain().joint_values(branches)
    torn = spm.Configuration(PAPER, state.pose, state.middle_joints + 1e-6 * PAPER.middle_side)
    rounded = spm.Configuration(PAPER, state.pose, state.middle_joints.round(4))
    for wrong, gap in ((rounded, r"\d\.\de-05"), (torn, r"\d\.\de-06")):
        with pytest.raises(ArgumentError, match=f"expected a closed mechanism, got a closure residual of {gap} m"):
            chain().joint_values(wrong)
    for name in ("base_radius", "platform_radius", "middle_side"):
        other = replace(PAPER, **{name: 1.001 * getattr(PAPER, name)})
        with pytest.raises(GeometryError, match=f"expected the {name} of the chain, "):
            chain().joint_values(spm.Configuration(other, state.pose, state.middle_joints))


def test_legs_of_negative_length_are_refused() -> None:
    """All other wrong vectors are those of `test_wrong_arguments`."""
    robot = chain()
    for call in (robot.leg_lengths, robot.project, robot.state):
        with pytest.raises(ArgumentError, check=with_fields(argument="q")):
            call(np.full(18, -2.0))


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
def built(name: str, size: float) -> Any:
    return ClosedChain.from_urdf(machine=problems.as_built(problems.MANIPULATORS[name], size)) if size else chain(name)


def states(robot: Any, count: int, seed: int) -> spm.Configuration:
    """Physical states of a machine, about where its nominal one has its random branches without torsion."""
    nominal = robot.machine.nominal
    start = problems.random_branches(nominal, "TT", 40 * count, seed).configuration
    if nominal.limits is not None:
        start = problems.in_leg_space(nominal, 4 * count, seed).configuration
    # Away from inverse singularities and from legs of no length: readings of machines near them are no test.
    far = (np.abs(spm.singularities(start).sigma[:, 2]) > 1e-2) & (
        start.leg_lengths.min(axis=-1) > 0.1 * nominal.middle_side
    )
    found = spm.forward_physical(robot.machine, start.leg_lengths[far] + robot.machine.legs.offsets)
    found = found[found.exists][:count]
    assert len(found) >= count // 2
    return found


@pytest.mark.parametrize("size", [0.0, 1e-3, 5e-2])
@pytest.mark.parametrize("name", problems.MANIPULATORS)
def test_states_have_joint_values_to_which_their_readings_and_poses_lead(name: str, size: float) -> None:
    robot = built(name, size)
    state, side = states(robot, 20, seed=4), robot.machine.nominal.middle_side
    q = robot.joint_values(state)
    assert np.abs(robot.state(q).closure_gap()).max() <= rounding(robot, q)
    np.testing.assert_allclose(robot.leg_lengths(q), state.leg_lengths, atol=1e-14 * side)
    np.testing.assert_allclose(robot.readings(q), state.readings, atol=1e-14 * side)
    back = robot.state(q).configuration()
    assert back.machine == robot.machine
    np.testing.assert_allclose(back.pose.as_matrix(), state.pose.as_matrix(), atol=1e-13 * max(side, 1.0))
    np.testing.assert_allclose(back.middle_joints, state.middle_joints, atol=1e-13 * side)
    np.testing.assert_allclose(back.leg_lengths, state.leg_lengths, atol=1e-13 * side)
    found = robot.forward_kinematics(state.readings)
    assert np.abs(robot.state(found).closure_gap()).max() <= rounding(robot, found)
    np.testing.assert_allclose(found, q, atol=1e-9)
    np.testing.assert_allclose(robot.leg_lengths(found), state.leg_lengths, atol=1e-13 * side)
    # Readings a little away, from the joint values nearby, and back by the pose that they give.
    change = 1e-3 * side * np.random.default_rng(5).uniform(-1.0, 1.0, 6)
    for k in range(5):
        moved = robot.forward_kinematics(state.readings[k] + change, near=q[k])
        np.testing.assert_allclose(robot.readings(moved), state.readings[k] + change, atol=1e-13 * side)
        assert np.abs(robot.state(moved).closure_gap()).max() <= 2.0 * rounding(robot, moved)
        np.testing.assert_allclose(moved, robot.forward_kinematics(state.readings[k] + change), atol=1e-9)
        back_there = robot.inverse_kinematics(state[k].pose, near=moved)
        np.testing.assert_allclose(back_there, q[k], atol=1e-9)
        changed = robot.with_readings(q[k], state.readings[k] + 1e-2 * change)
        np.testing.assert_allclose(robot.leg_lengths(changed), state.leg_lengths[k] + 1e-2 * change, atol=1e-13 * side)


def test_offsets_change_readings_and_nothing_else() -> None:
    plain = built("paper", 1e-3)
    machine = plain.machine
    shift = np.array([0.5, -0.05, 0.02, 0.0, 0.03, 0.01])
    shifted = ClosedChain.from_urdf(
        machine=replace(machine, legs=replace(machine.legs, offsets=machine.legs.offsets + shift))
    )
    q = plain.joint_values(states(plain, 3, seed=16))
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
    file, message = tmp_path / "robot.urdf", "The arguments machine and prefix are those the file was written for"
    for written, machines in others.items():
        file.write_text(urdf_text(written), encoding="utf-8")
        for machine in machines:
            with pytest.raises(DescriptionError, match=message):
                ClosedChain.from_urdf(file, machine)


def test_states_of_other_machines_are_refused() -> None:
    robot = built("paper", 1e-3)
    state = states(robot, 2, seed=18)
    nominal = chain().state(chain().joint_values(states(chain(), 1, seed=18))).configuration()
    with pytest.raises(GeometryError, match=r"the r_b1.direction_1 of the chain, .* rad, got 0 rad"):
        robot.joint_values(nominal)
    with pytest.raises(GeometryError, match=r"the r_b1.direction_1 of the chain, 0 rad, got .* rad"):
        chain().joint_values(state)
    other = problems.as_built(PAPER, 1e-3)
    moved = replace(other, legs=replace(other.legs, offsets=other.legs.offsets + 2e-6 * (np.arange(6) == 4)))
    with pytest.raises(GeometryError, match=r"the r_c2.offset of the chain, .* m, got .* m"):
        robot.joint_values(spm.Configuration(moved, state.pose, state.middle_joints))
    # Limits of the legs play no part.
    same = spm.Configuration(replace(other, limits=None), state.pose, state.middle_joints)
    np.testing.assert_array_equal(robot.joint_values(same), robot.joint_values(state))
