from __future__ import annotations

import shlex

import numpy as np
import pytest
from cli.running import run
from problems import GEOMETRIES

import spm_pin as spm
from spm_pin.crosscheck.random_poses import in_leg_space, on_all_rotations, printable
from spm_pin.mechanism.pose import inverse_command


@pytest.mark.parametrize("name", GEOMETRIES)
def test_poses_in_leg_space_have_a_branch_there(name: str) -> None:
    geometry = GEOMETRIES[name]
    poses = in_leg_space(geometry, 60, np.random.default_rng(0))
    assert poses.shape == (60,)
    branches = spm.inverse_displacement(geometry, poses)
    assert branches.exists.any(axis=-1).all()
    if geometry.limits is not None:
        inside = branches.within()
        assert inside.count.min() >= 1
        # Drawn uniformly: the legs of those branches fill their range.
        legs = inside.leg_lengths[inside.exists]
        width = np.array(geometry.limits.maximum) - geometry.limits.minimum
        assert (np.ptp(legs, axis=0) > 0.8 * width).all()


def test_rotations_are_uniform_and_some_poses_out_of_reach() -> None:
    geometry = GEOMETRIES["paper"]
    poses = on_all_rotations(geometry, 4000, np.random.default_rng(1))
    # Of a uniform rotation matrix every entry has mean zero and variance 1/3.
    matrices = poses.rotation.as_matrix()
    assert np.abs(matrices.mean(axis=0)).max() < 5.0 * np.sqrt(1 / 3 / 4000)
    assert np.abs((matrices**2).mean(axis=0) - 1 / 3).max() < 0.05
    share = spm.inverse_displacement(geometry, poses).exists.any(axis=-1).mean()
    assert 0.3 < share < 0.95


def test_the_printed_command_runs() -> None:
    geometry = GEOMETRIES["paper"]
    poses, translation, xyx = printable(in_leg_space(geometry, 1, np.random.default_rng(4)))
    words = shlex.split(inverse_command(translation[0], xyx[0]))[1:]
    found = spm.inverse_displacement(geometry, poses[0]).count
    assert f"{found} of 8 branches real" in run(*words).stdout
    assert inverse_command(translation[0], xyx[0], "my robot.yaml").endswith(" --geometry 'my robot.yaml'")
