"""Known branches are found, their number is certified, and the closure holds to rounding."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
import pytest
from oracle import certified_counts
from problems import MANIPULATORS, PAPER, Problem, conditioning, in_leg_space, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.kinematics.inverse_displacement import complex_middle_joints, inverse_physical
from spm_pin.machine.branch_of_state import branch_sign, family

EPS = np.finfo(float).eps


def assert_closed(solutions: spm.SolutionSet) -> None:
    """Closure to 64 roundings of the largest coordinate: 1e-14 m for a machine of the paper's size."""
    exists = solutions.exists
    size = np.abs(solutions.middle_joints[exists]).max(axis=(-1, -2), initial=solutions.machine.middle_side)
    assert (solutions.residual[exists] <= 64 * EPS * size).all()


@pytest.mark.parametrize(("name", "modes"), [("paper", "in leg space"), *product(MANIPULATORS, spm.machine.FAMILIES)])
def test_the_known_branch_is_among_those_found(name: str, modes: str) -> None:
    by_legs = modes == "in leg space"
    problem = in_leg_space(PAPER, 2_000, 2) if by_legs else random_branches(MANIPULATORS[name], modes, 1_000, seed=1)
    solutions = spm.inverse_displacement(problem.machine, problem.pose)
    assert (solutions.status == spm.Status.OK).all()
    assert_closed(solutions)
    found = solutions.nearest(problem.configuration)
    error = np.abs(found.middle_joints - problem.middle_joints).max(axis=(-1, -2))
    assert (error <= 32 * EPS * conditioning(problem.configuration)).all()
    assert np.median(error) < 1e-15 * 10 * problem.machine.middle_side
    if by_legs:
        assert set(np.unique(solutions.count)) == {4, 6, 8}
    else:
        # And it is found under its own name.
        assert (family(found) == spm.machine.FAMILIES.index(modes)).all()


@pytest.mark.parametrize(("count", "seed"), [(480, 5), pytest.param(2_400, 6, marks=pytest.mark.slow)])
def test_the_number_of_branches_is_certified(count: int, seed: int) -> None:
    """In leg space, over all rotations, and where most poses have none."""
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count // 2, 3)) * [0.4, 0.4, 2.0]
    pose = spm.pose(position, rotation=Rotation.random(count // 2, rng=rng))
    anywhere = Problem(PAPER, pose, np.full((count // 2, 3, 3), np.nan))
    problems = [anywhere, in_leg_space(PAPER, count, seed=seed)]
    for k, machine in enumerate(MANIPULATORS.values()):
        problems += [random_branches(machine, modes, count // 16, seed + k) for modes in spm.machine.FAMILIES]
    for problem in problems:
        solutions = spm.inverse_displacement(problem.machine, problem.pose)
        assert_closed(solutions)
        np.testing.assert_array_equal(solutions.count, certified_counts(problem.pose, problem.machine.middle_side))
        assert (solutions.status == np.where(solutions.count > 0, spm.Status.OK, spm.Status.UNREACHABLE)).all()
        assert problem is not anywhere or 0.05 < (solutions.count == 0).mean() < 0.95


def test_every_label_says_what_its_branch_is() -> None:
    solutions = spm.inverse_displacement(PAPER, random_branches(PAPER, "TT", 1_000, seed=8).pose)
    for k, label in enumerate(solutions.labels):
        state = solutions[label][solutions.exists[:, k]]
        assert (family(state) == spm.machine.FAMILIES.index(label[:2])).all()
        assert (branch_sign(state) * (1 if label[2] == "+" else -1) > 0.0).all()


def test_complex_roots_solve_the_closure_equations_and_contain_the_real_ones() -> None:
    pose = in_leg_space(PAPER, 500, seed=11).pose
    roots = complex_middle_joints(PAPER, pose)
    sides = ((roots - np.roll(roots, 1, axis=-2)) ** 2).sum(axis=-1)
    scale = np.abs(roots).max(axis=(-1, -2, -3))
    assert (np.abs(sides - PAPER.middle_side**2).max(axis=(-1, -2)) <= 1e3 * EPS * scale**2).all()
    lower = (roots * PAPER.revolute_axes).sum(axis=-1)
    offsets = roots - pose.translation[:, None, None, :]
    axes = PAPER.revolute_axes @ np.swapaxes(pose.rotation.as_matrix(), -1, -2)
    upper = (offsets * axes[:, None]).sum(axis=-1)
    assert (np.abs(lower).max(axis=(-1, -2)) <= 1e3 * EPS * scale).all()
    assert (np.abs(upper).max(axis=(-1, -2)) <= 1e3 * EPS * scale).all()
    real = spm.inverse_displacement(PAPER, pose)
    np.testing.assert_array_equal(roots[real.exists].imag, 0.0)
    np.testing.assert_allclose(roots[real.exists].real, real.middle_joints[real.exists], rtol=0, atol=1e-12)
    pairs = roots.reshape(-1, 4, 2, 3, 3)
    absent = ~real.exists.reshape(-1, 4, 2).all(axis=-1)
    np.testing.assert_allclose(pairs[absent, 0], pairs[absent, 1].conj(), rtol=1e-9)


def test_labels_follow_a_branch_along_a_path() -> None:
    """A label changes hands only at an inverse singularity, on loops over all orientations."""
    rng = np.random.default_rng(12)
    steps = np.linspace(0.0, 2 * np.pi, 4_001)
    followed = 0
    for _ in range(6):
        axis = np.cumsum(rng.normal(size=(4, 3)) / [[1], [2], [3], [4]], axis=0)
        angles = sum(np.sin(k * steps)[:, None] * axis[k - 1] for k in range(1, 4))
        aside = rng.normal(size=(2, 3)) * [0.15, 0.15, 0.3]
        position = [0, 0, 2.2] + np.cos(steps)[:, None] * aside[0] + np.sin(steps)[:, None] * aside[1]
        solutions = spm.inverse_displacement(PAPER, spm.pose(position, rotation=Rotation.from_rotvec(angles)))
        determinant = np.abs(branch_sign(solutions.configurations))
        joints = solutions.middle_joints
        for k, label in enumerate(solutions.labels):
            here, ahead = joints[:-1, k], joints[1:]
            moved = np.linalg.norm(ahead - here[:, None], axis=-1).max(axis=-1)
            # det K is at most (9/4) d² r = 0.67 m³; a step this long stays on its side of zero above 0.01.
            regular = (determinant[:-1, k] > 0.01) & (determinant[1:, k] > 0.01)
            followed += np.count_nonzero(regular)
            nearest = np.where(np.isnan(moved), np.inf, moved)[regular].argmin(axis=-1)
            assert (nearest == k).all(), label
    assert followed > 20_000


def test_a_pose_object_of_another_library_is_read_without_importing_it() -> None:
    class Se3:
        rotation = Rotation.from_euler("XYX", [-11.08, 32.97, -12.88], degrees=True).as_matrix()
        translation = np.array([0.6889, 0.4963, 2.253])

    expected = spm.inverse_displacement(PAPER, spm.pose(Se3.translation, rotation=Se3.rotation))
    for other in (Se3(), expected.configurations[0].pose.as_matrix(), expected.configurations[0].pose):
        np.testing.assert_array_equal(spm.inverse_displacement(PAPER, other).middle_joints, expected.middle_joints)
    assert isinstance(expected.configurations[0].pose, RigidTransform)


@pytest.mark.parametrize("limits", [None, spm.LegLimits(1.1, 1.5)])
def test_the_physical_branch_alone_is_that_of_all(limits: spm.LegLimits | None) -> None:
    machine, pose = dataclasses.replace(PAPER, limits=limits), in_leg_space(PAPER, 500, seed=12).pose
    solutions, found = spm.inverse_displacement(machine, pose), inverse_physical(machine, pose)
    chosen = solutions.physical()
    for name in ("rotation", "translation", "middle_joints", "leg_lengths"):
        np.testing.assert_array_equal(getattr(found, name), getattr(chosen, name), err_msg=name)
    if limits is None:
        # The rule itself, on the configurations.
        np.testing.assert_array_equal(solutions.configurations.is_at_home, solutions.is_physical)


def test_a_pose_without_a_physical_branch_says_why() -> None:
    pose = spm.pose([9, 9, 2], rotation=np.diag([1.0, -1, -1]))
    assert repr(inverse_physical(PAPER, pose)) == repr(spm.inverse_displacement(PAPER, pose).physical())
    assert not inverse_physical(PAPER, pose).exists


def test_complex_roots_are_nan_at_level_and_at_symmetric_poses() -> None:
    regular = in_leg_space(PAPER, 3, seed=15).pose.as_matrix()
    level = [spm.pose(o, rotation=np.eye(3)).as_matrix() for o in ([0, 0, 2.2], [0.1, 0.2, 2.2])]
    half = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix()
    symmetric = [spm.pose([0.0, 0.1, 2.2], rotation=half).as_matrix()]
    symmetric += [
        spm.pose([0.0, y, 2.2], rotation=Rotation.from_rotvec([a, 0.0, 0.0])).as_matrix()
        for a in (0.3, 1.0, np.pi / 2)
        for y in (0.0, 0.2)
    ]
    together = complex_middle_joints(PAPER, np.stack([*regular, *level, *symmetric]))
    np.testing.assert_array_equal(together[:3], complex_middle_joints(PAPER, regular))
    assert np.isnan(together[3:5]).all()
