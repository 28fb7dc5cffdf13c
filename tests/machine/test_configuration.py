from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from error_fields import with_fields
from problems import in_leg_space

import spm_pin as spm
from spm_pin.errors import SelectionError
from spm_pin.machine.configuration import check_configuration, stacked

POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


@pytest.fixture
def configuration() -> spm.Configuration:
    branches = spm.inverse_displacement(spm.Manipulator.paper(), POSE)
    state: spm.Configuration = branches["TT+"]
    return state


def test_leg_vectors_close_the_loop_of_equation_21(configuration: spm.Configuration) -> None:
    a = configuration.machine.base_joints
    c = POSE.apply(configuration.machine.platform_joints)
    vectors = configuration.leg_vectors
    np.testing.assert_allclose(a + vectors[:3] + vectors[3:], c, atol=1e-15)
    np.testing.assert_allclose(configuration.leg_lengths, np.linalg.norm(vectors, axis=-1), rtol=1e-15)


def test_middle_pose_carries_the_triangle(configuration: spm.Configuration) -> None:
    local = configuration.machine.middle_radius * configuration.machine.radial_directions
    np.testing.assert_allclose(configuration.middle_pose.apply(local), configuration.middle_joints, atol=1e-15)
    matrix = configuration.middle_pose.as_matrix()[:3, :3]
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) > 0.0


def test_closure_residual_is_the_worst_gap_in_metres(configuration: spm.Configuration) -> None:
    assert configuration.closure_residual < 1e-14
    for axis, expected in (
        (configuration.machine.revolute_axes[0], "plane of the lower leg"),
        (configuration.platform_axes[0], "plane of the upper leg"),
    ):
        moved = np.array(configuration.middle_joints)
        moved[0] += 1e-3 * axis
        residual = spm.Configuration(configuration.machine, POSE, moved).closure_residual
        assert residual == pytest.approx(1e-3, rel=1e-2), expected
    stretched = np.array(configuration.middle_joints)
    stretched[0] += 1e-3 * (stretched[0] - stretched[1]) / 0.8
    assert spm.Configuration(configuration.machine, POSE, stretched).closure_residual == pytest.approx(1e-3, rel=0.1)


def test_everything_is_batched_and_read_only() -> None:
    problem = in_leg_space(spm.Manipulator.paper(), 6, seed=0)
    batch = problem.configuration
    assert batch.shape == (6,)
    assert len(batch) == 6
    for name in ("rotation", "translation", "middle_joints", "leg_vectors", "leg_lengths", "closure_residual"):
        values = getattr(batch, name)
        assert not values.flags.writeable, name
        for k, state in enumerate(batch):
            np.testing.assert_array_equal(getattr(state, name), values[k])
    assert batch.pose.shape == batch.middle_pose.shape == (6,)
    np.testing.assert_array_equal(batch[2:4].leg_lengths, batch.leg_lengths[2:4])


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))])
def test_copies_are_equal_and_read_only(
    configuration: spm.Configuration, duplicate: Callable[[spm.Configuration], spm.Configuration]
) -> None:
    batch = in_leg_space(spm.Manipulator.paper(), 3, seed=0).configuration
    for state in (configuration, batch):
        again = duplicate(state)
        assert again.machine == state.machine
        for name in ("rotation", "translation", "middle_joints", "leg_lengths", "platform_joints"):
            np.testing.assert_array_equal(getattr(again, name), getattr(state, name))
            assert not getattr(again, name).flags.writeable, name
            with pytest.raises(ValueError, match="read-only"):
                getattr(again, name)[..., 0] = 1.0


def test_kinds_of_configurations_are_checked(configuration: spm.Configuration) -> None:
    assert check_configuration(configuration, single=True, existing=True) is configuration
    batch = in_leg_space(spm.Manipulator.paper(), 2, seed=0).configuration
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="start")):
        check_configuration(batch, "start", single=True)
    joints = np.array(batch.middle_joints)
    joints[1] = np.nan
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="start")):
        check_configuration(spm.Configuration(batch.machine, batch.pose, joints), "start", existing=True)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="start")):
        check_configuration(spm.inverse_displacement(spm.Manipulator.paper(), POSE), "start")


def test_absent_members_are_nan_throughout() -> None:
    problem = in_leg_space(spm.Manipulator.paper(), 2, seed=0)
    joints = np.array(problem.middle_joints)
    joints[1] = np.nan
    batch = spm.Configuration(problem.machine, problem.pose, joints)
    np.testing.assert_array_equal(batch.exists, [True, False])
    assert np.isnan(batch.leg_lengths[1]).all()
    assert np.isnan(batch.closure_residual[1])
    assert np.isnan(batch.middle_pose.as_matrix()[1, :3, :]).all()
    assert np.isfinite(batch.leg_lengths[0]).all()
    assert "does not exist" in repr(batch[1])


@pytest.mark.parametrize(
    ("pose", "joints", "words"),
    [
        (POSE, np.diag([np.nan, 1, 1]), "all nine coordinates finite, or all NaN"),
        (POSE, np.full((3, 3), np.inf), "middle_joints: expected finite"),
        (spm.pose(np.zeros((3, 3)), rotation=np.eye(3)), np.zeros((2, 3, 3)), "broadcast"),
    ],
)
def test_invalid_middle_joints_are_refused(pose: object, joints: np.ndarray, words: str) -> None:
    with pytest.raises(spm.ArgumentError, match=words):
        spm.Configuration(spm.Manipulator.paper(), pose, joints)  # type: ignore[arg-type]


def test_a_single_state_is_no_sequence(configuration: spm.Configuration) -> None:
    with pytest.raises(SelectionError, match="no batch axes"):
        configuration[0]
    with pytest.raises(TypeError, match="no batch axes"):
        iter(configuration)
    with pytest.raises(TypeError, match="no length"):
        len(configuration)


def test_no_states_make_no_batch() -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="states")):
        stacked([])
