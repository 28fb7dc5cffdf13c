"""Chains, configurations and norms shared by the tests of `multibody`."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import problems

import spm_pin as spm

Array = npt.NDArray[np.float64]

EPS = float(np.finfo(float).eps)
PAPER = spm.Geometry.paper()
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
MACHINES = {**problems.GEOMETRIES, "as built": problems.as_built(PAPER, 1e-2)}
NAMES = list(MACHINES)
BALL_ANGLES = ("ball_b1_y", "ball_c1_y")


@cache
def chain(name: str = "paper") -> Any:
    from spm_pin.multibody.chain import ClosedChain

    return ClosedChain.from_urdf(geometry=MACHINES[name])


def six_branches() -> list[spm.Configuration]:
    return list(spm.inverse_displacement(PAPER, POSE))


def placed(name: str, count: int, seed: int) -> list[tuple[spm.Configuration, Array]]:
    """Random branches of every family, `count` each, with their q: no ball's middle angle beyond 85 degrees.

    Of a machine as built, physical states.
    """
    found, geometry = [], MACHINES[name]
    if not geometry.is_nominal:
        readings = geometry.legs.offsets + np.random.default_rng(seed).uniform(1.15, 1.45, (3 * count, 6))
        return [(state, chain(name).joint_values(state)) for state in spm.forward_physical(geometry, readings)]
    for family in spm.mechanism.FAMILIES:
        for state in problems.random_branches(problems.GEOMETRIES[name], family, count, seed).configuration:
            q = chain(name).joint_values(state)
            if np.abs(q[chain(name).joint_indices(*BALL_ANGLES)]).max() <= np.deg2rad(85.0):
                found.append((state, q))
    assert len(found) > 2 * count
    return found


def frame_jacobian(owner: Any, q: Array, frame: str) -> Array:
    """Jacobian (6, 18) of a frame, and nothing of the package."""
    import pinocchio as pin

    model = owner.model
    index = model.getFrameId(frame)
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, index, pin.LOCAL_WORLD_ALIGNED)
    return np.array(jacobian)


def closure_jacobian(owner: Any, q: Array) -> Array:
    """J_tip - J_mb of every closure, (12, 18)."""
    return np.concatenate(
        [frame_jacobian(owner, q, c.frame_b)[:3] - frame_jacobian(owner, q, c.frame_a)[:3] for c in owner.closures]
    )


def random_q(owner: Any, rng: np.random.Generator) -> Array:
    """Joint values that leave the closures wide open."""
    q = rng.uniform(-1.5, 1.5, 18)
    q[owner.leg_indices] = rng.uniform(-0.5, 0.5, 6) * owner.leg_lengths(np.zeros(18))
    return q


def wrench_conditions(state: spm.Configuration) -> tuple[float, float]:
    """Smallest singular values of the closed form's J_b or J_c, and of its K; lengths in units of d."""
    arms = (state.balls - state.middle_joints.mean(axis=0)) / state.geometry.middle_side
    legs = state.leg_vectors / state.leg_lengths[:, None]
    along, across = (np.concatenate([f, np.cross(arms, f)], axis=-1) for f in (legs, state.leg_axes))

    def smallest(*rows: Array) -> float:
        return float(np.linalg.svd(np.concatenate(rows), compute_uv=False)[-1])

    return min(smallest(along[:3], across[:3]), smallest(along[3:], across[3:])), smallest(across)
