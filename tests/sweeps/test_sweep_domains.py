"""Lattices and samples: every point once, from the chunk's index alone."""

from __future__ import annotations

from itertools import product
from math import prod
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, qmc

import spm_pin as spm
from spm_pin.sweeps import leg_grid, leg_sample, pose_grid, pose_sample
from spm_pin.sweeps.domains import Domain, SweepPlan

lengths = st.lists(st.integers(2, 5), min_size=1, max_size=6)


def all_points(domain: Domain, limit: int) -> np.ndarray:
    """Every chunk's points, put where they belong, shape (*domain.shape, 6)."""
    chunk = domain.chunk_shape(limit)
    points = np.full((*domain.shape, 6), np.nan)
    for index in product(*(range(-(-n // c)) for n, c in zip(domain.shape, chunk, strict=True))):
        part = tuple(slice(i * c, (i + 1) * c) for i, c in zip(index, chunk, strict=True))
        points[part] = domain.points(index, chunk).reshape(points[part].shape)
    return points


@settings(max_examples=30)
@given(counts=lengths, limit=st.integers(1, 700))
def test_chunks_make_up_the_lattice(counts: list[int], limit: int) -> None:
    ranges = [(float(k), k + 1.0, count) for k, count in enumerate(counts, start=1)]
    six = [*ranges, *(0.5 for _ in range(6 - len(ranges)))]
    grid = leg_grid(six[:3], six[3:])
    assert grid.shape == tuple(counts)
    values = [np.linspace(*leg) if isinstance(leg, tuple) else np.array([leg]) for leg in six]
    expected = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(*counts, 6)
    np.testing.assert_array_equal(all_points(grid, limit), expected)


@given(shape=st.lists(st.integers(2, 2000), min_size=1, max_size=6), limit=st.integers(1, 10**7))
def test_chunks_keep_to_their_size_and_fill_it(shape: list[int], limit: int) -> None:
    six = [*((1.0, 2.0, n) for n in shape), *(1.0 for _ in range(6 - len(shape)))]
    grid = leg_grid(six[:3], six[3:])
    chunk = grid.chunk_shape(limit)
    assert prod(chunk) <= limit
    assert all(1 <= part <= whole for part, whole in zip(chunk, shape, strict=True))
    cut = [k for k, (part, whole) in enumerate(zip(chunk, shape, strict=True)) if part < whole]
    if cut:
        # Before the last axis that is cut chunks are single, and along it there are no more of them than need be.
        assert prod(chunk[: cut[-1]]) == 1
        fewer = -(-shape[cut[-1]] // chunk[cut[-1]]) - 1
        assert -(-shape[cut[-1]] // fewer) * prod(chunk[cut[-1] + 1 :]) > limit


def test_grid_of_a_billion_points_takes_no_memory() -> None:
    grid = pose_grid((-1, 1, 1001), (-1, 1, 1001), (2, 3, 1001), xyx=[0.1, (0.2, 0.8, 7), -0.1])
    assert grid.size == 7 * 1001**3
    chunk = grid.chunk_shape(50_000)
    last = tuple(-(-n // c) - 1 for n, c in zip(grid.shape, chunk, strict=True))
    np.testing.assert_array_equal(grid.points(last, chunk)[-1], [1, 1, 3, 0.1, 0.8, -0.1])
    sample = leg_sample(10**12, (1.1, 1.5), (1.1, 1.5))
    assert sample.points((10**7,), (16,)).shape == (16, 6)


def test_axes_and_names() -> None:
    grid = pose_grid((-1, 1, 3), 0.5, (2, 3, 2), xyx=[0.1, (0.2, 0.8, 7), -0.1])
    assert (grid.dims, grid.shape) == (("x", "z", "beta"), (3, 2, 7))
    assert leg_grid((1.1, 1.5, 4), 1.2).dims == ("r_b1", "r_b2", "r_b3")
    assert leg_grid(1.2, [1.1, (1.1, 1.5, 4), 1.3]).dims == ("r_c2",)
    plan = SweepPlan.make(spm.Manipulator.paper(), grid, ["branches"], 10)
    assert [plan.unit(axis) for axis in grid.axes] == ["m"] * 3 + ["rad"] * 3


def test_a_sample_fills_its_box_evenly() -> None:
    sample = pose_sample(4096, (-1, 3), (0, 1), 2.0, xyx=[(0, 1), (0.5, 0.75), -0.3], seed=5)
    points = all_points(sample, 1024)
    np.testing.assert_array_equal(points[:, [2, 5]], [[2.0, -0.3]] * 4096)
    unit = (points[:, [0, 1, 3, 4]] - [-1, 0, 0, 0.5]) / [4, 1, 1, 0.25]
    assert (unit >= 0).all()
    assert (unit <= 1).all()
    for column in unit.T:
        assert kstest(column, "uniform").pvalue > 1e-4
    assert np.abs(np.corrcoef(unit.T) - np.eye(4)).max() < 0.08


def test_chunks_are_more_even_than_independent_points_and_differ_from_one_another() -> None:
    sample = leg_sample(2048, (1, 2), (1, 2))
    chunks = [sample.points((k,), (1024,)) - 1.0 for k in range(2)]
    independent = np.random.default_rng(0).random((1024, 6))
    assert max(qmc.discrepancy(chunk) for chunk in chunks) < 0.3 * qmc.discrepancy(independent)
    assert not np.isin(chunks[0], chunks[1]).any()


def test_a_sample_depends_on_its_seed_alone() -> None:
    def points(seed: int, count: int = 1000) -> np.ndarray:
        return leg_sample(count, (1, 2), 1.5, seed=seed).points((3,), (200,))

    np.testing.assert_array_equal(points(1), points(1))
    assert not np.array_equal(points(1), points(2))
    # A shorter last chunk is the beginning of a whole one.
    np.testing.assert_array_equal(points(1, 650), points(1)[:50])


XYX = [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("argument", "make"),
    [
        *(
            ("x", lambda x=x: pose_grid(x, 0, 2, xyx=XYX))
            for x in ((1, -1, 5), (0, 1, 1), (0, 1, 2.5), (0, np.nan, 5), (0, 1), "0:1:5")
        ),
        ("x, y, z, xyx", lambda: pose_grid(0, 0, 2, xyx=XYX)),
        ("xyx", lambda: pose_grid((0, 1, 5), 0, 2, xyx=[0.1, 0.2])),
        ("beta", lambda: pose_grid((0, 1, 5), 0, 2, xyx=[0.1, (-30, 30, 5), 0.2])),
        ("r_b1", lambda: SweepPlan.make(spm.Manipulator.paper(), leg_grid((0, 1, 5), 1), ["branches"], 5)),
        ("lower", lambda: leg_grid([1, 2], 1)),
        ("count", lambda: leg_sample(0, (1, 2), 1)),
        ("seed", lambda: leg_sample(10, (1, 2), 1, seed=-1)),
        ("r_b1", lambda: leg_sample(10, (1, 2, 3), 1)),
        ("chunk", lambda: leg_grid((1, 2, 5), 1).chunk_shape(0)),
        ("chunk", lambda: leg_sample(10, (1, 2), 1).chunk_shape(True)),
    ],
)
def test_bad_ranges_are_refused(argument: str, make: Any) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        make()
