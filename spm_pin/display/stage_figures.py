"""Figures of a stage alone: the stage itself, and how far it tilts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.display.writing import legend_below, new_figure, write_name
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import StageConfiguration
from spm_pin.mechanism.arguments import check_instance
from spm_pin.mechanism.notebook import VIEW, view_axes
from spm_pin.stages import StageReach

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BASE, _PLATFORM, _CRANK, _ROD = "#8f979f", "#56b4e9", "#d55e00", "#0072b2"


def stage_figure(configuration: StageConfiguration, *, names: bool = True) -> Figure:
    """Draw a state of a stage: its base, cranks or slides, rods, and the platform with its normal.

    Parameters
    ----------
    configuration : StageConfiguration
        A single state that exists.
    names : bool
        Whether legs have their names.

    Returns
    -------
    matplotlib.figure.Figure
    """
    state = check_instance(configuration, StageConfiguration, "configuration")
    if state.shape or not state.exists:
        raise ArgumentError("configuration", "a single state that exists", repr(state))
    axes, size = view_axes(*VIEW)[:2], state.stage.platform_radius
    figure = new_figure(5.0, 5.0, layout="constrained")
    ax = figure.add_subplot()
    pivots, centres, balls = state.stage.legs.pivots, state.circle_centres, state.balls
    origin, tip = state.translation, state.translation + 0.5 * size * state.normal
    # From the back to the front, as seen.
    order = np.argsort((pivots + balls) @ view_axes(*VIEW)[2])
    shapes: list[tuple[str, Any, str, str]] = [("fill", pivots, _BASE, "base")]
    for leg in order:
        shapes += [("crank", [pivots[leg], centres[leg]], _CRANK, "crank or slide")]
        shapes += [("rod", [centres[leg], balls[leg]], _ROD, "rod")]
    if state.stage.kind.name == "RPS":
        shapes = [shape for shape in shapes if shape[0] != "crank"]
    for kind, points, colour, label in [*shapes, ("fill", balls, _PLATFORM, "platform")]:
        x, y = axes @ np.asarray(points).T
        if kind == "fill":
            ax.fill(x, y, facecolor=colour, edgecolor="black", alpha=0.6, label=label)
        else:
            ax.plot(x, y, color=colour, lw=5 if kind == "crank" else 3, solid_capstyle="round", label=label)
    x, y = axes @ balls.T
    ax.plot(x, y, "o", color="black", ms=5)
    (x0, x1), (y0, y1) = axes @ np.stack([origin, tip]).T
    ax.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
    if names:
        for name, pivot in zip(state.stage.legs.names, pivots, strict=True):
            x, y = axes @ (1.15 * pivot - [0.0, 0.0, 0.1 * size])
            write_name(ax, (x, y), f"${name}$", 11, "black", 0.3)
    tilt, azimuth = np.degrees([state.tilt, state.azimuth])
    ax.set_title(f"tilt {tilt:.1f}° towards {azimuth:.0f}°, height {1e3 * float(state.height):.1f} mm", fontsize=10)
    ax.set_aspect("equal")
    ax.margins(0.1)
    ax.set_axis_off()
    legend_below(figure, fontsize=8)
    return figure


def reach_figure(reach: StageReach) -> Figure:
    """Draw the largest tilt in every direction, a line for each height; legs are on the rim at their azimuths.

    Parameters
    ----------
    reach : StageReach
        What `spm_pin.stages.reach` returned.

    Returns
    -------
    matplotlib.figure.Figure
    """
    found = check_instance(reach, StageReach, "reach", "spm_pin.stages.reach returns one")
    from matplotlib import colormaps

    figure = new_figure(6.0, 5.2, layout="constrained")
    ax: Any = figure.add_subplot(projection="polar")
    count = len(found.heights)
    for k, (height, tilts) in enumerate(zip(found.heights, found.tilts, strict=True)):
        around = np.append(found.azimuths, found.azimuths[0] + 2.0 * np.pi)
        colour = colormaps["viridis"](k / max(count - 1, 1) * 0.92)
        label = f"{1e3 * height:.4g} mm"
        ax.plot(around, np.degrees(np.append(tilts, tilts[0])), color=colour, lw=1.5, label=label)
    ax.set_title("largest tilt [°] by the direction of the lowest point", fontsize=10)
    ax.set_thetagrids(range(0, 360, 30))
    top = float(np.nanmax(np.degrees(found.tilts), initial=1.0)) * 1.15
    ax.set_ylim(0.0, top)
    for leg, name in zip(found.stage.legs.pivots, found.stage.legs.names, strict=True):
        write_name(ax, (float(np.arctan2(leg[1], leg[0])), 0.93 * top), f"${name}$", 10, "black", 0.3)
    legend_below(figure, columns=5, fontsize=8)
    return figure
