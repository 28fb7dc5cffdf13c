"""The chain of a machine as built: loops, readings, files and states; `chains.NAMES` has one for other tests."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import problems
import pytest
from multibody.chains import EPS, PAPER, Array, chain
from multibody.engine_dynamics import Drake, Mujoco, accelerations

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.errors import ArgumentError, ClosureError, DescriptionError, GeometryError

pinocchio = pytest.importorskip("pinocchio")

from spm_pin.multibody.chain import ClosedChain  # noqa: E402

NAMES = list(problems.GEOMETRIES)
SIZES = (1e-6, 1e-3, 5e-2)
NEARLY = PAPER.from_parameters(PAPER.parameters + 1e-15)
"""A machine as built whose errors are rounding."""


@cache
def built(name: str = "paper", size: float = 1e-2) -> Any:
    return ClosedChain.from_urdf(geometry=problems.as_built(problems.GEOMETRIES[name], size))


def states(robot: Any, count: int, seed: int) -> spm.Configuration:
    """Physical states of a machine, about where its nominal one has its random branches without torsion."""
    nominal = robot.geometry.nominal
    start = problems.random_branches(nominal, "TT", 40 * count, seed).configuration
    if nominal.limits is not None:
        start = problems.in_leg_space(nominal, 4 * count, seed).configuration
    # Away from inverse singularities and from legs of no length: readings of machines near them are no test.
    far = (np.abs(spm.singularities(start).sigma[:, 2]) > 1e-2) & (
        start.leg_lengths.min(axis=-1) > 0.1 * nominal.middle_side
    )
    found = spm.forward_physical(robot.geometry, start.leg_lengths[far] + robot.geometry.legs.offsets)
    found = found[found.exists][:count]
    assert len(found) >= count // 2
    return found


def rounding(robot: Any, q: Array) -> float:
    """Closure gap that rounding explains: some eps times the length of a loop."""
    lengths = np.abs(robot.leg_lengths(q)).sum(axis=-1).max()
    return float(64.0 * EPS * (sum(robot.geometry.nominal.dimensions) + lengths))


def moving(robot: Any, count: int, seed: int) -> list[tuple[Array, Array]]:
    """Closed joint values with admissible velocities."""
    rng, d = np.random.default_rng(seed), robot.geometry.nominal.middle_side
    q = robot.joint_values(states(robot, count, seed))
    return [(each, robot.joint_velocities(each, rng.normal(size=6) * [d, d, d, 1, 1, 1])) for each in q]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", NAMES)
def test_loops_are_closed_at_the_joint_values_of_states(name: str, size: float) -> None:
    robot = built(name, size)
    state, side = states(robot, 30, seed=1), robot.geometry.nominal.middle_side
    q = robot.joint_values(state)
    assert np.abs(robot.closure_gap(q)).max() <= rounding(robot, q)
    np.testing.assert_allclose(robot.leg_lengths(q), state.leg_lengths, atol=1e-14 * side)
    np.testing.assert_allclose(robot.readings(q), state.readings, atol=1e-14 * side)
    back = robot.configuration(q)
    assert back.geometry == robot.geometry
    np.testing.assert_allclose(back.pose.as_matrix(), state.pose.as_matrix(), atol=1e-13 * max(side, 1.0))
    np.testing.assert_allclose(back.middle_joints, state.middle_joints, atol=1e-13 * side)
    np.testing.assert_allclose(back.leg_lengths, state.leg_lengths, atol=1e-13 * side)
    # A batch has the values of its members, an open state those of an open tree.
    for k in range(3):
        np.testing.assert_allclose(robot.joint_values(state[k]), q[k], atol=1e-14)
    torn = spm.Configuration(robot.geometry, state.pose, state.middle_joints + 1e-6 * side)
    with pytest.raises(ArgumentError, match="a closed mechanism"):
        robot.joint_values(torn)


def test_without_errors_the_numbers_are_those_of_the_nominal_chain() -> None:
    nominal, robot = chain(), ClosedChain.from_urdf(geometry=NEARLY)
    rng, state = np.random.default_rng(2), states(chain(), 10, seed=3)
    q = nominal.joint_values(state)
    np.testing.assert_allclose(robot.joint_values(state), q, atol=1e-14)
    np.testing.assert_allclose(robot.joint_values(states(robot, 10, seed=3)), q, atol=1e-13)
    assert robot.joint_names == nominal.joint_names
    np.testing.assert_allclose(robot.forward_kinematics(state.readings), q, atol=1e-12)
    np.testing.assert_allclose(robot.inverse_kinematics(state.pose), q, atol=1e-9)
    np.testing.assert_allclose(robot.closure_gap(q + 0.1), nominal.closure_gap(q + 0.1), atol=1e-14)
    np.testing.assert_allclose(robot.constraint_jacobian(q), nominal.constraint_jacobian(q), atol=1e-14)
    np.testing.assert_allclose(robot.inverse_jacobian(q), nominal.inverse_jacobian(q), rtol=1e-9, atol=1e-9)
    wrench, twist, f = rng.normal(size=(3, 6))
    for method, argument in (("leg_forces", wrench), ("cut_forces", wrench), ("joint_rates", f)):
        found, expected = (getattr(each, method)(q, argument) for each in (robot, nominal))
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    v = nominal.joint_velocities(q, twist)
    a = nominal.forward_dynamics(q, v, f, wrench)
    scale = np.abs(a).max()
    np.testing.assert_allclose(robot.forward_dynamics(q, v, f, wrench), a, atol=1e-9 * scale)
    again = robot.inverse_dynamics(q, v, a, wrench)
    np.testing.assert_allclose(again, np.broadcast_to(f, again.shape), atol=1e-9 * scale)
    np.testing.assert_allclose(robot.energy(q, v).total, nominal.energy(q, v).total, rtol=1e-12)
    stiffness = spm.stiffness(state, 1e7)
    frequencies = [each.natural_frequencies(q, stiffness).frequencies for each in (robot, nominal)]
    np.testing.assert_allclose(frequencies[0], frequencies[1], rtol=1e-9)
    values, expected = robot.singular_values(q), nominal.singular_values(q)
    np.testing.assert_allclose(np.array(values), np.array(expected), rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", NAMES)
def test_readings_and_poses_lead_to_the_state_that_has_them(name: str, size: float) -> None:
    robot = built(name, size)
    state, side = states(robot, 20, seed=4), robot.geometry.nominal.middle_side
    q = robot.joint_values(state)
    found = robot.forward_kinematics(state.readings)
    assert np.abs(robot.closure_gap(found)).max() <= rounding(robot, found)
    np.testing.assert_allclose(found, q, atol=1e-9)
    np.testing.assert_allclose(robot.leg_lengths(found), state.leg_lengths, atol=1e-13 * side)
    # Readings a little away, from the joint values nearby, and back by the pose that they give.
    change = 1e-3 * side * np.random.default_rng(5).uniform(-1.0, 1.0, 6)
    for k in range(5):
        moved = robot.forward_kinematics(state.readings[k] + change, near=q[k])
        np.testing.assert_allclose(robot.readings(moved), state.readings[k] + change, atol=1e-13 * side)
        assert np.abs(robot.closure_gap(moved)).max() <= rounding(robot, moved)
        np.testing.assert_allclose(moved, robot.forward_kinematics(state.readings[k] + change), atol=1e-9)
        back = robot.inverse_kinematics(state[k].pose, near=moved)
        np.testing.assert_allclose(back, q[k], atol=1e-9)
        projected = robot.project(q[k] + 1e-4 * np.sin(np.arange(18.0)))
        assert np.abs(robot.closure_gap(projected)).max() <= rounding(robot, projected)
        held = robot.project(robot.with_readings(q[k], state.readings[k] + 1e-2 * change), hold_legs=True)
        np.testing.assert_allclose(robot.leg_lengths(held), state.leg_lengths[k] + 1e-2 * change, atol=1e-13 * side)


def test_poses_lead_to_the_physical_branch() -> None:
    robot = built("paper", 1e-3)
    state = spm.inverse_physical(robot.geometry, states(robot, 30, seed=6).pose)
    state = state[state.exists]
    q = robot.inverse_kinematics(state.pose)
    np.testing.assert_allclose(robot.configuration(q).middle_joints, state.middle_joints, atol=1e-13)
    np.testing.assert_allclose(robot.leg_lengths(q), state.leg_lengths, atol=1e-13)
    nominal = chain().inverse_kinematics(state.pose[0])
    assert np.abs(nominal - q[0]).max() > 1e-4


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", NAMES)
def test_rates_are_derivatives_of_the_readings_and_those_of_the_closed_form(name: str, size: float) -> None:
    robot = built(name, size)
    state, d = states(robot, 6, seed=7), robot.geometry.nominal.middle_side
    q, h = robot.joint_values(state), 1e-6
    unit = np.array([d, d, d, 1.0, 1.0, 1.0])
    jacobian = robot.inverse_jacobian(q) * unit
    np.testing.assert_allclose(
        jacobian, spm.inverse_jacobian(state) * unit, rtol=1e-8, atol=1e-8 * np.abs(jacobian).max()
    )
    for k in range(len(q)):
        for rates in d * np.eye(6):
            v = robot.joint_rates(q[k], rates)
            readings = robot.readings(q[k])
            ends = [robot.forward_kinematics(readings + s * h * rates, near=q[k]) for s in (1, -1)]
            np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), v, rtol=1e-5, atol=1e-5 * np.abs(v).max())
            # What the joints do to the platform, by poses of the two ends.
            places = [robot.configuration(end) for end in ends]
            linear = (places[0].translation - places[1].translation) / (2 * h)
            turn = pinocchio.log3(places[0].rotation @ places[1].rotation.T) / (2 * h)
            twist = np.concatenate([linear, turn])
            np.testing.assert_allclose(
                robot.inverse_jacobian(q[k]) @ twist, rates, atol=1e-4 * np.abs(jacobian[k]).max()
            )


@pytest.mark.parametrize("engine", [Mujoco, Drake])
def test_other_engines_accelerate_alike(engine: Any, tmp_path: Path) -> None:
    pytest.importorskip("mujoco" if engine is Mujoco else "pydrake")
    robot, rng = built("paper", 2e-2), np.random.default_rng(12)
    file = tmp_path / "machine.urdf"
    file.write_text(urdf_text(robot.geometry), encoding="utf-8")
    other = engine(robot, urdf=file)
    for q, v in moving(robot, 5, seed=13):
        f = 500.0 * rng.normal(size=6)
        ours, theirs = robot.forward_dynamics(q, v, f), accelerations(other, robot.leg_indices, q, v, f)
        assert np.abs(ours - theirs).max() <= 1e-10 * np.abs(theirs).max() / robot.singular_values(q).constraint


def test_all_joints_of_a_platform_path() -> None:
    robot = built("paper", 1e-2)
    ends = spm.forward_physical(robot.geometry, [[1.2, 1.2, 1.4, 1.25, 1.2, 1.45], [1.22, 1.22, 1.42, 1.3, 1.2, 1.4]])
    path, times = spm.PlatformPath([0.0, 1.0], ends.pose), np.linspace(0.0, 1.0, 6)
    start = robot.joint_values(ends[0])
    motion, wanted = robot.joint_trajectory(path, times, start), path(times)
    found = robot.configuration(motion.positions)
    np.testing.assert_allclose(found.pose.as_matrix(), wanted.pose.as_matrix(), atol=1e-13)
    np.testing.assert_allclose(robot.leg_lengths(motion.positions[[0, -1]]), ends.leg_lengths, atol=1e-11)
    rates = (robot.inverse_jacobian(motion.positions) @ wanted.twist[..., None])[..., 0]
    np.testing.assert_allclose(motion.velocities[:, robot.leg_indices], rates, rtol=1e-9, atol=1e-12)
    forces = robot.inverse_dynamics(motion.positions, motion.velocities, motion.accelerations)
    np.testing.assert_allclose(motion.efforts[:, robot.leg_indices], forces, rtol=1e-9)


@pytest.mark.parametrize("size", [1e-3, 5e-2])
def test_a_passive_motion_keeps_its_energy_and_its_loops(size: float) -> None:
    robot = built("paper", size)
    q = robot.forward_kinematics(np.array([1.25, 1.2, 1.35, 1.3, 1.25, 1.3]) + robot.geometry.legs.offsets)
    v = robot.joint_rates(q, [0.2, -0.1, 0.1, 0.05, -0.2, 0.1])
    run = robot.simulate(q, v, None, np.linspace(0.0, 0.5, 11))
    assert run.complete
    assert np.abs(np.diff(run.leg_lengths, axis=0)).max() > 0.01
    assert np.abs(run.energy_error).max() <= 1e-10 * np.ptp(run.kinetic)
    assert run.closure_gap.max() <= 1e-13
    np.testing.assert_array_equal(run.leg_lengths, robot.leg_lengths(run.q))
    # The state at the end is one of this machine.
    end = robot.configuration(run.q[-1])
    np.testing.assert_allclose(end.leg_lengths, run.leg_lengths[-1], atol=1e-13)
    assert float(end.closure_residual) <= 1e-13


def test_offsets_change_readings_and_nothing_else() -> None:
    plain = built("paper", 1e-3)
    geometry = plain.geometry
    shift = np.array([0.5, -0.05, 0.02, 0.0, 0.03, 0.01])
    shifted = ClosedChain.from_urdf(
        geometry=replace(geometry, legs=replace(geometry.legs, offsets=geometry.legs.offsets + shift))
    )
    q = plain.joint_values(states(plain, 3, seed=16))
    np.testing.assert_allclose(shifted.readings(q) - plain.readings(q), np.broadcast_to(shift, (3, 6)), atol=1e-15)
    np.testing.assert_array_equal(shifted.leg_lengths(q), plain.leg_lengths(q))
    np.testing.assert_allclose(shifted.forward_kinematics(plain.readings(q) + shift), q, atol=1e-12)
    np.testing.assert_allclose(shifted.with_readings(q, plain.readings(q) + shift), q, atol=1e-15)
    with pytest.raises(ArgumentError, match=r"readings: expected legs of no negative length, got -0\.4\d+ m in r_b1"):
        shifted.forward_kinematics([0.05, 1.3, 1.3, 1.3, 1.3, 1.3], near=q[0])


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_a_file_of_the_machine_gives_the_same_chain(prefix: str, tmp_path: Path) -> None:
    geometry = problems.as_built(problems.GEOMETRIES["wide base"], 1e-2)
    path = tmp_path / "machine.urdf"
    path.write_text(urdf_text(geometry, prefix=prefix), encoding="utf-8")
    expected = ClosedChain.from_urdf(geometry=geometry, prefix=prefix)
    robot = ClosedChain.from_urdf(path, geometry, prefix=prefix)
    state = states(expected, 4, seed=17)
    q = expected.joint_values(state)
    np.testing.assert_array_equal(robot.joint_values(state), q)
    for other in (robot, pickle.loads(pickle.dumps(expected))):
        assert other.geometry == geometry
        np.testing.assert_array_equal(other.closure_gap(q), expected.closure_gap(q))
        np.testing.assert_array_equal(other.inverse_jacobian(q), expected.inverse_jacobian(q))


def test_files_and_geometries_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    geometry = problems.as_built(PAPER, 1e-3)
    nominal, measured = tmp_path / "nominal.urdf", tmp_path / "measured.urdf"
    nominal.write_text(urdf_text(PAPER), encoding="utf-8")
    measured.write_text(urdf_text(geometry), encoding="utf-8")
    others = (
        problems.as_built(PAPER, 1e-3, seed=4),
        geometry.from_parameters(geometry.parameters + 1e-8),
        replace(geometry, limits=spm.LegLimits(1.2, 1.5)),
    )
    for file, machine in ((measured, None), (measured, PAPER), (nominal, geometry), *((measured, g) for g in others)):
        with pytest.raises(
            DescriptionError, match="The arguments geometry and prefix are those the file was written for"
        ):
            ClosedChain.from_urdf(file, machine)


def test_states_of_other_machines_are_refused() -> None:
    robot = built("paper", 1e-3)
    state = states(robot, 2, seed=18)
    nominal = chain().configuration(chain().joint_values(states(chain(), 1, seed=18)))
    with pytest.raises(GeometryError, match=r"the axes of the chain, got a machine that differs by .* rad in r_"):
        robot.joint_values(nominal)
    with pytest.raises(GeometryError, match="the axes of the chain, got a machine that differs"):
        chain().joint_values(state)
    other = problems.as_built(PAPER, 1e-3)
    moved = replace(other, legs=replace(other.legs, offsets=other.legs.offsets + 2e-6 * (np.arange(6) == 4)))
    with pytest.raises(GeometryError, match=r"the offsets of the chain, .* differs by 2\.0e-06 m in r_c2"):
        robot.joint_values(spm.Configuration(moved, state.pose, state.middle_joints))
    # Limits of the legs play no part.
    free = replace(other, limits=None)
    same = spm.Configuration(free, state.pose, state.middle_joints)
    np.testing.assert_array_equal(robot.joint_values(same), robot.joint_values(state))
    with pytest.raises(ClosureError):
        robot.forward_kinematics(state.readings[0], near=np.zeros(18))
    with pytest.raises(ArgumentError, match="lengths that the physical assembly mode can have"):
        robot.forward_kinematics([1.3, 1.3, 9.0, 1.3, 1.3, 1.3])


def test_on_an_arm_the_loops_stay_closed() -> None:
    robots = pytest.importorskip("example_robot_data")
    machine = ClosedChain.from_urdf(geometry=problems.as_built(PAPER, 1e-2), prefix="spm_")
    arm = robots.load("ur5")
    q, arm_q = machine.joint_values(states(machine, 1, seed=19)[0]), np.linspace(-1.0, 1.0, arm.model.nq)
    for both in (machine.mounted_on(arm, "tool0"), machine.carrying(arm)):
        joined = both.join(arm_q, q)
        assert np.abs(both.closure_gap(joined)).max() <= 1e-14
        rest, rates = np.zeros(arm.model.nv), machine.joint_rates(q, np.full(6, 0.1))
        v = both.join_velocities(rest, rates)
        forces = np.linspace(-10.0, 10.0, both.actuated_indices.size)
        a = both.forward_dynamics(joined, v, forces)
        np.testing.assert_allclose(both.inverse_dynamics(joined, v, a), forces, atol=1e-7 * np.abs(a).max())
