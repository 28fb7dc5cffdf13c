"""Poses within limits of the legs and of the passive joints, and random ones of them."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from problems import PAPER, in_leg_space, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.workspace import JointLimits, reachable, sample_reachable
from spm_pin.workspace.state_set import pose_multiplicity, states_within

LIMITS = spm.LegLimits(1.1, 1.5)
BUILT = PAPER.perturbed(1, length=0.02, angle=0.02)
TIGHT = spm.LegLimits([1.15, 1.1, 1.1, 1.2, 1.1, 1.1], [1.5, 1.4, 1.5, 1.5, 1.3, 1.5])


def test_poses_made_from_legs_within_the_limits_are_reachable() -> None:
    problem = in_leg_space(PAPER, 300, 1)
    answer = reachable(PAPER, problem.pose)
    assert answer.reachable.all()
    assert LIMITS.contains(answer.configuration.leg_lengths).all()
    margins = np.take_along_axis(answer.leg_margin, answer.branch[:, None], -1)[:, 0]
    inside = np.minimum(answer.configuration.leg_lengths - 1.1, 1.5 - answer.configuration.leg_lengths).min(axis=-1)
    assert margins == pytest.approx(inside, abs=1e-12)
    # The state the pose was made from is among those allowed.
    legs = problem.configuration.leg_lengths
    gap = np.abs(answer.branches.leg_lengths - legs[:, None]).max(axis=-1)
    assert (np.where(answer.allowed, gap, np.inf).min(axis=-1) < 1e-9).all()


def test_narrower_limits_of_single_legs_are_those_that_count() -> None:
    problem = in_leg_space(PAPER, 500, 2)
    answer = reachable(PAPER, problem.pose, TIGHT)
    modes = spm.inverse_displacement(PAPER, problem.pose)
    low, high = np.array(TIGHT.minimum), np.array(TIGHT.maximum)
    with np.errstate(invalid="ignore"):
        inside = ((modes.leg_lengths >= low) & (modes.leg_lengths <= high)).all(axis=-1)
    expected = (inside & modes.configurations.is_at_home).any(axis=-1)
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(answer.reachable, expected)
    np.testing.assert_array_equal(answer.branch >= 0, expected)
    np.testing.assert_array_equal(answer.configuration.exists, expected)


def test_any_branch_reaches_more_than_the_physical_one() -> None:
    # Legs long enough for branches with a torsion of half a turn.
    wide = spm.LegLimits(0.3, 2.5)
    problem = random_branches(PAPER, "FT", 300, 3)
    physical, every = (reachable(PAPER, problem.pose, wide, branch=which) for which in ("physical", "any"))
    assert (every.allowed >= physical.allowed).all()
    assert every.reachable.sum() > physical.reachable.sum() + 30
    named = [reachable(PAPER, problem.pose, wide, branch=label).allowed for label in spm.machine.BRANCHES]
    np.testing.assert_array_equal(np.any(named, axis=0), every.allowed)
    for place, allowed in enumerate(named):
        assert not np.delete(allowed, place, axis=-1).any()


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_shapes(shape: tuple[int, ...]) -> None:
    problem = in_leg_space(PAPER, int(np.prod(shape)), 4)
    matrix = problem.pose.as_matrix().reshape(*shape, 4, 4)
    answer = reachable(PAPER, matrix, joints=JointLimits(hip=(-1.0, 1.0), clearance=0.05))
    for array in (answer.allowed, answer.leg_margin, answer.angle_margin, answer.clearance_margin):
        assert array.shape == (*shape, 8)
    assert np.shape(answer.reachable) == answer.branch.shape == answer.configuration.shape == shape
    assert isinstance(answer.reachable, bool) == (shape == ())


def test_without_limits_every_real_branch_that_counts_is_allowed() -> None:
    machine = spm.Manipulator(0.7, 0.35, 0.8)
    problem = random_branches(machine, "TT", 50, 5)
    answer = reachable(machine, problem.pose, branch="any")
    np.testing.assert_array_equal(answer.allowed, answer.branches.exists)
    assert np.isposinf(answer.leg_margin[answer.branches.exists]).all()
    assert np.isnan(answer.leg_margin[~answer.branches.exists]).all()


def test_out_of_reach_is_data_and_a_continuous_family_is_said_to_be_undecided() -> None:
    far = reachable(PAPER, spm.pose([9.0, 0.0, 2.0], xyx=[0.1, 0.2, 0.3]))
    assert far.reachable is False
    assert far.undecided is False
    assert far.branch == -1
    assert not far.configuration.exists
    home = reachable(PAPER, spm.pose([0.0, 0.0, 2.6], rotation=np.eye(3)))
    assert home.branches.status == spm.Status.DEGENERATE
    assert home.undecided is True


def test_joint_limits_exclude_what_violates_them() -> None:
    problem = in_leg_space(PAPER, 200, 6)
    free = reachable(PAPER, problem.pose)
    for joints, margin in (
        (JointLimits(hip=(-0.03, 0.03)), "angle_margin"),
        (JointLimits(ball_y=(-0.25, 0.3)), "angle_margin"),
        (JointLimits(ball_x=(-0.5, 0.4), ball_z=(-0.03, 0.03)), "angle_margin"),
    ):
        answer = reachable(PAPER, problem.pose, joints=joints)
        with np.errstate(invalid="ignore"):
            np.testing.assert_array_equal(answer.allowed, free.allowed & (getattr(answer, margin) >= 0.0))
        assert 0 < answer.reachable.sum() < 200
    # The upper legs stand 0.6 m apart, and here no two come nearer.
    assert reachable(PAPER, problem.pose, joints=JointLimits(clearance=0.599)).reachable.all()
    assert not reachable(PAPER, problem.pose, joints=JointLimits(clearance=0.601)).reachable.any()


def test_limits_without_a_sample_are_refused() -> None:
    for machine, limits in (
        (PAPER, spm.LegLimits(1.0, np.inf)),
        (spm.Manipulator(0.7, 0.35, 0.8), None),
        (PAPER, spm.LegLimits(0.15, 0.2)),
    ):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="limits")):
            sample_reachable(machine, 1, limits)


def test_a_sample_in_leg_space_is_uniform_there_and_repeatable() -> None:
    states = sample_reachable(PAPER, 4000, rng=8)
    assert states.shape == (4000,)
    assert states.is_at_home.all()
    share = (states.leg_lengths - 1.1) / 0.4
    # Mean 1/2 and variance 1/12, to four standard errors.
    assert share.mean(axis=0) == pytest.approx(0.5, abs=4 * np.sqrt(1 / 12 / 4000))
    assert (share**2).mean(axis=0) == pytest.approx(1 / 3, abs=4 * np.sqrt(4 / 45 / 4000))
    np.testing.assert_array_equal(states.translation, sample_reachable(PAPER, 4000, rng=8).translation)
    assert sample_reachable(PAPER, 0).shape == (0,)


def test_a_sample_of_poses_is_uniform_in_pose_space() -> None:
    """As often in each of two boxes of poses as uniform poses that are reachable by the inverse displacement."""
    steps: list[int] = []
    states = sample_reachable(PAPER, 5_000, space="poses", rng=9, progress=lambda what, done, of: steps.append(done))
    assert steps[-1] == 5_000
    determinant = np.linalg.det(spm.kinematics.platform_jacobian(states))
    weight = np.abs(determinant) / pose_multiplicity(states_within(PAPER), states)
    # Weighted back, leg lengths are uniform, but that pairs of states with one pose count one half each.
    share = (states.leg_lengths - 1.1) / 0.4
    mean = (share / weight[:, None]).sum(axis=0) / (1.0 / weight).sum()
    assert mean == pytest.approx(0.5, abs=0.08)

    rng = np.random.default_rng(10)
    vectors = states.pose.rotation.as_rotvec()
    hits, uniform = [], []
    for centre in (np.array([0.3, 0.1, 2.5]), np.array([-0.1, -0.3, 2.35])):
        box = 0.3
        inside = (np.abs(states.translation - centre) < box).all(axis=-1)
        centre_turn, half = np.median(vectors[inside], axis=0), np.array([0.2, 0.2, 0.03])
        hits.append((inside & (np.abs(vectors - centre_turn) < half).all(axis=-1)).sum())
        n = 12_000
        position = centre + rng.uniform(-box, box, (n, 3))
        turn = centre_turn + half * rng.uniform(-1.0, 1.0, (n, 3))
        rotation = spm.pose(position, rotation=Rotation.from_rotvec(turn))
        angle = np.linalg.norm(turn, axis=-1)
        # Rotation vectors carry the uniform measure of rotations times this.
        density = (2.0 * np.sin(0.5 * angle) / angle) ** 2
        uniform.append((reachable(PAPER, rotation).reachable * density).sum())
    assert min(hits) > 15
    expected = np.array(uniform) / np.sum(uniform)
    error = np.sqrt(expected.prod() * (1.0 / np.sum(hits) + 1.0 / np.sum(uniform)))
    assert hits[0] / np.sum(hits) == pytest.approx(expected[0], abs=4.0 * error)


# --- Limits of passive joints, and the distance between legs ---------------------------------------------------------


def test_a_state_that_does_not_exist_has_no_margin() -> None:
    absent = spm.forward_physical(PAPER, [[10.0, 1.0, 1.0, 1.0, 1.0, 1.0]])
    limits = JointLimits(hip=(-1.0, 1.0), clearance=0.1)
    assert np.isnan(limits.angle_margin(absent)).all()
    assert np.isnan(limits.clearance_margin(absent)).all()


@pytest.mark.parametrize(
    ("argument", "value"),
    [("hip", (1.0, -1.0)), ("hip", (np.nan, 1.0)), ("ball_x", (-25.0, 25.0)), ("clearance", -0.1)],
)
def test_wrong_limits_of_joints_are_refused(argument: str, value: object) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        JointLimits(**{argument: value})  # type: ignore[arg-type]
