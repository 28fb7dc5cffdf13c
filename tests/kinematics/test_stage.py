"""One 3RPS stage: known solutions are found under their names, their number is proved, and families are recognised."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from problems import MANIPULATORS, corners, stage
from stage_oracle import certified_modes
from stages import MODES, StageModes, solve_stage

import spm_pin as spm

EPS = np.finfo(float).eps
STAGES = {
    **{f"{name}, lower": (g.base_radius, g.middle_side) for name, g in MANIPULATORS.items()},
    **{f"{name}, upper": (g.platform_radius, g.middle_side) for name, g in MANIPULATORS.items()},
    "κ near zero": (0.3, 0.6 * 3**0.5),
    "small hips": (0.05, 1.0),
}


def solved(lengths: np.ndarray, hips: float, d: float) -> StageModes:
    r = d / np.sqrt(3.0)
    return solve_stage(np.atleast_2d(lengths) / r, hips / r)


def counted(modes: StageModes) -> np.ndarray:
    """Solutions on both sheets, those in the plane of the hips once."""
    return 2 * modes.exists.sum(axis=(-1, -2)) - (modes.flat & modes.exists).sum(axis=(-1, -2))


def length_samples(kind: str, hips: float, d: float, count: int, seed: int) -> np.ndarray:
    """Leg lengths from out of reach to far; a pair or all three equal, or nearly so down to rounding."""
    rng = np.random.default_rng(seed)
    size = hips + d / np.sqrt(3.0)
    if kind == "all different":
        return size * rng.uniform(0.05, 2.0, (count, 3))
    if kind == "alike":
        return size * rng.uniform(0.3, 2.0, (count, 1)) * (1.0 + 0.2 * rng.normal(size=(count, 3))).clip(0.1)
    lengths = size * rng.uniform(0.3, 2.0, (count, 3))
    if kind.startswith("nearly equal"):
        lengths[:] = lengths[:, :1]
        # Beside the families of E = r/2, equal legs, the count hangs on fewer digits.
        least = -8.0 if abs(2.0 * hips * np.sqrt(3.0) / d - 1.0) < 1e-6 else -13.0
        return lengths * (1.0 + 10.0 ** rng.uniform(least, -3.0, (count, 1)) * rng.normal(size=(count, 3)))
    lengths[:, 2] = lengths[:, 0]
    if kind == "nearly symmetric":
        lengths[:, 2] *= 1.0 + 10.0 ** rng.uniform(-15.0, -3.0, count) * rng.normal(size=count)
    return lengths


KINDS = ("all different", "alike", "symmetric", "nearly symmetric", "nearly equal")


@pytest.mark.parametrize("name", STAGES)
def test_every_solution_has_the_lengths_and_the_order_of_its_name(name: str) -> None:
    hips, d = STAGES[name]
    lengths = length_samples("alike", hips, d, 3_000, seed=2)
    modes = solved(lengths, hips, d)
    r = d / np.sqrt(3.0)
    reached = r * np.hypot(modes.radii - hips / r, modes.heights)
    assert np.nanmax(np.abs(reached - lengths[:, None, None])) < 64 * EPS * lengths.max()
    sides = (modes.radii - np.roll(modes.radii, 1, axis=-1) * -0.5) ** 2
    sides += 0.75 * np.roll(modes.radii, 1, axis=-1) ** 2 + (modes.heights - np.roll(modes.heights, 1, axis=-1)) ** 2
    assert np.nanmax(np.abs(np.sqrt(sides) - np.sqrt(3.0))) < 32 * EPS
    mean = modes.radii.mean(axis=-1)
    assert (mean[:, 0][modes.exists[:, 0]] > 0.0).all()
    assert (mean[:, 1][modes.exists[:, 1]] < 0.0).all()
    falls = np.diff(mean, axis=-1)
    assert (falls[~np.isnan(falls)] <= 1e-9).all()
    assert (modes.heights.mean(axis=-1)[modes.exists] >= 0.0).all()
    # Absent places come last, and as far as the count goes solutions appear in pairs.
    assert (np.diff(modes.exists.astype(int), axis=-1) <= 0).all()
    assert (modes.exists.sum(axis=-1) % 2 == 0).all()


@pytest.mark.parametrize(("count", "seed"), [(20, 3), pytest.param(200, 4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", STAGES)
def test_the_number_of_modes_is_certified(name: str, kind: str, count: int, seed: int) -> None:
    hips, d = STAGES[name]
    lengths = length_samples(kind, hips, d, count, seed)
    found = counted(solved(lengths, hips, d))
    certified = [certified_modes(legs, hips, d) for legs in lengths]
    decided = np.array([number is not None for number in certified])
    assert decided.mean() > 0.97
    np.testing.assert_array_equal(found[decided], np.array([n for n in certified if n is not None]))


def folds(mode: str, hips: float, d: float, count: int, seed: int) -> Iterator[np.ndarray]:
    """Yield leg lengths at which two solutions meet: a platform on a path between two random ones, bisected.

    Where the derivative of the leg lengths with respect to tilt axis, tilt and height is singular.
    """
    rng, machine = np.random.default_rng(seed), spm.Manipulator(hips, hips, d)
    r = machine.middle_radius

    def lengths(parameters: np.ndarray) -> np.ndarray:
        w = complex(*parameters[:2])
        placed = stage(mode, np.angle(w), abs(w), parameters[2], r)
        return np.linalg.norm(corners(machine, placed) - machine.base_joints, axis=-1)

    def determinant(parameters: np.ndarray) -> float:
        h = 1e-6
        steps = np.eye(3) * h
        return float(np.linalg.det([(lengths(parameters + s) - lengths(parameters - s)) / (2 * h) for s in steps]))

    while count:
        ends = np.column_stack([rng.uniform(-0.6, 0.6, (2, 2)), r * rng.uniform(0.3, 3.0, 2)])
        low, high = 0.0, 1.0
        first, last = determinant(ends[0]), determinant(ends[1])
        if first * last > 0.0:
            continue
        for _ in range(30):
            middle = (low + high) / 2
            inside = determinant(ends[0] + middle * (ends[1] - ends[0])) * first > 0.0
            low, high = (middle, high) if inside else (low, middle)
        count -= 1
        yield lengths(ends[0] + low * (ends[1] - ends[0]))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["paper, lower", "paper, upper", "wide base, lower", "small hips"])
def test_beside_a_fold_both_solutions_are_found_or_none(name: str, mode: str) -> None:
    hips, d = STAGES[name]
    rng = np.random.default_rng(5)
    counts = set()
    for lengths in folds(mode, hips, d, 6, seed=6):
        for away in (1e-10, 1e-8, 1e-6, 1e-4):
            direction = rng.normal(size=3)
            pair = [lengths * (1.0 + sign * away * direction) for sign in (1.0, -1.0)]
            found = [int(counted(solved(legs, hips, d))[0]) for legs in pair]
            assert found == [certified_modes(legs, hips, d) for legs in pair]
            counts.add(abs(found[0] - found[1]))
    assert counts == {0, 4} or counts == {4}, "the two sides of a fold differ by a pair and its mirror image"


def test_a_double_solution_counts_once() -> None:
    """A level platform in the plane of the hips: its mirror image is itself, and all four of T meet there."""
    for ratio in (1.5, 0.75):
        modes = solve_stage(np.full((1, 3), abs(1.0 - ratio)), ratio)
        np.testing.assert_array_equal(modes.exists[0], [[True, False, False, False], [False] * 4])
        assert modes.flat[0, 0, 0]
        np.testing.assert_allclose(modes.radii[0, 0, 0], 1.0, atol=1e-14)


@pytest.mark.parametrize("ratio", [1.5, 0.75, 3.0, 0.1])
def test_equal_legs_have_a_level_solution_and_three_tilted_alike(ratio: float) -> None:
    """Level, or tilted in the plane of a leg by |w|² = 4c / (4c + (2ε + 1)²), c = r² - (1 - ε)²."""
    lengths = np.linspace(abs(1.0 - ratio) + 0.01, 6.0, 500)
    modes = solve_stage(np.repeat(lengths[:, None], 3, axis=1), ratio)
    for k, epsilon in enumerate((ratio, -ratio)):
        c = lengths**2 - (1.0 - epsilon) ** 2
        tilt = 4.0 * c / (4.0 * c + (2.0 * epsilon + 1.0) ** 2)
        np.testing.assert_array_equal(modes.exists[:, k].sum(axis=-1), np.where(c > 0.0, 4, 0))
        sign = 1.0 if k == 0 else -1.0
        level, tilted = sign * np.ones_like(tilt), sign * (1.0 - tilt)
        expected = np.column_stack([level, *[tilted] * 3] if k == 0 else [*[tilted] * 3, level])
        mean = modes.radii[:, k].mean(axis=-1)[c > 0.0]
        np.testing.assert_allclose(mean, expected[c > 0.0], rtol=0, atol=1e-13)


# --- Families of solutions ----------------------------------------------------------------------------------------


def family_lengths(hips: float, r: float, leg: int) -> np.ndarray:
    lengths = np.full(3, np.sqrt(3.0 * (r * r - hips * hips)))
    lengths[leg] = 3.0 * hips
    return lengths


@pytest.mark.parametrize("leg", range(3))
@pytest.mark.parametrize("ratio", [0.2, 0.75, 0.99])
def test_families_are_recognised_and_what_is_isolated_is_kept(ratio: float, leg: int) -> None:
    lengths = family_lengths(ratio, 1.0, leg)
    modes = solve_stage(lengths[None], ratio)
    assert modes.continuous.all()
    # Tilted in the plane of the odd leg by κ²/(2 - κ), in each mode where that is below one.
    tilts = [(2.0 * e - 1.0) ** 2 / (3.0 - 2.0 * e) for e in (ratio, -ratio)]
    for k, tilt in enumerate(tilts):
        mean = modes.radii[0, k].mean(axis=-1)
        expected = [(1.0 - tilt) * (1.0, -1.0)[k]] if tilt < 1.0 else []
        np.testing.assert_allclose(mean[modes.exists[0, k]], expected, atol=1e-12)
    away = solve_stage(lengths[None] * (1.0 + 1e-9), ratio)
    assert not away.continuous.any()


def test_the_family_of_equal_legs() -> None:
    modes = solve_stage(np.array([[0.8] * 3, [0.5] * 3, [0.4] * 3, [1.5] * 3, [0.8, 0.8, 0.8 + 1e-9]]), 0.5)
    np.testing.assert_array_equal(
        modes.continuous, [[True, False], [False, False], [False, False], [True, True], [False, False]]
    )
    np.testing.assert_allclose(modes.radii[0, 0, 0], 1.0, atol=1e-14)
    np.testing.assert_array_equal(modes.exists[0], [[True, False, False, False], [False] * 4])
