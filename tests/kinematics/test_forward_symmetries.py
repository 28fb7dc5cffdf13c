"""Symmetries of the forward displacement, over batches and units."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics.forward_displacement import ASSEMBLY_MODES, forward_displacement, forward_physical

PAPER = spm.Geometry.paper()
SHAPES = [(), (1,), (3, 1, 2), (0,)]

legs = st.lists(st.floats(0.9, 1.6), min_size=6, max_size=6)
"""The paper's stages close over all of this box, with between two and all sixteen modes each."""


def sample(shape: tuple[int, ...]) -> np.ndarray:
    rng = np.random.default_rng(1)
    lengths = rng.uniform(0.9, 1.6, (*shape, 6))
    # A member out of reach must not disturb its neighbours.
    lengths.reshape(-1, 6)[1:2] = [0.3, 1.2, 3.0, 1.2, 1.2, 1.2]
    return lengths


@pytest.mark.parametrize("shape", SHAPES)
def test_a_batch_is_its_members(shape: tuple[int, ...]) -> None:
    lengths = sample(shape)
    solutions = forward_displacement(PAPER, lengths)
    physical = forward_physical(PAPER, lengths)
    assert solutions.shape == physical.shape == shape
    assert solutions.exists.shape == (*shape, 256)
    assert solutions.rotation.shape == (*shape, 256, 3, 3)
    assert solutions.translation.shape == (*shape, 256, 3)
    assert solutions.middle_joints.shape == (*shape, 256, 3, 3)
    assert np.shape(solutions.status) == shape
    for index in np.ndindex(shape):
        member = forward_displacement(PAPER, lengths[index])
        np.testing.assert_array_equal(member.middle_joints, solutions.middle_joints[index])
        np.testing.assert_array_equal(member.rotation, solutions.rotation[index])
        np.testing.assert_array_equal(member.translation, solutions.translation[index])
        assert int(member.status) == int(np.asarray(solutions.status)[index])
        alone = forward_physical(PAPER, lengths[index])
        np.testing.assert_array_equal(alone.middle_joints, physical.middle_joints[index])
        np.testing.assert_array_equal(alone.translation, physical.translation[index])


@pytest.mark.parametrize("shape", SHAPES)
def test_a_batch_of_seeds_is_its_members(shape: tuple[int, ...]) -> None:
    lengths = np.random.default_rng(2).uniform(1.1, 1.5, (*shape, 6))
    start = forward_physical(PAPER, lengths)
    target = lengths[..., ::-1]
    end = forward_physical(PAPER, target, near=start)
    assert end.shape == shape
    for index in np.ndindex(shape):
        alone = forward_physical(PAPER, target[index], near=start[index] if shape else start)
        np.testing.assert_allclose(alone.middle_joints, end.middle_joints[index], rtol=0, atol=1e-15)
    home = forward_physical(PAPER, [1.3] * 6)
    assert forward_physical(PAPER, target, near=home).shape == shape


def test_a_large_batch_is_its_parts() -> None:
    lengths = np.random.default_rng(3).uniform(1.1, 1.5, (2_500, 6))
    whole = forward_physical(PAPER, lengths)
    parts = [forward_physical(PAPER, lengths[k : k + 7]) for k in (0, 1020, 2490)]
    for k, part in zip((0, 1020, 2490), parts, strict=True):
        np.testing.assert_array_equal(whole.middle_joints[k : k + 7], part.middle_joints)
    modes = forward_displacement(PAPER, lengths[1000:1040])
    # The same solution, reached from another start.
    home = modes["T1+/T1+"].middle_joints[20:27]
    np.testing.assert_allclose(home, whole.middle_joints[1020:1027], rtol=0, atol=8 * np.finfo(float).eps)


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


@given(legs, st.sampled_from([1e-3, 0.125, 39.37, 1e3]))
def test_results_do_not_depend_on_the_unit_of_length(lengths: list[float], scale: float) -> None:
    solutions = forward_displacement(PAPER, lengths)
    assume(well_separated(solutions))
    geometry = spm.Geometry(*(scale * x for x in (PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)))
    scaled = forward_displacement(geometry, scale * np.array(lengths))
    np.testing.assert_array_equal(scaled.exists, solutions.exists)
    np.testing.assert_allclose(scaled.translation / scale, solutions.translation, rtol=0, atol=1e-8)
    np.testing.assert_allclose(scaled.rotation, solutions.rotation, rtol=0, atol=1e-8)


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
