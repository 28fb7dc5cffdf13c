"""Forward displacement from a seed: the solution stays on its path, and ends where the path meets a singularity."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spm_pin as spm

PAPER = spm.Geometry.paper()
RADIAL = PAPER.radial_directions
HIPS = np.array([[PAPER.base_radius], [PAPER.platform_radius]])


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
    [(300, 0), pytest.param(9_000, 1, marks=pytest.mark.slow), pytest.param(9_000, 2, marks=pytest.mark.slow)],
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
    joints, regular = follow_finely(seeds, ends, 2000)
    # Equal steps jump over what happens beside a singularity: there the steps follow the error.
    for k in np.flatnonzero(found.exists != regular):
        joints[k], regular[k] = follow_adaptively(seeds[k], ends[k])
    np.testing.assert_array_equal(found.exists, regular)
    apart = np.abs(joints - stage_joints(found)).max(axis=(-1, -2, -3))
    assert np.nanmax(apart) < 1e-8


def stage_joints(state: spm.Configuration) -> np.ndarray:
    """The b_i seen from {B} and from {m}, (..., 2, 3, 3) [m]."""
    local = (state.middle_joints - state.translation[..., None, :]) @ state.rotation
    return np.stack([state.middle_joints, local], axis=-3)


def leg_angles(joints: np.ndarray) -> np.ndarray:
    """Angles of the legs in their planes, (..., 2, 3) [rad]."""
    return np.arctan2(joints[..., 2], (joints * RADIAL).sum(axis=-1) - HIPS)


def joints_at(legs: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The b_i of legs at their angles, (..., 2, 3, 3) [m]."""
    rho, z = HIPS + legs * np.cos(theta), legs * np.sin(theta)
    return rho[..., None] * RADIAL + z[..., None] * np.array([0.0, 0.0, 1.0])


def side_errors(legs: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors of the squared sides 12, 23, 31, |b_i - b_j|² = ρ_i² + ρ_j² + ρ_i ρ_j + (z_i - z_j)², (..., 2, 3) [m²].

    Returns them with their derivatives by θ_i, by θ_j, and by l_i and l_j, (..., 2, 3, 2).
    """
    cos, sin = np.cos(theta), np.sin(theta)
    rho, z = HIPS + legs * cos, legs * sin
    rho_j, z_j, cos_j, sin_j, legs_j = (np.roll(x, -1, axis=-1) for x in (rho, z, cos, sin, legs))
    by_rho, by_rho_j, by_z = 2 * rho + rho_j, 2 * rho_j + rho, 2 * (z - z_j)
    gap = rho**2 + rho_j**2 + rho * rho_j + (z - z_j) ** 2 - PAPER.middle_side**2
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


def follow_finely(seeds: spm.Configuration, ends: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Follow both stages by Newton's method on the angles of the legs in their planes, in steps of equal size.

    Returns the joints as `stage_joints`, and whether no determinant changed its sign and every step converged.
    """
    start, end = (np.asarray(x).reshape(-1, 2, 3) for x in (seeds.leg_lengths, ends))
    theta = leg_angles(stage_joints(seeds).reshape(-1, 2, 3, 3))
    sign, regular = None, np.ones(len(start), dtype=bool)
    for t in np.linspace(0.0, 1.0, steps + 1):
        legs = start + t * (end - start)
        for _ in range(3):
            gap, by_own, by_next, _ = side_errors(legs, theta)
            step, determinant = cyclic_solution(by_own, by_next, -gap)
            theta = theta + step
        sign = np.sign(determinant) if sign is None else sign
        regular &= ((np.sign(determinant) == sign) & (np.abs(gap).max(axis=-1) < 1e-9)).all(axis=-1)
        theta = np.where(regular[:, None, None], theta, np.nan)
    return joints_at(end, theta), regular


def follow_adaptively(seed: spm.Configuration, end: np.ndarray) -> tuple[np.ndarray, bool]:
    """Follow one state as `follow_finely` does, by integrating θ' with SciPy, whose steps get as short as needed."""
    start = np.asarray(seed.leg_lengths).reshape(2, 3)
    rates = end.reshape(2, 3) - start

    def slopes(t: float, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, by_own, by_next, by_legs = side_errors(start + t * rates, theta.reshape(2, 3))
        change = by_legs[..., 0] * rates + by_legs[..., 1] * np.roll(rates, -1, axis=-1)
        return cyclic_solution(by_own, by_next, -change)

    angles = leg_angles(stage_joints(seed))
    path = solve_ivp(
        lambda t, theta: slopes(t, theta)[0].ravel(), (0.0, 1.0), angles.ravel(), "DOP853", rtol=1e-12, atol=1e-13
    )
    determinants = np.array([slopes(t, theta)[1] for t, theta in zip(path.t, path.y.T, strict=True)])
    regular = bool(path.success and (np.sign(determinants) == np.sign(determinants[0])).all())
    return joints_at(end.reshape(2, 3), path.y[:, -1].reshape(2, 3) if regular else np.full((2, 3), np.nan)), regular
