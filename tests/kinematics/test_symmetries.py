"""Symmetries of the inverse and of the forward displacement."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from problems import GEOMETRIES, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.kinematics.forward_displacement import ASSEMBLY_MODES, forward_displacement, forward_physical

PAPER = spm.Geometry.paper()
seeds = st.integers(0, 2**32 - 1)
families = st.sampled_from(spm.mechanism.FAMILIES)
geometries = st.sampled_from(sorted(GEOMETRIES))


# --- Inverse -----------------------------------------------------------------------------------------------------


def poses(family: str, shape: tuple[int, ...], seed: int, geometry: spm.Geometry = PAPER) -> RigidTransform:
    matrix = random_branches(geometry, family, int(np.prod(shape)), seed).pose.as_matrix()
    return RigidTransform.from_matrix(matrix.reshape(*shape, 4, 4))


def assert_same_branches(found: np.ndarray, expected: np.ndarray, size: float) -> None:
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    # Both sides round, and the pose was rounded once more in between: compare away from singularities.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)


def regular(solutions: spm.SolutionSet) -> np.ndarray:
    """Poses whose branches are all away from a fold and whose platform is tilted."""
    tilt = np.abs(np.linalg.norm(solutions.rotation[:, 0, :2, 2], axis=-1))
    return np.asarray((np.abs(solutions.discriminants) > 1e-4).all(axis=-1) & (tilt > 0.05))


@given(family=families, seed=seeds, name=geometries)
def test_turning_base_and_platform_by_a_third_permutes_the_legs(family: str, seed: int, name: str) -> None:
    geometry = GEOMETRIES[name]
    pose = poses(family, (20,), seed, geometry)
    third = Rotation.from_euler("z", 120, degrees=True)
    turned = spm.pose(third.apply(pose.translation), rotation=third * pose.rotation * third.inv())
    before, after = spm.inverse_displacement(geometry, pose), spm.inverse_displacement(geometry, turned)
    keep = regular(before)
    expected = np.roll(before.middle_joints, 1, axis=-2) @ third.as_matrix().T
    assert_same_branches(after.middle_joints[keep], expected[keep], geometry.middle_side)


@given(family=families, seed=seeds, name=geometries)
def test_a_mirror_image_has_the_mirrored_branches(family: str, seed: int, name: str) -> None:
    """Reflection at the plane X = 0 of leg 2 exchanges legs 1 and 3, and TF- stays TF-."""
    geometry = GEOMETRIES[name]
    pose = poses(family, (20,), seed, geometry)
    mirror = np.diag([-1.0, 1.0, 1.0])
    image = spm.pose(pose.translation @ mirror, rotation=mirror @ pose.rotation.as_matrix() @ mirror)
    before, after = spm.inverse_displacement(geometry, pose), spm.inverse_displacement(geometry, image)
    keep = regular(before)
    expected = before.middle_joints[..., ::-1, :] @ mirror
    # A reflection turns det K about, so + and - change places.
    swapped = expected.reshape(-1, 4, 2, 3, 3)[:, :, ::-1].reshape(-1, 8, 3, 3)
    assert_same_branches(after.middle_joints[keep], swapped[keep], geometry.middle_side)


@given(family=families, seed=seeds, name=geometries)
def test_seen_from_the_platform_the_stages_change_places(family: str, seed: int, name: str) -> None:
    """The inverse pose has the same branches with TF and FT exchanged: base and platform differ in size only."""
    geometry = GEOMETRIES[name]
    pose = poses(family, (20,), seed, geometry)
    before, after = spm.inverse_displacement(geometry, pose), spm.inverse_displacement(geometry, pose.inv())
    keep = regular(before) & regular(after)
    back = before.middle_joints - before.translation[..., None, :]
    expected = np.einsum("...ij,...kj->...ki", np.swapaxes(before.rotation, -1, -2), back)
    exchanged = expected.reshape(-1, 4, 2, 3, 3)[:, [0, 2, 1, 3]]
    found = after.middle_joints.reshape(-1, 4, 2, 3, 3)
    sets = [np.sort(np.nan_to_num(x[keep, :, :, 0, 2], nan=9e9), axis=-1) for x in (found, exchanged)]
    np.testing.assert_allclose(*sets, rtol=0, atol=1e-8 * geometry.middle_side)


@given(family=families, seed=seeds)
def test_the_sizes_of_base_and_platform_do_not_matter_for_the_joints(family: str, seed: int) -> None:
    pose = poses(family, (10,), seed)
    other = spm.Geometry(3.0, 0.1, 0.8)
    np.testing.assert_array_equal(
        spm.inverse_displacement(PAPER, pose).middle_joints, spm.inverse_displacement(other, pose).middle_joints
    )


# --- Forward -----------------------------------------------------------------------------------------------------

legs = st.lists(st.floats(0.9, 1.6), min_size=6, max_size=6)
"""The paper's stages close over all of this box, with between two and all sixteen modes each."""


def assert_same(left: spm.SolutionSet, rotation: np.ndarray, translation: np.ndarray, order: np.ndarray) -> None:
    """Mode k of `left` is mode order[k] of the set that has these poses, up to the order of equal mean radii."""
    np.testing.assert_array_equal(left.exists, ~np.isnan(translation[order, 0]))
    np.testing.assert_allclose(left.translation, translation[order], rtol=0, atol=1e-8)
    np.testing.assert_allclose(left.rotation, rotation[order], rtol=0, atol=1e-8)


@given(legs)
def test_a_third_of_a_turn_permutes_the_legs(lengths: list[float]) -> None:
    solutions = forward_displacement(PAPER, lengths)
    assume(well_separated(solutions))
    turned = forward_displacement(PAPER, np.roll(np.reshape(lengths, (2, 3)), 1, axis=1).reshape(-1))
    turn = Rotation.from_euler("z", 120, degrees=True).as_matrix()
    assert_same(turned, turn @ solutions.rotation @ turn.T, solutions.translation @ turn.T, np.arange(256))


@given(legs)
def test_reflection_in_the_plane_of_leg_2_exchanges_legs_1_and_3(lengths: list[float]) -> None:
    solutions = forward_displacement(PAPER, lengths)
    assume(well_separated(solutions))
    reflected = forward_displacement(PAPER, np.array(lengths)[[2, 1, 0, 5, 4, 3]])
    mirror = np.diag([-1.0, 1.0, 1.0])
    assert_same(reflected, mirror @ solutions.rotation @ mirror, solutions.translation @ mirror, np.arange(256))


@given(legs)
def test_reflection_in_the_base_exchanges_the_sheets_of_both_stages(lengths: list[float]) -> None:
    solutions = forward_displacement(PAPER, lengths)
    mirror = np.diag([1.0, 1.0, -1.0])
    swapped = [label.translate(str.maketrans("+-", "-+")) for label in ASSEMBLY_MODES]
    order = np.array([ASSEMBLY_MODES.index(label) for label in swapped])
    assert_same(solutions, mirror @ solutions.rotation @ mirror, solutions.translation @ mirror, order)


def test_exchanging_the_stages_inverts_the_pose() -> None:
    """Seen from {m} and turned over, the manipulator with C for E stands on its head."""
    rng = np.random.default_rng(4)
    swapped = spm.Geometry(PAPER.platform_radius, PAPER.base_radius, PAPER.middle_side)
    for _ in range(20):
        lengths = rng.uniform(1.1, 1.5, 6)
        state = forward_physical(PAPER, lengths)
        # Turned over about Y, legs 1 and 3 change places.
        other = forward_physical(swapped, lengths[[5, 4, 3, 2, 1, 0]])
        over = np.diag([-1.0, 1.0, -1.0])
        np.testing.assert_allclose(other.rotation, over @ state.rotation.T @ over, atol=1e-12)
        np.testing.assert_allclose(other.translation, -over @ state.rotation.T @ state.translation, atol=1e-12)


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
