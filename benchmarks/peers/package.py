"""The package's own public functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from benchmarks.peers.c_loop import real_branches
from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin.crosscheck.paper import resultant
from spm_pin.kinematics.inverse_displacement import BranchMemory, branch_lengths


def inverse(problem: tuple[spm.Manipulator, RigidTransform]) -> Prepared:
    """Prepare `inverse_displacement`: ball joints, leg lengths and status of all branches, as the C loop writes."""
    machine, poses = problem

    def call() -> spm.SolutionSet:
        solutions = spm.inverse_displacement(machine, poses)
        _ = solutions.leg_lengths, solutions.status
        return solutions

    return Prepared(call, lambda solutions: real_branches(solutions.middle_joints))


def inverse_physical(problem: tuple[spm.Manipulator, RigidTransform]) -> Prepared:
    """Prepare `inverse_physical`: the physical branch."""
    machine, poses = problem
    return Prepared(
        lambda: spm.inverse_physical(machine, poses), lambda found: real_branches(found.middle_joints[:, None])
    )


def lengths_only(problem: tuple[spm.Manipulator, RigidTransform]) -> Prepared:
    """Prepare `branch_lengths`: lengths and status of all branches; read as the lengths (n, 8, 6)."""
    machine, poses = problem
    return Prepared(lambda: branch_lengths(machine, poses), lambda found: found[0])


def kernel(problem: tuple[spm.Manipulator, RigidTransform]) -> Prepared:
    """Prepare the compiled loop alone, which writes into the same arrays at every call, as the C loop does."""
    from spm_pin.kinematics.kernels.branch_kernels import all_branches

    machine, poses = problem
    matrices = poses.as_matrix()
    rotation, position = np.ascontiguousarray(matrices[:, :3, :3]), np.ascontiguousarray(matrices[:, :3, 3])
    n = len(position)
    results = BranchMemory(machine, n).arrays
    sizes = machine.middle_radius, machine.base_radius, machine.platform_radius

    def call() -> FloatArray:
        all_branches(rotation, position, *sizes, *results)
        return results[2]

    return Prepared(call, real_branches)


def paper_inverse(problem: tuple[spm.Manipulator, RigidTransform]) -> Prepared:
    """Prepare the paper's Eqs. (5)-(20) with Newton steps on Eq. (13)."""
    machine, poses = problem
    return Prepared(
        lambda: resultant.inverse_displacement(machine, poses),
        lambda solutions: real_branches(solutions.middle_joints),
    )


def renewed(configuration: spm.Configuration) -> spm.Configuration:
    """Return the same states without what was derived from them and kept."""
    arrays = configuration.rotation, configuration.translation, configuration.middle_joints
    return spm.Configuration.from_arrays(configuration.machine, *arrays)


def jacobian(configuration: spm.Configuration) -> Prepared:
    """Prepare J_f of states (n,)."""
    return Prepared(lambda: spm.inverse_jacobian(renewed(configuration)), np.asarray)


def forces(problem: tuple[spm.Configuration, FloatArray]) -> Prepared:
    """Prepare the leg forces of states (n,) under wrenches (n, 6)."""
    configuration, wrenches = problem
    return Prepared(lambda: spm.leg_forces(renewed(configuration), wrenches), np.asarray)


def physical(problem: tuple[spm.Manipulator, FloatArray]) -> Prepared:
    """Prepare `forward_physical` of leg lengths (n, 6)."""
    machine, lengths = problem

    def read(configuration: Any) -> FloatArray:
        return np.asarray(configuration.middle_joints)

    return Prepared(lambda: spm.forward_physical(machine, lengths), read)


def modes(problem: tuple[spm.Manipulator, FloatArray]) -> Prepared:
    """Prepare all assembly modes of leg lengths (n, 6); read as their numbers (n,)."""
    machine, lengths = problem
    return Prepared(lambda: spm.forward_displacement(machine, lengths), lambda found: np.asarray(found.count))
