"""Symmetries of the inverse and of the forward displacement."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from problems import MANIPULATORS, PAPER, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.kinematics.forward_displacement import ASSEMBLY_MODES, forward_displacement


def in_pairs(joints: np.ndarray) -> np.ndarray:
    return joints.reshape(-1, 4, 2, 3, 3)


def regular(solutions: spm.SolutionSet) -> np.ndarray:
    """Poses whose branches are all away from a fold and whose platform is tilted."""
    tilt = np.abs(np.linalg.norm(solutions.rotation[:, 0, :2, 2], axis=-1))
    return np.asarray((np.abs(solutions.discriminants) > 1e-4).all(axis=-1) & (tilt > 0.05))


@given(st.sampled_from(spm.machine.FAMILIES), st.integers(0, 2**32 - 1), st.sampled_from(sorted(MANIPULATORS)))
def test_images_of_a_pose_have_the_images_of_its_branches(family: str, seed: int, name: str) -> None:
    machine, third, mirror = MANIPULATORS[name], Rotation.from_euler("z", 120, degrees=True), np.diag([-1.0, 1.0, 1.0])
    pose = random_branches(machine, family, 20, seed).pose
    before = spm.inverse_displacement(machine, pose)
    b, keep, size = before.middle_joints, regular(before), machine.middle_side

    def images(other: RigidTransform) -> np.ndarray:
        return spm.inverse_displacement(machine, other).middle_joints

    # A third of a turn of base and platform permutes the legs. Both sides round, and the pose once more in between.
    turned = images(spm.pose(third.apply(pose.translation), rotation=third * pose.rotation * third.inv()))
    expected = np.roll(b, 1, axis=-2) @ third.as_matrix().T
    np.testing.assert_allclose(turned[keep], expected[keep], rtol=0, atol=1e-9 * size)
    # Reflection at the plane X = 0 of leg 2 exchanges legs 1 and 3, and turns det K about: + and - change places.
    mirrored = images(spm.pose(pose.translation @ mirror, rotation=mirror @ pose.rotation.as_matrix() @ mirror))
    expected = in_pairs(b[..., ::-1, :] @ mirror)[:, :, ::-1]
    np.testing.assert_allclose(in_pairs(mirrored)[keep], expected[keep], rtol=0, atol=1e-9 * size)
    # Seen from the platform, TF and FT change places: base and platform differ in size only.
    after = spm.inverse_displacement(machine, pose.inv())
    expected = in_pairs((b - before.translation[..., None, :]) @ before.rotation)[:, [0, 2, 1, 3]]
    both = keep & regular(after)
    found = (np.sort(np.nan_to_num(x[both, :, :, 0, 2], nan=9e9)) for x in (in_pairs(after.middle_joints), expected))
    np.testing.assert_allclose(*found, rtol=0, atol=1e-8 * size)
    # The sizes of base and platform do not matter for the joints.
    other = spm.Manipulator(3.0 * size, 0.1 * size, size)
    np.testing.assert_array_equal(spm.inverse_displacement(other, pose).middle_joints, b)


@given(st.lists(st.floats(0.9, 1.6), min_size=6, max_size=6))
def test_images_of_leg_lengths_have_the_images_of_the_modes(lengths: list[float]) -> None:
    """The paper's stages close over all of this box, with between two and all sixteen modes each."""
    solutions = forward_displacement(PAPER, lengths)

    def assert_images(found: spm.SolutionSet, motion: np.ndarray, order: np.ndarray) -> None:
        rotation, translation = motion @ solutions.rotation @ motion.T, solutions.translation @ motion.T
        np.testing.assert_allclose(found.translation, translation[order], rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.rotation, rotation[order], rtol=0, atol=1e-8)

    # Reflection in the base exchanges the sheets of both stages.
    swapped = [label.translate(str.maketrans("+-", "-+")) for label in ASSEMBLY_MODES]
    assert_images(solutions, np.diag([1.0, 1.0, -1.0]), np.array([ASSEMBLY_MODES.index(label) for label in swapped]))
    assume(well_separated(solutions))
    # A third of a turn permutes the legs; reflection in the plane of leg 2 exchanges legs 1 and 3.
    turned = forward_displacement(PAPER, np.roll(np.reshape(lengths, (2, 3)), 1, axis=1).reshape(-1))
    assert_images(turned, Rotation.from_euler("z", 120, degrees=True).as_matrix(), np.arange(256))
    reflected = forward_displacement(PAPER, np.array(lengths)[[2, 1, 0, 5, 4, 3]])
    assert_images(reflected, np.diag([-1.0, 1.0, 1.0]), np.arange(256))


def well_separated(solutions: spm.SolutionSet) -> bool:
    """No two modes of a stage so close, or of so nearly equal mean radius, that rounding decides their number or order.

    What symmetric legs do is a matter of `test_stage.py`.
    """
    b = solutions.middle_joints
    radial = PAPER.radial_directions
    lower = (b * radial).sum(axis=(-1, -2))
    hanging = (b - solutions.translation[:, None]) @ solutions.rotation
    upper = (hanging * radial).sum(axis=(-1, -2))
    for radii in (lower.reshape(16, 16).T, upper.reshape(16, 16)):
        values = radii[np.argmax(~np.isnan(radii).all(axis=-1))][::2]
        values = np.sort(values[~np.isnan(values)])
        if np.any(np.diff(values) < 1e-5):
            return False
    return True
