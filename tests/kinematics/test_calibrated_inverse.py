"""Inverse displacement of machines as built: all roots certified, labels carried from the nominal machine."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from calibrated_oracle import certified_real_branches, distance_to_root
from error_fields import with_fields
from problems import EXAMPLE, MANIPULATORS, PAPER, as_built, at_discriminant, in_leg_space, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.kinematics import complex_middle_joints

DIRECTION = np.random.default_rng(1).standard_normal(54)
SIZES = (1e-9, 1e-5, 1e-3, 1e-2, 5e-2)


def along(size: float) -> spm.Manipulator:
    return PAPER.from_parameters(PAPER.parameters + size * DIRECTION)


@pytest.mark.parametrize(("machines", "poses"), [(4, 2), pytest.param(12, 4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", MANIPULATORS)
def test_all_eight_roots_are_certified(name: str, size: float, machines: int, poses: int) -> None:
    machine, families = MANIPULATORS[name], spm.machine.FAMILIES
    for seed in range(machines):
        built = as_built(machine, size, seed)
        pose = random_branches(machine, families[seed % 4], poses, seed=1000 + seed).pose
        solutions, joints = spm.inverse_displacement(built, pose), complex_middle_joints(built, pose)
        assert not (solutions.status == spm.Status.UNSOLVED).any()
        exists = solutions.exists
        assert np.nanmax(solutions.residual, initial=0.0) <= 1e-13 * machine.middle_side
        np.testing.assert_array_equal(joints.imag.any(axis=(-1, -2)), ~exists)
        np.testing.assert_array_equal(joints.real[exists], solutions.middle_joints[exists])
        for k in range(poses):
            matrix = pose[k].as_matrix()
            proved = certified_real_branches(built, matrix[:3, :3], matrix[:3, 3], joints[k])
            assert proved == solutions.count[k], (name, size, seed, k)


@pytest.mark.parametrize("name", ["paper", "equal triangles"])
def test_vanishing_errors_lead_to_the_nominal_branches_under_their_labels(name: str) -> None:
    machine = MANIPULATORS[name]
    pose = random_branches(machine, "TT", 300, seed=8).pose
    nominal = spm.inverse_displacement(machine, pose)
    # Away from the singularities at which branches of a family or of two families meet.
    apart = np.abs(nominal.middle_joints[:, :, None] - nominal.middle_joints[:, None]).max(axis=(-1, -2))
    apart = np.where(np.eye(8, dtype=bool) | np.isnan(apart), np.inf, apart) / machine.middle_side
    clear = (apart.min(axis=(-1, -2)) > 1e-2) & (np.abs(nominal.discriminants).min(axis=-1) > 1e-3)
    assert clear.sum() > 150
    errors = []
    for size in (1e-11, 1e-9):
        built = spm.inverse_displacement(as_built(machine, size, seed=9), pose)
        np.testing.assert_array_equal(built.exists[clear], nominal.exists[clear])
        assert not built.merged[clear].any()
        moved = np.abs(built.middle_joints - nominal.middle_joints)[clear][nominal.exists[clear]]
        errors.append(np.median(moved.max(axis=(-1, -2))) / machine.middle_side)
    # In proportion to the errors.
    assert errors[0] < 1e-9
    assert errors[1] / errors[0] == pytest.approx(100.0, rel=0.05)


def test_labels_are_continuous_in_the_errors_until_branches_meet() -> None:
    """Followed in small steps by nearness alone, every branch keeps its label until the two of a pair vanish."""
    pose = in_leg_space(PAPER, 30, seed=5).pose
    before = spm.inverse_displacement(PAPER, pose)
    lost = np.zeros(before.exists.shape, dtype=bool)
    for size in np.linspace(0.0, 2e-4, 201)[1:]:
        now = spm.inverse_displacement(along(float(size)), pose)
        assert not (lost & ~now.merged).any(), "a label that was lost came back as if nothing had been"
        kept = before.exists & ~lost & now.exists & ~now.merged
        distance = np.abs(before.middle_joints[:, :, None] - now.middle_joints[:, None]).max(axis=(-1, -2))
        nearest = np.where(np.isnan(distance), np.inf, distance).argmin(axis=-1)
        step = np.take_along_axis(distance, nearest[..., None], -1)[..., 0]
        clear = kept & (step < 1e-3)
        np.testing.assert_array_equal(nearest[clear], np.broadcast_to(np.arange(8), nearest.shape)[clear])
        newly = before.exists & ~lost & now.merged
        for problem in np.flatnonzero(newly.any(axis=-1)):
            # Whoever is lost has met another one that is lost with it; the two were near each other.
            members = np.flatnonzero(newly[problem])
            assert len(members) % 2 == 0, (size, problem, members)
            joints = before.middle_joints[problem, members]
            gaps = np.abs(joints[:, None] - joints[None]).max(axis=(-1, -2)) + np.diag(np.full(len(members), np.inf))
            assert (gaps.min(axis=-1) < 0.35).all(), (size, problem, members)
        lost |= now.merged
        before = now
    assert lost.any()


def meeting(resolution: float) -> tuple[float, float]:
    """Sizes of the errors below and above which two branches of the paper's example meet, to a relative resolution."""
    low, high = 1e-6, 1e-4
    assert [spm.inverse_displacement(along(size), EXAMPLE).count for size in (low, high)] == [6, 4]
    while high / low - 1.0 > resolution:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spm.inverse_displacement(along(middle), EXAMPLE).count == 6 else (low, middle)
    return low, high


def test_two_branches_of_the_papers_example_end_where_they_meet_in_an_inverse_singularity() -> None:
    before, after = (spm.inverse_displacement(along(size), EXAMPLE) for size in meeting(1e-10))
    gone = before.exists & ~after.exists
    assert gone.sum() == 2
    assert np.abs(np.diff(before.middle_joints[gone], axis=0)).max() < 1e-4
    np.testing.assert_array_equal(after.merged, gone)
    np.testing.assert_allclose(after.middle_joints[after.exists], before.middle_joints[after.exists], atol=1e-8)
    described = spm.singularities(before.configurations)
    assert (described.sigma[gone, 2] < 1e-6).all()
    assert (described.sigma[before.exists & ~gone, 2] > 1e-5).all()
    assert np.sign(spm.determinants(before.configurations)[gone, 2]).sum() == 0
    near = spm.singularities(before.configurations, tolerance=1e-5)
    assert (near.kind[gone] == spm.kinematics.SingularityKind.INVERSE).all()
    assert (near.mobility[gone] == 5).all()
    # No motion of the platform does work on the lost wrench: the legs do not carry it.
    state = before.configurations[int(np.flatnonzero(gone)[0])]
    assert np.abs(spm.leg_forces(state, described.lost_wrench[gone][0])).max() < 1e-4
    # The middle platform moves with both ends at rest, from one branch to the other.
    gap = np.diff(before.configurations[gone].balls, axis=0)[0]
    twist = described.inner_twist[gone][0]
    velocity = twist[:3] + np.cross(twist[3:], state.balls - state.translation)
    cosine = (gap * velocity).sum() / np.linalg.norm(gap) / np.linalg.norm(velocity)
    assert abs(cosine) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 1e-2])
@pytest.mark.parametrize("name", MANIPULATORS)
def test_the_physical_branch_alone_is_that_of_all_branches(name: str, size: float) -> None:
    machine = MANIPULATORS[name]
    built, pose = as_built(machine, size, seed=3), random_branches(machine, "TT", 500, seed=2).pose
    chosen, alone = spm.inverse_displacement(built, pose).physical(), spm.inverse_physical(built, pose)
    assert chosen.exists.any()
    np.testing.assert_allclose(alone.middle_joints, chosen.middle_joints, atol=1e-11 * machine.middle_side)
    np.testing.assert_allclose(alone.leg_lengths, chosen.leg_lengths, rtol=1e-11)
    np.testing.assert_array_equal(alone.translation, chosen.translation)
    assert np.nanmax(alone.closure_residual) <= 1e-14 * machine.middle_side


def test_outcomes_that_are_no_branches_are_statuses() -> None:
    built = as_built(PAPER, 1e-3, seed=6)
    far = spm.inverse_displacement(built, spm.pose([50.0, 0.0, 2.0], rotation=Rotation.from_rotvec([0.1, 0.2, 0.0])))
    assert far.status is spm.Status.UNREACHABLE
    # Offsets leave the planes as they are drawn: level ones, that say nothing of the height.
    offsets = replace(PAPER, legs=replace(PAPER.legs, offsets=np.full(6, 1e-3)))
    level = spm.inverse_displacement(offsets, spm.pose([0.0, 0.0, 2.2], rotation=np.eye(3)))
    assert level.status is spm.Status.DEGENERATE
    assert level.count == 0
    assert not level.physical().exists
    tilted = spm.inverse_displacement(offsets, EXAMPLE)
    nominal = spm.inverse_displacement(PAPER, EXAMPLE)
    np.testing.assert_allclose(tilted.leg_lengths, nominal.leg_lengths, atol=1e-9)
    np.testing.assert_allclose(tilted.readings, nominal.leg_lengths + 1e-3, atol=1e-9)


# Near level poses a branch far from physical became the physical one: which was not looked at, or lost to its partner.
MISSED = [
    (754572008, 7.559494563531443e-05, "1.41915275 1.23131409 1.42200633 1.47385439 1.4710534 1.47088554"),
    (226073069, 6.55e-4, "1.3938 1.4022 1.4303 1.3703 1.3602 1.3452"),
    (321997600, 0.0004410194809943684, "1.2186 1.2713 1.3458 1.3139 1.2595 1.1852"),
]


@pytest.mark.parametrize(("seed", "size", "readings"), MISSED)
def test_the_physical_branch_within_the_limits_is_not_missed(seed: int, size: float, readings: str) -> None:
    built, expected = PAPER.perturbed(seed, length=size, angle=size), np.array(readings.split(), dtype=float)
    pose = spm.forward_physical(built, expected).pose
    np.testing.assert_allclose(spm.inverse_physical(built, pose).readings, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("seeds", "poses", "least"),
    [(range(4), 3000, 11_400), pytest.param(range(4, 34), 30_000, 890_000, marks=pytest.mark.slow)],
)
def test_the_physical_branch_of_reachable_poses_is_that_of_all_branches(seeds: range, poses: int, least: int) -> None:
    count = 0
    for seed in seeds:
        rng = np.random.default_rng([2026, seed])
        size = 10.0 ** rng.uniform(-5.0, -2.7)
        built = PAPER.perturbed(rng, length=size, angle=size)
        state = spm.forward_physical(built, rng.uniform(1.1, 1.5, (poses, 6)))
        state = state[state.exists]
        alone = spm.inverse_physical(built, state.pose)
        # All branches are solved for only where the answer is not the state that the pose came from.
        other = np.flatnonzero(~(np.abs(alone.readings - state.readings).max(axis=-1) < 1e-7))
        count += len(state)
        if len(other):
            chosen = spm.inverse_displacement(built, state.pose[other]).physical()
            np.testing.assert_allclose(alone.readings[other], chosen.readings, atol=1e-6, err_msg=f"{seed}")
    assert count > least


def test_of_two_physical_branches_the_one_near_a_state_is_returned() -> None:
    built = as_built(PAPER, 1e-4, seed=2)
    for machine in (PAPER, built):
        solutions = spm.inverse_displacement(machine, in_leg_space(PAPER, 3000, seed=9).pose)
        solutions = solutions[np.asarray(solutions.ambiguous)]
        assert len(solutions.configurations) > 5
        for place in range(2):
            branch = np.argsort(~solutions.is_physical, axis=-1, kind="stable")[:, place]
            near = solutions.pick(branch, np.ones(solutions.shape, dtype=bool))
            chosen = spm.inverse_physical(machine, near.pose, near=near)
            np.testing.assert_array_equal(chosen.middle_joints, near.middle_joints)


@pytest.mark.parametrize("distance", [1e6, 1e160])
def test_poses_too_far_away_to_be_resolved_are_refused(distance: float) -> None:
    pose = np.eye(4)
    pose[:3] = EXAMPLE.as_matrix()[:3]
    pose[2, 3] = distance
    for machine in (PAPER, as_built(PAPER, 1e-4)):
        for solve in (spm.inverse_displacement, spm.inverse_physical, complex_middle_joints):
            with pytest.raises(spm.PoseError, check=with_fields(argument="pose")):
                solve(machine, np.stack([EXAMPLE.as_matrix(), pose]))


def test_results_are_written_into_memory_of_the_same_machine_only() -> None:
    built, poses = as_built(PAPER, 1e-4, seed=2), in_leg_space(PAPER, 40, seed=3).pose.as_matrix().reshape(2, 20, 4, 4)
    for machine in (PAPER, built):
        memory, expected = spm.kinematics.BranchMemory(machine, 20), spm.inverse_displacement(machine, poses[1])
        first, again = (spm.inverse_displacement(machine, pose, out=memory) for pose in poses)
        assert np.shares_memory(again.middle_joints, first.middle_joints)
        for name in ("rotation", "translation", "middle_joints", "leg_lengths", "discriminants", "status"):
            np.testing.assert_array_equal(getattr(again, name), getattr(expected, name), err_msg=name)
        np.testing.assert_array_equal(first.rotation, expected.rotation)
        for other in (spm.Manipulator(0.7, 0.35, 0.8), as_built(PAPER, 1e-4, seed=3), replace(PAPER, limits=None)):
            with pytest.raises(spm.ArgumentError, check=with_fields(argument="out")):
                spm.inverse_displacement(other, poses[1], out=memory)
        for wrong in (poses[0], expected, spm.kinematics.BranchMemory(machine, 19)):
            with pytest.raises(spm.ArgumentError, check=with_fields(argument="out")):
                spm.inverse_displacement(machine, poses[1], out=wrong)


def assert_roots_are_within(branches: spm.SolutionSet) -> None:
    """Check the radius of every branch that has one against the root of ball arithmetic beside it."""
    proved = np.isfinite(branches.radius)
    assert not (proved & ~branches.exists).any()
    for place in np.argwhere(proved):
        at = tuple(place)
        where = branches.rotation[at], branches.translation[at], branches.middle_joints[at]
        assert distance_to_root(branches.machine, *where) <= branches.radius[at]


@pytest.mark.parametrize("size", [1e-6, 1e-4, 1e-2])
def test_certified_radii_hold_the_roots_of_ball_arithmetic(size: float) -> None:
    built, pose = as_built(PAPER, size, seed=11), in_leg_space(PAPER, 12, seed=11).pose
    plain, certified = spm.inverse_displacement(built, pose), spm.inverse_displacement(built, pose, certify=True)
    assert plain.radius is None
    np.testing.assert_array_equal(certified.middle_joints, plain.middle_joints)
    assert certified.certain is None
    proved = np.isfinite(certified.radius)
    assert proved[certified.exists].mean() > 0.95
    assert np.median(certified.radius[proved]) < 1e-9
    assert_roots_are_within(certified)


@pytest.mark.parametrize("family", range(4))
def test_near_double_roots_labels_and_radii_hold(family: int) -> None:
    """Branches meet where det K vanishes, so under a label that was carried it has the sign of the drawn machine."""
    poses = random_branches(PAPER, spm.machine.FAMILIES[family], 12, seed=21).pose
    lost = 0
    for beyond, share in product((1e-3, 1e-6, 1e-9), (1e-2, 1.0)):
        pose = RigidTransform.concatenate([at_discriminant(pose, family, beyond, PAPER) for pose in poses])
        built, drawn = as_built(PAPER, share * beyond, seed=22), spm.inverse_displacement(PAPER, pose)
        branches = spm.inverse_displacement(built, pose, certify=True)
        kept = drawn.exists & branches.exists & ~branches.merged
        signs = [np.sign(spm.determinants(solutions.configurations)[kept][:, 2]) for solutions in (drawn, branches)]
        np.testing.assert_array_equal(*signs)
        # What is gone has met another one.
        gone = (drawn.exists & (branches.merged | ~branches.exists)).sum(axis=-1)
        np.testing.assert_array_equal(gone % 2, 0)
        lost += int(gone.sum())
        assert not (np.isfinite(branches.radius) & ~branches.exists).any()
        assert_roots_are_within(branches[:3])
    assert lost > 10
