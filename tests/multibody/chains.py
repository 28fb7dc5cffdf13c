"""Chains, configurations and norms shared by the tests of `multibody`."""

from __future__ import annotations

from functools import cache
from typing import Any

import kinds_of_legs
import numpy as np
import numpy.typing as npt
import problems
from balancers import existing_states, stage_and_height

import spm_pin as spm
from spm_pin.machine import PRS, RRS, Stage

Array = npt.NDArray[np.float64]

EPS = float(np.finfo(float).eps)
PAPER = spm.Manipulator.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
MACHINES = {
    "paper": PAPER,
    "millimetres": problems.MANIPULATORS["millimetres"],
    "as built": problems.as_built(PAPER, 1e-2),
}
NAMES = list(MACHINES)
BALL_ANGLES = ("ball_b1_y", "ball_c1_y")


@cache
def chain(name: str = "paper") -> Any:
    from spm_pin.multibody.chain import ClosedChain

    return ClosedChain.from_urdf(machine=MACHINES[name])


def six_branches() -> list[spm.Configuration]:
    return [state for state in spm.inverse_displacement(PAPER, POSE) if state.exists]


def placed(name: str, count: int, seed: int) -> list[tuple[spm.Configuration, Array]]:
    """Random branches of every family, `count` each, with their q: no ball's middle angle beyond 85 degrees.

    Of a machine as built, physical states.
    """
    found, machine = [], MACHINES[name]
    if not machine.is_nominal:
        readings = machine.legs.offsets + np.random.default_rng(seed).uniform(1.15, 1.45, (3 * count, 6))
        return [(state, chain(name).joint_values(state)) for state in spm.forward_physical(machine, readings)]
    for family in spm.machine.FAMILIES:
        for state in problems.random_branches(machine, family, count, seed).configuration:
            q = chain(name).joint_values(state)
            if np.abs(q[chain(name).joint_indices(*BALL_ANGLES)]).max() <= np.deg2rad(85.0):
                found.append((state, q))
    assert len(found) > 2 * count
    return found


def frame_jacobian(owner: Any, q: Array, frame: str) -> Array:
    """Jacobian (6, joints) of a frame, and nothing of the package."""
    import pinocchio as pin

    model = owner.model
    index = model.getFrameId(frame)
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, index, pin.LOCAL_WORLD_ALIGNED)
    return np.array(jacobian)


def plain_accelerations(model: Any, closures: Any, q: Array, v: Array, force: Array) -> Array:
    """The equations of motion and of the closures, solved as they stand, with Jacobians of Pinocchio's frames."""
    import pinocchio as pin

    data, world = model.createData(), pin.LOCAL_WORLD_ALIGNED
    ends = [[model.getFrameId(frame) for frame in (c.frame_a, c.frame_b)] for c in closures]
    half = np.triu(pin.crba(model, data, q))
    mass = half + np.triu(half, 1).T
    force = force - pin.nonLinearEffects(model, data, q, v)

    def rows(of_frame: Any) -> Array:
        return np.concatenate([of_frame(b)[:3] - of_frame(a)[:3] for a, b in ends])

    jacobian = rows(lambda frame: pin.computeFrameJacobian(model, model.createData(), q, frame, world))
    # J̇c v, from the classical accelerations of the frames where no joint accelerates.
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    drift = rows(lambda frame: pin.getFrameClassicalAcceleration(model, data, frame, world).linear)
    matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((len(drift), len(drift)))]])
    return np.linalg.solve(matrix, np.concatenate([force, -drift]))[: model.nv]


def rounding(owner: Any, q: Array) -> float:
    """Closure gap that rounding explains: some eps times the length of the loops."""
    legs = np.abs(owner.leg_lengths(q)).sum(axis=-1).max()
    return float(32 * EPS * (legs + sum(owner.machine.nominal.dimensions)))


def random_q(owner: Any, rng: np.random.Generator) -> Array:
    """Joint values that leave the closures wide open."""
    q = rng.uniform(-1.5, 1.5, 18)
    q[owner.leg_indices] = rng.uniform(-0.5, 0.5, 6) * owner.leg_lengths(np.zeros(18))
    return q


def wrench_conditions(state: spm.Configuration) -> tuple[float, float]:
    """Smallest singular values of the closed form's J_b or J_c, and of its K; lengths in units of d."""
    lower, upper, across = np.linalg.svd(problems.wrench_matrices(state), compute_uv=False)[:, -1]
    return min(lower, upper), across


WRENCH = np.array([3.0, -2.0, -50.0, 0.4, -0.6, 0.8])
SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(-0.5, 1.5))
SCREWS = Stage(0.20, 0.25, PRS(rod=0.30), limits=(-0.05, 0.25))
ROBOTS = {
    "servos below screws": lambda: spm.forward_physical(
        spm.Manipulator.of_stages(SERVOS, SCREWS), [[0.4, 0.5, 0.6, 0.10, 0.12, 0.14], [0.5, 0.4, 0.5, 0.12, 0.1, 0.1]]
    ),
    "PRS below RRS as built": lambda: kinds_of_legs.states(kinds_of_legs.machine_of_kinds("PRS", "RRS", built=True)),
    "RPS below PRS as built": lambda: kinds_of_legs.states(kinds_of_legs.machine_of_kinds("RPS", "PRS", built=True)),
}


@cache
def start(name: str) -> tuple[Any, Any, Array]:
    """Return the chain of a machine, regular states of it, and their joint values."""
    states = ROBOTS[name]()[:3] if name in ROBOTS else existing_states(*stage_and_height(name), 6)
    chain = spm.ClosedChain.from_urdf(machine=states.machine)
    return chain, states, chain.joint_values(states)
