"""The figure of docs/theory/uniqueness.md.

Units are the middle platform's radius r; a tilt is w = √p e^{iψ}, the vector part of its quaternion in mode T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import label
from uniqueness_slides import SLIDES, slides_of_two_states

import spm_pin as spm

Array = npt.NDArray[np.float64]

HOME, OTHER, SMALL, GREY = "#0072b2", "#d9dde0", "#d98c00", "#5f6770"


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
    machine = spm.Manipulator.paper()
    epsilon = machine.base_radius / machine.middle_radius
    kappa = 2.0 * epsilon - 1.0
    level = (1.3 / machine.middle_radius) ** 2 - (1.0 - epsilon) ** 2

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
