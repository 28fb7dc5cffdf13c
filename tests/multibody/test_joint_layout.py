"""From configurations to joint values and back, and which joint is where in q."""

from __future__ import annotations

import numpy as np
import problems
import pytest
from multibody.chains import EPS, PAPER, chain, placed, random_q, six_branches

import spm_pin as spm
from spm_pin.description.tree import SLIDES
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.mechanism.joint_angles import JOINTS

pinocchio = pytest.importorskip("pinocchio")

HOME = np.zeros(18)


@pytest.mark.parametrize("name", problems.GEOMETRIES)
def test_round_trip_in_every_family(name: str) -> None:
    robot = chain(name)
    for family in spm.mechanism.FAMILIES:
        for state in problems.random_branches(robot.geometry, family, 50, seed=71).configuration:
            q = robot.joint_values(state)
            assert np.abs(robot.closure_gap(q)).max() <= 1e-13
            found = robot.configuration(q)
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
    state = robot.configuration(q)
    assert state.closure_residual > 1e-2
    # Leg b2 ends beside the middle platform's corner, and q has the length of the leg.
    gap = np.linalg.norm(robot.closure_gap(q)[0])
    assert 0.0 < abs(state.leg_lengths[1] - robot.leg_lengths(q)[1]) <= gap


def test_names_and_places() -> None:
    robot = chain()
    assert sorted(robot.joint_names) == sorted(JOINTS)
    for place, name in enumerate(robot.joint_names):
        joint = robot.model.joints[robot.model.getJointId(name)]
        assert joint.idx_q == joint.idx_v == place == robot.joint_indices(name)[0]
    assert np.array_equal(robot.leg_indices, robot.joint_indices(*SLIDES))
    with pytest.raises(ArgumentError, match=r"names: expected joints: leg_b1_hip, .*, got 'leg_b4_hip'"):
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
    with pytest.raises(ArgumentError, match=r"expected a Configuration, got SolutionSet\. .*\.physical\(\)"):
        chain().joint_values(branches)
    rounded = spm.Configuration(PAPER, state.pose, state.middle_joints.round(4))
    with pytest.raises(ArgumentError, match=r"expected a closed mechanism, got a closure residual of \d\.\de-05 m"):
        chain().joint_values(rounded)
    for name in ("base_radius", "platform_radius", "middle_side"):
        dimensions = {key: getattr(PAPER, key) for key in ("base_radius", "platform_radius", "middle_side")}
        other = spm.Geometry(**{**dimensions, name: 1.001 * dimensions[name]})
        with pytest.raises(GeometryError, match=f"expected the {name} of the chain, "):
            chain().joint_values(spm.Configuration(other, state.pose, state.middle_joints))


def test_legs_of_negative_length_are_refused() -> None:
    """All other wrong vectors are those of `test_wrong_arguments`."""
    robot = chain()
    for call in (robot.configuration, robot.leg_lengths, robot.project, robot.inverse_jacobian, robot.state):
        with pytest.raises(ArgumentError, match=r"^q: expected legs of no negative length, got -0\.7 m"):
            call(np.full(18, -2.0))


def test_results_of_a_state_do_not_change_with_later_updates() -> None:
    """Pinocchio hands out views of its data; the state does not."""
    robot = chain()
    (_, first), (_, second), *_ = placed("paper", 3, seed=74)
    state = robot.state(first)
    calls = (
        state.closure_gap,
        state.constraint_jacobian,
        state.inverse_jacobian,
        lambda: state.configuration().rotation,
        lambda: state.configuration().translation,
        lambda: state.configuration().middle_joints,
        lambda: state.q,
    )
    for call in calls:
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
    robot.closure_gap(q)
    closed = robot.joint_values(six_branches()[0]) + 1e-3
    start = closed.copy()
    assert not np.array_equal(robot.project(closed), start)
    assert np.array_equal(closed, start)
    assert np.array_equal(q, before)
    state = robot.state(q)
    q += 1.0
    assert np.array_equal(state.q, before)
