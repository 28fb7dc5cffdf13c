"""The mechanism on an arm's tool and an arm on the mechanism, the loops closed in one model."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields
from multibody.chains import Array, frame_jacobian, plain_accelerations

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError

pinocchio = pytest.importorskip("pinocchio")
robots = pytest.importorskip("example_robot_data")


from spm_pin.multibody.chain import ClosedChain  # noqa: E402

SMALL = spm.Manipulator(0.06, 0.04, 0.05)
PLACEMENT = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(0.3, -0.2, 0.1), np.array([0.0, 0.02, 0.1]))


@cache
def small() -> Any:
    return ClosedChain.from_urdf(machine=SMALL, prefix="spm_")


@cache
def arm(name: str) -> Any:
    return robots.load(name)


def mounted(name: str, way: str) -> Any:
    robot = arm(name)
    if way == "carried":
        return small().mounted_on(robot, robot.model.frames[robot.model.nframes - 1].name, PLACEMENT)
    return small().carrying(robot.model, placement=PLACEMENT)


def state(both: Any, name: str, seed: int) -> tuple[Array, Array]:
    rng, model = np.random.default_rng(seed), arm(name).model
    pinocchio.seed(seed)
    q = pinocchio.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    machine_q = small().forward_kinematics(small().leg_lengths(np.zeros(18)) * rng.uniform(0.95, 1.05, 6))
    rates = small().state(machine_q).joint_rates(0.01 * rng.normal(size=6))
    return both.join(q, machine_q), both.join_velocities(0.3 * rng.normal(size=model.nv), rates)


CASES = [("ur5", "carries"), ("kinova", "carried"), ("panda", "carried")]


@pytest.mark.parametrize(("name", "way"), CASES)
def test_closed_wherever_the_arm_is(name: str, way: str) -> None:
    both = mounted(name, way)
    q, v = state(both, name, seed=500)
    assert both.model.nv == arm(name).model.nv + 18
    assert np.abs(both.state(q).closure_gap()).max() <= 1e-14
    assert np.abs(both.state(q).constraint_jacobian() @ v).max() <= 1e-14
    data = both.model.createData()
    pinocchio.framesForwardKinematics(both.model, data, q)
    # Each robot is as it is by itself.
    other, machine_q = both.split(q)
    alone = small().state(machine_q).configuration()
    base, platform = (data.oMf[both.model.getFrameId(f"spm_{link}")] for link in ("base", "terminal_platform"))
    assert np.allclose(base.actInv(platform).translation, alone.translation, atol=1e-14)
    tool = arm(name).model.nframes - 1
    reference = arm(name).model.createData()
    pinocchio.framesForwardKinematics(arm(name).model, reference, other)
    found = data.oMf[both.model.getFrameId(arm(name).model.frames[tool].name)]
    root = pinocchio.SE3.Identity() if way == "carried" else platform * PLACEMENT
    assert np.allclose(root.actInv(found).homogeneous, reference.oMf[tool].homogeneous, atol=1e-13)


@pytest.mark.parametrize(("name", "way"), CASES)
def test_forces_and_motions_of_both_mounted_chains(name: str, way: str) -> None:
    both, rng = mounted(name, way), np.random.default_rng(501)
    q, v = state(both, name, seed=502)
    f = rng.normal(size=both.actuated_indices.size)
    push = rng.normal(size=6)
    model, a = both.model, both.state(q, v).forward_dynamics(f, push)
    force = frame_jacobian(both, q, "spm_terminal_platform").T @ push
    force[both.actuated_indices] += f
    expected = plain_accelerations(both.model, small().closures, q, v, force)
    assert np.abs(a - expected).max() <= 1e-9 * np.abs(expected).max()
    back = both.state(q, v).inverse_dynamics(a, push)
    mass = pinocchio.crba(model, model.createData(), q)
    size = np.abs((np.triu(mass) + np.triu(mass, 1).T) @ a).max()
    assert np.abs(back - f).max() <= 1e-9 * size + 1e-9
    # Actuators alone change the energy: dE/dt by differences along the motion.
    a = both.state(q, v).forward_dynamics(f)
    h = 1e-5

    def energy(t: float) -> float:
        return float(both.state(pinocchio.integrate(model, q, t * v + t**2 / 2 * a), v + t * a).energy().total)

    power = f @ v[both.actuated_indices]
    assert (energy(h) - energy(-h)) / (2 * h) == pytest.approx(power, rel=1e-4, abs=1e-5)


def test_batches_states_joining_and_wrapping() -> None:
    both = mounted("ur5", "carried")
    pairs = [state(both, "ur5", seed) for seed in (503, 504)]
    q, v = (np.array(part) for part in zip(*pairs, strict=True))
    assert np.array_equal(both.join(*both.split(q)), q)
    forces = np.random.default_rng(506).normal(size=12)
    together = both.state(q, v).forward_dynamics(forces)
    assert np.array_equal(together[1], both.state(q[1], v[1]).forward_dynamics(forces))
    wrapper = both.robot_wrapper()
    assert wrapper.nq == 24
    shapes = arm("ur5").visual_model.ngeoms, small().visual_model.ngeoms
    assert wrapper.visual_model.ngeoms == sum(shapes)
    assert small().carrying(arm("ur5").model).robot_wrapper().visual_model is None
    assert "ur5, 24 degrees of freedom" in repr(both)
    assert sorted([*both.chain_indices, *both.other_indices]) == list(range(24))
    with pytest.raises(ArgumentError, check=with_fields(argument="q")):
        both.state(both.join(np.zeros(6), np.full(18, -1.0))).closure_gap()


def test_invalid_mountings_are_refused() -> None:
    robot, both, mount = arm("ur5"), mounted("ur5", "carried"), small().mounted_on
    q, v = state(both, "ur5", seed=505)
    for argument, call, *arguments in (
        ("other", ClosedChain.from_urdf(machine=SMALL).mounted_on, robot, "tool0"),
        ("frame", mount, robot, "tool1"),
        ("frame", small().carrying, robot, "tool0"),
        ("placement", mount, robot, "tool0", np.eye(4)),
        ("other", mount, ClosedChain.from_urdf(prefix="b_"), "b_base"),
        ("v", both.state(q, v + 1e-3).inverse_dynamics, np.zeros(24)),
        ("forces", both.state(q, v).forward_dynamics, np.zeros(6)),
        ("chain", both.join, np.zeros((2, 6)), np.zeros((3, 18))),
    ):
        with pytest.raises(ArgumentError, check=with_fields(argument=argument)):
            call(*arguments)
    with pytest.raises(ClosureError):
        both.state(q + 1e-3, v).forward_dynamics(np.zeros(12))


@pytest.mark.parametrize(("name", "way"), CASES)
@pytest.mark.parametrize("speed", [1e-3, 30.0])
def test_the_arm_moves_alone_with_the_legs_held(name: str, way: str, speed: float) -> None:
    """Both ends of a gap have the arm's speed: rounding of their difference is no velocity that opens the loops."""
    both = mounted(name, way)
    q, v = state(both, name, seed=510)
    v *= speed
    v[both.chain_indices] = 0.0
    a = both.state(q, v).forward_dynamics(np.zeros(both.actuated_indices.size))
    assert np.abs(both.state(q, v).inverse_dynamics(a)).max() <= 1e-9 * max(1.0, np.abs(a).max())
    v[both.chain_indices[3]] = 1e-3 * speed
    with pytest.raises(ArgumentError, check=with_fields(argument="v")):
        both.state(q, v).inverse_dynamics(a)
