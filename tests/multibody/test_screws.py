"""The screws at singularities, applied in Pinocchio: the motions that they allow are free there too."""

from __future__ import annotations

import numpy as np
import pytest
from problems import PAPER_TILTS, singular_state

import spm_pin as spm

pin = pytest.importorskip("pinocchio")

LOWER, STRUCTURE = 0, 2


def platform_jacobian(chain: spm.ClosedChain, q: np.ndarray) -> np.ndarray:
    data = chain.model.createData()
    frame = chain.model.getFrameId("terminal_platform")
    pin.computeJointJacobians(chain.model, data, q)
    pin.updateFramePlacements(chain.model, data)
    return np.array(pin.getFrameJacobian(chain.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED))


def left_over(rows: list[np.ndarray], right_side: list[np.ndarray]) -> float:
    """Return by how much the best joint velocities miss linear conditions on them."""
    matrix, value = np.concatenate(rows), np.concatenate(right_side)
    found = np.linalg.lstsq(matrix, value, rcond=1e-9)[0]
    return float(np.abs(matrix @ found - value).max())


def test_gained_twist_moves_the_platform_with_the_legs_locked() -> None:
    chain = spm.ClosedChain.from_urdf()
    state = singular_state(LOWER, *PAPER_TILTS[LOWER])
    q = chain.joint_values(state)
    gained = spm.singularities(state).gained_twist[LOWER]
    legs = np.eye(18)[chain.leg_indices]
    rows = [chain.constraint_jacobian(q), legs, platform_jacobian(chain, q)]
    assert left_over(rows, [np.zeros(12), np.zeros(6), gained]) < 1e-8
    other = np.random.default_rng(0).normal(size=6)
    assert left_over(rows, [np.zeros(12), np.zeros(6), other]) > 1e-2


def test_lost_wrench_needs_no_leg_and_no_motion_works_on_it() -> None:
    chain = spm.ClosedChain.from_urdf()
    state = singular_state(STRUCTURE, *PAPER_TILTS[STRUCTURE])
    q = chain.joint_values(state)
    found = spm.singularities(state)
    assert np.abs(chain.leg_forces(q, found.lost_wrench)).max() < 1e-8
    assert np.abs(chain.leg_forces(q, np.eye(6)[2])).max() > 1e-2
    # Every motion that keeps the loops closed is reciprocal to it.
    closed = np.linalg.svd(chain.constraint_jacobian(q))[2][12:]
    assert np.abs(found.lost_wrench @ platform_jacobian(chain, q) @ closed.T).max() < 1e-8


def test_inner_twist_moves_the_middle_platform_while_the_terminal_one_stands() -> None:
    chain = spm.ClosedChain.from_urdf()
    state = singular_state(STRUCTURE, *PAPER_TILTS[STRUCTURE])
    q = chain.joint_values(state)
    data = chain.model.createData()
    frame = chain.model.getFrameId("middle_platform")
    pin.computeJointJacobians(chain.model, data, q)
    pin.updateFramePlacements(chain.model, data)
    middle = np.array(pin.getFrameJacobian(chain.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED))
    inner = spm.singularities(state).inner_twist
    centre = state.middle_joints.mean(axis=0)
    at_centre = np.concatenate([inner[:3] + np.cross(inner[3:], centre - state.translation), inner[3:]])
    rows = [chain.constraint_jacobian(q), platform_jacobian(chain, q), middle]
    assert left_over(rows, [np.zeros(12), np.zeros(6), at_centre]) < 1e-8
