"""Public functions over the kernels: compared with plain matrices, and in no more memory than the answer."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from problems import GEOMETRIES, in_leg_space, random_branches

import spm_pin as spm
from spm_pin.kinematics.batches import threads
from spm_pin.kinematics.inverse_displacement import branch_lengths
from spm_pin.kinematics.rates_and_forces import force_matrices
from spm_pin.kinematics.singularity_analysis import determinants

EPS = np.finfo(float).eps
PAPER = spm.Geometry.paper()


@pytest.mark.parametrize("name", GEOMETRIES)
@pytest.mark.parametrize("modes", spm.mechanism.FAMILIES)
def test_the_three_equations_solve_the_six(name: str, modes: str) -> None:
    """Solutions from determinants of three equations solve the 6 x 6 systems of all forces."""
    problem = random_branches(GEOMETRIES[name], modes, 500, seed=1)
    state = problem.configuration
    matrices = force_matrices(state)
    stages, structure = matrices[:, :2], matrices[:, 2]
    lever = state.translation - state.middle_joints.mean(axis=-2)
    d = problem.geometry.middle_side

    # The twists (v, dω) at the middle platform's centre that J_b and J_c turn into unit rates.
    linear, angular = np.split(spm.kinematics.platform_jacobian(state), 2, axis=-2)
    centred = np.concatenate([linear + np.cross(lever[:, :, None], angular, axis=-2), d * angular], axis=-2)
    rates = stages @ np.stack([centred[..., :3], centred[..., 3:]], axis=-3)
    size = (
        np.linalg.norm(stages, axis=(-1, -2))[..., None, None]
        * np.linalg.norm(centred, axis=-2).max(axis=-1)[:, None, None, None]
    )
    assert (np.abs(rates - np.eye(6)[:, :3]) <= 64 * EPS * size).all()

    # K takes a middle platform's twist to what the structure carries; all three maps agree.
    wrench = np.random.default_rng(2).normal(size=6)
    forces = spm.leg_forces(state, wrench)
    np.testing.assert_allclose(
        forces, -np.swapaxes(spm.kinematics.platform_jacobian(state), -1, -2) @ wrench, rtol=1e-9
    )
    both = spm.inverse_jacobian(state) @ spm.kinematics.platform_jacobian(state)
    condition = np.linalg.cond(structure) * np.linalg.cond(stages).max(axis=-1)
    assert (np.abs(both - np.eye(6)).max(axis=(-1, -2)) <= 256 * EPS * condition * (1.0 + d + 1.0 / d)).all()


@pytest.mark.parametrize("name", GEOMETRIES)
def test_determinants_are_those_of_the_matrices(name: str) -> None:
    state = random_branches(GEOMETRIES[name], "TT", 500, seed=3).configuration
    found = determinants(state)
    d = state.geometry.middle_side
    np.testing.assert_allclose(found, np.linalg.det(force_matrices(state)) * d**3, rtol=0, atol=64 * EPS * d**3)
    assert determinants(state[0]).shape == (3,)
    absent = spm.inverse_displacement(PAPER, in_leg_space(PAPER, 50, seed=4).pose).configurations
    np.testing.assert_array_equal(np.isnan(determinants(absent)).all(axis=-1), ~absent.exists)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,), (5,)])
def test_lengths_alone_are_those_of_the_branches(shape: tuple[int, ...]) -> None:
    pose = random_branches(PAPER, "TF", int(np.prod(shape)), seed=5).pose.as_matrix().reshape(*shape, 4, 4)
    solutions = spm.inverse_displacement(PAPER, pose)
    lengths, status = branch_lengths(PAPER, pose)
    assert lengths.shape == (*shape, 8, 6)
    assert status.shape == shape
    np.testing.assert_array_equal(lengths, solutions.leg_lengths)
    np.testing.assert_array_equal(status, solutions.status)


def test_branch_lengths_flag_a_degenerate_pose() -> None:
    poses = [spm.pose([0, 0, 2.2], rotation=np.eye(3)), spm.pose([9, 9, 2], rotation=np.diag([1.0, -1, -1]))]
    _, status = branch_lengths(PAPER, np.stack([pose.as_matrix() for pose in poses]))
    assert list(status) == [spm.Status.DEGENERATE, spm.Status.UNREACHABLE]
    with pytest.raises(spm.PoseError, match="pose: expected finite"):
        branch_lengths(PAPER, np.diag([1.0, np.nan, 1.0, 1.0]))


@pytest.mark.parametrize("index", [0, 17, 40])
def test_one_rough_rotation_is_repaired_and_the_others_keep_their_bits(index: int) -> None:
    exact = random_branches(PAPER, "TT", 41, seed=6).pose.as_matrix()
    rough = exact.copy()
    rough[index, :3, :3] = rough[index, :3, :3].astype(np.float32)
    before, after = spm.inverse_displacement(PAPER, exact), spm.inverse_displacement(PAPER, rough)
    others = np.arange(41) != index
    np.testing.assert_array_equal(before.middle_joints[others], after.middle_joints[others])
    alone = spm.inverse_displacement(PAPER, rough[index])
    np.testing.assert_array_equal(alone.middle_joints, after.middle_joints[index])
    assert np.abs(after.rotation[index] @ after.rotation[index][0].T - np.eye(3)).max() < 4 * EPS
    np.testing.assert_array_equal(rough[others], exact[others])


def peak_of(call: Callable[[], object]) -> tuple[object, int]:
    call()
    tracemalloc.start()
    try:
        result = call()
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("count", [1, 2])
def test_a_batch_takes_the_memory_of_its_answer(count: int) -> None:
    n = 50_000
    pose = in_leg_space(PAPER, n, seed=7).pose.as_matrix()
    with threads(count):
        solutions, peak = peak_of(lambda: spm.inverse_displacement(PAPER, pose))
        assert isinstance(solutions, spm.SolutionSet)
        # b, lengths, discriminants, the pose, the status, the flags; degeneracies are zeros never touched.
        assert peak <= 1.02 * n * 8 * (72 + 48 + 4 + 16 + 4)
        (lengths, _), peak = peak_of(lambda: branch_lengths(PAPER, pose))
        assert peak <= 1.02 * n * 8 * (48 + 3)
        _, peak = peak_of(lambda: spm.forward_physical(PAPER, lengths[:, 0]))
        assert peak <= 1.05 * n * 8 * (9 + 3 + 9 + 6)
        states = solutions.configurations
        matrices, peak = peak_of(lambda: spm.inverse_jacobian(states))
        assert isinstance(matrices, np.ndarray)
        assert peak <= 1.02 * (matrices.nbytes + 8 * n)
