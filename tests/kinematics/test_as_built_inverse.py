"""Inverse displacement of machines as built: all roots certified, labels carried from the nominal machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from as_built_oracle import certified_real_branches
from problems import GEOMETRIES, as_built, in_leg_space, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics import complex_middle_joints
from spm_pin.proofs import certify_inverse

PAPER = spm.Geometry.paper()
NOMINAL = PAPER
EXAMPLE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
DIRECTION = np.random.default_rng(1).standard_normal(54)
SIZES = (1e-9, 1e-5, 1e-3, 1e-2, 5e-2)


def along(size: float) -> spm.Geometry:
    return NOMINAL.from_parameters(NOMINAL.parameters + size * DIRECTION)


def check_counts(name: str, size: float, machines: int, poses: int) -> None:
    geometry, families = GEOMETRIES[name], spm.mechanism.FAMILIES
    for seed in range(machines):
        built = as_built(geometry, size, seed)
        pose = random_branches(geometry, families[seed % 4], poses, seed=1000 + seed).pose
        solutions, joints = spm.inverse_displacement(built, pose), complex_middle_joints(built, pose)
        assert not (solutions.status == spm.Status.UNSOLVED).any()
        exists = solutions.exists
        assert np.nanmax(solutions.residual, initial=0.0) <= 1e-13 * geometry.middle_side
        np.testing.assert_array_equal(joints.imag.any(axis=(-1, -2)), ~exists)
        np.testing.assert_array_equal(joints.real[exists], solutions.middle_joints[exists])
        for k in range(poses):
            matrix = pose[k].as_matrix()
            proved = certified_real_branches(built, matrix[:3, :3], matrix[:3, 3], joints[k])
            assert proved == solutions.count[k], (name, size, seed, k)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", GEOMETRIES)
def test_all_eight_roots_are_certified(name: str, size: float) -> None:
    check_counts(name, size, machines=5, poses=3)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", GEOMETRIES)
def test_all_eight_roots_of_many_machines_are_certified(name: str, size: float) -> None:
    check_counts(name, size, machines=100, poses=5)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_without_errors_the_answers_are_those_of_the_nominal_machine(name: str) -> None:
    geometry = GEOMETRIES[name]
    problem = random_branches(geometry, "TF", 50, seed=7)
    level = spm.pose([0.0, 0.0, geometry.middle_side], rotation=np.eye(3))
    for pose in (problem.pose, level):
        nominal = spm.inverse_displacement(geometry, pose)
        built = spm.inverse_displacement(geometry, pose)
        np.testing.assert_array_equal(built.middle_joints, nominal.middle_joints)
        np.testing.assert_array_equal(built.leg_lengths, nominal.leg_lengths)
        np.testing.assert_array_equal(built.status, nominal.status)
        np.testing.assert_array_equal(built.is_physical, nominal.is_physical)
        np.testing.assert_allclose(built.configurations.leg_lengths, nominal.leg_lengths, rtol=1e-14)
        assert built.merged is not None
        assert not built.merged.any()


@pytest.mark.parametrize("name", GEOMETRIES)
def test_vanishing_errors_lead_to_the_nominal_branches_under_their_labels(name: str) -> None:
    geometry = GEOMETRIES[name]
    pose = random_branches(geometry, "TT", 300, seed=8).pose
    nominal = spm.inverse_displacement(geometry, pose)
    assert nominal.discriminants is not None
    # Away from the singularities at which branches of a family or of two families meet.
    apart = np.abs(nominal.middle_joints[:, :, None] - nominal.middle_joints[:, None]).max(axis=(-1, -2))
    apart = np.where(np.eye(8, dtype=bool) | np.isnan(apart), np.inf, apart) / geometry.middle_side
    clear = (apart.min(axis=(-1, -2)) > 1e-2) & (np.abs(nominal.discriminants).min(axis=-1) > 1e-3)
    assert clear.sum() > 150
    errors = []
    for size in (1e-11, 1e-9):
        built = spm.inverse_displacement(as_built(geometry, size, seed=9), pose)
        np.testing.assert_array_equal(built.exists[clear], nominal.exists[clear])
        assert built.merged is not None
        assert not built.merged[clear].any()
        moved = np.abs(built.middle_joints - nominal.middle_joints)[clear][nominal.exists[clear]]
        errors.append(np.median(moved.max(axis=(-1, -2))) / geometry.middle_side)
    # In proportion to the errors.
    assert errors[0] < 1e-9
    assert errors[1] / errors[0] == pytest.approx(100.0, rel=0.05)


def test_readings_are_distances_from_pivots_to_balls_and_offsets() -> None:
    built = as_built(PAPER, 5e-3, seed=3)
    pose = in_leg_space(PAPER, 40, seed=3).pose
    solutions = spm.inverse_displacement(built, pose)
    states = solutions.configurations[solutions.exists]
    rotation, position = states.rotation, states.translation
    middle = states.middle_pose
    for i in range(6):
        ball = middle.apply(built.legs.balls[i])
        pivot, axis = built.legs.pivots[i], built.legs.axes[i]
        if i >= 3:
            pivot, axis = rotation @ pivot + position, rotation @ axis
        np.testing.assert_allclose(states.balls[:, i], ball, atol=1e-13)
        np.testing.assert_allclose(((ball - pivot) * axis).sum(axis=-1), 0.0, atol=1e-13)
        reading = np.linalg.norm(ball - pivot, axis=-1) + built.legs.offsets[i]
        np.testing.assert_allclose(states.leg_lengths[:, i], reading, atol=1e-13)
    again = spm.Configuration(built, states.pose, states.middle_joints)
    np.testing.assert_allclose(again.leg_lengths, states.leg_lengths, atol=1e-13)
    assert (again.closure_residual <= 1e-13).all()
    moved = spm.Configuration(built, states.pose, states.middle_joints + np.array([1e-3, 0.0, 0.0]))
    assert (moved.closure_residual > 1e-4).all()


def test_labels_are_continuous_in_the_errors_until_branches_meet() -> None:
    """Followed in small steps by nearness alone, every branch keeps its label until the two of a pair vanish."""
    pose = in_leg_space(PAPER, 30, seed=5).pose
    before = spm.inverse_displacement(PAPER, pose)
    lost = np.zeros(before.exists.shape, dtype=bool)
    for size in np.linspace(0.0, 2e-4, 201)[1:]:
        now = spm.inverse_displacement(along(float(size)), pose)
        assert now.merged is not None
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


def test_two_branches_of_the_papers_example_end_where_they_meet() -> None:
    def both(size: float) -> spm.SolutionSet:
        return spm.inverse_displacement(along(size), EXAMPLE)

    low, high = 1e-6, 1e-4
    assert both(low).count == 6
    assert both(high).count == 4
    while high / low - 1.0 > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if both(middle).count == 6 else (low, middle)
    before, after = both(low), both(high)
    gone = np.flatnonzero(before.exists & ~after.exists)
    assert len(gone) == 2
    joints = before.middle_joints[gone]
    assert np.abs(joints[0] - joints[1]).max() < 1e-4
    assert after.merged is not None
    np.testing.assert_array_equal(np.flatnonzero(after.merged), gone)
    np.testing.assert_allclose(after.middle_joints[after.exists], before.middle_joints[after.exists], atol=1e-8)


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 1, 2)])
def test_a_batch_is_solved_like_its_members(shape: tuple[int, ...]) -> None:
    built = as_built(PAPER, 1e-3, seed=4)
    poses = random_branches(PAPER, "TT", int(np.prod(shape)), seed=6).pose.as_matrix().reshape(*shape, 4, 4)
    solutions = spm.inverse_displacement(built, poses)
    roots = complex_middle_joints(built, poses)
    assert solutions.middle_joints.shape == (*shape, 8, 3, 3) == roots.shape
    assert solutions.leg_lengths.shape == (*shape, 8, 6)
    for index in np.ndindex(shape):
        alone = spm.inverse_displacement(built, poses[index])
        np.testing.assert_array_equal(alone.middle_joints, solutions.middle_joints[index])
        np.testing.assert_array_equal(alone.leg_lengths, solutions.leg_lengths[index])
        np.testing.assert_array_equal(alone.merged, np.asarray(solutions.merged)[index])
        np.testing.assert_array_equal(complex_middle_joints(built, poses[index]), roots[index])
        np.testing.assert_allclose(
            spm.inverse_physical(built, poses[index]).leg_lengths, alone.physical().leg_lengths, rtol=1e-13
        )


def test_threads_do_not_change_a_bit() -> None:
    built = as_built(PAPER, 1e-3, seed=4)
    pose = in_leg_space(PAPER, 1500, seed=7).pose
    try:
        spm.set_threads(1)
        first = spm.inverse_displacement(built, pose)
        spm.set_threads(2)
        second = spm.inverse_displacement(built, pose)
    finally:
        spm.set_threads(None)
    np.testing.assert_array_equal(first.middle_joints, second.middle_joints)


def test_the_physical_branch_of_a_small_error_is_near_the_nominal_one() -> None:
    pose = in_leg_space(PAPER, 300, seed=8).pose
    nominal = spm.inverse_physical(PAPER, pose)
    built = spm.inverse_physical(as_built(PAPER, 1e-6, seed=5), pose)
    assert built.exists.mean() > 0.97
    moved = np.abs(built.leg_lengths - nominal.leg_lengths).max(axis=-1)
    assert np.nanmedian(moved) < 1e-4


@pytest.mark.parametrize("size", [1e-6, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("name", GEOMETRIES)
def test_the_physical_branch_alone_is_that_of_all_branches(name: str, size: float) -> None:
    geometry = GEOMETRIES[name]
    built = as_built(geometry, size, seed=3)
    sets = [random_branches(geometry, "TT", 1500, seed=2)]
    if geometry.limits is not None:
        sets.append(in_leg_space(geometry, 700, seed=1))
    for problem in sets:
        chosen = spm.inverse_displacement(built, problem.pose).physical()
        alone = spm.inverse_physical(built, problem.pose)
        assert chosen.exists.any()
        np.testing.assert_allclose(alone.middle_joints, chosen.middle_joints, atol=1e-11 * geometry.middle_side)
        np.testing.assert_allclose(alone.leg_lengths, chosen.leg_lengths, rtol=1e-11)
        np.testing.assert_array_equal(alone.translation, chosen.translation)
        assert np.nanmax(alone.closure_residual) <= 1e-14 * geometry.middle_side
        np.testing.assert_array_equal(
            spm.inverse_physical(built, problem.pose[7:8]).leg_lengths[0], alone[7].leg_lengths
        )


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


STATE = spm.inverse_physical(as_built(PAPER, 1e-4, seed=7), EXAMPLE)


@pytest.mark.parametrize(
    "call",
    [
        spm.kinematics.determinant_gradients,
        lambda state: spm.forward_physical(PAPER, state.leg_lengths, near=state),
        lambda state: spm.follow(PAPER, np.stack([state.pose.as_matrix()] * 2), start=state),
        lambda state: spm.workspace.nearest_reachable_pose(PAPER, state.pose, near=state),
        lambda state: certify_inverse(state.geometry, PAPER.limits),
        lambda state: spm.workspace.reachable(state.geometry, state.pose),
        lambda state: spm.SolutionSet.from_unordered(state.geometry, state.pose, state.middle_joints[None]),
        lambda state: spm.follow(state.geometry, np.stack([state.pose.as_matrix()] * 2)),
        lambda state: spm.inverse_displacement(state.geometry, state.pose, out=1),
    ],
)
def test_what_does_not_support_imperfect_machines_yet_refuses_them(call: Callable[..., object]) -> None:
    assert STATE.exists
    with pytest.raises(spm.ArgumentError, match=r"Geometry"):
        call(STATE)
