"""The rule of `in_home_aspect` holds in the aspect of the home and nowhere else, by subdivision.

The aspect cannot be left without a forward singularity, and where the rule holds, p can be reduced to zero without one.

With z_k = Z + 2 x0 √p sin(φ_k - ψ) and ρ_k = 1 - p - 2p sin(2ψ + φ_k), lengths in units of r, the six factors
m_ij = z_i (ε + ρ_j/2) + z_j (ρ_i - ε) of a stage are linear in (Z, 2 x0 √p). Up to a positive factor these are cos θ
and sin θ, 0 <= θ <= π, so that p, ψ and θ cover all states of mode T. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import reduce
from itertools import pairwise, product
from math import comb

import numpy as np
import pytest

from spm_pin.kinematics.intervals import Interval

AZIMUTHS = np.radians([-30.0, 90.0, 210.0])
PAIRS = ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2))
PARTS = (8, 24, 12, 1)
"""Into how many cells p, ψ, θ and ε are divided at first."""


def sine_and_cosine(centre: np.ndarray, half: np.ndarray) -> tuple[Interval, Interval]:
    """Return enclosures over [centre - half, centre + half], half < π/2; the functions' own rounding is below 1e-15."""
    rounding = Interval(np.full_like(half, -4e-15), np.full_like(half, 4e-15))
    near, aside = (
        Interval(np.cos(half) - 1e-15, np.ones_like(half)),
        Interval(-np.sin(half) - 1e-15, np.sin(half) + 1e-15),
    )
    sine, cosine = Interval.from_numbers(np.sin(centre)), Interval.from_numbers(np.cos(centre))
    return sine * near + cosine * aside + rounding, cosine * near - sine * aside + rounding


def middle_and_half(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-12) + 1e-14


def sign(x: Interval) -> np.ndarray:
    return np.where(x.low > 0.0, 1, np.where(x.high < 0.0, -1, 0))


def undecided(excluded: Callable[..., np.ndarray], ends: tuple[tuple[float, float], ...], boxes: int) -> int:
    """Return how many cells of p, ψ, θ and ε between ends are not excluded after so many boxes; 0 if all are."""
    grids = [np.linspace(*end, parts + 1) for end, parts in zip(ends, PARTS, strict=True)]
    cells = np.array([list(box) for box in product(*(pairwise(grid) for grid in grids))])
    scale = [1.0, 0.5, 0.5, 1.0 / max(1.0, ends[3][1])]
    seen = 0
    while len(cells) and seen <= boxes:
        seen += len(cells)
        cells = cells[~excluded(cells)]
        rows, axis = np.arange(len(cells)), ((cells[..., 1] - cells[..., 0]) * scale).argmax(axis=-1)
        middle = cells[rows, axis].mean(axis=-1)
        lower, upper = cells.copy(), cells
        lower[rows, axis, 1], upper[rows, axis, 0] = middle, middle
        cells = np.concatenate([lower, upper])
    return len(cells)


Series = tuple[Interval, ...]
"""A function of ψ and its derivatives."""
PRODUCTS = ((0, 1), (1, 2), (2, 0)), ((1, 0), (2, 1), (0, 2))


def total(*terms: Series) -> Series:
    return tuple(reduce(operator.add, parts) for parts in zip(*terms, strict=True))


def times(f: Series, g: Series) -> Series:
    orders = range(len(f))
    return tuple(reduce(operator.add, (comb(n, k) * (f[k] * g[n - k]) for k in range(n + 1))) for n in orders)


def factors(cells: np.ndarray, low: np.ndarray, high: np.ndarray, order: int):  # type: ignore[no-untyped-def]
    """Return the six m_ij and their derivatives with respect to p, over cells whose azimuths are [low, high].

    Each comes with its first derivatives with respect to ψ, up to the order of 0 to 2.
    """
    p, ratio = (Interval(cells[:, k, 0], cells[:, k, 1]) for k in (0, 3))
    azimuth, rise = middle_and_half(low, high), middle_and_half(*cells[:, 2].T)
    sine, cosine = sine_and_cosine(*rise)
    constant = (ratio, Interval.from_numbers(0.0), Interval.from_numbers(0.0))[: order + 1]
    falls, radii, heights = [], [], []
    for phi in AZIMUTHS:
        s2, c2 = sine_and_cosine(2.0 * azimuth[0] + phi, 2.0 * azimuth[1])
        s1, c1 = sine_and_cosine(phi - azimuth[0], azimuth[1])
        fall = (-1.0 * (1.0 + 2.0 * s2), -4.0 * c2, 8.0 * s2)[: order + 1]
        falls.append(fall)
        radii.append((1.0 + p * fall[0], *(p * part for part in fall[1:])))
        heights.append((cosine + sine * s1, -(sine * c1), -(sine * s1))[: order + 1])
    m, slopes = {}, {}
    for i, j in PAIRS:
        half = tuple(0.5 * part for part in falls[j])
        inward = total(constant, tuple(0.5 * part for part in radii[j]))
        outward = total(radii[i], tuple(-part for part in constant))
        m[i, j] = total(times(heights[i], inward), times(heights[j], outward))
        slopes[i, j] = total(times(heights[i], half), times(heights[j], falls[i]))
    return m, slopes


def determinant(m) -> Series:  # type: ignore[no-untyped-def]
    return total(*(times(times(m[a], m[b]), m[c]) for a, b, c in PRODUCTS))


def determinant_and_slope(cells: np.ndarray, low: np.ndarray, high: np.ndarray, order: int):  # type: ignore[no-untyped-def]
    """Return the factors, D and its derivative with respect to p, as `factors` does."""
    m, slopes = factors(cells, low, high, order)
    turns = [(a, b, c) for x, y, z in PRODUCTS for a, b, c in ((x, y, z), (y, z, x), (z, x, y))]
    return m, determinant(m), total(*(times(slopes[a], times(m[b], m[c])) for a, b, c in turns))


def without_exit(cells: np.ndarray) -> np.ndarray:
    """Return which cells hold no states with D > 0, m12, m23 <= 0 and m21, m32, m13 >= 0.

    Some cells without such states are beside a plane of symmetry, ψ = ψ0. There two legs change places, and with them
    m12 and m32, m21 and m23 for legs 1 and 3: their differences are (ψ - ψ0) times derivatives in between, and have
    signs that agree with the inequalities for ψ = ψ0 only, where the four are zero and D is too.
    """
    m, _ = factors(cells, *cells[:, 1].T, 0)
    gone = (m[0, 1][0].low > 0.0) | (m[1, 2][0].low > 0.0) | (determinant(m)[0].high <= 0.0)
    for pair in ((1, 0), (2, 1), (0, 2)):
        gone |= m[pair][0].high < 0.0
    number = np.round(cells[:, 1].mean(axis=-1) / (np.pi / 3.0)).astype(int)
    plane = number * np.pi / 3.0
    m, _ = factors(cells, np.minimum(cells[:, 1, 0], plane), np.maximum(cells[:, 1, 1], plane), 1)
    d = {pair: series[1] for pair, series in m.items()}
    # Legs 1 and 3 change places at multiples of a half turn, 2 and 3, and 1 and 2, a third of a turn from there.
    signs = (
        sign(d[0, 1] - d[2, 1]) * sign(d[1, 0] - d[1, 2]),
        -sign(d[0, 1] - d[0, 2]) * sign(d[1, 2] - d[2, 1]),
        -sign(d[0, 1] - d[1, 0]) * sign(d[1, 2] - d[0, 2]),
    )
    return gone | (np.choose(number % 3, signs) > 0)


def without_rule(cells: np.ndarray) -> np.ndarray:
    """Return which cells hold no states with D > 0 and at most one negative factor."""
    m, _ = factors(cells, *cells[:, 1].T, 0)
    negative = np.sum([value[0].high < 0.0 for value in m.values()], axis=0)
    return np.asarray((determinant(m)[0].high <= 0.0) | (negative >= 2))


def exits(least: float, most: float, boxes: int) -> int:
    ends = (0.0, 1.0), (-np.pi - 1e-12, np.pi + 1e-12), (0.0, np.pi + 1e-12), (least, most)
    return undecided(without_exit, ends, boxes)


def below_the_hips(least: float, most: float) -> int:
    ends = (0.0, 1.0), (-np.pi - 1e-12, np.pi + 1e-12), (np.pi / 2.0 - 1e-12, np.pi + 1e-12), (least, most)
    return undecided(without_rule, ends, 100_000)


def without_ascent(cells: np.ndarray) -> np.ndarray:
    """Return which cells, 0 <= ψ <= π/3, hold no states of the rule's closure with D = 0 and dD/dp >= 0.

    States are meant from which D and the rule become positive and true when p increases. Near a plane of symmetry
    ψ = ψ0, h = ψ - ψ0, D is even in h: D = 3 z u v + h² g, dD/dp = (3 z u v)' + h² g', with the height z of the two
    corners that the reflection exchanges, u = z (ε + 1/2 - 3/2 p) + z' (1 - ε), v = z' (ε + 1/2) + z (1 - 3p - ε),
    where z' is the height of the third. Two arguments are used, see `docs/theory/forward_displacement.md`.
    """
    m, value, slope = determinant_and_slope(cells, *cells[:, 1].T, 0)
    negative = np.sum([series[0].high < 0.0 for series in m.values()], axis=0)
    gone = (value[0].low > 0.0) | (value[0].high < 0.0) | (negative >= 2) | (slope[0].high < 0.0)
    rest = np.flatnonzero(~gone)
    cells = cells[rest]
    number = np.round(cells[:, 1].mean(axis=-1) / (np.pi / 3.0)).astype(int)
    plane = number * np.pi / 3.0
    h = np.abs(cells[:, 1] - plane[:, None]).max(axis=-1) + 1e-15
    m, value, slope = determinant_and_slope(cells, plane - h, plane + h, 2)
    g, g_slope = 0.5 * value[2], 0.5 * slope[2]
    p, ratio = (Interval(cells[:, k, 0], cells[:, k, 1]) for k in (0, 3))
    sine, cosine = sine_and_cosine(*middle_and_half(*cells[:, 2].T))
    side = Interval.from_numbers(np.where(number == 0, 1.0, -1.0)) * sine
    z, third = cosine - 0.5 * side, cosine + side
    v = third * (ratio + 0.5) + z * (1.0 - 3.0 * p - ratio)
    first = (v.low > 0.0) & ((g_slope * v + 3.0 * (z * g)).high < 0.0)
    # u and v as functions of ψ: m12, m23 at ψ0 = 0, m21, m13 at ψ0 = π/3.
    monotonic = np.choose(number, [sign(m[a][1]) * sign(m[b][1]) != 0 for a, b in (((0, 1), (1, 2)), ((1, 0), (0, 2)))])
    room, least = np.maximum(z.low, 0.0), np.maximum(-g.high, 0.0)
    gain = 6.0 * room * np.sqrt(1.5 * least * room) * (1.0 - 1e-12)
    gone[rest] = first | (monotonic & (gain > h * np.maximum(g_slope.high, 0.0) * (1.0 + 1e-12)))
    return gone


def ascents(least: float, most: float, boxes: int) -> int:
    ends = (0.0, 1.0), (-1e-12, np.pi / 3.0 + 1e-12), (0.0, np.pi / 2.0 + 1e-12), (least, most)
    return undecided(without_ascent, ends, boxes)


RATIOS = [0.02, 0.1, 0.4330127, 0.8660254, 1.0, 2.0, 10.0]
SLOW_RATIOS = np.geomspace(0.02, 10.0, 60).tolist()


@pytest.mark.parametrize(
    ("least", "most", "boxes"),
    [
        *((ratio * (1.0 - 1e-6), ratio * (1.0 + 1e-6), (200_000, 200_000)) for ratio in RATIOS),
        *(pytest.param(*ends, (400_000, 1_000_000), marks=pytest.mark.slow) for ends in pairwise(SLOW_RATIOS)),
    ],
)
def test_the_rule_cannot_be_left_without_a_singularity(least: float, most: float, boxes: tuple[int, int]) -> None:
    least, most = least * (1.0 - 1e-12), most * (1.0 + 1e-12)
    assert exits(least, most, boxes[0]) == 0
    assert below_the_hips(least, most) == 0
    assert ascents(least, most, boxes[1]) == 0


def test_what_does_not_hold_is_not_proved() -> None:
    # Hips at radius zero, and a base that is too large for the subdivision.
    assert exits(0.0, 1e-3, 20_000) > 0
    assert exits(0.5, 5.0, 20_000) > 0
    assert ascents(0.5, 5.0, 20_000) > 0


def test_the_factors_are_those_of_the_package() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        p, psi, height, ratio = rng.uniform([0.0, -3.0, -2.0, 0.1], [1.0, 3.0, 2.0, 3.0])
        reach = 2.0 * np.sqrt((1.0 - p) * p)
        radii = 1.0 - p - 2.0 * p * np.sin(2.0 * psi + AZIMUTHS)
        heights = height + reach * np.sin(AZIMUTHS - psi)
        x, y = np.sqrt(p) * np.cos(psi), np.sqrt(p) * np.sin(psi)
        x0 = np.sqrt(1.0 - p)
        # Radii and heights as in `spm_pin.proofs.stage_proof`.
        expected = [1.0 - 2.0 * y * y - 12**0.5 * x * y, 1.0 - 3.0 * x * x + y * y, 1.0 - 2.0 * y * y + 12**0.5 * x * y]
        np.testing.assert_allclose(radii, expected, atol=1e-14)
        rises = [-x0 * (x + 3**0.5 * y), 2.0 * x0 * x, -x0 * (x - 3**0.5 * y)]
        np.testing.assert_allclose(heights, height + np.array(rises), atol=1e-14)
        size, theta = np.hypot(height, reach), np.arctan2(reach, height)
        cell = np.array([(p, psi, theta, ratio)])[..., None].repeat(2, axis=-1)
        found, _ = factors(cell, *cell[:, 1].T, 1)
        nearby, _ = factors(cell, *cell[:, 1].T + 1e-6, 0)
        for i, j in PAIRS:
            value = heights[i] * (ratio + radii[j] / 2.0) + heights[j] * (radii[i] - ratio)
            assert size * found[i, j][0].low[0] <= value + 1e-12
            assert value - 1e-12 <= size * found[i, j][0].high[0]
            difference = (nearby[i, j][0].low[0] - found[i, j][0].low[0]) / 1e-6
            assert found[i, j][1].low[0] == pytest.approx(difference, abs=1e-4)


def test_series_of_the_determinant_in_the_azimuth() -> None:
    rng = np.random.default_rng(2)

    def values(p: float, psi: float, theta: float, ratio: float) -> tuple[float, float]:
        cell = np.array([(p, psi, theta, ratio)])[..., None].repeat(2, axis=-1)
        return tuple(float(x[0].low[0] + x[0].high[0]) / 2.0 for x in determinant_and_slope(cell, *cell[:, 1].T, 2)[1:])

    for number in (0, 1) * 10:
        plane = number * np.pi / 3.0
        p, theta, ratio = rng.uniform([0.0, 0.0, 0.1], [1.0, 1.5, 2.0])
        cell = np.array([(p, plane, theta, ratio)])[..., None].repeat(2, axis=-1)
        for k, found in enumerate(determinant_and_slope(cell, *cell[:, 1].T, 2)[1:]):
            below, here, above = (values(p, plane + h, theta, ratio)[k] for h in (-1e-4, 0.0, 1e-4))
            assert below == pytest.approx(above, abs=1e-12), "even about the plane"
            assert found[2].low[0] == pytest.approx((below - 2.0 * here + above) / 1e-8, abs=1e-5)
        ahead, behind = (values(p + h, plane, theta, ratio)[0] for h in (1e-6, -1e-6))
        assert values(p, plane, theta, ratio)[1] == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)
        side = np.sin(theta) * (1 - 2 * number)
        z, third = np.cos(theta) - side / 2.0, np.cos(theta) + side
        u, v = z * (ratio + 0.5 - 1.5 * p) + third * (1 - ratio), third * (ratio + 0.5) + z * (1 - 3 * p - ratio)
        assert values(p, plane, theta, ratio)[0] == pytest.approx(3.0 * z * u * v, abs=1e-12)
