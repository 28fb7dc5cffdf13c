"""Forward displacement, rates, forces and singularities of machines as built."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from problems import GEOMETRIES, as_built, in_leg_space, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm

PAPER = spm.Geometry.paper()
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
    found = spm.forward_physical(built, state.leg_lengths)
    exists = found.exists
    # Within the errors of a forward singularity of the nominal machine a state may not be found.
    assert exists.mean() >= 0.95
    side = geometry.middle_side
    np.testing.assert_allclose(found.middle_joints[exists], state.middle_joints[exists], atol=1e-10 * side)
    np.testing.assert_allclose(found.translation[exists], state.translation[exists], atol=1e-10 * side)
    np.testing.assert_allclose(found.rotation[exists], state.rotation[exists], atol=1e-10)
    np.testing.assert_allclose(found.leg_lengths[exists], state.leg_lengths[exists], rtol=1e-12)
    assert found.closure_residual[exists].max() <= 1e-13 * side


@pytest.mark.parametrize("name", GEOMETRIES)
def test_without_errors_the_answers_are_those_of_the_nominal_machine(name: str) -> None:
    geometry = GEOMETRIES[name]
    built = geometry
    nominal = random_branches(geometry, "TT", 300, seed=5).configuration
    same = spm.Configuration(built, nominal.pose, nominal.middle_joints)
    legs = nominal.leg_lengths
    forward = spm.forward_physical(geometry, legs)
    np.testing.assert_array_equal(spm.forward_physical(built, legs).middle_joints, forward.middle_joints)
    load = np.random.default_rng(0).standard_normal((300, 6))
    for function in (spm.inverse_jacobian, spm.kinematics.platform_jacobian, spm.determinants):
        expected, found = function(nominal), function(same)
        scale = np.abs(expected).max(axis=tuple(range(1, expected.ndim)), keepdims=True)
        # Errors of the 6 x 6 solution grow with the condition.
        assert np.median(np.abs(found - expected) / scale) < 1e-14
        assert (np.abs(found - expected) / scale).max() < 1e-8
    np.testing.assert_allclose(spm.leg_forces(same, load), spm.leg_forces(nominal, load), rtol=1e-6, atol=1e-7)
    first, second = spm.singularities(nominal), spm.singularities(same)
    np.testing.assert_allclose(second.sigma, first.sigma, atol=1e-13)
    np.testing.assert_allclose(second.scaled_determinants, first.scaled_determinants, atol=1e-11)
    for name in ("rank", "kind", "mobility"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name))
    clear = (first.sigma > 1e-2).all(axis=-1)
    for name in ("gained_twist", "inner_twist", "lost_wrench"):
        expected_screw, found_screw = (getattr(s, name)[clear].reshape(clear.sum(), -1, 6) for s in (first, second))
        sign = np.sign((expected_screw * found_screw).sum(axis=-1, keepdims=True))
        scale = np.abs(expected_screw).max(axis=-1, keepdims=True)
        assert np.median(np.abs(sign * found_screw - expected_screw) / scale) < 1e-12


def test_a_seed_is_followed_from_its_readings_to_others() -> None:
    built = as_built(PAPER, 1e-3)
    state = states(count=40)
    found = spm.forward_physical(built, state.leg_lengths[1:], near=state[:-1])
    assert found.exists.mean() > 0.95
    error = np.abs(found.translation - state.translation[1:]).max(axis=-1)
    assert np.nanmax(error) < 1e-12
    # A mode that no machine gets into by itself stays that mode.
    turned = spm.inverse_displacement(built, in_leg_space(PAPER, 20, seed=9).pose)["FF+"]
    turned = turned[turned.exists]
    near = spm.forward_physical(built, turned.leg_lengths + 1e-4, near=turned)
    moved = np.abs(near.translation - turned.translation).max(axis=-1)
    assert (np.isnan(moved) | (moved < 0.05)).all()
    assert near.exists.mean() > 0.7
    alone = spm.forward_physical(built, state.leg_lengths[5], near=state[4])
    np.testing.assert_array_equal(alone.middle_joints, found.middle_joints[4])


def test_offsets_are_taken_off_the_readings() -> None:
    built = as_built(PAPER, 1e-4)
    shifted = replace(built, legs=replace(built.legs, offsets=built.legs.offsets + 0.25))
    legs = np.full(6, 1.3)
    np.testing.assert_allclose(
        spm.forward_physical(shifted, legs + 0.25).translation,
        spm.forward_physical(built, legs).translation,
        atol=1e-14,
    )


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 1, 2)])
def test_a_batch_is_solved_like_its_members(shape: tuple[int, ...]) -> None:
    built = as_built(PAPER, 1e-3)
    legs = np.random.default_rng(1).uniform(1.15, 1.45, (*shape, 6))
    found = spm.forward_physical(built, legs)
    assert found.shape == shape
    jacobian, determinants = spm.inverse_jacobian(found), spm.determinants(found)
    described = spm.singularities(found)
    assert jacobian.shape == (*shape, 6, 6)
    assert determinants.shape == (*shape, 3) == described.sigma.shape
    assert described.gained_twist.shape == (*shape, 2, 6)
    for index in np.ndindex(shape):
        alone = spm.forward_physical(built, legs[index])
        np.testing.assert_array_equal(alone.middle_joints, found.middle_joints[index])
        np.testing.assert_allclose(spm.inverse_jacobian(alone), jacobian[index], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(spm.singularities(alone).sigma, described.sigma[index], rtol=1e-12)


def moved(pose: spm.mechanism.PoseLike, twist: np.ndarray, step: float) -> np.ndarray:
    matrix = np.array(pose)
    matrix[..., :3, 3] += step * twist[:3]
    matrix[..., :3, :3] = Rotation.from_rotvec(step * twist[3:]).as_matrix() @ matrix[..., :3, :3]
    return matrix


def test_leg_rates_are_derivatives_of_the_readings() -> None:
    state = states(size=5e-3)
    pose, step = state.pose.as_matrix(), 1e-6
    twist = np.random.default_rng(4).standard_normal(6)
    ahead, behind = (
        spm.inverse_displacement(state.geometry, moved(pose, twist, s)).nearest(state) for s in (step, -step)
    )
    expected = (ahead.leg_lengths - behind.leg_lengths) / (2.0 * step)
    rates = spm.leg_rates(state, twist)
    assert len(state) > 30
    np.testing.assert_allclose(rates, expected, rtol=1e-5, atol=1e-5)


def test_forces_do_the_work_of_the_wrench() -> None:
    state = states(size=5e-3)
    random = np.random.default_rng(5)
    wrench, twist = random.standard_normal((2, len(state), 6))
    work = (spm.leg_forces(state, wrench) * spm.leg_rates(state, twist)).sum(axis=-1)
    np.testing.assert_allclose(work, -(wrench * twist).sum(axis=-1), rtol=1e-9, atol=1e-9)


def test_determinants_are_those_of_the_jacobian() -> None:
    state = states(size=5e-3)
    lower, upper, structure = np.moveaxis(spm.determinants(state), -1, 0)
    np.testing.assert_allclose(np.linalg.det(spm.inverse_jacobian(state)), lower * upper / structure, rtol=1e-9)
    np.testing.assert_allclose(spm.singularities(state).determinants, spm.determinants(state), rtol=1e-9)


def test_a_pair_of_branches_meets_at_an_inverse_singularity() -> None:
    """The errors are bisected to where two branches of the paper's example end; K is singular there and only there."""
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    nominal = PAPER
    direction = np.random.default_rng(1).standard_normal(54)

    def branches(size: float) -> spm.SolutionSet:
        return spm.inverse_displacement(nominal.from_parameters(nominal.parameters + size * direction), pose)

    low, high = 1e-6, 1e-4
    while high / low - 1.0 > 1e-10:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if branches(middle).count == 6 else (low, middle)
    before, after = branches(low), branches(high)
    gone = before.exists & ~after.exists
    described = spm.singularities(before.configurations)
    assert gone.sum() == 2
    assert (described.sigma[gone, 2] < 1e-6).all()
    signs = np.sign(spm.determinants(before.configurations)[gone, 2])
    assert signs.sum() == 0
    assert (described.sigma[before.exists & ~gone, 2] > 1e-5).all()
    near = spm.singularities(before.configurations, tolerance=1e-5)
    assert (near.kind[gone] == spm.kinematics.SingularityKind.INVERSE).all()
    assert (near.mobility[gone] == 5).all()
    # No motion of the platform does work on the lost wrench: the legs do not carry it.
    state = before.configurations[int(np.flatnonzero(gone)[0])]
    forces = spm.leg_forces(state, described.lost_wrench[gone][0])
    assert np.abs(forces).max() < 1e-4
    # The middle platform moves with both ends at rest, from one branch to the other.
    gap = np.diff(before.configurations[gone].balls, axis=0)[0]
    twist = described.inner_twist[gone][0]
    velocity = twist[:3] + np.cross(twist[3:], state.balls - state.translation)
    cosine = (gap * velocity).sum() / np.linalg.norm(gap) / np.linalg.norm(velocity)
    assert abs(cosine) == pytest.approx(1.0, abs=1e-4)


def test_singular_states_are_refused_as_those_of_the_nominal_machine() -> None:
    home = spm.forward_physical(PAPER, np.full(6, 1.3))
    nominal = PAPER
    state = spm.Configuration(nominal, home.pose, home.middle_joints)
    with pytest.raises(spm.SingularConfigurationError) as raised:
        spm.inverse_jacobian(state)
    assert raised.value.kind == "inverse"
    assert spm.singularities(state).rank[2] == spm.singularities(home).rank[2] == 3
    assert np.isfinite(spm.leg_forces(state, np.ones(6))).all()
    level = spm.pose(np.zeros(3), rotation=np.eye(3))
    flat = spm.Configuration(nominal, level, PAPER.middle_radius * PAPER.radial_directions)
    with pytest.raises(spm.SingularConfigurationError) as raised:
        spm.leg_forces(flat, np.ones(6))
    assert raised.value.kind == "forward"


def test_states_that_do_not_exist_give_nan() -> None:
    built = as_built(PAPER, 1e-3)
    found = spm.forward_physical(built, [[1.3] * 6, [1.3, 1.3, 9.0, 1.3, 1.3, 1.3]])
    assert found.exists.tolist() == [True, False]
    assert np.isnan(spm.determinants(found)[1]).all()
    assert np.isfinite(spm.determinants(found)[0]).all()
    described = spm.singularities(found)
    assert described.rank[1].tolist() == [0, 0, 0]
    assert np.isnan(described.sigma[1]).all()
    assert np.isnan(described.lost_wrench[1]).all()
    forces = spm.leg_forces(found, np.ones(6))
    assert np.isfinite(forces[0]).all()
    assert np.isnan(forces[1]).all()


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_rates_of_states_that_do_not_exist_are_nan(size: float) -> None:
    found = spm.inverse_physical(as_built(PAPER, size), in_leg_space(PAPER, 5, seed=2).pose)
    absent = spm.inverse_physical(as_built(PAPER, size), spm.pose([0.0, 0.0, 9.0], xyx=[0.0, 0.0, 0.0]))
    assert not absent.exists
    assert np.isfinite(spm.inverse_jacobian(found)).all()
    assert np.isnan(spm.inverse_jacobian(absent)).all()
    assert np.isnan(spm.leg_rates(absent, np.ones(6))).all()
    assert np.isnan(spm.stiffness(absent, 1e7)).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda built, state: spm.forward_physical(built, np.full(5, 1.3)), "leg_lengths"),
        (lambda built, state: spm.forward_physical(built, np.full(6, -1.0)), "leg_lengths.*exceed their offset.*r_b1"),
        (lambda built, state: spm.forward_physical(built, np.full(6, 1e9)), "leg_lengths.*another unit"),
        (lambda built, state: spm.forward_physical(PAPER, np.full(6, 1.3), near=state), "seed.*of this geometry"),
        (lambda built, state: spm.forward_physical(built, np.full(6, 1.3), seed=built), "seed.*Configuration"),
        (
            lambda built, state: spm.forward_physical(as_built(PAPER, 2e-3), np.full(6, 1.3), near=state),
            "seed.*of this geometry",
        ),
        (
            lambda built, state: spm.forward_physical(
                built, np.full(6, 1.3), seed=spm.Configuration(built, state.pose, state.middle_joints + 0.01)
            ),
            "seed.*closes",
        ),
        (lambda built, state: spm.leg_rates(state, np.zeros(5)), "twist"),
        (lambda built, state: spm.leg_forces(state, np.full(6, np.nan)), "wrench"),
        (lambda built, state: spm.singularities(state, tolerance=2.0), "tolerance"),
    ],
)
def test_bad_arguments_are_named(call: Callable[[object, object], object], message: str) -> None:
    built = as_built(PAPER, 1e-3)
    state = spm.forward_physical(built, np.full(6, 1.3))
    with pytest.raises(spm.ArgumentError, match=message):
        call(built, state)
