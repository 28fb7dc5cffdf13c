"""One 3RPS stage: known solutions are found under their names, their number is proved, and families are recognised."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from problems import PAPER, corners, stage
from stage_oracle import certified_modes

import spm_pin as spm

EPS = np.finfo(float).eps
STAGES = {
    "paper, lower": (PAPER.base_radius, PAPER.middle_side),
    "paper, upper": (PAPER.platform_radius, PAPER.middle_side),
    "equal radii": (0.7, 0.7 * 3**0.5),
    "wide base": (1.5, 0.5),
    "κ near zero": (0.3, 0.6 * 3**0.5),
    "small hips": (0.05, 1.0),
}


def solved(lengths: np.ndarray, hips: float, d: float) -> spm.SolutionSet:
    return spm.forward_displacement(spm.Stage(hips, d / np.sqrt(3.0)), lengths)


def mean_radii(modes: spm.SolutionSet) -> np.ndarray:
    """Return the mean radius of the balls, (..., 2, 4, 2): of modes T and F, in order, on both sheets."""
    radii = modes.configurations.places[..., 0] + modes.machine.base_radius
    return radii.mean(axis=-1).reshape(*modes.shape, 2, 4, 2)


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
    lengths = length_samples("alike", hips, d, 500, seed=2)
    modes = solved(lengths, hips, d)
    size = lengths.max()
    assert np.nanmax(np.abs(modes.readings - lengths[:, None])) < 64 * EPS * size
    assert np.nanmax(modes.configurations.closure_residual) < 64 * EPS * size
    exists, radii = modes.exists.reshape(-1, 2, 4, 2), mean_radii(modes)
    assert (radii[:, 0][exists[:, 0]] > 0.0).all()
    assert (radii[:, 1][exists[:, 1]] < 0.0).all()
    falls = np.diff(radii, axis=-2)
    assert (falls[~np.isnan(falls)] <= 1e-9 * d).all()
    heights = modes.translation[..., 2].reshape(-1, 2, 4, 2)
    assert (heights[..., 0][exists[..., 0]] >= 0.0).all()
    np.testing.assert_allclose(heights[..., 1], -heights[..., 0], atol=64 * EPS * size)
    # Missing places come last, and as far as the count goes solutions appear in pairs.
    assert (np.diff(exists.astype(int), axis=-2) <= 0).all()
    assert (exists[..., 0].sum(axis=-1) % 2 == 0).all()


@pytest.mark.parametrize(("count", "seed"), [(12, 3), pytest.param(80, 4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", STAGES)
def test_the_number_of_modes_is_certified(name: str, kind: str, count: int, seed: int) -> None:
    hips, d = STAGES[name]
    lengths = length_samples(kind, hips, d, count, seed)
    modes = solved(lengths, hips, d)
    certified = [certified_modes(legs, hips, d) for legs in lengths]
    # Beside the family of equal legs at E = r/2 the count hangs on too few digits.
    unsolved = modes.status == spm.Status.UNSOLVED
    assert not unsolved.any() or (name, kind) == ("κ near zero", "nearly equal")
    decided = ~unsolved & np.array([number is not None for number in certified])
    assert decided.mean() > (0.97 if not unsolved.any() else 0.2)
    np.testing.assert_array_equal(modes.count[decided], np.array(certified)[decided].astype(int))


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


@pytest.mark.parametrize("mode", "TF")
@pytest.mark.parametrize("name", ["paper, upper", "wide base", "small hips"])
def test_beside_a_fold_both_solutions_are_found_or_none(name: str, mode: str) -> None:
    hips, d = STAGES[name]
    rng = np.random.default_rng(5)
    counts = set()
    for lengths in folds(mode, hips, d, 3, seed=6):
        for away in (1e-10, 1e-8, 1e-6, 1e-4):
            pair = lengths * (1.0 + away * np.array([[1.0], [-1.0]]) * rng.normal(size=3))
            found = solved(pair, hips, d).count
            np.testing.assert_array_equal(found, [certified_modes(legs, hips, d) for legs in pair])
            counts.add(abs(int(found[0]) - int(found[1])))
    assert counts == {0, 4} or counts == {4}, "the two sides of a fold differ by a pair and its mirror image"


@pytest.mark.parametrize("ratio", [1.5, 0.75, 3.0, 0.1])
def test_equal_legs_have_a_level_solution_and_three_tilted_alike(ratio: float) -> None:
    """Level, or tilted in the plane of a leg by |w|² = 4c / (4c + (2ε + 1)²), c = r² - (1 - ε)²."""
    lengths = np.linspace(abs(1.0 - ratio) + 0.01, 6.0, 100)
    modes = spm.forward_displacement(spm.Stage(ratio, 1.0), np.repeat(lengths[:, None], 3, axis=1))
    for k, epsilon in enumerate((ratio, -ratio)):
        c = lengths**2 - (1.0 - epsilon) ** 2
        tilt = 4.0 * c / (4.0 * c + (2.0 * epsilon + 1.0) ** 2)
        found, sign = mean_radii(modes)[:, k, :, 0], 1.0 - 2.0 * k
        np.testing.assert_array_equal(np.isfinite(found).sum(axis=-1), np.where(c > 0.0, 4, 0))
        level, tilted = sign * np.ones_like(tilt), sign * (1.0 - tilt)
        expected = np.column_stack([level, *[tilted] * 3] if k == 0 else [*[tilted] * 3, level])
        np.testing.assert_allclose(found[c > 0.0], expected[c > 0.0], rtol=0, atol=1e-13)
    # In the plane of the hips its mirror image is itself, and all four of T meet there.
    flat = spm.forward_displacement(spm.Stage(ratio, 1.0), [abs(1.0 - ratio)] * 3)
    np.testing.assert_array_equal(np.flatnonzero(flat.exists), [0])


@pytest.mark.parametrize(("ratio", "leg"), [(0.2, 0), (0.75, 1), (0.99, 2)])
def test_families_are_recognised_and_what_is_isolated_is_kept(ratio: float, leg: int) -> None:
    lengths = np.full(3, np.sqrt(3.0 * (1.0 - ratio**2)))
    lengths[leg] = 3.0 * ratio
    modes = spm.forward_displacement(spm.Stage(ratio, 1.0), [lengths, lengths * (1.0 + 1e-9)])
    np.testing.assert_array_equal(modes.status == spm.Status.DEGENERATE, [True, False])
    # Tilted in the plane of the odd leg by κ²/(2 - κ), in each mode where that is below one.
    tilts = [(2.0 * e - 1.0) ** 2 / (3.0 - 2.0 * e) for e in (ratio, -ratio)]
    for k, tilt in enumerate(tilts):
        found = mean_radii(modes)[0, k, :, 0]
        expected = [(1.0 - tilt) * (1.0, -1.0)[k]] if tilt < 1.0 else []
        np.testing.assert_allclose(found[np.isfinite(found)], expected, atol=1e-12)


def test_the_family_of_equal_legs() -> None:
    modes = spm.forward_displacement(
        spm.Stage(0.5, 1.0), [[0.8] * 3, [0.5] * 3, [0.4] * 3, [1.5] * 3, [0.8] * 2 + [0.81]]
    )
    degenerate = modes.status == spm.Status.DEGENERATE
    np.testing.assert_array_equal(degenerate, [True, False, False, True, False])
    assert mean_radii(modes)[0, 0, 0, 0] == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_array_equal(np.flatnonzero(modes.exists[0]), [0, 1])
