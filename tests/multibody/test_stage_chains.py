"""Chains of one stage: against its closed form, finite differences, virtual work and the equations of MuJoCo."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from balancers import MACHINES, existing_states, stage_and_height
from error_fields import with_fields
from multibody.chains import WRENCH, Array, start

import spm_pin as spm
from spm_pin.description import Masses, RigidBody, urdf_text
from spm_pin.errors import ArgumentError, DescriptionError, GeometryError, SingularConfigurationError, UnreachableError
from spm_pin.multibody import PlatformPath, SimulationEnd

pytest.importorskip("pinocchio")

BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))


def test_the_normal_and_height_of_a_pose_count() -> None:
    """Its shift and torsion are those of the stage, whatever the pose has."""
    chain, states, q = start("PRS inclined")
    turned = spm.pose(states.translation[1] + [0.01, 0.02, 0.0], rotation=states.rotation[1] @ _about_z(0.3))
    np.testing.assert_allclose(chain.inverse_kinematics(turned, near=q[0]), q[1], atol=1e-12)
    np.testing.assert_allclose(chain.inverse_kinematics(turned), q[1], atol=1e-12)


def _about_z(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def test_a_stage_that_falls_keeps_its_energy() -> None:
    chain, _, q = start("RPS")
    run = chain.simulate(q[0], np.zeros(9), None, np.linspace(0.0, 0.2, 5))
    assert run.end is SimulationEnd.COMPLETE
    assert run.readings.shape == run.leg_forces.shape == (5, 3)
    assert np.ptp(run.readings, axis=0).max() > 0.01
    assert np.abs(run.energy_error).max() <= 1e-10 * run.energy[0]
    assert run.closure_gap.max() <= 1e-14


@pytest.mark.parametrize("name", MACHINES)
def test_the_path_of_a_platform_is_followed_by_its_normal_and_height(name: str) -> None:
    chain, states, q = start(name)
    # Poses that no stage has: without shift and torsion of their own.
    turns = np.stack([states.rotation[k] @ _about_z(0.2 * k) for k in range(3)])
    places = states.translation[:3] * [0.0, 0.0, 1.0]
    path = PlatformPath([0.0, 0.6, 1.0], spm.pose(places, rotation=turns))
    times = np.linspace(0.0, 0.5, 101)
    motion = chain.joint_trajectory(path, times, q[0])
    wanted = path(times).pose
    np.testing.assert_allclose(
        motion.pose.rotation.as_matrix()[..., 2], wanted.rotation.as_matrix()[..., 2], atol=1e-12
    )
    np.testing.assert_allclose(motion.pose.translation[:, 2], wanted.translation[:, 2], atol=1e-12)
    h = times[1]
    for values, rates in ((motion.positions, motion.velocities), (motion.velocities, motion.accelerations)):
        slope = (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * h)
        np.testing.assert_allclose(slope, rates[2:-2], rtol=0, atol=1e-5 * np.abs(rates).max())
    forces = chain.state(motion.positions, motion.velocities).inverse_dynamics(motion.accelerations)
    np.testing.assert_allclose(motion.efforts[:, chain.leg_indices], forces, rtol=1e-9)
    assert list(motion.columns())[1:4] == list(chain.machine.legs.names)


def test_a_path_beyond_the_limits_is_refused() -> None:
    chain = spm.ClosedChain.from_urdf(machine=BALANCER)
    poses = spm.pose([[0.0, 0.0, 0.12], [0.0, 0.0, 0.157]], xyx=[[0.0, 0.0, 0.0]] * 2)
    q = chain.inverse_kinematics(poses[0])
    with pytest.raises(UnreachableError, check=with_fields(argument="path")):
        chain.joint_trajectory(PlatformPath([0.0, 1.0], poses), np.linspace(0.0, 1.0, 21), q)


def test_cranks_and_rods_in_line_are_an_inverse_singularity() -> None:
    stage = spm.Stage(0.09, 0.09, spm.RRS(crank=0.05, rod=0.11))
    chain = spm.ClosedChain.from_urdf(machine=stage)
    stretched = spm.Configuration(stage, spm.pose([0.0, 0.0, 0.16], xyx=[0.0, 0.0, 0.0]))
    state = chain.state(chain.joint_values(stretched))
    for call in (state.inverse_jacobian, state.platform_dynamics, lambda: state.joint_velocities(np.ones(3))):
        with pytest.raises(SingularConfigurationError, check=with_fields(kind="inverse")):
            call()
    # The readings do not follow the height, and no torque is needed to hold a load.
    np.testing.assert_allclose(state.leg_forces([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]), 0.0, atol=1e-7)
    assert state.singular_values().inverse < 1e-7


def test_the_mode_turned_half_round_is_not_left() -> None:
    chain = spm.ClosedChain.from_urdf(machine=spm.Stage(0.7, 0.46))
    both = spm.inverse_displacement(chain.machine, [1.1, 1.12], tilt=[0.2, 0.25], azimuth=[0.5, 0.7])
    turned = both.configurations[:, spm.machine.OPERATION_MODES.index("F")]
    assert turned.exists.all()
    q = chain.joint_values(turned)
    for found in (chain.inverse_kinematics(turned.pose[1], q[0]), chain.forward_kinematics(turned.readings[1], q[0])):
        np.testing.assert_allclose(
            chain.state(found).configuration().pose.as_matrix(), turned.pose[1].as_matrix(), atol=1e-12
        )


def test_files_prefixes_copies_and_shapes(tmp_path: Path) -> None:
    stage, file = stage_and_height("RRS as built")[0], tmp_path / "stage.urdf"
    file.write_text(urdf_text(stage, prefix="left_"), encoding="utf-8")
    chain = spm.ClosedChain.from_urdf(file, stage, prefix="left_")
    states = existing_states(stage, 0.12, 3)
    q = chain.joint_values(states)
    for other in (chain, pickle.loads(pickle.dumps(chain))):
        assert all(name.startswith("left_") for name in other.joint_names)
        np.testing.assert_allclose(other.state(q).configuration().pose.as_matrix(), states.pose.as_matrix(), atol=1e-14)
    heavy = chain.with_masses(Masses(payload=RigidBody(2.0)))
    held = [each.state(q[0]).inverse_dynamics(np.zeros(9)) for each in (heavy, chain)]
    weight = chain.state(q[0]).leg_forces([0.0, 0.0, -2.0 * 9.81, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(held[0] - held[1], weight, rtol=1e-9)
    for machine in (stage.nominal, spm.Manipulator.paper()):
        with pytest.raises(DescriptionError):
            spm.ClosedChain.from_urdf(file, machine, prefix="left_")
    pytest.importorskip("coal")
    assert len(chain.collision_model.collisionPairs) > 0
    assert chain.robot_wrapper().visual_model.ngeoms > chain.collision_model.ngeoms


def test_the_same_chain_in_loops() -> None:
    """It finds the freedoms by itself, and the same motions by other equations."""
    chain, states, q = start("PRS inclined as built")
    loops, rates = chain.loops, np.array([0.1, -0.2, 0.3])
    mobility = loops.mobility(q[0])
    assert (mobility.dof, mobility.rank, mobility.actuated_rank, mobility.rows) == (3, 6, 3, 6)
    v, pull = chain.state(q[0]).joint_rates(rates), np.array([5.0, -3.0, 2.0])
    ours, other = chain.state(q[0], v), loops.state(q[0], v)
    np.testing.assert_allclose(other.actuator_jacobian("platform"), ours.platform_jacobian(), atol=1e-12)
    a = ours.forward_dynamics(pull, WRENCH)
    np.testing.assert_allclose(other.forward_dynamics(pull, {"platform": WRENCH}), a, atol=1e-9 * np.abs(a).max())
    readings = states.readings[0] + 0.01 * np.sin(np.arange(3.0))
    values = q[0][chain.leg_indices] + readings - states.readings[0]
    followed = chain.forward_kinematics(readings, near=q[0])
    np.testing.assert_allclose(loops.forward(values, near=q[0]), followed, atol=1e-12)


def test_states_of_other_machines_are_refused() -> None:
    chain, states, q = start("RRS")
    wider = spm.Stage(0.081, 0.09, spm.RRS(crank=0.05, rod=0.11))
    other = spm.inverse_physical(wider, 0.12)
    for wrong in (other, spm.forward_physical(spm.Manipulator.paper(), [1.3] * 6)):
        with pytest.raises(GeometryError, check=with_fields(argument="configuration")):
            chain.joint_values(wrong)
    # Limits choose the zero of the tree only.
    limited = spm.ClosedChain.from_urdf(machine=BALANCER)
    np.testing.assert_allclose(limited.readings(limited.joint_values(states[0])), states.readings[0], atol=1e-14)
    with pytest.raises(ArgumentError, check=with_fields(argument="readings")):
        chain.forward_kinematics([0.1, 0.2], near=q[0])
