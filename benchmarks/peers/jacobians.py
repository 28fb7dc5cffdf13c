"""J_f and leg forces by other methods, per branch."""

from __future__ import annotations

from typing import Any

import numpy as np

import spm_pin as spm
from benchmarks.peers.package import renewed
from benchmarks.peers.peer import FloatArray, Prepared, required
from spm_pin.crosscheck.paper.jacobian import J_alpha, J_lambda


def nine_by_nine(configuration: spm.Configuration) -> Prepared:
    """Prepare the solve of Eq. (30b) alone: J_α and J_λ computed beforehand, all states stacked."""
    left, right = _matrices(configuration)
    return Prepared(lambda: _solved(left, right), np.asarray)


def nine_by_nine_complete(configuration: spm.Configuration) -> Prepared:
    """Prepare J_α and J_λ from the states, and the solve."""
    return Prepared(lambda: _solved(*_matrices(renewed(configuration))), np.asarray)


def forces_by_nine_by_nine(problem: tuple[spm.Configuration, FloatArray]) -> Prepared:
    """Prepare Eq. (33), f = -J_f⁻ᵀ w: a stacked 9 x 9 and a 6 x 6 solve, J_α and J_λ computed beforehand."""
    configuration, wrenches = problem
    left, right = _matrices(configuration)
    return Prepared(lambda: _balanced(_solved(left, right), wrenches), np.asarray)


def forces_by_nine_by_nine_complete(problem: tuple[spm.Configuration, FloatArray]) -> Prepared:
    """Prepare J_α and J_λ from the states, and both solves."""
    configuration, wrenches = problem
    return Prepared(lambda: _balanced(_solved(*_matrices(renewed(configuration))), wrenches), np.asarray)


def _matrices(states: spm.Configuration) -> tuple[FloatArray, FloatArray]:
    """Return J_α (n, 9, 9), and of J_λ the six columns that are not zero."""
    return J_alpha(states), np.ascontiguousarray(J_lambda(states)[..., :6])


def _solved(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(left, right)[..., :6, :])


def _balanced(jacobian: FloatArray, wrenches: FloatArray) -> FloatArray:
    return np.asarray(-np.linalg.solve(np.swapaxes(jacobian, -1, -2), wrenches[..., None])[..., 0])


def pinocchio(configuration: spm.Configuration) -> Prepared:
    """Prepare J_f from Pinocchio's constraint Jacobians, state by state, joint values computed beforehand."""
    chain, joints = _placed(configuration)
    state = chain.state(joints[0])
    return Prepared(lambda: [state.update(q).inverse_jacobian() for q in joints], np.array)


def forces_by_pinocchio(problem: tuple[spm.Configuration, FloatArray]) -> Prepared:
    """Prepare the forces from Pinocchio's constraint Jacobians, state by state, joint values computed beforehand."""
    configuration, wrenches = problem
    chain, joints = _placed(configuration)
    state = chain.state(joints[0])
    return Prepared(lambda: [state.update(q).leg_forces(w) for q, w in zip(joints, wrenches, strict=True)], np.array)


def _placed(configuration: spm.Configuration) -> tuple[Any, list[FloatArray]]:
    required("pinocchio", "pin")
    from spm_pin.multibody.chain import ClosedChain

    chain = ClosedChain.from_urdf(machine=configuration.machine)
    return chain, [chain.joint_values(configuration[k]) for k in range(len(configuration))]
