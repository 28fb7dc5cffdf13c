"""Chains of RPS, PRS and RRS legs: against the closed form, finite differences, and the equations of other engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engines import Drake, Mujoco, accelerations
from error_fields import with_fields
from kinds_of_legs import EACH_KIND, machine_of_kinds, states
from problems import Array
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.description import actuated_joints, joint_values, mjcf_text, urdf_text
from spm_pin.machine import PRS, RPS, RRS, Stage
from spm_pin.machine.joint_angles import home_readings

WRENCH = np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])
SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(-0.5, 1.5))
SCREWS = Stage(0.20, 0.25, PRS(rod=0.30), limits=(-0.05, 0.25))
BOTH = {
    "servos below": (spm.Manipulator.of_stages(SERVOS, SCREWS), [0.4, 0.5, 0.6, 0.10, 0.12, 0.14]),
    "screws below": (spm.Manipulator.of_stages(SCREWS, SERVOS), [0.10, 0.12, 0.14, 0.4, 0.5, 0.6]),
}


def start(name: str) -> tuple[spm.ClosedChain, spm.Configuration, Array]:
    """Return a chain, a state of it, and efforts that nearly hold its weights: a servo exerts more."""
    machine, readings = BOTH[name]
    chain, state = spm.ClosedChain.from_urdf(machine=machine), spm.forward_physical(machine, readings)
    efforts = chain.state(chain.joint_values(state)).inverse_dynamics(np.zeros(18))
    efforts[machine.legs.units.index("rad")] *= 1.3
    return chain, state, efforts


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), EACH_KIND)
def test_constraint_jacobians_give_the_rates_and_forces_of_the_closed_form(lower: str, upper: str, built: bool) -> None:
    found = states(machine_of_kinds(lower, upper, built=built))[:3]
    chain = spm.ClosedChain.from_urdf(machine=found.machine)
    q = chain.joint_values(found)
    state = chain.state(q)
    assert np.abs(state.closure_gap()).max() < 1e-14
    np.testing.assert_allclose(chain.readings(q), found.readings, atol=1e-14)
    again = state.configuration()
    np.testing.assert_allclose(again.pose.as_matrix(), found.pose.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(again.middle_joints, found.middle_joints, atol=1e-14)
    expected = spm.inverse_jacobian(found)
    np.testing.assert_allclose(state.inverse_jacobian(), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    forces = spm.leg_forces(found, WRENCH)
    np.testing.assert_allclose(state.leg_forces(WRENCH), forces, rtol=0, atol=1e-12 * np.abs(forces).max())
    # Along a path of readings, and back along one of poses.
    moved = found.readings[0] + 0.001 * np.sin(np.arange(6.0))
    there = chain.forward_kinematics(moved, q[0])
    np.testing.assert_allclose(there, chain.forward_kinematics(moved), atol=1e-10)
    np.testing.assert_allclose(chain.inverse_kinematics(found.pose[0], there), q[0], atol=1e-10)
    loose = chain.with_readings(q[0], moved)
    np.testing.assert_allclose(chain.readings(loose), moved, atol=1e-14)
    assert np.abs(chain.state(chain.project(loose)).closure_gap()).max() < 1e-13


@pytest.mark.parametrize("name", BOTH)
def test_finite_differences_give_rates_and_efforts(name: str) -> None:
    chain, state, _ = start(name)
    q, h = chain.joint_values(state), 1e-6
    ends = [chain.forward_kinematics(state.readings + h * sign * np.eye(6), near=q) for sign in (1.0, -1.0)]
    forth, back = (chain.state(end).configuration() for end in ends)
    turns = (Rotation.from_matrix(forth.rotation) * Rotation.from_matrix(back.rotation).inv()).as_rotvec()
    twists = np.concatenate([forth.translation - back.translation, turns], axis=-1) / (2.0 * h)
    now = chain.state(q)
    np.testing.assert_allclose(now.inverse_jacobian() @ twists.T, np.eye(6), atol=1e-7)
    # What holds a wrench does the work that the wrench takes.
    np.testing.assert_allclose(now.leg_forces(WRENCH), -twists @ WRENCH, rtol=1e-7)
    # The efforts that hold the weights are the slopes of their energy.
    energies = [chain.state(end).energy().potential for end in ends]
    slopes = (energies[0] - energies[1]) / (2.0 * h)
    np.testing.assert_allclose(now.inverse_dynamics(np.zeros(18)), slopes, rtol=1e-6)


@pytest.mark.parametrize("engine", [Mujoco, Drake])
@pytest.mark.parametrize("name", BOTH)
def test_accelerations_by_the_equations_of_other_engines(engine: Any, name: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco" if engine is Mujoco else "pydrake")
    chain, state, efforts = start(name)
    file = tmp_path / "robot.urdf"
    file.write_text(urdf_text(state.machine), encoding="utf-8")
    other, q = engine(file, chain.joint_names), chain.joint_values(state)
    v = chain.state(q).joint_rates(0.3 * np.cos(np.arange(6.0)))
    found = chain.state(q, v).forward_dynamics(efforts)
    expected = accelerations(other, chain.leg_indices, q, v, efforts)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(chain.state(q, v).inverse_dynamics(found), efforts, rtol=1e-9)


def test_mujoco_s_own_steps_under_torques_of_servos_come_to_the_simulation() -> None:
    """Its loops hold, and the error of its method falls with the step."""
    mujoco = pytest.importorskip("mujoco")
    chain, state, efforts = start("servos below")
    until, errors = 0.1, []
    run = chain.simulate(chain.joint_values(state), np.zeros(18), efforts, [0.0, until])
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
    chain, state, _ = start("servos below")
    poses = [state.pose.as_matrix(), spm.forward_physical(state.machine, state.readings + 0.01).pose.as_matrix()]
    path = spm.multibody.PlatformPath([0.0, 1.0], np.array(poses), ease=True)
    motion = chain.joint_trajectory(path, np.linspace(0.0, 1.0, 5), chain.joint_values(state))
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
    chain, state, _ = start("servos below")
    kinds = RRS(crank=0.16, rod=0.35), PRS(rod=0.30)
    other = spm.Manipulator(*state.machine.dimensions, legs=spm.machine.Legs(*state.machine.legs.arrays, kinds))
    with pytest.raises(spm.GeometryError, check=with_fields(argument="configuration")):
        chain.joint_values(spm.Configuration(other, state.pose, state.middle_joints))
    with pytest.raises(spm.GeometryError, check=with_fields(argument="machine")):
        chain.leg_lengths(np.zeros(18))
    far = spm.Manipulator.of_stages(Stage(0.30, 0.25, RRS(crank=0.15, rod=0.20)), Stage(0.20, 0.25, RPS()))
    near = spm.Manipulator.of_stages(Stage(0.30, 0.25), Stage(0.20, 0.25))
    high = spm.forward_physical(near, [0.5, 0.51, 0.52] * 2)
    chain, state = spm.ClosedChain.from_urdf(machine=far), spm.Configuration(far, high.pose, high.middle_joints)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="configuration")):
        chain.joint_values(state)
