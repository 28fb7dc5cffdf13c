"""The figure of docs/theory/uniqueness.md, and the stage of vertical slides with two configurations of one aspect.

Units are the middle platform's radius r; a tilt is w = √p e^{iψ}, the vector part of its quaternion in mode T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import label

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval

Array = npt.NDArray[np.float64]

HOME, OTHER, SMALL, GREY = "#0072b2", "#d9dde0", "#d98c00", "#5f6770"
AZIMUTHS = np.radians([-30.0, 90.0, 210.0])
SLIDES = 0.25, 1.4, -0.67 + 0.18j
"""E and the rods, in units of r, and the tilt at which the certified ray ends."""


def uniqueness() -> Figure:
    """Draw the home's aspect and its lengths, the aspects over E/r, and where stages of slides lose uniqueness."""
    figure = Figure(figsize=(8.5, 7.4), layout="constrained")
    (domain, image), (shares, slides) = figure.subplots(2, 2)
    _draw_slice(domain, image)
    _draw_shares(shares)
    _draw_slides(slides)
    return figure


# The home's aspect of a stage of RPS legs


@dataclass(frozen=True)
class Values:
    """A stage at tilts and heights: the determinant times a positive number, Φ, and η."""

    determinant: Array
    phi: Array
    eta: Array

    @property
    def home(self) -> npt.NDArray[np.bool_]:
        """Whether a state is in the home's aspect."""
        return np.asarray((self.determinant > 0.0) & (self.phi > 0.0) & (self.eta > 0.0))


def values(epsilon: float, w: Array, eta: Array) -> Values:
    """Return what decides the aspect of states given by w and η = 2 ζ x0 / |w|."""
    kappa, p, psi = 2.0 * epsilon - 1.0, np.abs(w) ** 2, np.angle(w)
    c, s, left = np.cos(3.0 * psi), np.sin(3.0 * psi), 2.0 * (1.0 - p)
    u = (1.0 - 2.0 * p) * eta**2 + left * (4.0 * p + kappa) * c * eta - left**2 * (kappa + 1.0 + 2.0 * p)
    determinant = u * (eta + 2.0 * (p - kappa) * c) - 2.0 * left * eta * kappa * (3.0 * p + kappa) * s**2
    plane = np.pi / 3.0 if kappa > 0.0 else 0.0
    cosine = np.cos((psi + plane) % (2.0 * np.pi / 3.0) - np.pi / 3.0)
    size = np.where(p < 1.0, (np.abs(eta) + 2.0 * left) ** 3, np.nan)
    return Values(determinant / size, eta + 2.0 * p * c - 2.0 * abs(kappa) * cosine, eta)


def _draw_slice(domain: Axes, image: Axes) -> None:
    """Draw the paper's lower stage at the mean square of legs of 1.3 m: tilts, and harmonics of the squared lengths."""
    geometry = spm.Geometry.paper()
    epsilon = geometry.base_radius / geometry.middle_radius
    kappa = 2.0 * epsilon - 1.0
    level = (1.3 / geometry.middle_radius) ** 2 - (1.0 - epsilon) ** 2

    def state(w: Array) -> tuple[Array, Array]:
        p = np.abs(w) ** 2
        with np.errstate(invalid="ignore", divide="ignore"):
            zeta = np.sqrt(level - 2.0 * epsilon * p - p**2)
            eta = 2.0 * zeta * np.sqrt(1.0 - p) / np.abs(w)
            harmonic = (kappa + p) * w**2 + np.conj(w) ** 4 + 2.0 * zeta * np.sqrt(1.0 - p) * np.conj(w)
        return eta, np.conj(harmonic)

    grid = np.linspace(-1.0, 1.0, 801) + 1e-4
    w = grid + 1j * grid[:, None]
    domain.contourf(grid, grid, values(epsilon, w, state(w)[0]).home, levels=[0.5, 1.5], colors=[HOME], alpha=0.25)
    azimuths = np.linspace(0.0, 2.0 * np.pi, 1441)
    rays = np.linspace(1e-4, 1.0, 4001)[:, None] * np.exp(1j * azimuths)
    inside = values(epsilon, rays, state(rays)[0]).home
    last = np.where(inside.all(axis=0), len(inside) - 1, np.argmin(inside, axis=0) - 1)
    edge = rays[last, np.arange(len(azimuths))]
    circles = [radius * np.exp(1j * azimuths) for radius in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)]
    for ax, mapped in ((domain, lambda w: w), (image, lambda w: state(w)[1])):
        for circle in circles:
            kept = np.where(values(epsilon, circle, state(circle)[0]).home, mapped(circle), np.nan)
            ax.plot(kept.real, kept.imag, color=HOME, lw=0.7)
        line = mapped(edge)
        ax.plot(line.real, line.imag, color="black", lw=1.2)
        cusps = mapped(edge[[0, 480, 960]])
        ax.plot(cusps.real, cusps.imag, "o", color=SMALL, ms=5)
        ax.set_aspect("equal")
        ax.spines[["top", "right"]].set_visible(False)
    domain.plot(np.cos(azimuths), np.sin(azimuths), color=GREY, lw=0.7, ls=":")
    domain.set(xlabel="$x_1$", ylabel="$x_2$")
    domain.set_title("the home's aspect, legs of 1.3 m in the mean", fontsize=9)
    image.fill(line.real, line.imag, color=HOME, alpha=0.15)
    image.set(xlabel="Re λ", ylabel="−Im λ")
    image.set_title("its squared lengths' first harmonic: one to one", fontsize=9)


def share_of_aspects(epsilon: float, cells: int = 101) -> tuple[float, float, int]:
    """Return the home's and the small aspects' share of the states with D > 0, and how many aspects there are of them.

    States are measured by p, ψ and the angle whose tangent is 4 (1 - p) / η; counted are sets of cells of a grid that
    are larger than 1e-4 of all, hence observed.
    """
    x = (np.arange(cells) + 0.513) / cells * 2.0 - 1.0
    w = x[:, None, None] + 1j * x[:, None]
    angle = (np.arange(cells) + 0.5) * np.pi / cells
    p = np.abs(w) ** 2
    with np.errstate(invalid="ignore"):
        found = values(epsilon, np.where(p < 1.0, w, np.nan), 4.0 * (1.0 - p) / np.tan(angle))
    number, count = label((found.determinant > 1e-4) & ~found.home)
    sizes = np.sort(np.bincount(number.ravel(), minlength=count + 1)[1:])[::-1]
    home, total = found.home.sum(), (found.determinant > 0.0).sum()
    sizes = sizes[sizes > 1e-4 * total]
    return home / total, sizes[1:].sum() / total, 1 + len(sizes)


def _draw_shares(ax: Axes) -> None:
    ratios = np.geomspace(0.02, 10.0, 41)
    home, small, _ = np.array([share_of_aspects(ratio) for ratio in ratios]).T
    ax.stackplot(ratios, home, small, 1.0 - home - small, colors=[HOME, SMALL, OTHER], alpha=0.8)
    ax.axvline(1.0, color=GREY, lw=0.9, ls=":")
    ax.text(0.03, 0.3, "the home's aspect", color="white", fontsize=9)
    ax.text(0.03, 0.9, "one cuspidal aspect", color=GREY, fontsize=9)
    ax.text(1.15, 0.7, "and three small\nones for E > r", color=SMALL, fontsize=9)
    ax.set(xscale="log", xlim=(0.02, 10.0), ylim=(0.0, 1.0), xlabel="E / r", ylabel="share of the states with D > 0")
    ax.set_title("aspects of mode T with D > 0 (D < 0: their mirror images)", fontsize=9)


# A stage of vertical slides


def slide_stage(epsilon: float, rod: float, w: Array) -> tuple[Array, Array]:
    """Return the carriages' heights (3, ...) with the platform's centre at height 0, and D; NaN out of reach."""
    p, turned = np.abs(w) ** 2, np.exp(1j * AZIMUTHS).reshape(3, *[1] * np.ndim(w))
    radii = 1.0 - p - 2.0 * np.imag(w**2 * turned)
    heights = 2.0 * np.sqrt(1.0 - p) * np.imag(np.conj(w) * turned)
    with np.errstate(invalid="ignore"):
        rise = np.sqrt(rod**2 - (radii - epsilon) ** 2)
    return heights - rise, _slide_determinant(radii, heights, rise, epsilon)


def _slide_determinant(radii, heights, rise, epsilon):  # type: ignore[no-untyped-def]
    """Return D of the rods, of arrays or intervals."""
    m = {
        (i, j): rise[i] * (radii[i] + 0.5 * radii[j]) - (radii[i] - epsilon) * (heights[i] - heights[j])
        for i in range(3)
        for j in range(3)
    }
    return m[0, 1] * m[1, 2] * m[2, 0] + m[1, 0] * m[2, 1] * m[0, 2]


def slides_of_two_states(epsilon: float, rod: float, cells: int = 161) -> bool:
    """Return whether, on a grid, the home's aspect holds a tilt off a leg's plane with two slides equal: observed."""
    x = np.linspace(-1.0, 1.0, cells)
    w = x[:, None] + 1j * x
    slides, determinant = slide_stage(epsilon, rod, np.where(np.abs(w) < 1.0, w, np.nan))
    number, _ = label(determinant > 0.0)
    centre = cells // 2
    if number[centre, centre] == 0:
        return False
    home = number == number[centre, centre]
    home[:, : centre + 2] = False  # tilts with x2 > 0; their mirror images have legs 1 and 3 exchanged
    unlike = slides[0] - slides[2]
    return bool((unlike[home] > 0.0).any())


def _draw_slides(ax: Axes) -> None:
    ratios, rods = np.linspace(0.05, 1.5, 38), np.linspace(0.3, 2.4, 36)
    level = np.abs(1.0 - ratios) < rods[:, None]
    lost = np.array([[slides_of_two_states(ratio, rod) for ratio in ratios] for rod in rods])
    ax.contourf(ratios, rods, np.where(level, 0.0, 1.0), levels=[0.5, 1.5], colors=[OTHER])
    ax.contourf(ratios, rods, lost, levels=[0.5, 1.5], colors=[SMALL], alpha=0.6)
    ax.plot(*SLIDES[:2], "o", color="black", ms=5)
    ax.annotate("proved", SLIDES[:2], textcoords="offset points", xytext=(6, 5), fontsize=9)
    ax.text(0.2, 0.45, "no level state", color=GREY, fontsize=9)
    ax.text(0.8, 1.7, "no pair found", fontsize=9)
    ax.set(xlabel="E / r", ylabel="rod / r")
    ax.set_title("vertical slides: two states of one aspect", fontsize=9)


@dataclass(frozen=True)
class SlidePair:
    """A ray of tilts from the level state, on which D > 0, and what is proved at both ends of a part of it."""

    boxes: int
    least: float
    """A lower bound of D / r⁶ along the ray."""
    near: Interval
    """The difference of slides 1 and 3 halfway along the ray."""
    far: Interval
    """The same at its end."""

    @property
    def proved(self) -> bool:
        """Whether D > 0, and slides 1 and 3 are equal between both."""
        return bool(self.least > 0.0 and self.near.high[0] < 0.0 < self.far.low[0])


def slide_pair(epsilon: float, rod: float, end: complex, boxes: int = 400) -> SlidePair:
    """Return what interval arithmetic proves along the ray of tilts from 0 to `end`."""
    ends = np.linspace(0.0, 1.0, boxes + 1)
    _, least, reach = _along(epsilon, rod, end, Interval(ends[:-1], ends[1:]))
    points, _, _ = _along(epsilon, rod, end, Interval.from_numbers(np.array([0.5, 1.0])))
    unlike = points[0] - points[2]
    bound = least.low.min() if (reach.low > 0.0).all() else -np.inf
    halves = [Interval(unlike.low[i : i + 1], unlike.high[i : i + 1]) for i in (0, 1)]
    return SlidePair(boxes, float(bound), *halves)


def _along(epsilon: float, rod: float, end: complex, t: Interval) -> tuple[list[Interval], Interval, Interval]:
    """Return the slides, D, and the least square of a rod's rise, over parts of the ray."""
    x, y = t * end.real, t * end.imag
    root_3 = Interval.from_numbers(3.0).root()
    a, b, product = x.square(), y.square(), 2.0 * root_3 * (x * y)
    radii = [1.0 - 2.0 * b - product, 1.0 - 3.0 * a + b, 1.0 - 2.0 * b + product]
    lever = (1.0 - (a + b)).root()
    heights = [-1.0 * lever * (x + root_3 * y), 2.0 * lever * x, -1.0 * lever * (x - root_3 * y)]
    squares = [rod * Interval.from_numbers(rod) - (radius - epsilon).square() for radius in radii]
    rise = [square.root() for square in squares]
    slides = [height - part for height, part in zip(heights, rise, strict=True)]
    reach = Interval(
        np.minimum.reduce([square.low for square in squares]), np.maximum.reduce([s.high for s in squares])
    )
    return slides, _slide_determinant(radii, heights, rise, Interval.from_numbers(epsilon)), reach
