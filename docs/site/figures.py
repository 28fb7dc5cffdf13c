"""Draw the figures of the documentation: `python docs/site/figures.py`. Needs `pip install ".[plots]"`."""

from __future__ import annotations

from pathlib import Path

import gallery
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from PIL import Image
from uniqueness_figure import uniqueness

import spm_pin as spm
from spm_pin.display import draw, draw_capability, front_figure
from spm_pin.machine import PRS, RPS, RRS, Stage

IMAGES = Path(__file__).parents[1] / "images"
MACHINE = spm.Manipulator.paper()
LOWER, UPPER, GREY = "#0072b2", "#d98c00", "#5f6770"
EXAMPLE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


def main() -> None:
    """Draw each figure into docs/images."""
    figures = anatomy, kinds_of_legs, number_of_branches, followed_path, condition_numbers, capability, design_front
    for figure in (*figures, uniqueness):
        save(figure(), figure.__name__)
    save(gallery.picture(), "gallery")


def save(figure: Figure, name: str) -> None:
    """Write a figure as a PNG of few colours."""
    path = IMAGES / f"{name}.png"
    figure.savefig(path, dpi=160, facecolor="white")
    reduce_colours(path, path)


def reduce_colours(source: Path, target: Path) -> None:
    """Write a picture with a palette of 256 colours, a third of its size."""
    picture = Image.open(source).convert("RGB")
    picture.quantize(method=Image.Quantize.MAXCOVERAGE, kmeans=4).save(target, optimize=True)
    print(f"{target.name}: {target.stat().st_size // 1024} kB")


def anatomy() -> Figure:
    """Draw the mechanism with its parts named, and its lower stage from above."""
    state = spm.forward_physical(MACHINE, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
    figure = Figure(figsize=(8.5, 5.2))
    draw(state, ax=figure.add_axes((0.09, 0.01, 0.42, 0.98)))
    parts = {"base": (0.05, "k"), "lower stage, 3RPS": (0.30, LOWER), "middle platform": (0.51, "k")}
    parts |= {"upper stage, 3SPR": (0.68, UPPER), "terminal platform": (0.89, "k")}
    for text, (height, colour) in parts.items():
        figure.text(0.005, height, text.replace(", ", "\n"), color=colour, fontsize=9, va="center")
    _from_above(figure.add_axes((0.58, 0.10, 0.40, 0.80)), state)
    return figure


def kinds_of_legs() -> Figure:
    """Draw a machine of cylinders, one of screws and one of servos."""
    kinds = {
        "RPS, cylinders": (RPS(), (0.28, 0.42), 0.02),
        "PRS, screws and rods": (PRS(rod=0.30), (-0.05, 0.25), 0.02),
        "RRS, servos, cranks and rods": (RRS(crank=0.15, rod=0.33), (-0.5, 1.5), 0.15),
    }
    figure = Figure(figsize=(8.5, 4.6))
    for k, (title, (kind, limits, swing)) in enumerate(kinds.items()):
        lower, upper = (Stage(radius, 0.25, kind, limits) for radius in (0.30, 0.20))
        machine = spm.Manipulator.of_stages(lower, upper)
        middle = np.full(6, np.mean(limits))
        ax = figure.add_axes((0.01 + 0.33 * k, 0.02, 0.32, 0.88))
        draw(spm.forward_physical(machine, middle + swing * np.sin([1, 2, 4, 5, 1, 3])), ax=ax, labels=False)
        ax.axis("off")
        figure.text(0.17 + 0.33 * k, 0.95, title, fontsize=10, ha="center")
    return figure


def _from_above(ax: Axes, state: spm.Configuration) -> None:
    """Draw the base, the three leg planes through Z, and the middle platform, as seen down the Z axis."""
    for direction in MACHINE.radial_directions:
        ax.plot(*np.outer(direction[:2], [-0.35, 0.85]), color=LOWER, lw=0.9, ls=(0, (6, 3)))
    for points, colour, name in (
        (MACHINE.base_joints, GREY, "a"),
        (state.middle_joints, "#a9b1b8", "b"),
    ):
        ax.fill(*points[:, :2].T, facecolor=colour, alpha=0.35, edgecolor=colour)
        ax.plot(*points[:, :2].T, "o", color="black", ms=4)
        for k, (x, y, _) in enumerate(points, 1):
            ax.annotate(f"${name}_{k}$", (x, y), textcoords="offset points", xytext=(-4, 7), fontsize=10)
    for a, b in zip(MACHINE.base_joints, state.middle_joints, strict=True):
        ax.plot([a[0], b[0]], [a[1], b[1]], color=LOWER, lw=2.5, solid_capstyle="round")
    ax.plot(0, 0, "+", color="black", ms=9)
    ax.annotate("Z", (0, 0), textcoords="offset points", xytext=(-12, -4), fontsize=10)
    ax.set(aspect="equal", xlabel="X [m]", ylabel="Y [m]")
    ax.set_title("the lower stage from above:\neach leg in a vertical plane through Z", fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)


def number_of_branches(samples: int = 700) -> Figure:
    """Draw how many branches are real over the position of o, at three tilts."""
    figure = Figure(figsize=(8.5, 3.3))
    colours = ListedColormap(["#f2f2f2", "#c9dcec", "#8dbbdc", "#3f87bd", "#0b4a7d"])
    norm = BoundaryNorm(np.arange(-1, 10, 2), colours.N)
    grid = np.linspace(-1.5, 1.5, samples)
    x, y = np.meshgrid(grid, grid)
    points = np.stack([x, y, np.full_like(x, 2.2)], axis=-1)
    axes = figure.subplots(1, 3, sharey=True)
    for ax, tilt in zip(axes, (10, 25, 45), strict=True):
        poses = spm.pose(points, xyx=np.deg2rad([20.0, tilt, -10.0]))
        count = spm.inverse_displacement(MACHINE, poses).count
        image = ax.imshow(count, extent=(-1.5, 1.5, -1.5, 1.5), origin="lower", cmap=colours, norm=norm)
        ax.set(xlabel="$o_X$ [m]")
        ax.set_title(f"(20°, {tilt}°, −10°)", fontsize=9)
    axes[0].set_ylabel("$o_Y$ [m]")
    figure.subplots_adjust(left=0.085, right=0.9, bottom=0.16, top=0.9, wspace=0.08)
    bar = figure.colorbar(image, cax=figure.add_axes((0.92, 0.16, 0.018, 0.74)), ticks=[0, 2, 4, 6, 8])
    bar.set_label("real branches")
    return figure


def followed_path() -> Figure:
    """Draw the leg lengths along a followed path, and what it meets."""
    legs = np.array(
        [
            [1.20, 1.20, 1.40, 1.25, 1.20, 1.45],
            [1.45, 1.15, 1.30, 1.20, 1.50, 1.35],
            [1.10, 1.35, 1.60, 1.30, 1.40, 1.20],
        ]
    )
    path = spm.follow(MACHINE, legs)
    figure = Figure(figsize=(8.5, 3.2))
    left, right = figure.subplots(1, 2)
    plot_legs(left, path.parameters, path.configurations.leg_lengths, fontsize=8)
    left.set(xlabel="parameter", ylabel="leg length [m]")
    near = spm.singularities(path.configurations)
    for k, name in enumerate(("$J_b$", "$J_c$", "$K$")):
        right.semilogy(path.parameters, near.sigma[:, k], color=(LOWER, UPPER, "black")[k], label=name)
    right.legend(fontsize=8, frameon=False, title="singular values")
    right.set(xlabel="parameter", ylabel="distance to a singularity")
    marks = {
        spm.kinematics.EventKind.LIMIT: (":", UPPER),
        spm.kinematics.EventKind.INVERSE_SINGULARITY: ("-", "#cc4778"),
    }
    for event in path.events:
        style, colour = marks.get(event.kind, ("-", GREY))
        for ax in (left, right):
            ax.axvline(event.parameter, color=colour, ls=style, lw=1)
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    return figure


def condition_numbers(count: int = 4000) -> Figure:
    """Draw how the condition number of G depends on the characteristic length, and on the distance from the home."""
    figure = Figure(figsize=(8.5, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    shares = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 6))
    lengths = np.geomspace(0.03, 6.0, 40)
    everywhere = spm.kinematics.platform_jacobian(spm.forward_physical(MACHINE, 1.3 + 0.2 * shares))
    quantiles = np.array([np.quantile(_condition(everywhere, length), [0.05, 0.5, 0.95]) for length in lengths])
    left.fill_between(lengths, quantiles[:, 0], quantiles[:, 2], color=LOWER, alpha=0.2, lw=0.0, label="90 % of states")
    left.plot(lengths, quantiles[:, 1], color=LOWER, label="median")
    left.axvline(MACHINE.platform_radius, color=GREY, lw=0.9, ls=":")
    left.annotate("C", (1.05 * MACHINE.platform_radius, 11.0), color=GREY)
    left.set(xlabel="characteristic length L [m]", ylabel="condition number of G", ylim=(10.0, 1e5))
    steps = np.geomspace(1e-3, 0.2, 12)
    columns = []
    for step in steps:
        states = spm.forward_physical(MACHINE, 1.3 + step * shares[:500])
        g = spm.kinematics.platform_jacobian(states)
        radius = spm.capability.wrench_polytope(states, 1.0).ball()
        conditions = spm.singularities(states).condition
        columns.append([np.median(x) for x in (_condition(g, MACHINE.platform_radius), *conditions[:, :2].T, radius)])
    looks = {"G, with L = C": (LOWER, "-", 1.5), "J_b": (UPPER, "-", 3.0), "J_c": ("k", ":", 1.5)}
    for values, (name, (colour, style, width)) in zip(np.array(columns).T[:3], looks.items(), strict=True):
        right.plot(steps, values, color=colour, ls=style, lw=width, label=f"condition number of {name}")
    right.plot(
        steps, np.array(columns)[:, 3], color="k", ls="--", label="force held in every direction, over a leg\u2019s"
    )
    right.set(xlabel="largest difference of a leg from 1.3 m [m]", ylim=(0.1, 3e6))
    for ax in (left, right):
        ax.set(xscale="log", yscale="log")
        ax.legend(fontsize=7.5, frameon=False, loc="upper right")
        ax.spines[["top", "right"]].set_visible(False)
    return figure


def _condition(g: np.ndarray, length: float) -> np.ndarray:
    """Return the condition numbers of G for the twist (v, Lω)."""
    values = spm.kinematics.singular_values(g * np.repeat([1.0, length], 3)[:, None])
    return np.asarray(values[:, 0] / values[:, -1])


def capability() -> Figure:
    """Draw the forces and the moments that legs of 1 kN hold, weights aside, without and with a limit of bending."""
    state = spm.forward_physical(MACHINE, [1.20, 1.20, 1.40, 1.25, 1.20, 1.40])
    held = spm.capability.wrench_polytope(state, 1000.0)
    bearing = held.within(spm.capability.joint_reactions(state).bending, 250.0)
    panels = {
        "forces": (held.section("linear"), 3e-4),
        "moments": (held.section("angular"), 1.5e-4),
        "forces, bending at most 250 N m": (bearing.section("linear"), 3e-4),
    }
    figure = Figure(figsize=(8.5, 4.6))
    axes = [figure.add_axes((k / 3.0 + 0.005, 0.0, 0.323, 0.92)) for k in range(3)]
    for ax, (name, (section, scale)) in zip(axes, panels.items(), strict=True):
        draw_capability(state, section, scale=scale, ax=ax)
        ax.set_title(name, fontsize=9)
    # The robot in the same size.
    limits = np.array([[*ax.get_xlim(), *ax.get_ylim()] for ax in axes])
    low, high = limits.min(axis=0), limits.max(axis=0)
    for ax in axes:
        ax.set(xlim=(low[0], high[1]), ylim=(low[2], high[3]))
    return figure


def design_front() -> Figure:
    """Draw the front of the page on capability; its search takes some seconds, and is kept below build/."""
    problem = spm.design.DesignProblem(
        MACHINE,
        free={"base_radius": (0.4, 1.0), "platform_radius": (0.2, 0.6), "middle_side": (0.5, 1.1)},
        aims={"payload_low": "max", "volume": "max", "footprint": "min"},
        at_least={"certified": 1.0},
    )
    store = IMAGES.parents[1] / "build" / "design_front.json"
    store.parent.mkdir(exist_ok=True)
    return front_figure(spm.design.pareto_front(problem, store, generations=12))


def plot_legs(ax: Axes, x: np.ndarray, values: np.ndarray, fontsize: float) -> None:
    """Draw a curve for each leg, the lower ones blue, the upper ones orange."""
    for k, name in enumerate(spm.machine.LEGS):
        colour, style = (LOWER if k < 3 else UPPER), ("-", "--", ":")[k % 3]
        ax.plot(x, values[:, k], color=colour, ls=style, label=f"$r_{{{name[2:]}}}$")
    ax.legend(ncols=2, fontsize=fontsize, frameon=False)


if __name__ == "__main__":
    main()
