"""Figures of a stage alone: the stage itself, and how far it tilts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from spm_pin.display.plots import EDGE, draw_solids
from spm_pin.display.rendering import camera_axes, placed_solids
from spm_pin.display.writing import legend_below, new_figure, write_name
from spm_pin.errors import ArgumentError
from spm_pin.mechanism import StageConfiguration
from spm_pin.mechanism.arguments import check_instance
from spm_pin.mechanism.notebook import VIEW
from spm_pin.stages import StageReach

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def stage_figure(configuration: StageConfiguration, *, names: bool = True) -> Figure:
    """Draw a state of a stage: its base, cranks, rails or cylinders, rods, and the platform.

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
    (solids, size), camera = placed_solids(state), camera_axes(VIEW)
    ax, _, _ = draw_solids(solids, camera, (0.05, 0.05), ax=None, dpi=200.0, edge=EDGE)
    ax.axis("off")
    if names:
        beside = 0.5 * (state.circle_centres + state.balls) + 0.4 * size * state.stage.legs.planes[0]
        for name, place in zip(state.stage.legs.names, beside, strict=True):
            x, y = camera[:2] @ place
            write_name(ax, (x, y), f"${name}$", 11, "black", 0.3)
    tilt, azimuth = np.degrees([state.tilt, state.azimuth])
    text = f"tilt {tilt:.1f}° towards {azimuth:.0f}°, height {1e3 * float(state.height):.1f} mm"
    ax.text(0.5, 1.0, text, fontsize=8, ha="center", va="top", transform=ax.transAxes)
    return cast("Figure", ax.figure)


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
