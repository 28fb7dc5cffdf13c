"""Forward displacement, rates, forces and singularities of machines as built."""

from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES, as_built, in_leg_space, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.kinematics import EventKind

PAPER = spm.Geometry.paper()
EXAMPLE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
SIZES = (1e-6, 1e-4, 1e-3, 1e-2)


def states(size: float = 1e-3, count: int = 60, seed: int = 1) -> spm.Configuration:
    """Physical states of an imperfect machine within the leg limits, away from inverse singularities."""
    found = spm.inverse_physical(as_built(PAPER, size), in_leg_space(PAPER, count, seed=seed).pose)
    found = found[found.exists]
    return found[np.abs(spm.singularities(found).sigma[:, 2]) > 5e-3]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", GEOMETRIES)
def test_forward_finds_the_states_whose_readings_they_are(name: str, size: float) -> None:
    geometry = GEOMETRIES[name]
    built = as_built(geometry, size)
    problem = random_branches(geometry, "TT", 2000, seed=2)
    if geometry.limits is not None:
        problem = in_leg_space(geometry, 300, seed=2)
    state = spm.inverse_physical(built, problem.pose)
    state = state[state.exists]
    found = spm.forward_physical(built, state.readings)
    exists = found.exists
    # Within the errors of a forward singularity of the nominal machine a state may not be found.
    assert exists.mean() >= 0.95
    side = geometry.middle_side
    np.testing.assert_allclose(found.middle_joints[exists], state.middle_joints[exists], atol=1e-10 * side)
    np.testing.assert_allclose(found.translation[exists], state.translation[exists], atol=1e-10 * side)
    np.testing.assert_allclose(found.rotation[exists], state.rotation[exists], atol=1e-10)
    np.testing.assert_allclose(found.leg_lengths[exists], state.leg_lengths[exists], rtol=1e-12)
    assert found.closure_residual[exists].max() <= 1e-13 * side


def test_a_state_is_followed_from_its_readings_to_others() -> None:
    built = as_built(PAPER, 1e-3)
    state = states(count=40)
    found = spm.forward_physical(built, state.readings[1:], near=state[:-1])
    assert found.exists.mean() > 0.95
    error = np.abs(found.translation - state.translation[1:]).max(axis=-1)
    assert np.nanmax(error) < 1e-12
    # A mode that no machine gets into by itself stays that mode.
    turned = spm.inverse_displacement(built, in_leg_space(PAPER, 20, seed=9).pose)["FF+"]
    turned = turned[turned.exists]
    near = spm.forward_physical(built, turned.readings + 1e-4, near=turned)
    moved = np.abs(near.translation - turned.translation).max(axis=-1)
    assert (np.isnan(moved) | (moved < 0.05)).all()
    assert near.exists.mean() > 0.7
    alone = spm.forward_physical(built, state.readings[5], near=state[4])
    np.testing.assert_array_equal(alone.middle_joints, found.middle_joints[4])


def test_leg_rates_are_derivatives_of_the_readings() -> None:
    state = states(size=5e-3)
    twist, step = np.random.default_rng(4).standard_normal(6), 1e-6

    def lengths(s: float) -> np.ndarray:
        turned = Rotation.from_rotvec(s * twist[3:]) * state.pose.rotation
        pose = spm.pose(state.translation + s * twist[:3], rotation=turned)
        return spm.inverse_displacement(state.geometry, pose).nearest(state).leg_lengths

    expected = (lengths(step) - lengths(-step)) / (2.0 * step)
    assert len(state) > 30
    np.testing.assert_allclose(spm.leg_rates(state, twist), expected, rtol=1e-5, atol=1e-5)


def test_readings_below_their_offsets_are_refused() -> None:
    with pytest.raises(spm.ArgumentError, match=r"readings.*exceed their offset.*r_b1"):
        spm.forward_physical(as_built(PAPER, 1e-3), np.full(6, -1.0))


def test_a_path_of_a_machine_as_built_is_followed() -> None:
    built = as_built(PAPER, 1e-3)
    ends = np.array([[1.2, 1.2, 1.4, 1.25, 1.2, 1.5], [1.3, 1.25, 1.2, 1.2, 1.4, 1.6]])
    by_legs = spm.follow(built, ends, samples=20)
    assert by_legs.complete
    assert [event.kind for event in by_legs.events if "LIMIT" in event.kind.name] == [EventKind.LIMIT]
    lines = ends[0] + by_legs.parameters[:, None] * (ends[1] - ends[0])
    np.testing.assert_allclose(by_legs.configurations.readings, lines, atol=1e-12)
    # The same states along their poses, where the branches are known with their labels.
    poses = by_legs.configurations.pose
    by_poses = spm.follow(built, poses, start=by_legs.configurations[0], samples=20)
    assert by_poses.complete
    np.testing.assert_allclose(by_poses.configurations[-1].readings, ends[1], atol=1e-9)
    # A state of another mode is followed too.
    turned = spm.inverse_displacement(built, EXAMPLE)["FF+"]
    other = spm.follow(built, np.stack([turned.readings, turned.readings + 0.01]), start=turned, samples=5)
    np.testing.assert_allclose(other.configurations[0].middle_joints, turned.middle_joints, atol=1e-12)
    with pytest.raises(spm.GeometryError, match="a machine as drawn"):
        spm.forward_displacement(built, ends)
