"""Continuation in leg lengths and poses: it ends at folds and singularities, and never comes to another mode."""

from __future__ import annotations

import re

import numpy as np
import pytest
from multibody.chains import MACHINES, NAMES, PAPER, chain

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


@pytest.mark.parametrize(
    ("count", "seed", "parts"), [(25, 411, 100), pytest.param(250, 412, 1000, marks=pytest.mark.slow)]
)
def test_random_modes_arrive_where_fine_steps_lead(count: int, seed: int, parts: int) -> None:
    """Paths from random modes, in one call and in `parts` steps; about 0.2 s a mode with a thousand of them."""
    robot, rng, arrived, tried = chain(), np.random.default_rng(seed), 0, 0
    while tried < count:
        begin = rng.uniform(0.5, 2.0, 6)
        end = begin + rng.normal(0.0, 0.1, 6)
        modes = spm.forward_displacement(PAPER, begin)
        if not modes.exists.any():
            continue
        tried += 1
        q = robot.joint_values(modes.configurations[int(rng.choice(np.flatnonzero(modes.exists)))])
        try:
            coarse = robot.forward_kinematics(end[None], near=q)[-1]
        except SpmError:
            continue
        # What arrives in one call arrives in fine steps, too, and in the same place.
        fine = robot.forward_kinematics(begin + np.linspace(0.0, 1.0, parts + 1)[1:, None] * (end - begin), near=q)[-1]
        assert np.abs(coarse - fine).max() < 1e-6
        arrived += 1
    assert arrived >= 0.2 * count


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


@pytest.mark.parametrize("name", NAMES)
def test_the_physical_branch_is_that_of_all_branches(name: str) -> None:
    geometry, robot = MACHINES[name], chain(name)
    rng = np.random.default_rng(415)
    readings = robot.readings(np.zeros(18)) * rng.uniform(0.98, 1.02, (20, 6))
    poses = spm.forward_physical(geometry, readings).pose
    expected = robot.joint_values(spm.inverse_displacement(geometry, poses).physical())
    together = robot.inverse_kinematics(poses)
    assert np.array_equal(together, expected)
    assert robot.inverse_kinematics(poses[:0]).shape == (0, 18)
    # The same by continuation from beside it.
    near = robot.forward_kinematics(readings[7] + 1e-4 * geometry.middle_side * rng.normal(size=6))
    followed = robot.inverse_kinematics(poses[7], near)
    assert np.abs(np.exp(1j * followed) - np.exp(1j * together[7])).max() <= 1e-9


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
