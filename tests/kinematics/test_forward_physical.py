"""The configuration of six leg lengths that is continued from home, or from a seed, to where its mode ends."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from problems import MANIPULATORS, PAPER, as_built, distance, in_leg_space, random_branches
from scipy.integrate import solve_ivp

import spm_pin as spm
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical

RADIAL = PAPER.radial_directions
UP = np.array([0.0, 0.0, 1.0])
LEGS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])


# --- Both stages followed by the angles of their legs, without the package ----------------------------------------


def hips(machine: spm.Manipulator) -> np.ndarray:
    return np.array([[machine.base_radius], [machine.platform_radius]])


def stage_joints(state: spm.Configuration) -> np.ndarray:
    """The b_i seen from {B} and from {m}, (..., 2, 3, 3) [m]."""
    local = (state.middle_joints - state.translation[..., None, :]) @ state.rotation
    return np.stack([state.middle_joints, local], axis=-3)


def leg_angles(machine: spm.Manipulator, joints: np.ndarray) -> np.ndarray:
    """Angles of the legs in their planes, (..., 2, 3) [rad]."""
    return np.arctan2(joints[..., 2], (joints * RADIAL).sum(axis=-1) - hips(machine))


def joints_at(machine: spm.Manipulator, legs: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The b_i of legs at their angles, (..., 2, 3, 3) [m]."""
    rho, z = hips(machine) + legs * np.cos(theta), legs * np.sin(theta)
    return rho[..., None] * RADIAL + z[..., None] * UP


def side_errors(machine: spm.Manipulator, legs: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """Errors of the squared sides 12, 23, 31, |b_i - b_j|² = ρ_i² + ρ_j² + ρ_i ρ_j + (z_i - z_j)², (..., 2, 3) [m²].

    Returns them with their derivatives by θ_i, by θ_j, and by l_i and l_j, (..., 2, 3, 2).
    """
    cos, sin = np.cos(theta), np.sin(theta)
    rho, z = hips(machine) + legs * cos, legs * sin
    rho_j, z_j, cos_j, sin_j, legs_j = (np.roll(x, -1, axis=-1) for x in (rho, z, cos, sin, legs))
    by_rho, by_rho_j, by_z = 2 * rho + rho_j, 2 * rho_j + rho, 2 * (z - z_j)
    gap = rho**2 + rho_j**2 + rho * rho_j + (z - z_j) ** 2 - machine.middle_side**2
    by_own = legs * (by_z * cos - by_rho * sin)
    by_next = -legs_j * (by_z * cos_j + by_rho_j * sin_j)
    by_legs = np.stack([by_rho * cos + by_z * sin, by_rho_j * cos_j - by_z * sin_j], axis=-1)
    return gap, by_own, by_next, by_legs


def cyclic_solution(by_own: np.ndarray, by_next: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve by_own_i x_i + by_next_i x_(i+1) = right_i by Cramer's rule; the solution (..., 3) and the determinant."""
    (a1, a2, a3), (c1, c2, c3), (g1, g2, g3) = (np.moveaxis(x, -1, 0) for x in (by_own, by_next, right))
    determinant = a1 * a2 * a3 + c1 * c2 * c3
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (g1 * a2 * a3 - c1 * (g2 * a3 - c2 * g3)) / determinant
        second = (a1 * (g2 * a3 - c2 * g3) + c3 * c2 * g1) / determinant
        third = (a1 * a2 * g3 - c3 * (g1 * a2 - c1 * g2)) / determinant
    return np.stack([first, second, third], axis=-1), determinant


def follow_finely(
    machine: spm.Manipulator, theta: np.ndarray, start: np.ndarray, end: np.ndarray, steps: int, newton: int
) -> tuple[np.ndarray, np.ndarray]:
    """Follow both stages by some steps of Newton's method on the angles of the legs (N, 2, 3) at equal distances.

    Returns the joints as `stage_joints`, and whether no determinant changed its sign and every step converged.
    """
    sign, regular = None, np.ones(len(start), dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        for t in np.linspace(0.0, 1.0, steps + 1):
            legs = start + t * (end - start)
            for _ in range(newton):
                gap, by_own, by_next, _ = side_errors(machine, legs, theta)
                step, determinant = cyclic_solution(by_own, by_next, -gap)
                theta = theta + step
            sign = np.sign(determinant) if sign is None else sign
            closed = np.abs(gap).max(axis=-1) < 1e-9 * machine.middle_side**2
            regular &= ((np.sign(determinant) == sign) & closed).all(axis=-1)
            theta = np.where(regular[:, None, None], theta, np.nan)
    return joints_at(machine, end, theta), regular


def continued_from_home(machine: spm.Manipulator, lengths: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Follow both stages from equal legs, the upper one below its hips."""
    r, side = machine.middle_radius, np.array([[1.0], [-1.0]])
    target = lengths.reshape(-1, 2, 3)
    home = np.maximum(target.mean(axis=-1, keepdims=True), 1.001 * np.abs(r - hips(machine)) + 1e-3 * r)
    theta = side * np.arccos(np.clip((r - hips(machine)) / home, -1.0, 1.0)) * np.ones(3)
    return follow_finely(machine, theta, home * np.ones(3), target, steps, newton=4)


def follow_adaptively(seed: spm.Configuration, end: np.ndarray) -> tuple[np.ndarray, bool]:
    """Follow one state as `follow_finely` does, by integrating θ' with SciPy, whose steps get as short as needed."""
    start = np.asarray(seed.leg_lengths).reshape(2, 3)
    rates = end.reshape(2, 3) - start

    def slopes(t: float, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, by_own, by_next, by_legs = side_errors(PAPER, start + t * rates, theta.reshape(2, 3))
        change = by_legs[..., 0] * rates + by_legs[..., 1] * np.roll(rates, -1, axis=-1)
        return cyclic_solution(by_own, by_next, -change)

    angles = leg_angles(PAPER, stage_joints(seed))
    path = solve_ivp(
        lambda t, theta: slopes(t, theta)[0].ravel(), (0.0, 1.0), angles.ravel(), "DOP853", rtol=1e-12, atol=1e-13
    )
    determinants = np.array([slopes(t, theta)[1] for t, theta in zip(path.t, path.y.T, strict=True)])
    legs, theta = end.reshape(2, 3), path.y[:, -1].reshape(2, 3)
    # A step that jumps over a singularity leaves the sides open.
    closed = np.abs(side_errors(PAPER, legs, theta)[0]).max() < 1e-9
    regular = bool(path.success and closed and (np.sign(determinants) == np.sign(determinants[0])).all())
    return joints_at(PAPER, legs, theta if regular else np.full((2, 3), np.nan)), regular


# --- From home ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*MANIPULATORS, "small platforms"])
def test_far_from_home_the_physical_configuration_is_continued_or_absent(name: str) -> None:
    machine = {**MANIPULATORS, "small platforms": spm.Manipulator(0.05, 0.1, 0.8)}[name]
    rng = np.random.default_rng(6)
    size = machine.middle_radius + np.repeat([machine.base_radius, machine.platform_radius], 3)
    spread = rng.uniform(0.0, 0.4, (600, 1))
    lengths = size * rng.uniform(0.6, 2.0, (600, 1)) * np.abs(1.0 + spread * rng.normal(size=(600, 6))).clip(0.05)
    state = forward_physical(machine, lengths)
    joints, whole = continued_from_home(machine, lengths, steps=200)
    assert 0.1 < whole.mean() < 0.97
    assert state.exists[whole].all()
    np.testing.assert_allclose(stage_joints(state)[whole], joints[whole], rtol=0, atol=1e-7)
    # A straight path may leave what is reachable and come back, but seldom.
    assert (state.exists & ~whole).mean() < 0.01
    assert np.isnan(state.rotation[~state.exists]).all()
    assert np.isnan(state.translation[~state.exists]).all()


# --- From a seed --------------------------------------------------------------------------------------------------


def test_a_seed_is_followed_in_its_own_mode() -> None:
    solutions = forward_displacement(PAPER, LEGS)
    every = solutions.configurations[solutions.exists]
    here = forward_physical(PAPER, LEGS, near=every)
    assert distance(here, every).max() < 1e-13
    ahead = forward_physical(PAPER, LEGS + 1e-4, near=every)
    back = forward_physical(PAPER, LEGS, near=ahead)
    assert ahead.exists.all()
    assert distance(back, every).max() < 1e-11
    np.testing.assert_allclose(ahead.leg_lengths, np.broadcast_to(LEGS + 1e-4, (144, 6)), atol=1e-14)
    rates = np.stack([spm.kinematics.platform_jacobian(state) @ np.full(6, 1e-4) for state in every])
    np.testing.assert_allclose(ahead.translation - every.translation, rates[:, :3], atol=1e-5)


def test_a_path_through_a_half_turn_ends_there() -> None:
    """Stages of mode F that turn half round meet mode T: a forward singularity of the stage."""
    start = [1.2287530, 1.8342318, 1.9010653, 1.0366928, 1.3572947, 0.9828041]
    end = [1.1288651, 1.9396405, 1.4737952, 0.8767962, 1.3590058, 1.0512802]
    seed = spm.forward_displacement(PAPER, start)["F1+/F1+"]
    assert seed.exists
    assert not spm.forward_physical(PAPER, end, near=seed).exists
    assert not follow_adaptively(seed, np.array(end))[1]
    # The way that stays on this side of the singularity is followed.
    assert spm.forward_physical(PAPER, 0.95 * np.array(start) + 0.05 * np.array(end), near=seed).exists


@pytest.mark.parametrize(
    ("count", "draw"),
    [(300, 0), pytest.param(2_500, 1, marks=pytest.mark.slow)],
)
def test_the_solution_stays_on_its_path(count: int, draw: int) -> None:
    """Random modes, followed far: no arrival jumps, and no determinant changes its sign on the way to one."""
    rng = np.random.default_rng(draw)
    lengths = rng.uniform(0.6, 2.0, (count, 6))
    modes = spm.forward_displacement(PAPER, lengths)
    some = np.flatnonzero(modes.exists.any(axis=-1))
    place = np.where(modes.exists[some], rng.random((len(some), 256)), -1.0).argmax(axis=-1)
    seeds = modes.configurations[some, place]
    ends = seeds.leg_lengths * rng.uniform(0.75, 1.3, (len(some), 6))
    found = spm.forward_physical(PAPER, ends, near=seeds)
    assert 0.2 < found.exists.mean() < 0.9
    as_stages = (lengths.reshape(-1, 2, 3) for lengths in (seeds.leg_lengths, ends))
    joints, regular = follow_finely(PAPER, leg_angles(PAPER, stage_joints(seeds)), *as_stages, 2000, newton=3)
    # Equal steps jump over what happens beside a singularity: there the steps follow the error.
    for k in np.flatnonzero(found.exists != regular):
        joints[k], regular[k] = follow_adaptively(seeds[k], ends[k])
    np.testing.assert_array_equal(found.exists, regular)
    apart = np.abs(joints - stage_joints(found)).max(axis=(-1, -2, -3))
    assert np.nanmax(apart) < 1e-8


def test_where_modes_vanish_their_seeds_end_and_no_two_end_in_one_mode() -> None:
    every = forward_displacement(PAPER, [1.20, 1.21, 1.22, 1.23, 1.24, 1.25]).configurations
    target = forward_displacement(PAPER, LEGS)
    end = forward_physical(PAPER, LEGS, near=every)
    alive = end[end.exists]
    assert 100 < len(alive) <= target.count < len(every)
    apart = distance(target.configurations[None], alive[:, None])
    assert np.nanmin(apart, axis=-1).max() < 1e-12
    assert len(set(np.nanargmin(apart, axis=-1).tolist())) == len(alive)


@pytest.mark.parametrize("size", [1e-4, 1e-2])
@pytest.mark.parametrize("name", MANIPULATORS)
def test_states_of_a_machine_as_built_are_found_whose_readings_they_are(name: str, size: float) -> None:
    machine = MANIPULATORS[name]
    built, side = as_built(machine, size), machine.middle_side
    problem = random_branches(machine, "TT", 500, seed=2)
    if machine.limits is not None:
        problem = in_leg_space(machine, 300, seed=2)
    state = spm.inverse_physical(built, problem.pose)
    state = state[state.exists]
    found = forward_physical(built, state.readings)
    # Within the errors of a forward singularity of the nominal machine a state may not be found.
    assert found.exists.mean() >= 0.95
    state, found = state[found.exists], found[found.exists]
    assert distance(found, state).max() <= 1e-10 * side
    np.testing.assert_allclose(found.rotation, state.rotation, atol=1e-10)
    np.testing.assert_allclose(found.leg_lengths, state.leg_lengths, rtol=1e-12)
    assert found.closure_residual.max() <= 1e-13 * side


@pytest.mark.parametrize("machine", [PAPER, as_built(PAPER, 1e-3)], ids=["drawn", "as built"])
def test_invalid_seeds_and_readings_are_refused(machine: spm.Manipulator) -> None:
    state = forward_physical(machine, LEGS)
    torn = spm.Configuration(machine, state.pose, state.middle_joints + np.diag([0.0, 0.0, 0.01]))
    absent = forward_physical(machine, LEGS * 100)
    other = forward_physical(as_built(PAPER, 2e-3), LEGS)
    batch = forward_physical(machine, [LEGS] * 3)
    for seed in (state.middle_joints, torn, absent, other, batch):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="near")):
            forward_physical(machine, np.array([LEGS] * 2), near=seed)  # type: ignore[arg-type]
    if machine is not PAPER:
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="readings")):
            forward_physical(machine, np.full(6, -1.0))
