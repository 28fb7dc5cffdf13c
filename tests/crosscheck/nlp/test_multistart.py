from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest
from problems import EXAMPLE, MANIPULATORS, PAPER, at_discriminant, in_leg_space, random_branches
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from spm_pin.crosscheck import nlp
from spm_pin.crosscheck import random_poses as draw
from spm_pin.machine import Status

FAR = spm.pose([3.0, 3.0, 2.0], xyx=[0.1, 0.5, 0.3])


@pytest.mark.parametrize("seed", range(2))
def test_the_paper_s_six_branches_for_every_seed(seed: int) -> None:
    found = nlp.search(PAPER, EXAMPLE, seed=seed)
    assert nlp.search(PAPER, EXAMPLE, seed=seed, starts=5).hits.sum() <= 5
    closed = spm.inverse_displacement(PAPER, EXAMPLE)
    np.testing.assert_array_equal(found.solutions.exists, closed.exists)
    assert found.solutions.count == 6
    difference = (found.solutions.middle_joints - closed.middle_joints)[closed.exists]
    assert np.abs(difference).max() < 1e-9
    assert (np.linalg.norm(difference.reshape(-1, 9), axis=-1) <= found.error_bound[closed.exists]).all()
    assert np.nanmax(found.solutions.residual) < 1e-14
    assert found.hits.sum() <= 512
    assert (found.hits[closed.exists] >= 2).all()


@pytest.mark.parametrize("name", ["paper", "equal triangles"])
@pytest.mark.parametrize("family", spm.machine.FAMILIES)
def test_all_branches_over_all_rotations(name: str, family: str) -> None:
    problem = random_branches(MANIPULATORS[name], family, 4, 17)
    found = nlp.search(problem.machine, problem.pose)
    closed = spm.inverse_displacement(problem.machine, problem.pose)
    np.testing.assert_array_equal(found.solutions.exists, closed.exists)
    difference = np.linalg.norm((found.solutions.middle_joints - closed.middle_joints).reshape(4, 8, 9), axis=-1)
    # The closed form has an error of its own, of the same order as the bound's rounding part.
    assert np.nanmax(difference / found.error_bound) < 1.0
    assert found.isolated[closed.exists].all()


def test_the_set_of_branches_of_a_calibrated_machine() -> None:
    built = PAPER.perturbed(4, length=1e-3, angle=1e-3)
    parts = draw.in_leg_space(built, 8, 1), draw.on_all_rotations(built, 4, 2)
    poses = np.concatenate([part.as_matrix() for part in parts])
    found, closed = nlp.search(built, poses), spm.inverse_displacement(built, poses)
    exists = found.solutions.exists
    assert found.solutions.labels == tuple("12345678")
    np.testing.assert_array_equal(found.solutions.count, closed.count)
    np.testing.assert_array_equal(found.solutions.status, closed.status)
    apart = found.solutions.middle_joints[:, :, None] - closed.middle_joints[:, None]
    distance = np.where(np.isnan(apart), np.inf, apart).reshape(12, 8, 8, 9)
    nearest = np.linalg.norm(distance, axis=-1).min(axis=-1)
    assert (nearest[exists] <= found.error_bound[exists]).all()
    assert found.isolated[exists].all()
    assert (found.hits[exists] > 0).all()


@pytest.mark.parametrize("beyond", [1e-10, -1e-10, -1e-6])
def test_branches_near_a_fold_are_counted_as_by_the_closed_form(beyond: float) -> None:
    for index, family in enumerate(spm.machine.FAMILIES):
        pose = at_discriminant(random_branches(PAPER, family, 1, 41).pose[0], index, beyond, PAPER)
        found, closed = nlp.search(PAPER, pose).solutions, spm.inverse_displacement(PAPER, pose)
        np.testing.assert_array_equal(found.exists, closed.exists)


def test_results_depend_on_pose_and_seed_not_on_the_batch() -> None:
    poses = in_leg_space(PAPER, 4, 2).pose
    grid = poses.as_matrix().reshape(2, 2, 4, 4)
    whole = nlp.search(PAPER, grid, seed=3)
    assert whole.solutions.shape == (2, 2)
    assert whole.hits.shape == whole.sigma.shape == (2, 2, 8)
    alone = nlp.search(PAPER, grid[1, 0], seed=3)
    np.testing.assert_array_equal(alone.hits, whole.hits[1, 0])
    np.testing.assert_array_equal(alone.solutions.middle_joints, whole.solutions.middle_joints[1, 0])
    other = nlp.search(PAPER, grid[1, 0], seed=4)
    assert (other.hits != alone.hits).any()
    assert nlp.search(PAPER, RigidTransform.from_matrix(np.empty((0, 4, 4)))).solutions.shape == (0,)


@pytest.mark.parametrize(
    "pose",
    [
        FAR,
        spm.pose([0.1, 0.1, 2.2], rotation=np.eye(3)),
        spm.pose([0.1, 0.1, 2.2], rotation=np.diag([1.0, -1.0, -1.0])),
    ],
)
def test_an_unreachable_pose_has_its_status_and_infeasibility(pose: RigidTransform) -> None:
    assert spm.inverse_displacement(PAPER, pose).status is Status.UNREACHABLE
    found = nlp.search(PAPER, pose)
    assert found.solutions.status is Status.UNREACHABLE
    assert found.infeasibility > 1e-3
    assert not found.hits.any()


@pytest.mark.parametrize(
    "pose",
    [
        spm.pose([0.0, 0.0, 2.2], rotation=np.eye(3)),
        spm.pose([0.0, 0.1, 2.2], xyx=[0.4, 0.0, 0.0]),
        spm.pose([0.0, 0.0, 2.2], rotation=np.diag([-1.0, -1.0, 1.0])),
    ],
)
def test_points_of_a_continuous_family_are_not_reported_as_branches(pose: RigidTransform) -> None:
    closed = spm.inverse_displacement(PAPER, pose)
    assert closed.status is Status.DEGENERATE
    found = nlp.search(PAPER, pose)
    assert found.solutions.status is Status.DEGENERATE
    np.testing.assert_array_equal(found.solutions.exists, closed.exists)
    assert found.hits.sum() < 512


# --- IPOPT -----------------------------------------------------------------------------------------------------------


def test_ipopt_finds_the_paper_s_branches_none_out_of_reach_and_prints_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    found = nlp.search(PAPER, EXAMPLE, solver="ipopt", starts=80, seed=1)
    closed = spm.inverse_displacement(PAPER, EXAMPLE)
    np.testing.assert_array_equal(found.solutions.exists, closed.exists)
    assert np.nanmax(np.abs(found.solutions.middle_joints - closed.middle_joints)) < 1e-9
    assert np.nanmax(found.solutions.residual) < 1e-14
    assert found.hits.sum() > 60
    unreachable = nlp.search(PAPER, FAR, solver="ipopt", starts=20)
    assert unreachable.solutions.status is Status.UNREACHABLE
    assert unreachable.infeasibility > 0.0
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_ctrl_c_during_a_solve_ends_the_search() -> None:
    """CasADi swallows the signal and reports a failed solve."""
    poses = in_leg_space(PAPER, 500, 8).pose
    nlp.search(PAPER, poses[:1], solver="ipopt", starts=4)  # the solver is made before the clock runs
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.6, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            nlp.search(PAPER, poses, solver="ipopt", starts=4)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)
