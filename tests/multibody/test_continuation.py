"""Continuation in leg lengths and poses: it ends at folds and singularities, and never comes to another mode."""

from __future__ import annotations

import re

import numpy as np
import problems
import pytest
from multibody.chains import PAPER, Array, chain

import spm_pin as spm
from spm_pin.errors import ArgumentError, ClosureError, PoseError, SpmError

pytest.importorskip("pinocchio")

NEAR = "Pass a closed q as near: the solution on the path from there need not be physical."
"""The end of an error where there is no physical solution."""


def test_a_path_that_ends_at_a_fold_is_not_completed_in_another_mode() -> None:
    begin = [0.684323687731267, 1.5724122184620153, 0.9033743064577988]
    begin += [0.7089082670062409, 0.7536839372978562, 0.6860272440464935]
    end = [0.6822367053271448, 1.753103485743987, 0.9020521723520921]
    end += [0.6342860269226885, 0.5528705330271455, 0.7360498750791851]
    q = chain().joint_values(spm.forward_displacement(PAPER, begin)["T2+/T1+"])
    with pytest.raises(ClosureError, match="a forward singularity, or the end of this assembly mode") as caught:
        chain().forward_kinematics(end, near=q)
    # A constraint singularity comes first, at 0.6085; without it the path would end at a fold at 0.7265.
    share = float(re.findall(r"No further than (\S+) %", str(caught.value))[0]) / 100.0
    assert 0.55 < share <= 0.7265


def test_the_determinant_keeps_its_sign_where_no_singularity_is() -> None:
    """The scaled matrix of NumPy's determinant, against the one from the factors."""
    robot = chain()
    state = robot.state(np.zeros(18))
    ratios = []
    for legs in np.random.default_rng(410).uniform(1.1, 1.5, (20, 6)):
        kinematics = state.update(robot.forward_kinematics(legs)).kinematics
        ratios.append(kinematics.forward_determinant() / np.linalg.det(kinematics.forward_matrix()))
    assert np.abs(np.array(ratios) / ratios[0] - 1.0).max() < 1e-9


def arrivals(count: int, seed: int, parts: int) -> list[tuple[Array | None, Array | None]]:
    """Return the ends of paths from random modes, in one call and in `parts` steps; None where a path has no end."""
    robot, rng, found = chain(), np.random.default_rng(seed), []
    while len(found) < count:
        begin = rng.uniform(0.5, 2.0, 6)
        end = begin + rng.normal(0.0, 0.1, 6)
        modes = spm.forward_displacement(PAPER, begin)
        if not modes.exists.any():
            continue
        q = robot.joint_values(modes.configurations[int(rng.choice(np.flatnonzero(modes.exists)))])
        ways = end[None], begin + np.linspace(0.0, 1.0, parts + 1)[1:, None] * (end - begin)
        ends: list[Array | None] = []
        for legs in ways:
            try:
                ends.append(robot.forward_kinematics(legs, near=q)[-1])
            except SpmError:
                ends.append(None)
        found.append((ends[0], ends[1]))
    return found


def check_arrivals(count: int, seed: int, parts: int) -> None:
    found = arrivals(count, seed, parts)
    both = [pair for pair in found if pair[0] is not None and pair[1] is not None]
    assert len(both) >= 0.2 * count
    for coarse, fine in both:
        assert np.abs(coarse - fine).max() < 1e-6
    # What arrives in one call arrives in steps a thousand times finer, too.
    assert all(fine is not None for coarse, fine in found if coarse is not None)


def test_random_modes_arrive_where_fine_steps_lead() -> None:
    check_arrivals(count=25, seed=411, parts=100)


@pytest.mark.slow
def test_a_thousand_random_modes_arrive_where_steps_a_thousand_times_finer_lead() -> None:
    """About 0.2 s a mode: four minutes in all."""
    check_arrivals(count=1000, seed=412, parts=1000)


def test_the_physical_mode_of_a_batch_is_that_of_its_members() -> None:
    robot, legs = chain(), np.random.default_rng(413).uniform(1.1, 1.5, (2, 3, 6))
    together = robot.forward_kinematics(legs)
    assert np.abs(robot.leg_lengths(together) - legs).max() <= 1e-13
    assert np.abs(robot.closure_gap(together)).max() <= 1e-13
    for index in np.ndindex(2, 3):
        assert np.array_equal(together[index], robot.forward_kinematics(legs[index]))
        followed = robot.forward_kinematics(legs[index], near=np.zeros(18))
        assert np.abs(np.exp(1j * followed) - np.exp(1j * together[index])).max() <= 1e-11


def test_lengths_that_the_physical_mode_cannot_have_are_refused_or_nan() -> None:
    robot, far = chain(), [1.2, 1.2, 1.2, 1.2, 1.2, 9.0]
    begin = "readings: expected lengths that the physical assembly mode can have, got [1.2, 1.2, 1.2, 1.2, 1.2, 9] m"
    reason = "With these leg lengths no configuration is reached from the home without a forward singularity."
    with pytest.raises(ArgumentError) as caught:
        robot.forward_kinematics(far)
    assert str(caught.value) == f"{begin}. {reason} {NEAR}"
    found = robot.forward_kinematics([[1.3] * 6, far])
    assert np.array_equal(found[0], robot.forward_kinematics([1.3] * 6))
    assert np.isnan(found[1]).all()


def test_the_physical_branch_of_a_batch_is_that_of_its_members_and_of_the_path_there() -> None:
    robot, rng = chain(), np.random.default_rng(414)
    legs = rng.uniform(1.1, 1.5, (2, 3, 6))
    poses = spm.forward_physical(PAPER, legs).pose.as_matrix()
    together = robot.inverse_kinematics(poses)
    reached = robot.configuration(together)
    assert np.abs(reached.pose.as_matrix() - poses).max() <= 1e-13
    # The pose and its legs belong to one physical state, which forward displacement comes from and inverse goes to.
    assert np.abs(robot.leg_lengths(together) - legs).max() <= 1e-9
    assert np.abs(robot.closure_gap(together)).max() <= 1e-13
    for index in np.ndindex(2, 3):
        assert np.array_equal(together[index], robot.inverse_kinematics(poses[index]))
        near = robot.forward_kinematics(legs[index] + 1e-4 * rng.normal(size=6))
        followed = robot.inverse_kinematics(poses[index], near)
        assert np.abs(np.exp(1j * followed) - np.exp(1j * together[index])).max() <= 1e-9


@pytest.mark.parametrize("name", problems.GEOMETRIES)
def test_the_physical_branch_is_that_of_all_branches(name: str) -> None:
    geometry, robot = problems.GEOMETRIES[name], chain(name)
    legs = robot.leg_lengths(np.zeros(18)) * np.random.default_rng(415).uniform(0.98, 1.02, (20, 6))
    poses = spm.forward_physical(geometry, legs).pose
    expected = robot.joint_values(spm.inverse_displacement(geometry, poses).physical())
    assert np.array_equal(robot.inverse_kinematics(poses), expected)
    assert robot.inverse_kinematics(poses[:0]).shape == (0, 18)


def test_poses_that_no_physical_branch_has_are_refused_or_nan() -> None:
    home, away = spm.pose([0.0, 0.0, 2.3], xyx=[0.0, 0.0, 0.0]), spm.pose([0.1, 0.2, 9.0], xyx=[0.1, 0.2, 0.3])
    good = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    begin = "pose: expected poses that a physical branch has, got o at "
    level = "[0, 0, 2.3] m, turned by the rotation vector [0, 0, 0] rad. A level platform over the axis of the base"
    turn = ", ".join(f"{angle:.9g}" for angle in away.rotation.as_rotvec())
    high = f"[0.1, 0.2, 9] m, turned by the rotation vector [{turn}] rad"
    for pose, text in ((home, level), (away, f"{high}. Out of reach: no solution is real. {NEAR}")):
        with pytest.raises(ArgumentError) as caught:
            chain().inverse_kinematics(pose)
        assert str(caught.value).startswith(begin + text)
        assert str(caught.value).endswith(NEAR)
    both = chain().inverse_kinematics(np.stack([good.as_matrix(), away.as_matrix()]))
    assert np.array_equal(both[0], chain().inverse_kinematics(good))
    assert np.isnan(both[1]).all()
    with pytest.raises(PoseError):
        chain().inverse_kinematics(np.eye(3))
