"""Which families are real, and how far from the computed joints the exact ones are: proved, against ball arithmetic."""

from __future__ import annotations

import flint
import mpmath
import numpy as np
import pytest
from oracle import discriminants, quaternion_of, rotation_rows
from problems import MANIPULATORS, PAPER, at_discriminant, in_leg_space, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.formulas.branches import ROUNDING_BOUND


@pytest.fixture(autouse=True)
def default_precision() -> None:
    """The package sets the precision of its balls itself; the oracle leaves its own behind."""
    flint.ctx.default()


def poses(count: int, seed: int, size: float = 0.6) -> RigidTransform:
    """Return poses of all orientations, half of them nearly level, nearly turned over, or beside another half turn."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(count, rng=seed)
    near = Rotation.from_rotvec(rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-9.0, 0.0, (count, 1)))
    axis = np.eye(3)[rng.integers(0, 3, count)] * np.pi * rng.integers(0, 3, (count, 1)) / 2.0
    special = near * Rotation.from_rotvec(axis)
    half = np.arange(count) % 2 == 0
    matrices = np.where(half[:, None, None], rotation.as_matrix(), special.as_matrix())
    place = rng.normal(size=(count, 3)) * size * np.where(half, 1.0, 10.0 ** rng.uniform(-6.0, 2.0, count))[:, None]
    return spm.pose(place, rotation=matrices)


def folds(family: int, count: int, seed: int, beyond: float) -> RigidTransform:
    """Return poses at which the two branches of a family of the paper's machine are about to meet, to `beyond` [m]."""
    poses = random_branches(PAPER, spm.machine.FAMILIES[family], count, seed).pose
    shares = np.random.default_rng(seed).uniform(-1.0, 1.0, count)
    return RigidTransform.concatenate(
        [at_discriminant(pose, family, beyond * share, PAPER) for pose, share in zip(poses, shares, strict=True)]
    )


def check_against_balls(machine: spm.Manipulator, *answers: spm.SolutionSet) -> None:
    """Check of answers for the same poses that no family is said to be certainly real, or not, that is otherwise."""
    rotation, position = answers[0].rotation[:, 0], answers[0].translation[:, 0]
    claims = [(solutions.certain, solutions.exists[:, ::2]) for solutions in answers]
    for n in range(len(position)):
        values = discriminants(rotation[n], position[n], machine.middle_side)
        for certain, exists in claims:
            for family in np.flatnonzero(certain[n]):
                value = values[family]
                if not (value > 0 or value < 0):
                    value = discriminants(rotation[n], position[n], machine.middle_side, bits=2000)[family]
                assert value >= 0 if exists[n, family] else value < 0


@pytest.mark.parametrize("name", MANIPULATORS)
def test_rounding_error_of_a_discriminant_is_below_its_bound(name: str) -> None:
    machine = MANIPULATORS[name]
    solutions = spm.inverse_displacement(machine, poses(200, 3, machine.middle_side))
    position = solutions.translation[:, 0]
    allowed = (1.0 + np.abs(position[:, :2]).sum(axis=-1) / machine.middle_radius) ** 2
    for n in range(200):
        exact = discriminants(solutions.rotation[n, 0], position[n], machine.middle_side, bits=300)
        for computed, ball in zip(solutions.discriminants[n], exact, strict=True):
            # The bound is a sum of worst cases; a fiftieth of it is never reached.
            assert abs(float(computed) - ball) <= ROUNDING_BOUND * float(allowed[n]) / 50.0


@pytest.mark.parametrize(
    ("machine", "count", "seed", "size"),
    [
        *((machine, 200, 4, machine.middle_side) for machine in MANIPULATORS.values()),
        pytest.param(PAPER, 60_000, 0, 0.6, marks=pytest.mark.slow),
    ],
)
def test_generic_poses_are_certain_and_right(machine: spm.Manipulator, count: int, seed: int, size: float) -> None:
    solutions = spm.inverse_displacement(machine, poses(count, seed, size))
    assert solutions.certain[::2].all()
    check_against_balls(machine, solutions)


@pytest.mark.parametrize("family", range(4))
def test_folds_are_uncertain_and_their_counts_then_corrected(family: int) -> None:
    pose = folds(family, 80, family, 2e-16)
    plain = spm.inverse_displacement(PAPER, pose)
    settled = spm.inverse_displacement(PAPER, pose, certify=True)
    assert not plain.certain[:, family].any()
    assert settled.certain.all()
    check_against_balls(PAPER, plain, settled)
    np.testing.assert_array_equal(np.isfinite(settled.radius), settled.exists)
    assert (settled.residual[settled.exists] < 1e-13).all()
    # A wrong count is corrected, and nothing else changed.
    others = np.delete(np.arange(8), [2 * family, 2 * family + 1])
    np.testing.assert_array_equal(settled.middle_joints[:, others], plain.middle_joints[:, others])
    assert (plain.exists != settled.exists).any()
    np.testing.assert_array_equal(settled.status == spm.Status.OK, settled.exists.any(axis=-1))


def test_settled_families_keep_labels_and_the_physical_choice() -> None:
    pose = folds(0, 200, 11, 1e-13)
    plain, settled = spm.inverse_displacement(PAPER, pose), spm.inverse_displacement(PAPER, pose, certify=True)
    both = plain.exists & settled.exists
    apart = np.abs(plain.middle_joints - settled.middle_joints)[both].max(axis=(-1, -2))
    assert both[:, :2].sum() > 100
    # Rounding of the discriminant moves the joints by its root.
    assert apart.max() < 1e-5
    wide = np.abs(settled.middle_joints[:, 0] - settled.middle_joints[:, 1]).max(axis=(-1, -2)) > 1e-6
    assert wide.any()
    assert (np.abs(plain.middle_joints - settled.middle_joints)[wide][:, :2] < 1e-7).all()
    unchanged = (plain.exists == settled.exists).all(axis=-1)
    assert (plain.is_physical == settled.is_physical)[unchanged].mean() > 0.95


def newton(solutions: spm.SolutionSet, n: int, branch: int, side: float) -> np.ndarray:
    """Return the exact joints (3, 3) beside computed ones: nine loop equations by Newton's method with fifty digits."""
    with mpmath.workdps(60):
        x0, *vector = quaternion_of(solutions.rotation[n, 0])
        rows = [[mpmath.mpf(int(x.p)) / int(x.q) for x in row] for row in rotation_rows([*vector, x0])]
        o = [mpmath.mpf(float(v)) for v in solutions.translation[n, 0]]
        half_root = mpmath.sqrt(3) / 2
        below = [[mpmath.mpf(1) / 2, half_root, 0], [-1, 0, 0], [mpmath.mpf(1) / 2, -half_root, 0]]
        above = [[sum(row[k] * axis[k] for k in range(3)) for row in rows] for axis in below]

        def equations(*b: object) -> list[object]:
            joints = [b[0:3], b[3:6], b[6:9]]
            planes = [sum(axis[k] * joints[i][k] for k in range(3)) for i, axis in enumerate(below)]
            planes += [sum(axis[k] * (joints[i][k] - o[k]) for k in range(3)) for i, axis in enumerate(above)]
            sides = [sum((joints[i][k] - joints[i - 1][k]) ** 2 for k in range(3)) for i in range(3)]
            return planes + [square - mpmath.mpf(side) ** 2 for square in sides]

        start = [mpmath.mpf(float(v)) for v in solutions.middle_joints[n, branch].ravel()]
        exact = mpmath.findroot(equations, start, tol=1e-80, maxsteps=30)
        moved = [float(a - b) for a, b in zip(exact, start, strict=True)]
    return np.array(moved).reshape(3, 3)


def test_exact_joints_are_within_radii_that_tell_branches_apart() -> None:
    nearly_meeting = folds(3, 20, 6, 1e-13)
    for pose in (in_leg_space(PAPER, 2, 1).pose, random_branches(PAPER, "TF", 2, 2).pose, nearly_meeting):
        solutions = spm.inverse_displacement(PAPER, pose, certify=True)
        places = np.argwhere(solutions.exists)
        if pose is nearly_meeting:
            real = solutions.exists[:, 6]
            assert real.sum() >= 5
            pair = solutions.middle_joints[real, 6:8]
            between = np.linalg.norm(pair[:, 0] - pair[:, 1], axis=-1).max(axis=-1)
            assert (solutions.radius[real, 6:8].sum(axis=-1) < between).all()
            places = [(n, 6) for n in np.flatnonzero(real)[:5]]
        for n, branch in places:
            apart = np.linalg.norm(newton(solutions, n, branch, PAPER.middle_side), axis=-1).max()
            assert apart <= solutions.radius[n, branch]
            assert pose is nearly_meeting or solutions.radius[n, branch] < 1e-10


def test_continuous_families_and_parallel_axes_are_not_certain() -> None:
    home = spm.inverse_displacement(PAPER, spm.pose([0, 0, 2.5], rotation=np.eye(3)), certify=True)
    assert not home.certain.any()
    # A rotation about the axis of a leg, on the axis of the base: all four families are continuous.
    axis = PAPER.revolute_axes[0]
    symmetric = spm.inverse_displacement(
        PAPER, spm.pose([0, 0, 2.5], rotation=Rotation.from_rotvec(0.4 * axis)), certify=True
    )
    assert not (symmetric.certain & symmetric.degeneracy.families).any()
    assert symmetric.status is spm.Status.DEGENERATE


def test_proofs_are_kept_by_parts() -> None:
    pose = folds(1, 4, 7, 1e-15)
    solutions = spm.inverse_displacement(PAPER, pose, certify=True)
    np.testing.assert_array_equal(solutions[1].certain, solutions.certain[1])
    np.testing.assert_array_equal(solutions[2].radius, solutions.radius[2])
    few = solutions.within(spm.LegLimits(0.5, 0.9))
    np.testing.assert_array_equal(few.certain, solutions.certain)
    assert np.isnan(few.radius[~few.exists]).all()
    alone = spm.inverse_displacement(PAPER, pose[0], certify=True)
    np.testing.assert_array_equal(alone.radius, solutions.radius[0])
    assert spm.inverse_displacement(PAPER, pose).radius is None
