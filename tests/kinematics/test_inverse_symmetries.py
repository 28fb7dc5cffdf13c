"""Symmetries of the inverse displacement, over batch shapes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import GEOMETRIES, random_branches
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

PAPER = spm.Geometry.paper()
SHAPES = [(), (1,), (3, 1, 2), (0,), (5,)]
seeds = st.integers(0, 2**32 - 1)
families = st.sampled_from(spm.mechanism.FAMILIES)
geometries = st.sampled_from(sorted(GEOMETRIES))


def poses(family: str, shape: tuple[int, ...], seed: int, geometry: spm.Geometry = PAPER) -> RigidTransform:
    matrix = random_branches(geometry, family, int(np.prod(shape)), seed).pose.as_matrix()
    return RigidTransform.from_matrix(matrix.reshape(*shape, 4, 4))


def assert_same_bits(found: spm.SolutionSet, expected: spm.SolutionSet) -> None:
    for name in ("middle_joints", "leg_lengths", "discriminants", "exists", "status", "residual"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


@pytest.mark.parametrize("shape", SHAPES)
@given(family=families, seed=seeds)
def test_a_batch_is_its_singles(shape: tuple[int, ...], family: str, seed: int) -> None:
    pose = poses(family, shape, seed)
    batch = spm.inverse_displacement(PAPER, pose)
    assert batch.shape == shape
    assert batch.middle_joints.shape == (*shape, 8, 3, 3)
    roots = spm.kinematics.complex_middle_joints(PAPER, pose)
    assert roots.shape == (*shape, 8, 3, 3)
    if not shape:
        return
    for index in np.ndindex(shape):
        single = pose.as_matrix()[index]
        assert_same_bits(spm.inverse_displacement(PAPER, single), batch[index])
        np.testing.assert_array_equal(spm.kinematics.complex_middle_joints(PAPER, single), roots[index])


@pytest.mark.parametrize("length", [4000, 4001, 4567])
def test_a_large_batch_is_its_parts(length: int) -> None:
    """Kernels fetch the memory of large batches ahead of writing it, beyond the end as well."""
    pose = random_branches(PAPER, "TT", length, seed=8).pose
    whole, lengths = spm.inverse_displacement(PAPER, pose), spm.kinematics.branch_lengths(PAPER, pose)[0]
    np.testing.assert_array_equal(lengths, whole.leg_lengths)
    for first in range(0, length, 500):
        part = slice(first, min(first + 500, length))
        assert_same_bits(spm.inverse_displacement(PAPER, pose[part]), whole[part])


@given(family=families, seed=seeds)
def test_results_do_not_depend_on_neighbours_in_the_batch(family: str, seed: int) -> None:
    """A degenerate, an unreachable and a regular pose side by side are what each is alone."""
    regular = poses(family, (3,), seed).as_matrix()
    odd = [spm.pose([0, 0, 2], rotation=np.eye(3)), spm.pose([9, 9, 2], rotation=np.diag([1.0, -1, -1]))]
    mixed = np.stack([regular[0], odd[0].as_matrix(), regular[1], odd[1].as_matrix(), regular[2]])
    batch = spm.inverse_displacement(PAPER, mixed)
    assert list(batch.status[[1, 3]]) == [spm.Status.DEGENERATE, spm.Status.UNREACHABLE]
    for k, pose in enumerate(mixed):
        assert_same_bits(spm.inverse_displacement(PAPER, pose), batch[k])


def assert_same_branches(found: np.ndarray, expected: np.ndarray, size: float) -> None:
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    # Both sides round, and the pose was rounded once more in between: compare away from singularities.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)


def regular(solutions: spm.SolutionSet) -> np.ndarray:
    """Poses whose branches are all away from a fold and whose platform is tilted."""
    tilt = np.abs(np.linalg.norm(solutions.rotation[:, 0, :2, 2], axis=-1))
    assert solutions.discriminants is not None
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


@given(family=families, seed=seeds, scale=st.floats(1e-3, 1e3))
def test_lengths_scale(family: str, seed: int, scale: float) -> None:
    small, large = PAPER, spm.Geometry(*(scale * x for x in (PAPER.base_radius, PAPER.platform_radius, 0.8)))
    pose = poses(family, (20,), seed)
    scaled = spm.pose(scale * pose.translation, rotation=pose.rotation)
    before, after = spm.inverse_displacement(small, pose), spm.inverse_displacement(large, scaled)
    keep = regular(before)
    assert_same_branches(after.middle_joints[keep] / scale, before.middle_joints[keep], 1.0)
    np.testing.assert_allclose(
        np.asarray(after.discriminants)[keep], np.asarray(before.discriminants)[keep], rtol=1e-9, atol=1e-12
    )


@given(family=families, seed=seeds)
def test_the_sizes_of_base_and_platform_do_not_matter_for_the_joints(family: str, seed: int) -> None:
    pose = poses(family, (10,), seed)
    other = spm.Geometry(3.0, 0.1, 0.8)
    np.testing.assert_array_equal(
        spm.inverse_displacement(PAPER, pose).middle_joints, spm.inverse_displacement(other, pose).middle_joints
    )
