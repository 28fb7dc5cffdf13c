from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.mechanism import as_rigid_transform

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


def test_small_rotations_keep_their_digits() -> None:
    tiny = Rotation.from_rotvec([1e-9, 2e-9, 1e-12])
    matrix = spm.pose([0, 0, 1], rotation=tiny).as_matrix()[:3, :3]
    np.testing.assert_array_equal(matrix, tiny.as_matrix())
    again = as_rigid_transform(spm.pose([0, 0, 1], rotation=tiny).as_matrix())
    np.testing.assert_array_equal(again.as_matrix()[:3, :3], tiny.as_matrix())


def test_a_pose_does_not_depend_on_its_neighbours() -> None:
    exact = Rotation.from_euler("XYX", EULER).as_matrix()
    rough = exact.astype(np.float32).astype(np.float64)
    alone = spm.pose([0, 0, 1], rotation=exact).as_matrix()
    np.testing.assert_array_equal(alone[:3, :3], exact)
    np.testing.assert_array_equal(spm.pose([0, 0, 1], rotation=np.stack([exact, rough])).as_matrix()[0], alone)


def test_rounding_of_single_precision_is_repaired() -> None:
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
        (lambda: spm.pose([0, np.inf, 1], xyx=EULER), "translation: expected finite"),
        (lambda: spm.pose("here", xyx=EULER), "translation: expected real numbers"),
        (lambda: spm.pose([[0, 0, 1], [0, 0]], xyx=EULER), "translation"),
        (lambda: spm.pose([1j, 0, 0], xyx=EULER), "translation: expected real"),
        (lambda: spm.pose([0, 0, 1], xyx=[0, 1]), r"xyx: expected .*\(\.\.\., 3\)"),
        (lambda: spm.pose([0, 0, 1], xyx=[0, 1, np.nan]), "xyx: expected finite"),
        (lambda: spm.pose([0, 0, 1]), "either xyx=... or rotation=..., got neither"),
        (lambda: spm.pose([0, 0, 1], xyx=EULER, rotation=np.eye(3)), "got both"),
        (lambda: spm.pose([0, 0, 1], rotation=2 * np.eye(3)), "rotation: expected a rotation matrix.*Scaled"),
        (lambda: spm.pose([0, 0, 1], rotation=np.diag([1, 1, -1])), "determinant -1.*reflection"),
        (lambda: spm.pose([0, 0, 1], rotation=np.eye(4)), r"rotation: expected .*\(\.\.\., 3, 3\)"),
        (lambda: spm.pose([0, 0, 1], rotation=np.full((3, 3), np.nan)), "rotation: expected finite"),
        (lambda: spm.pose(np.zeros((2, 3)), xyx=np.zeros((3, 3))), "broadcast"),
        (lambda: as_rigid_transform(np.eye(3)), r"pose: expected .*\(\.\.\., 4, 4\)"),
        (lambda: as_rigid_transform(replaced(3, 0, 0.5)), r"last row \[0, 0, 0, 1\]"),
        (lambda: as_rigid_transform(replaced(3, 0, 0.5).T.T), "last row"),
        (
            lambda: as_rigid_transform(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1.0]])),
            "Transposed",
        ),
        (lambda: as_rigid_transform(replaced(0, 3, np.nan)), "pose: expected finite"),
        (lambda: as_rigid_transform(replaced(0, 0, 0.9)), "pose: expected a rotation matrix"),
        (lambda: as_rigid_transform(Rotation.identity()), "A rotation alone is no pose"),
        (lambda: as_rigid_transform(None), "pose: expected"),
        (lambda: as_rigid_transform(RigidTransform(replaced(0, 0, 0.9), normalize=False)), "rotation matrix"),
        (lambda: as_rigid_transform(np.stack([GOOD, replaced(1, 1, -1)])), r"determinant -1 at index \(1,\)"),
    ],
)
def test_what_is_no_pose_is_refused(make: object, words: str) -> None:
    with pytest.raises(spm.PoseError, match=words):
        make()  # type: ignore[operator]


def test_the_argument_is_named_in_the_callers_words() -> None:
    with pytest.raises(spm.PoseError, match=r"^pose: expected") as caught:
        spm.inverse_displacement(spm.Geometry.paper(), np.zeros((3, 3)))
    assert caught.value.argument == "pose"
    assert isinstance(caught.value, ValueError)


def test_angles_in_degrees_are_noticed() -> None:
    with pytest.warns(UserWarning, match=r"xyx: an angle of 32\.97 rad is beyond a full turn"):
        spm.pose([0.6889, 0.4963, 2.253], xyx=[-11.08, 32.97, -12.88])
    # A full turn itself is none of it: warnings are errors here.
    spm.pose([0.0, 0.0, 2.0], xyx=[2.0 * np.pi, -2.0 * np.pi, 0.0])
    spm.pose(np.zeros((0, 3)), xyx=np.zeros((0, 3)))
