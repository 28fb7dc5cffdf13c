"""Forward displacement from a seed: the solution stays on its path, and ends where the path meets a singularity."""

from __future__ import annotations

import numpy as np
import pytest

import spm_pin as spm

PAPER = spm.Geometry.paper()
RADIAL = PAPER.radial_directions


def test_a_path_through_a_half_turn_ends_there() -> None:
    """Stages of mode F that turn half round meet mode T: a forward singularity of the stage."""
    start = [1.2287530, 1.8342318, 1.9010653, 1.0366928, 1.3572947, 0.9828041]
    end = [1.1288651, 1.9396405, 1.4737952, 0.8767962, 1.3590058, 1.0512802]
    seed = spm.forward_displacement(PAPER, start)["F1+/F1+"]
    assert seed.exists
    assert not spm.forward_physical(PAPER, end, seed=seed).exists
    assert not follow_finely(seed, np.array(end), 20_000)[1].all()
    # The way that stays on this side of the singularity is followed.
    assert spm.forward_physical(PAPER, 0.95 * np.array(start) + 0.05 * np.array(end), seed=seed).exists


@pytest.mark.parametrize(
    ("count", "draw"),
    [(300, 0), pytest.param(9_000, 1, marks=pytest.mark.exhaustive), pytest.param(9_000, 2, marks=pytest.mark.slow)],
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
    found = spm.forward_physical(PAPER, ends, seed=seeds)
    assert 0.2 < found.exists.mean() < 0.9
    joints, regular = follow_finely(seeds, ends, 2000)
    # Beside a singularity the comparison needs shorter steps than elsewhere.
    hard = np.flatnonzero(found.exists != regular)
    joints[hard], regular[hard] = follow_finely(seeds[hard], ends[hard], 100_000)
    np.testing.assert_array_equal(found.exists, regular)
    apart = np.abs(joints - stage_joints(found)).max(axis=(-1, -2, -3))
    assert np.nanmax(apart) < 1e-8


def stage_joints(state: spm.Configuration) -> np.ndarray:
    """The b_i seen from {B} and from {m}, (..., 2, 3, 3) [m]."""
    local = (state.middle_joints - state.translation[..., None, :]) @ state.rotation
    return np.stack([state.middle_joints, local], axis=-3)


def follow_finely(seeds: spm.Configuration, ends: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Follow both stages by Newton's method on the angles of the legs in their planes, in steps of equal size.

    Returns the joints as `stage_joints`, and whether no determinant changed its sign and every step converged.
    """
    joints = stage_joints(seeds)
    hips = np.array([PAPER.base_radius, PAPER.platform_radius])[:, None]
    start, end = (np.asarray(x).reshape(-1, 2, 3) for x in (seeds.leg_lengths, ends))
    joints = joints.reshape(-1, 2, 3, 3)
    slope = (joints * RADIAL).sum(axis=-1) - hips
    theta = np.arctan2(joints[..., 2], slope)
    sign, regular = None, np.ones(len(start), dtype=bool)
    for t in np.linspace(0.0, 1.0, steps + 1):
        legs = start + t * (end - start)
        for _ in range(3):
            rho, z = hips + legs * np.cos(theta), legs * np.sin(theta)
            d_rho, d_z = -legs * np.sin(theta), legs * np.cos(theta)
            # Sides 12, 23, 31: |b_i - b_j|² = ρ_i² + ρ_j² + ρ_i ρ_j + (z_i - z_j)².
            rho_j, z_j, d_rho_j, d_z_j = (np.roll(x, -1, axis=-1) for x in (rho, z, d_rho, d_z))
            gap = rho**2 + rho_j**2 + rho * rho_j + (z - z_j) ** 2 - PAPER.middle_side**2
            own = d_rho * (2 * rho + rho_j) + 2 * (z - z_j) * d_z
            other = d_rho_j * (2 * rho_j + rho) - 2 * (z - z_j) * d_z_j
            # own_i δ_i + other_i δ_j = -gap_i, by Cramer's rule.
            (a1, a2, a3), (c1, c2, c3), (g1, g2, g3) = (np.moveaxis(x, -1, 0) for x in (own, other, -gap))
            determinant = a1 * a2 * a3 + c1 * c2 * c3
            with np.errstate(divide="ignore", invalid="ignore"):
                first = (g1 * a2 * a3 - c1 * (g2 * a3 - c2 * g3)) / determinant
                second = (a1 * (g2 * a3 - c2 * g3) + c3 * c2 * g1) / determinant
                third = (a1 * a2 * g3 - c3 * (g1 * a2 - c1 * g2)) / determinant
            theta = theta + np.stack([first, second, third], axis=-1)
        sign = np.sign(determinant) if sign is None else sign
        regular &= ((np.sign(determinant) == sign) & (np.abs(gap).max(axis=-1) < 1e-9)).all(axis=-1)
        theta = np.where(regular[:, None, None], theta, np.nan)
    rho, z = hips + legs * np.cos(theta), legs * np.sin(theta)
    return (rho[..., None] * RADIAL + z[..., None] * np.array([0.0, 0.0, 1.0])), regular
