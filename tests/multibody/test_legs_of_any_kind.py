"""Chains of stages and robots of any legs: closed form, finite differences, virtual work and equations of engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balancers import MACHINES
from engines import Drake, Mujoco, accelerations
from error_fields import with_fields
from finite_differences import extrapolated
from multibody.chains import ROBOTS, WRENCH, Array, frame_jacobian, plain_accelerations, start

import spm_pin as spm
from spm_pin.description import actuated_joints, joint_values, mjcf_text, urdf_text
from spm_pin.machine import PRS, RPS, RRS, Stage
from spm_pin.machine.joint_angles import home_readings

pytest.importorskip("pinocchio")

EACH = pytest.mark.parametrize("name", [*MACHINES, *ROBOTS])


def moving(name: str) -> tuple[Any, Array, Array, Array]:
    """Return a chain with q, v, and the efforts that hold it."""
    chain, _, q = start(name)
    held = chain.state(q[0]).inverse_dynamics(np.zeros(chain.model.nv))
    size, n = chain.machine.ball_side, len(chain.leg_indices)
    v = chain.state(q[0]).joint_velocities(np.array([0.1 * size, 0.2 * size, 0.3 * size, 0.4, -0.5, 0.1])[freedoms(n)])
    return chain, q[0], v, held


def freedoms(legs: int) -> slice:
    """Return which of a twist's components are the motion of a platform."""
    return slice(6) if legs == 6 else slice(2, 5)


def platform_jacobian(chain: Any, q: Array) -> Array:
    return frame_jacobian(chain, q, "platform" if len(chain.leg_indices) == 3 else "terminal_platform")


@EACH
def test_the_closed_form_of_the_machine(name: str) -> None:
    chain, states, q = start(name)
    state = chain.state(q)
    assert chain.model.nq == chain.model.nv == 3 * len(chain.leg_indices)
    assert np.abs(state.closure_gap()).max() <= 1e-14
    np.testing.assert_allclose(chain.readings(q), states.readings, atol=1e-14)
    found = state.configuration()
    assert type(found) is type(states)
    np.testing.assert_allclose(found.pose.as_matrix(), states.pose.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(found.balls, states.balls, atol=1e-14)
    for ours, theirs in (
        (state.inverse_jacobian(), spm.inverse_jacobian(states)),
        (state.platform_jacobian(), spm.kinematics.platform_jacobian(states)),
        (state.leg_forces(WRENCH), spm.leg_forces(states, WRENCH)),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())


@EACH
def test_readings_and_poses_are_reached_from_another_state(name: str) -> None:
    chain, states, q = start(name)
    size = 0.03 * chain.machine.size if name in MACHINES else 0.003
    readings = states.readings[0] + size * np.sin(np.arange(len(chain.leg_indices)))
    there = chain.forward_kinematics(readings, near=q[0])
    np.testing.assert_allclose(there, chain.forward_kinematics(readings), atol=1e-10)
    np.testing.assert_allclose(chain.inverse_kinematics(states.pose[0], near=there), q[0], atol=1e-10)
    np.testing.assert_allclose(chain.inverse_kinematics(states.pose), q, atol=1e-10)
    loose = chain.with_readings(q[0], readings)
    np.testing.assert_allclose(chain.readings(loose), readings, atol=1e-14)
    assert np.abs(chain.state(chain.project(loose)).closure_gap()).max() <= 1e-13


@EACH
def test_differences_and_virtual_work_give_rates_and_efforts(name: str) -> None:
    chain, states, q = start(name)
    readings, state, n = states.readings[0], chain.state(q[0]), len(chain.leg_indices)

    def ends(h: float, way: Array) -> list[Array]:
        return [chain.forward_kinematics(readings + sign * h * way, near=q[0]) for sign in (1.0, -1.0)]

    def twist(h: float, way: Array) -> Array:
        ahead, behind = (chain.state(end).configuration().pose for end in ends(h, way))
        turn = (ahead.rotation * behind.rotation.inv()).as_rotvec()
        return np.concatenate([ahead.translation - behind.translation, turn]) / (2.0 * h)

    def slopes(h: float, way: Array) -> Array:
        ahead, behind = ends(h, way)
        return (ahead - behind) / (2.0 * h)

    def weight(h: float, way: Array) -> float:
        above, below = (chain.state(end).energy().potential for end in ends(h, way))
        return float(above - below) / (2.0 * h)

    step = 1e-3 if name in ROBOTS else 1e-2 * (chain.machine.size if chain.machine.unit == "m" else 1.0)
    for way in [*np.eye(n), np.sin(np.arange(1.0, n + 1.0))]:
        moved = extrapolated(lambda h, way=way: twist(h, way), step)
        np.testing.assert_allclose(state.platform_jacobian() @ way, moved, rtol=0, atol=1e-8 * np.abs(moved).max())
        rates, motion = extrapolated(lambda h, way=way: slopes(h, way), step), moved[freedoms(n)]
        np.testing.assert_allclose(state.joint_rates(way), rates, rtol=0, atol=1e-8 * np.abs(rates).max())
        np.testing.assert_allclose(state.joint_velocities(motion), rates, rtol=0, atol=1e-7 * np.abs(rates).max())
        # Efforts do the work that the load and the weights take.
        work = np.abs(moved * WRENCH).max()
        assert state.leg_forces(WRENCH) @ way == pytest.approx(-moved @ WRENCH, rel=1e-7, abs=1e-7 * work)
        held = state.inverse_dynamics(np.zeros(3 * n), WRENCH) @ way
        taken = extrapolated(lambda h, way=way: weight(h, way), step) - moved @ WRENCH
        assert held == pytest.approx(taken, rel=1e-6, abs=1e-6 * work)


@EACH
def test_accelerations_are_those_of_plain_equations_and_of_engines(name: str, tmp_path: Path) -> None:
    chain, q, v, held = moving(name)
    file = tmp_path / "machine.urdf"
    file.write_text(urdf_text(chain.machine), encoding="utf-8")
    engines = [Mujoco(file, chain.joint_names, machine=chain.machine)]
    if name in ROBOTS:
        pytest.importorskip("pydrake")
        engines.append(Drake(file, chain.joint_names))
    efforts = 1.2 * held + 0.1 * np.abs(held).max()
    found, loaded = (chain.state(q, v).forward_dynamics(efforts, load) for load in (None, WRENCH))
    for engine in engines:
        other = accelerations(engine, chain.leg_indices, q, v, efforts)
        np.testing.assert_allclose(found, other, rtol=0, atol=1e-9 * np.abs(other).max())
    force = platform_jacobian(chain, q).T @ WRENCH
    force[chain.leg_indices] += efforts
    plain = plain_accelerations(chain.model, chain.closures, q, v, force)
    np.testing.assert_allclose(loaded, plain, rtol=0, atol=1e-10 * np.abs(plain).max())
    np.testing.assert_allclose(chain.state(q, v).inverse_dynamics(found), efforts, rtol=1e-8)
    np.testing.assert_allclose(chain.state(q, v).inverse_dynamics(loaded, WRENCH), efforts, rtol=1e-8)


@EACH
def test_the_equations_of_motion_of_the_platform(name: str) -> None:
    chain, q, v, _ = moving(name)
    wanted = np.array([0.3, -0.4, 0.5, -2.0, 3.0, 1.0])[freedoms(len(chain.leg_indices))]
    state = chain.state(q, v)
    part = freedoms(len(chain.leg_indices))
    a, motion = state.joint_accelerations(wanted), (platform_jacobian(chain, q) @ v)[part]
    np.testing.assert_allclose(state.platform_acceleration(a)[part], wanted, atol=1e-11)
    np.testing.assert_allclose(state.joint_accelerations_of_legs(a[chain.leg_indices]), a, atol=1e-8)
    terms, efforts = state.platform_dynamics(), state.inverse_dynamics(a, WRENCH)
    inverse = state.inverse_jacobian()
    parasitic = state.platform_jacobian() @ inverse
    left = terms.mass @ wanted + terms.bias + terms.gravity
    right = inverse.T @ efforts + parasitic.T @ WRENCH
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-8 * np.abs(right).max())
    assert motion @ terms.mass @ motion / 2.0 == pytest.approx(state.energy().kinetic, rel=1e-9)
    np.testing.assert_allclose(terms.coriolis @ motion, terms.bias, atol=1e-9 * np.abs(terms.bias).max())
    assert np.array_equal(terms.mass, terms.mass.T)

    def mass(h: float) -> Array:
        ends = [chain.project(q + sign * h * v) for sign in (1.0, -1.0)]
        ahead, behind = (chain.state(end).platform_dynamics().mass for end in ends)
        return np.asarray(ahead - behind) / (2.0 * h)

    # Λ̇ - 2 C is skew.
    rate = extrapolated(mass, 1e-2)
    allowed = 1e-5 * np.abs(terms.coriolis).max()
    np.testing.assert_allclose(terms.coriolis + terms.coriolis.T, rate, rtol=0, atol=allowed)


def test_mujoco_s_own_steps_under_torques_of_servos_come_to_the_simulation() -> None:
    """Its loops hold, and the error of its method falls with the step."""
    mujoco = pytest.importorskip("mujoco")
    chain, states, q = start("servos below screws")
    state, until, errors = states[0], 0.1, []
    efforts = chain.state(q[0]).inverse_dynamics(np.zeros(18))
    efforts[:3] *= 1.3
    run = chain.simulate(q[0], np.zeros(18), efforts, [0.0, until])
    moved = np.abs(run.readings[-1] - run.readings[0]).max()
    assert run.complete
    assert moved > 0.1
    for step in (1e-3, 2.5e-4):
        text = mjcf_text(state.machine, collisions="none").replace('timestep="0.001"', f'timestep="{step}"')
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        for joint, value in joint_values(state).items():
            data.joint(joint).qpos[0] = value
        data.ctrl[:] = efforts
        for _ in range(round(until / step)):
            mujoco.mj_step(model, data)
        joints = [data.joint(joint).qpos[0] for joint in actuated_joints(state.machine)]
        errors.append(np.abs(joints + home_readings(state.machine) - run.readings[-1]).max())
        assert np.abs(data.efc_pos[:12]).max() < 1e-5
    assert errors[0] < 0.05 * moved
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_trajectory_says_in_which_units_legs_are() -> None:
    chain, states, q = start("servos below screws")
    state = states[0]
    poses = [state.pose.as_matrix(), spm.forward_physical(state.machine, state.readings + 0.01).pose.as_matrix()]
    path = spm.multibody.PlatformPath([0.0, 1.0], np.array(poses), ease=True)
    motion = chain.joint_trajectory(path, np.linspace(0.0, 1.0, 5), q[0])
    assert motion.leg_units == ("rad, m", "rad/s, m/s", "rad/s², m/s²", "N m, N")
    names = [motion.joint_names[k] for k in motion.actuated]
    assert (
        names
        == list(actuated_joints(state.machine))
        == [f"leg_b{i}_hip" for i in "123"] + [f"leg_c{i}_slide" for i in "123"]
    )
    np.testing.assert_allclose(motion.readings[-1], state.readings + 0.01, atol=1e-9)
    assert (motion.efforts[:, motion.actuated] != 0.0).all()


def test_states_of_other_legs_and_lengths_that_no_leg_has_are_refused() -> None:
    chain, states, _ = start("servos below screws")
    state, kinds = states[0], (RRS(crank=0.16, rod=0.35), PRS(rod=0.30))
    other = spm.Manipulator(*state.machine.dimensions, legs=spm.machine.Legs(*state.machine.legs.arrays, kinds))
    with pytest.raises(spm.GeometryError, check=with_fields(argument="configuration")) as caught:
        chain.joint_values(spm.Configuration(other, state.pose, state.middle_joints))
    assert "r_b1.crank" in caught.value.expected
    with pytest.raises(spm.GeometryError, check=with_fields(argument="machine")):
        chain.leg_lengths(np.zeros(18))
    far = spm.Manipulator.of_stages(Stage(0.30, 0.25, RRS(crank=0.15, rod=0.20)), Stage(0.20, 0.25, RPS()))
    near = spm.Manipulator.of_stages(Stage(0.30, 0.25), Stage(0.20, 0.25))
    high = spm.forward_physical(near, [0.5, 0.51, 0.52] * 2)
    chain, state = spm.ClosedChain.from_urdf(machine=far), spm.Configuration(far, high.pose, high.middle_joints)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="configuration")):
        chain.joint_values(state)
