"""The physical configuration of six leg lengths: the one continued from home, alone in its aspect, or none."""

from __future__ import annotations

import numpy as np
import pytest
from problems import GEOMETRIES, distance
from stages import StageModes, solve_stage

import spm_pin as spm
from spm_pin.formulas import stages, wrenches
from spm_pin.formulas.operations import on_arrays, rows_of
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical

PAPER = spm.Geometry.paper()
RADIAL = PAPER.radial_directions
LEGS = np.array([1.20, 1.20, 1.40, 1.25, 1.20, 1.50])


def planes(radii: np.ndarray, heights: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Joints b_i and normals w_i of a stage's leg planes, up to a positive factor, in units of r."""
    up = np.array([0.0, 0.0, 1.0])
    b = radii[..., None] * RADIAL + heights[..., None] * up
    return b, heights[..., None] * RADIAL - (radii[..., None] - ratio) * up


def pairs(modes: StageModes, ratio: float) -> tuple[np.ndarray, ...]:
    """The c_ij of a stage."""
    return on_arrays(wrenches.pairs)(*map(rows_of, planes(modes.radii, modes.heights, ratio)))


def is_home(modes: StageModes, ratio: float) -> np.ndarray:
    return on_arrays(stages.is_home_aspect)(pairs(modes, ratio))


def continued_from_home(geometry: spm.Geometry, lengths: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Follow both stages from equal legs in small steps by Newton's method on the legs' angles.

    Returns the corners' radii and heights over each stage's hips (N, 2, 3) [m], stacked, and whether no determinant
    changed its sign.
    """
    r, d = geometry.middle_radius, geometry.middle_side
    hips = np.array([geometry.base_radius, geometry.platform_radius])[:, None]
    target = lengths.reshape(-1, 2, 3)
    home = np.maximum(target.mean(axis=-1, keepdims=True), 1.001 * np.abs(r - hips) + 1e-3 * r)
    theta = np.broadcast_to(np.arccos(np.clip((r - hips) / home, -1.0, 1.0)), target.shape).copy()
    whole = np.ones(len(target), dtype=bool)
    sign = None
    for t in np.linspace(0.0, 1.0, steps + 1):
        legs = home + t * (target - home)
        for _ in range(4):
            rho, z = hips + legs * np.cos(theta), legs * np.sin(theta)
            rho2, z2 = np.roll(rho, -1, axis=-1), np.roll(z, -1, axis=-1)
            gap = rho**2 + rho2**2 + rho * rho2 + (z - z2) ** 2 - d * d
            a = -(2 * rho + rho2) * z + 2 * (z - z2) * (rho - hips)
            b = -(2 * rho2 + rho) * z2 - 2 * (z - z2) * (rho2 - hips)
            matrix = a[..., None] * np.eye(3) + b[..., None] * np.roll(np.eye(3), 1, axis=1)
            determinant = a.prod(axis=-1) + b.prod(axis=-1)
            sign = np.sign(determinant) if sign is None else sign
            whole &= (determinant * sign > 0.0).all(axis=-1)
            matrix[~whole] = np.eye(3)
            theta -= np.where(whole[:, None, None], np.linalg.solve(matrix, gap[..., None])[..., 0], 0.0)
        whole &= (np.abs(gap) < 1e-6 * d * d).all(axis=(-1, -2))
    return np.stack([hips + legs * np.cos(theta), legs * np.sin(theta)], axis=-1), whole


def stage_corners(state: spm.Configuration) -> np.ndarray:
    """Return radii and heights of the middle joints over the hips of both stages, (N, 2, 3, 2) [m]."""
    radial = state.geometry.radial_directions
    b = state.middle_joints
    hanging = (b - state.translation[..., None, :]) @ state.rotation
    return np.stack(
        [
            np.stack([(b * radial).sum(axis=-1), b[..., 2]], axis=-1),
            np.stack([(hanging * radial).sum(axis=-1), -hanging[..., 2]], axis=-1),
        ],
        axis=-3,
    )


def test_the_physical_configuration_is_the_one_continued_from_home() -> None:
    lengths = np.random.default_rng(5).uniform(1.1, 1.5, (10_000, 6))
    state = forward_physical(PAPER, lengths)
    assert state.exists.all()
    corners, whole = continued_from_home(PAPER, lengths, steps=40)
    assert whole.all()
    np.testing.assert_allclose(stage_corners(state), corners, rtol=0, atol=1e-11)
    assert spm.determinants(state)[:, :2].min() > 0.0


@pytest.mark.parametrize("name", [*GEOMETRIES, "small platforms"])
def test_far_from_home_the_physical_configuration_is_continued_or_absent(name: str) -> None:
    """Lengths up to where stages do not close: wherever the path arrives it arrives at the physical mode."""
    geometry = {**GEOMETRIES, "small platforms": spm.Geometry(0.05, 0.1, 0.8)}[name]
    rng = np.random.default_rng(6)
    size = geometry.middle_radius + np.repeat([geometry.base_radius, geometry.platform_radius], 3)
    spread = rng.uniform(0.0, 0.4, (1_500, 1))
    lengths = size * rng.uniform(0.6, 2.0, (1_500, 1)) * np.abs(1.0 + spread * rng.normal(size=(1_500, 6))).clip(0.05)
    state = forward_physical(geometry, lengths)
    corners, whole = continued_from_home(geometry, lengths, steps=200)
    assert 0.1 < whole.mean() < 0.97
    assert state.exists[whole].all()
    np.testing.assert_allclose(stage_corners(state)[whole], corners[whole], rtol=0, atol=1e-7)
    # A straight path may leave what is reachable and come back, but seldom.
    assert (state.exists & ~whole).mean() < 0.01
    assert np.isnan(state.rotation[~state.exists]).all()
    assert np.isnan(state.translation[~state.exists]).all()


def test_physical_configurations_are_among_all_modes_and_so_named() -> None:
    lengths = np.random.default_rng(7).uniform(1.1, 1.5, (200, 6))
    solutions = forward_displacement(PAPER, lengths)
    state = forward_physical(PAPER, lengths)
    # The same solution, reached from another start.
    for same in (solutions["T1+/T1+"], solutions.physical()):
        assert distance(same, state).max() < 16 * np.finfo(float).eps


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


def test_continuation_from_a_seed_ends_at_a_singularity() -> None:
    start = [0.6, 0.6, 0.6, 1.2, 1.2, 1.2]
    seed = forward_physical(PAPER, start)
    assert seed.exists
    beyond = [0.6, 0.6, 1.9, 1.2, 1.2, 1.2]
    assert forward_displacement(PAPER, beyond).status is spm.Status.UNREACHABLE
    end = forward_physical(PAPER, [start, beyond, start], near=seed)
    np.testing.assert_array_equal(end.exists, [True, False, True])
    assert np.isnan(end.rotation[1]).all()


def test_where_modes_vanish_their_seeds_end_and_no_two_end_in_one_mode() -> None:
    every = forward_displacement(PAPER, [1.20, 1.21, 1.22, 1.23, 1.24, 1.25]).configurations
    target = forward_displacement(PAPER, LEGS)
    end = forward_physical(PAPER, LEGS, near=every)
    alive = end[end.exists]
    assert 100 < len(alive) <= target.count < len(every)
    apart = distance(target.configurations[None], alive[:, None])
    assert np.nanmin(apart, axis=-1).max() < 1e-12
    assert len(set(np.nanargmin(apart, axis=-1).tolist())) == len(alive)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 3.0])
def test_the_home_aspect_holds_one_solution_at_most(ratio: float) -> None:
    rng = np.random.default_rng(9)
    size = rng.uniform(0.3, 1.6, (8_000, 1)) * (1.0 + ratio)
    modes = solve_stage(size * (1.0 + 0.3 * rng.normal(size=(8_000, 3))).clip(0.05), ratio, ("T",))
    home = is_home(modes, ratio)[:, 0]
    assert home.sum(axis=-1).max() == 1
    assert not home[:, 1:].any(), "it is T1"
    # The determinant's sign alone would let others pass.
    same_sign = stages.pair_determinant(pairs(modes, ratio))[:, 0] > 0.0
    assert same_sign[home].all()
    assert (same_sign & ~home).any()


def test_invalid_seeds_are_refused() -> None:
    state = forward_physical(PAPER, LEGS)
    torn = spm.Configuration(PAPER, state.pose, state.middle_joints + np.diag([0.0, 0.0, 0.01]))
    absent = forward_physical(PAPER, LEGS * 100)
    other = forward_physical(spm.Geometry(0.7, 0.35, 0.8), LEGS)
    batch = forward_physical(PAPER, [LEGS] * 3)
    for seed, words in (
        (state.middle_joints, "a Configuration"),
        (torn, "that closes"),
        (absent, "that exist"),
        (other, "of this geometry"),
        (batch, "broadcast"),
    ):
        with pytest.raises(spm.ArgumentError, match=words):
            forward_physical(PAPER, np.array([LEGS] * 2), near=seed)  # type: ignore[arg-type]
