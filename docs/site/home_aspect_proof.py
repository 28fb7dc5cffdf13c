"""The rule of `in_home_aspect` holds in the home's aspect and nowhere else: `python docs/site/home_aspect_proof.py`.

The proof is by subdivision, in interval arithmetic with outward rounding, and takes two minutes.

The aspect cannot be left without a forward singularity, and where the rule holds, p can be reduced to zero without one.

With z_k = Z + 2 x0 √p sin(φ_k - ψ) and ρ_k = 1 - p - 2p sin(2ψ + φ_k), lengths in units of r, the six factors
m_ij = z_i (ε + ρ_j/2) + z_j (ρ_i - ε) of a stage are linear in (Z, 2 x0 √p). Up to a positive factor these are cos θ
and sin θ, 0 <= θ <= π, so that p, ψ and θ cover all states of mode T. See `docs/theory/forward_displacement.md`.
"""

from __future__ import annotations

import operator
import sys
from collections.abc import Callable
from functools import reduce
from itertools import pairwise, product
from math import comb

import numpy as np

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
    """Return middle and half width of intervals, the latter rounded up."""
    return 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-12) + 1e-14


def sign(x: Interval) -> np.ndarray:
    """Return the sign of all numbers of an interval, 0 where they have several."""
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
    """Return a sum."""
    return tuple(reduce(operator.add, parts) for parts in zip(*terms, strict=True))


def times(f: Series, g: Series) -> Series:
    """Return a product, by Leibniz' rule."""
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
    """Return D of the factors."""
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
    """Return how many cells are left in which the rule might be left."""
    ends = (0.0, 1.0), (-np.pi - 1e-12, np.pi + 1e-12), (0.0, np.pi + 1e-12), (least, most)
    return undecided(without_exit, ends, boxes)


def below_the_hips(least: float, most: float) -> int:
    """Return how many cells below the hips are left in which the rule might hold."""
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
    """Return how many cells are left in which D might vanish while p is reduced."""
    ends = (0.0, 1.0), (-1e-12, np.pi / 3.0 + 1e-12), (0.0, np.pi / 2.0 + 1e-12), (least, most)
    return undecided(without_ascent, ends, boxes)


RATIOS = list(pairwise(np.geomspace(0.02, 10.0, 60).tolist()))
"""Radii of the hips over r, between which the rule is proved."""


def rest(least: float, most: float, boxes: tuple[int, int] = (400_000, 1_000_000)) -> int:
    """Return how many boxes are left in which the rule might be left, or hold elsewhere, without a singularity."""
    least, most = least * (1.0 - 1e-12), most * (1.0 + 1e-12)
    return exits(least, most, boxes[0]) + below_the_hips(least, most) + ascents(least, most, boxes[1])


def main() -> int:
    """Print for which radii the rule is proved; 0 if for all."""
    left = [rest(*ends) for ends in RATIOS]
    for ends, boxes in zip(RATIOS, left, strict=True):
        print("{:.4f} <= E/r <= {:.4f}: ".format(*ends) + (f"{boxes} boxes are left" if boxes else "proved"))
    return 1 if any(left) else 0


if __name__ == "__main__":
    sys.exit(main())
