"""Forces and accelerations of closed chains: against plain equations, Pinocchio's own, work, and energy."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from loops.mechanisms import MAKERS, Array, admissible, ankle, mechanism, states

from spm_pin.errors import ArgumentError, ClosureError, SingularConfigurationError
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.loop_state import LoopState
from tests.loops import robots
from tests.loops.robots import add, at, hinge

DRIVEN = [name for name in MAKERS if name != "Delta"]


def frame_of(chain: ClosedChain) -> str:
    """A frame that moves in a loop."""
    return "platform" if "platform" in chain.joint_names else chain.joint_names[-1]


def forces_of(chain: ClosedChain, rng: np.random.Generator) -> tuple[Array, dict[str, Array]]:
    return 10.0 * rng.normal(size=len(chain.actuated)), {frame_of(chain): 5.0 * rng.normal(size=6)}


def generalized(chain: ClosedChain, q: Array, tau: Array, wrenches: dict[str, Array]) -> Array:
    """Forces of all joints, with Pinocchio's Jacobian of the frame."""
    forces = np.zeros(chain.model.nv)
    forces[chain.actuated_in_v] = tau
    for frame, wrench in wrenches.items():
        index, data = chain.model.getFrameId(frame), chain.model.createData()
        forces += pin.computeFrameJacobian(chain.model, data, q, index, pin.LOCAL_WORLD_ALIGNED).T @ wrench
    return forces


def drift(chain: ClosedChain, q: Array, v: Array, step: float = 1e-4) -> Array:
    """J̇ v by differences of Jacobians along v."""
    plus, minus, twice, thrice = (
        chain.state(pin.integrate(chain.model, q, s * step * v)).constraint_jacobian() @ v for s in (1, -1, 2, -2)
    )
    return np.asarray((8.0 * (plus - minus) - (twice - thrice)) / (12.0 * step))


@pytest.mark.parametrize("name", MAKERS)
def test_second_derivatives_of_closures_are_differences(name: str) -> None:
    """At open configurations and any velocity as well, where nothing vanishes."""
    chain, rng = mechanism(name), np.random.default_rng(1)
    for q, _ in states(name, 2):
        q, v = pin.integrate(chain.model, q, 0.2 * rng.normal(size=chain.model.nv)), rng.normal(size=chain.model.nv)
        state = chain.state(q, v)
        bias = state.kinematics.bias(v)[: chain.rows.count]
        assert np.abs(bias - drift(chain, q, v)).max() <= 1e-7 * max(1.0, np.abs(bias).max())


@pytest.mark.parametrize("name", MAKERS)
def test_accelerations_are_the_plain_solution(name: str) -> None:
    """Equations of motion and closures as they stand, solved by singular values."""
    chain, rng = mechanism(name), np.random.default_rng(2)
    model, data, nv = chain.model, chain.model.createData(), chain.model.nv
    for q, v in states(name):
        tau, wrenches = forces_of(chain, rng)
        state = chain.state(q, v)
        jacobian = np.concatenate([state.constraint_jacobian(), np.eye(nv)[chain.indices_in_v(*chain.held)]])
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        zeros = np.zeros((len(jacobian), len(jacobian)))
        matrix = np.block([[mass, jacobian.T], [jacobian, zeros]])
        right = np.concatenate(
            [
                generalized(chain, q, tau, wrenches) - pin.nonLinearEffects(model, data, q, v),
                -drift(chain, q, v),
                np.zeros(len(chain.held)),
            ]
        )
        expected = np.linalg.lstsq(matrix, right, rcond=1e-10)[0][:nv]
        a = state.forward_dynamics(tau, wrenches)
        assert np.abs(a - expected).max() <= 1e-7 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("name", ["Stewart", "Delta", "ankle", "free ankle"])
def test_accelerations_are_those_of_pinocchio(name: str) -> None:
    """Chains of point closures, which `pinocchio.constraintDynamics` takes."""
    chain, rng = mechanism(name), np.random.default_rng(3)
    model, data = chain.model, chain.model.createData()
    constraints = pin.StdVec_RigidConstraintModel()
    for (first, second), places in zip(chain.rows.joints, chain.rows.placements, strict=True):
        kind = pin.ContactType.CONTACT_3D
        constraints.append(pin.RigidConstraintModel(kind, model, first, places[0], second, places[1], pin.LOCAL))
    memory = pin.StdVec_RigidConstraintData()
    for constraint in constraints:
        memory.append(constraint.createData())
    pin.initConstraintDynamics(model, data, constraints, memory)
    settings = pin.ProximalSettings(0.0, 1e-12, 20)
    for q, v in states(name):
        tau, wrenches = forces_of(chain, rng)
        force = generalized(chain, q, tau, wrenches)
        expected = np.array(pin.constraintDynamics(model, data, q, v, force, constraints, memory, settings))
        a = chain.state(q, v).forward_dynamics(tau, wrenches)
        assert np.abs(a - expected).max() <= 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("name", DRIVEN)
def test_inverse_of_forward_dynamics_does_the_same_work(name: str) -> None:
    """The forces themselves come back, unless there are more actuators than freedoms: then the least ones."""
    chain, rng = mechanism(name), np.random.default_rng(4)
    for q, v in states(name):
        tau, wrenches = forces_of(chain, rng)
        state = chain.state(q, v)
        a = state.forward_dynamics(tau, wrenches)
        back = state.inverse_dynamics(a, wrenches)
        if name == "parallelogram":
            assert np.linalg.norm(back) < np.linalg.norm(tau)
            rates = np.ones(3)
            assert back @ rates == pytest.approx(tau @ rates, rel=1e-10)
        else:
            assert np.abs(back - tau).max() <= 1e-9 * np.abs(tau).max()
        again = state.forward_dynamics(back, wrenches)
        assert np.abs(again - a).max() <= 1e-9 * np.abs(a).max()


@pytest.mark.parametrize("name", MAKERS)
def test_forces_of_closures_complete_the_equations_of_motion(name: str) -> None:
    chain, rng = mechanism(name), np.random.default_rng(5)
    for q, v in states(name):
        tau, wrenches = forces_of(chain, rng)
        state = chain.state(q, v)
        a, forces = state.forward_dynamics(tau, wrenches), state.constraint_forces(tau, wrenches)
        total = generalized(chain, q, tau, wrenches) + state.constraint_jacobian().T @ forces
        moved = pin.rnea(chain.model, chain.model.createData(), q, v, a)
        moved[chain.indices_in_v(*chain.held)] = total[chain.indices_in_v(*chain.held)]
        assert np.abs(moved - total).max() <= 1e-10 * max(1.0, np.abs(total).max())


def test_dependent_closures_share_a_load_in_equal_parts() -> None:
    """A coupler on two pins carries a weight at its middle: half of it each along the rods' common direction."""
    chain = mechanism("parallelogram")
    q = chain.close()
    forces = chain.state(q).constraint_forces(np.zeros(3)).reshape(2, 5)
    other = chain.state(q).kinematics.space
    null = np.eye(10) - np.linalg.pinv(other.scaled.T) @ other.scaled.T
    # The least of all solutions has no part in what the dependent rows may exert on each other.
    assert np.abs(null @ (forces.ravel() * chain.rows.row_units)).max() <= 1e-12 * np.abs(forces).max()


def test_the_torque_map_of_an_ankle_does_the_same_work() -> None:
    chain, rng = mechanism("ankle"), np.random.default_rng(6)
    places = chain.indices_in_v("pitch", "roll")
    for q, v in states("ankle"):
        joint_forces = np.zeros(chain.model.nv)
        joint_forces[places] = rng.normal(size=2)
        tau = chain.state(q).actuator_forces(joint_forces)
        assert tau @ v[chain.actuated_in_v] == pytest.approx(joint_forces @ v, rel=1e-10)


@pytest.mark.parametrize("name", ["Bennett", "ankle", "free ankle", "weld and gear"])
def test_the_mass_of_the_actuators_has_the_kinetic_energy(name: str) -> None:
    chain = mechanism(name)
    for q, v in states(name):
        rates = v[chain.actuated_in_v]
        state = chain.state(q)
        v = state.joint_rates(rates)
        energy = chain.state(q, v).energy()
        assert 0.5 * rates @ state.actuator_mass() @ rates == pytest.approx(energy.kinetic, rel=1e-9)
        assert energy.total == energy.kinetic + energy.potential


def test_a_batch_is_its_members_and_says_which_fail() -> None:
    chain, rng = mechanism("ankle"), np.random.default_rng(7)
    q, v = map(np.array, zip(*states("ankle"), strict=True))
    tau = rng.normal(size=(3, 1, 2))
    batch = chain.state(q, v)
    a, frame = batch.forward_dynamics(tau), chain.model.frames[-1].name
    twists, accelerations = batch.twist(frame), batch.frame_acceleration(frame, a)
    assert a.shape == (3, 4, 8)
    for i, j in np.ndindex(3, 4):
        assert np.array_equal(twists[j], chain.state(q[j], v[j]).twist(frame))
        assert np.array_equal(accelerations[i, j], chain.state(q[j], v[j]).frame_acceleration(frame, a[i, j]))
        assert np.array_equal(a[i, j], chain.state(q[j], v[j]).forward_dynamics(tau[i, 0]))
    assert np.array_equal(a[:, 0], chain.state(q[0], v[0]).forward_dynamics(tau[:, 0]))
    q[2, 0] += 0.1
    batch.update(q, v)
    assert np.isnan(batch.forward_dynamics(tau[0])[2]).all()
    assert list(batch.failures) == [(2,)]
    assert isinstance(batch.failures[2,], ClosureError)


def test_joints_that_are_held_do_not_move() -> None:
    """Without spins of a Delta's rods its three actuators determine all; with them, the platform's motion."""
    loose, held = mechanism("Delta"), mechanism("Delta without spins")
    state = loose.state(states("Delta")[0][0])
    assert np.linalg.matrix_rank(state.actuator_jacobian("platform")) == 3
    with pytest.raises(SingularConfigurationError) as raised:
        state.joint_rates([1.0, 0.0, 0.0])
    assert "rod0a" in raised.value.cause
    assert "two hinges" in raised.value.cause
    q, v = states("Delta without spins")[0]
    a = held.state(q, v).joint_accelerations([1.0, 2.0, 3.0])
    assert a[held.actuated_in_v] == pytest.approx([1.0, 2.0, 3.0])
    assert np.abs(a[held.indices_in_v(*held.held)]).max() <= 1e-12 * np.abs(a).max()
    state = held.state(q, v)
    assert state.forward_dynamics(state.inverse_dynamics(a)) == pytest.approx(a, rel=1e-9, abs=1e-9)


def test_bad_input_is_refused() -> None:
    chain, free = mechanism("ankle"), mechanism("Stewart")
    (q, v), *_ = states("ankle")
    state, tau = chain.state(q, v), [0.0, 0.0]
    massless, shuffled = ankle(), pin.Model()
    for inertia in massless.model.inertias:
        inertia.mass, inertia.inertia = 0.0, np.zeros((3, 3))
    for name, parent in (("arm", 0), ("other", 0), ("hand", 1)):
        shuffled.addJoint(parent, pin.JointModelRZ(), pin.SE3.Identity(), name)
    for argument, call, *arguments in (
        ("q", chain.state, q[:-1]),
        ("v", chain.state, q, v[:-1]),
        ("q", chain.state, q * np.nan),
        ("q", free.state, np.zeros(25)),
        ("tau", state.forward_dynamics, [1.0]),
        ("wrenches", state.forward_dynamics, tau, {"nowhere": np.zeros(6)}),
        ("wrenches", state.forward_dynamics, tau, [1.0] * 6),
        ("wrenches", state.forward_dynamics, tau, {"roll": [1.0] * 5}),
        ("a", state.inverse_dynamics, np.ones(8)),
        ("v", chain.state(q, np.ones(8)).forward_dynamics, tau),
        ("model", massless.state(massless.close()).forward_dynamics, tau),
        ("model", ClosedChain, shuffled, [], []),
    ):
        with pytest.raises(ArgumentError, check=with_fields(argument=argument)):
            call(*arguments)
    with pytest.raises(ArgumentError, check=with_fields(argument="frame")) as raised:
        state.actuator_jacobian("rol")
    assert "roll" in raised.value.cause
    with pytest.raises(ClosureError) as opened:
        chain.state(q + 0.01).forward_dynamics(tau)
    assert "rod" in opened.value.cause


def test_more_actuators_than_freedoms_must_agree() -> None:
    chain = mechanism("parallelogram")
    state = chain.state(chain.close())
    assert state.joint_rates([2.0, 2.0, 2.0]) == pytest.approx([2.0, -2.0, 2.0, 2.0])
    with pytest.raises(ArgumentError):
        state.joint_rates([2.0, 2.0, 1.0])


def test_chain_without_actuators_moves_and_holds_nothing() -> None:
    full = robots.stewart()
    chain = ClosedChain(full.model, full.closures, [], q0=full.q0)
    state = chain.state(chain.q0)
    np.testing.assert_allclose(state.forward_dynamics([]), full.state(full.q0).forward_dynamics(np.zeros(6)), atol=1e-9)
    for call in (state.holding_forces, lambda: state.inverse_dynamics(np.zeros(chain.model.nv))):
        with pytest.raises(ArgumentError, check=with_fields(argument="actuated")):
            call()


def test_fewer_actuators_than_freedoms_bear_what_they_can() -> None:
    """A free robot falls: with no force of its own it can, and hovering it cannot."""
    chain = mechanism("free ankle")
    q, _ = states("free ankle")[0]
    state = chain.state(q)
    fall = state.forward_dynamics([0.0, 0.0])
    assert state.frame_acceleration("shank", fall)[:3] == pytest.approx(chain.model.gravity.linear)
    assert state.inverse_dynamics(fall) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ArgumentError) as raised:
        state.holding_forces()
    assert "shank" in raised.value.received


GEARED_ANKLE = """<mujoco>
  <option gravity="0.5 -1 -9.81" tolerance="1e-14" iterations="200" jacobian="dense"><flag contact="disable"/></option>
  <default><equality solimp="0.9999 0.9999 0.001"/><geom density="800"/></default>
  <worldbody>
    <body name="foot" pos="0 0 -0.4">
      <joint name="pitch" axis="0 1 0" armature="0.01"/><joint name="roll" axis="1 0 0"/>
      <geom type="box" size="0.1 0.04 0.02"/>
    </body>
    <body name="left" pos="0 0.05 -0.1">
      <joint name="left" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 -0.05 0 0" size="0.02"/>
      <body name="left_rod" pos="-0.05 0 0"><joint name="left_ball" type="ball"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body></body>
    <body name="right" pos="0 -0.05 -0.2">
      <joint name="right" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 -0.05 0 0" size="0.02"/>
      <body name="right_rod" pos="-0.05 0 0"><joint name="right_ball" type="ball"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/></body></body>
    <body name="wheel" pos="1 0 0"><joint name="wheel" axis="0 0 1"/>
      <geom type="box" pos="0.1 0 0" size="0.1 0.05 0.05"/></body>
    <body name="tool" pos="1 0 1"><joint name="tool" type="slide" axis="1 1 1"/><geom size="0.05"/></body>
  </worldbody>
  <equality>
    <connect name="left" body1="foot" body2="left_rod" anchor="-0.05 0.05 0"/>
    <connect name="right" body1="foot" body2="right_rod" anchor="-0.05 -0.05 0"/>
    <joint name="screw" joint1="tool" joint2="wheel" polycoef="0 0.2 0.1 0 0"/>
  </equality>
  <actuator><motor joint="left"/><motor joint="right"/><motor joint="wheel"/></actuator>
</mujoco>"""


def test_mujoco_accelerates_alike() -> None:
    """At rest, as its constraints leave J̇ v out: its matrices with hard constraints, and as it solves them, softly."""
    mujoco = pytest.importorskip("mujoco")
    chain, rng = ClosedChain.from_mjcf(GEARED_ANKLE), np.random.default_rng(8)
    engine = mujoco.MjModel.from_xml_string(GEARED_ANKLE)
    data, q = mujoco.MjData(engine), chain.close()
    joints = list(zip(chain.joint_names, list(chain.model.joints)[1:], strict=True))
    places = np.concatenate([np.arange(j.nv) + engine.joint(name).dofadr[0] for name, j in joints])
    for _ in range(3):
        q = chain.close(pin.integrate(chain.model, q, 0.2 * admissible(chain, q) @ rng.normal(size=chain.model.nv)))
        tau = rng.normal(size=3)
        for name, joint in joints:
            index, own = engine.joint(name).qposadr[0], q[joint.idx_q : joint.idx_q + joint.nq]
            data.qpos[index : index + joint.nq] = np.roll(own, 1) if joint.nq == 4 else own
        data.ctrl[:] = tau
        mujoco.mj_forward(engine, data)
        mass, jacobian = np.zeros((engine.nv, engine.nv)), data.efc_J.reshape(-1, engine.nv)
        mujoco.mj_fullM(engine, data, mass)
        matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((data.nefc, data.nefc))]])
        forces = data.qfrc_actuator - data.qfrc_bias
        expected = np.linalg.solve(matrix, np.concatenate([forces, np.zeros(data.nefc)]))[places]
        a = chain.state(q).forward_dynamics(tau)
        assert np.abs(a - expected).max() <= 1e-9 * np.abs(a).max()
        assert np.abs(a - data.qacc[places]).max() <= 2e-3 * np.abs(a).max()
        assert chain.mobility(q).undriven == ("left_ball", "right_ball")


@pytest.mark.parametrize("name", MAKERS)
def test_compiled_accelerations_are_the_interpreted_ones(name: str) -> None:
    """The same equations by Pinocchio and LAPACK; open loops and velocities that open them are left to these."""
    chain, rng = mechanism(name), np.random.default_rng(9)
    chain.compile()
    for q, v in states(name):
        forces = generalized(chain, q, *forces_of(chain, rng))
        state = chain.state(q, v)
        state.forward_dynamics(np.zeros(len(chain.actuated)))
        expected = state.kinematics.accelerations(v, forces)
        a = forces.copy()
        assert state.kinematics.accelerate(q, v, a)
        assert np.abs(a - expected).max() <= 1e-12 * np.abs(expected).max()
        moved, kept = pin.integrate(chain.model, q, 0.1 * chain.rows.units), forces.copy()
        assert not state.kinematics.accelerate(moved, v, kept)
        assert np.array_equal(kept, forces)
    q, v = states(name)[0]
    opens, forces = rng.normal(size=chain.model.nv), np.zeros(chain.model.nv)
    assert not chain.state(q).kinematics.accelerate(q, opens, forces)


def test_a_compiled_batch_is_its_members() -> None:
    chain, rng = mechanism("ankle"), np.random.default_rng(10)
    chain.compile()
    q, v = map(np.array, zip(*states("ankle"), strict=True))
    tau = rng.normal(size=(3, 1, 2))
    a = chain.state(q, v).forward_dynamics(tau)
    assert a.shape == (3, 4, 8)
    for i, j in np.ndindex(3, 4):
        state = chain.state(q[j], v[j])
        forces = np.zeros(chain.model.nv)
        forces[chain.actuated_in_v] = tau[i, 0]
        expected = state.kinematics.accelerations(v[j], forces)
        assert np.abs(a[i, j] - expected).max() <= 1e-12 * np.abs(expected).max()
    assert np.array_equal(chain.state(q[1], v[1]).forward_dynamics(tau)[:, 0], a[:, 1])
    q[2, 0] += 0.1
    batch = chain.state(q, v)
    opened = batch.forward_dynamics(tau[0])
    assert np.isnan(opened[2]).all()
    assert np.array_equal(opened[[0, 1, 3]], a[0][[0, 1, 3]])
    assert list(batch.failures) == [(2,)]


def test_tree_without_loops_has_its_own_dynamics_and_energy() -> None:
    """Kinetic energy includes the armature of a hinge along any axis."""
    model = pin.Model()
    hinge(model, "universe", "first", at())
    add(model, "first", "second", at(0.3), pin.JointModelRevoluteUnaligned(np.array([0.0, 0.6, 0.8])))
    model.armature[:] = 0.1, 0.2
    chain, q, v, tau = (
        ClosedChain(model, [], ["first", "second"]),
        np.array([0.2, 0.4]),
        np.array([1.0, 2.0]),
        [3.0, 4.0],
    )
    state = chain.state(q, v)
    assert state.gap().shape == (0,)
    assert state.forward_dynamics(tau) == pytest.approx(pin.aba(model, model.createData(), q, v, np.array(tau)))
    bodies = model.copy()
    bodies.armature[:] = 0.0
    kinetic = pin.computeKineticEnergy(bodies, bodies.createData(), q, v) + 0.5 * 0.1 + 0.5 * 0.2 * 4.0
    assert state.energy().kinetic == pytest.approx(kinetic)
    motion = chain.simulate(q, v, tau, [0.0, 0.2])
    assert abs(motion.energy_error[-1]) <= 1e-8 * abs(motion.energy).max()


@pytest.mark.parametrize("name", ["ankle", "weld and gear"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))])
def test_copy_of_a_state_moves_alone(name: str, copied: Callable[[LoopState], LoopState]) -> None:
    chain, ((q, v), (other, _), *_) = mechanism(name), states(name)
    state = chain.state(q, v)
    own, tau = copied(state), np.ones(len(chain.actuated))
    expected = state.forward_dynamics(tau).copy()
    assert np.array_equal(own.forward_dynamics(tau), expected)
    own.update(other)
    assert np.array_equal(state.constraint_jacobian(), chain.state(q).constraint_jacobian())
    assert np.array_equal(state.forward_dynamics(tau), expected)
