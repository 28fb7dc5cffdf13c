from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from error_fields import with_fields
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.machine import as_rigid_transform

EULER = np.deg2rad([-11.08, 32.97, -12.88])


def equation_3(alpha: float, beta: float, lam: float) -> np.ndarray:
    """R as Eq. (3) prints it."""
    (sa, sb, sl), (ca, cb, cl) = np.sin([alpha, beta, lam]), np.cos([alpha, beta, lam])
    return np.array(
        [
            [cb, sb * sl, sb * cl],
            [sa * sb, ca * cl - sa * cb * sl, -ca * sl - sa * cb * cl],
            [-ca * sb, sa * cl + ca * cb * sl, -sa * sl + ca * cb * cl],
        ]
    )


@pytest.mark.filterwarnings("ignore:xyx")  # beyond a full turn
@given(st.tuples(*[st.floats(-7, 7)] * 3))
def test_euler_angles_are_those_of_equation_3(angles: tuple[float, float, float]) -> None:
    pose = spm.pose([0, 0, 1], xyx=angles)
    np.testing.assert_allclose(pose.rotation.as_matrix(), equation_3(*angles), atol=1e-14)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_shapes_broadcast(shape: tuple[int, ...]) -> None:
    pose = spm.pose(np.zeros((*shape, 3)), xyx=EULER)
    assert pose.shape == shape
    assert spm.pose([0, 0, 1], xyx=np.zeros((*shape, 3))).shape == shape
    assert spm.pose(np.zeros((2, 1, 3)), rotation=np.broadcast_to(np.eye(3), (4, 3, 3))).shape == (2, 4)


def turn(axis: int, angle: float) -> np.ndarray:
    """The elementary rotation about one axis of the base."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def test_roll_pitch_yaw_are_those_of_a_urdf() -> None:
    rpy = np.array([0.3, -0.5, 1.1])
    expected = turn(2, rpy[2]) @ turn(1, rpy[1]) @ turn(0, rpy[0])
    np.testing.assert_allclose(spm.pose([0, 0, 1], rpy=rpy).rotation.as_matrix(), expected, atol=1e-15)
    np.testing.assert_allclose(pinocchio.rpy.rpyToMatrix(*rpy), expected, atol=1e-15)


def test_orientations_of_every_kind_make_the_same_pose() -> None:
    poses = spm.pose(np.zeros((4, 3)), xyx=np.random.default_rng(0).uniform(-3, 3, (4, 3)))
    turns = poses.rotation
    quaternions = turns.as_quat()
    # cos θ/2 is last.
    np.testing.assert_allclose(np.abs(quaternions[:, 3]), np.cos(turns.magnitude() / 2), atol=1e-14)
    kinds = {"quat": quaternions, "rotvec": turns.as_rotvec(), "matrix": turns.as_matrix(), "rotation": turns}
    for name, value in (kinds | {"rpy": turns.as_euler("xyz")}).items():
        made = spm.pose(np.zeros(3), **{name: value})
        np.testing.assert_allclose(made.as_matrix(), poses.as_matrix(), atol=1e-14, err_msg=name)


def test_small_rotations_keep_their_digits_and_the_rounding_of_single_precision_is_repaired() -> None:
    tiny = Rotation.from_rotvec([1e-9, 2e-9, 1e-12])
    pose = spm.pose([0, 0, 1], rotation=tiny)
    for same in (pose, as_rigid_transform(pose.as_matrix())):
        np.testing.assert_array_equal(same.as_matrix()[:3, :3], tiny.as_matrix())
    single = Rotation.from_euler("XYX", EULER).as_matrix().astype(np.float32)
    matrix = spm.pose([0, 0, 1], rotation=single).as_matrix()[:3, :3]
    assert np.abs(matrix.T @ matrix - np.eye(3)).max() < 1e-15
    np.testing.assert_allclose(matrix, single, atol=1e-7)


GOOD = np.eye(4)


def replaced(row: object, column: object, value: object) -> np.ndarray:
    matrix = np.array(GOOD)
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: spm.pose([0, 0], xyx=EULER), r"translation: expected .*\(\.\.\., 3\).* got shape \(2,\)"),
        (lambda: spm.pose([0, np.nan, 1], xyx=EULER), r"translation: expected finite .*nan at index \(1,\)"),
        (lambda: spm.pose([0, 0, 1], xyx=[0, 1]), r"xyx: expected .*\(\.\.\., 3\)"),
        (lambda: spm.pose([0, 0, 1], xyx=[0, 1, np.nan]), "xyx: expected finite"),
        (lambda: spm.pose([0, 0, 1]), "rotation: expected exactly one orientation: xyx=..., rpy=.*, got none"),
        (lambda: spm.pose([0, 0, 1], xyx=EULER, rotation=np.eye(3)), "got xyx and rotation"),
        (lambda: spm.pose([0, 0, 1], quat=[1, 0, 0]), r"quat: expected .*\(\.\.\., 4\), a unit quaternion x, y, z, w"),
        (lambda: spm.pose([0, 0, 1], quat=[[0, 0, 0, 1], [0, 0, 0, 2]]), r"length 1, got length 2 at index \(1,\)"),
        (lambda: as_rigid_transform([0, 0, 1, 0.1, 0.2, 0.3]), r"spm\.pose\(a\[\.\.\., :3\], rpy=a\[\.\.\., 3:\]\)"),
        (lambda: as_rigid_transform(np.zeros((5, 7))), r"got shape \(5, 7\)\. .*quat=a\[\.\.\., 3:\]"),
        (lambda: spm.pose([0, 0, 1], matrix=2 * np.eye(3)), "matrix: expected a rotation matrix.*scaled"),
        (lambda: spm.pose([0, 0, 1], rotation=np.diag([1, 1, -1])), "determinant -1.*reflection"),
        (lambda: spm.pose([0, 0, 1], rotation=np.eye(4)), r"rotation: expected .*\(\.\.\., 3, 3\)"),
        (lambda: spm.pose(np.zeros((2, 3)), xyx=np.zeros((3, 3))), "broadcast"),
        (lambda: as_rigid_transform(np.eye(3)), r"pose: expected .*\(\.\.\., 4, 4\)"),
        (lambda: as_rigid_transform(replaced(3, 0, 0.5)), r"last row \[0, 0, 0, 1\]"),
        (lambda: as_rigid_transform(np.linalg.inv(replaced(0, 3, 2.0)).T), "transposed"),
        (lambda: as_rigid_transform(replaced(0, 3, np.nan)), "pose: expected finite"),
        (lambda: as_rigid_transform(replaced(0, 0, 0.9)), "pose: expected a rotation matrix"),
        (lambda: as_rigid_transform(Rotation.identity()), "A rotation alone is not a pose"),
        (lambda: as_rigid_transform(RigidTransform(replaced(0, 0, 0.9), normalize=False)), "rotation matrix"),
        (lambda: as_rigid_transform(np.stack([GOOD, replaced(1, 1, -1)])), r"determinant -1 at index \(1,\)"),
        # Whole poses are refused with the way to say them.
        (lambda: spm.pose(np.ones(6)), r"spm\.pose\(a\[\.\.\., :3\], rpy=a"),
        (lambda: spm.pose(np.ones(7)), r"spm\.pose\(a\[\.\.\., :3\], quat=a"),
        (lambda: spm.pose(np.eye(4)), r"RigidTransform\.from_matrix\(a\)"),
        (lambda: spm.pose(pinocchio.SE3.Identity()), "got a SE3. It is a pose already"),
        (lambda: spm.pose(RigidTransform.identity(), rpy=np.zeros(3)), "got a RigidTransform. It is a pose already"),
        (lambda: spm.pose(np.ones(3), rotation=np.eye(4)), r"^rotation: .*RigidTransform\.from_matrix\(a\)"),
    ],
)
def test_what_is_no_pose_is_refused(make: object, words: str) -> None:
    with pytest.raises(spm.PoseError, match=words):
        make()  # type: ignore[operator]


def test_the_argument_is_named_in_the_callers_words() -> None:
    with pytest.raises(spm.PoseError, check=with_fields(argument="pose")) as caught:
        spm.inverse_displacement(spm.Manipulator.paper(), np.zeros((3, 3)))
    assert caught.value.argument == "pose"
    assert isinstance(caught.value, ValueError)


def test_angles_in_degrees_are_noticed() -> None:
    with pytest.warns(UserWarning, match=r"xyx: an angle of 32\.97 rad is beyond a full turn"):
        spm.pose([0.6889, 0.4963, 2.253], xyx=[-11.08, 32.97, -12.88])
    # A full turn itself is none of it: warnings are errors here.
    spm.pose([0.0, 0.0, 2.0], xyx=[2.0 * np.pi, -2.0 * np.pi, 0.0])
    spm.pose(np.zeros((0, 3)), xyx=np.zeros((0, 3)))
