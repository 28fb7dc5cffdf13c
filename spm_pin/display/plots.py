"""Pictures of configurations in a 2-D matplotlib Axes, or in a file, alone or side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from spm_pin.display.figure_files import FORMATS, check_appearance, new_figure, save_figure
from spm_pin.display.labels import LabelPlacer, label
from spm_pin.display.rendering import VIEW, Rendering, bounds, camera_axes, render
from spm_pin.display.scene import Scene, scene
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, file_path
from spm_pin.mechanism.configuration import Configuration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EDGE = 0.45  # width of edges in points
_WIDTH = 4.0  # of a new figure, in inches
_MARGINS = (0.049, 0.035)  # for labels
NARROWEST = {False: 100, True: 200}
"""Least width of a picture in pixels, without and with labels, which are seven pixels high there."""
_NARROWEST_NAMED_COLUMN = 260
_GALLERY = np.array([2.6, 3.3])  # width and height of one picture, in inches


def draw_solids(
    solids: Scene, camera: FloatArray, margins: tuple[float, float], *, ax: Axes | None, dpi: float, edge: float
) -> tuple[Axes, float, Rendering]:
    """Draw solids into an Axes, a new one without axes lines if not given, with margins and edges [points] around them.

    Returns the axes, metres per inch in them, and the image. A three-dimensional `ax` is an `ArgumentError`.
    """
    low, high = bounds(solids, camera, margins)
    if ax is None:
        width, height = (high - low) / (high - low)[0] * _WIDTH
        ax = new_figure(width, height).add_axes((0.0, 0.0, 1.0, 1.0))
        ax.axis("off")
    elif ax.name == "3d":
        cause = "The view is projected here: leave out projection='3d'"
        raise ArgumentError("ax", "two-dimensional axes", "3-D axes", cause)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.apply_aspect()
    inch = float((high - low)[1]) / ax.get_window_extent().transformed(ax.figure.dpi_scale_trans.inverted()).height
    rendering = render(solids, camera, dpi / inch, edge / 72.0 * dpi)
    ax.imshow(rendering.image, extent=rendering.extent, interpolation_stage="rgba")
    return ax, inch, rendering


def draw(
    configuration: Configuration,
    *,
    ax: Axes | None = None,
    view: tuple[float, float] = VIEW,
    labels: bool = True,
    dpi: float = 200.0,
) -> Axes:
    """Draw a configuration into a 2-D matplotlib Axes.

    The lower stage's legs are blue, the upper stage's orange; base, middle and terminal platform are grey. Data
    coordinates are metres to the right of O and above it as the viewer sees it.

    Parameters
    ----------
    configuration : Configuration
        A single configuration that exists.
    ax : matplotlib.axes.Axes, optional
        Where to draw; a new figure if not given: ``ax.figure``.
    view : tuple of two floats
        Azimuth and elevation of the viewer in {B} [rad].
    labels : bool
        Name the joints, the legs and the axes of {B} and {m}; else leave the frames out too.
    dpi : float
        Pixels per inch of the solids, at the present size of `ax`.

    Returns
    -------
    matplotlib.axes.Axes
        `ax`, or the new one.

    Raises
    ------
    ArgumentError
        If the configuration is a batch or does not exist, `ax` is three-dimensional, or `view` is not two angles.
    """
    solids, camera = scene(configuration, frames=labels), camera_axes(view)
    margins = _MARGINS if labels else (0.014, 0.01)
    ax, inch, (image, extent, _) = draw_solids(solids, camera, margins, ax=ax, dpi=dpi, edge=_EDGE)
    ax.axis("off")
    if labels:
        size = max(float(np.ptp(ax.get_xlim())), float(np.ptp(ax.get_ylim())))
        font = float(np.clip(1.55 * size / inch, 5.0, 11.0))
        darkness = image[..., 3] * (1.0 - image[..., :3].mean(axis=-1))
        label(configuration, LabelPlacer(ax, darkness, extent, font / 72.0 * inch, font), camera, solids.size)
    return ax


def save_picture(
    configuration: Configuration,
    path: str | Path,
    *,
    view: tuple[float, float] = VIEW,
    labels: bool = True,
    width: int = 1000,
    background: str = "white",
) -> Path:
    """Save a picture of a configuration.

    Parameters
    ----------
    configuration : Configuration
        A single configuration that exists.
    path : str or Path
        File to write, ending in ``.png``, ``.svg`` or ``.pdf``; one that exists is replaced. In the last two the
        labels are outlines, the solids an image. It is returned.
    view, labels
        As for `draw`.
    width : int
        Width of the picture in pixels; the height follows from the view.
    background : str
        Any colour of matplotlib, or ``"none"``.

    Raises
    ------
    ArgumentError
        If the suffix is another, the file cannot be written, `width` is less than 100, or 200 with labels, or more
        than `WIDEST`, the colour is unknown, or `draw` would raise it.
    """
    path = file_path(path, suffixes=FORMATS)
    check_appearance(width, NARROWEST[labels], background)
    dpi = width / _WIDTH
    figure = cast("Figure", draw(configuration, view=view, labels=labels, dpi=dpi).figure)
    return save_figure(figure, path, dpi=dpi, background=background)


def save_gallery(
    configurations: Mapping[str, Configuration],
    path: str | Path,
    *,
    view: tuple[float, float] = VIEW,
    labels: bool = False,
    width: int = 1600,
    background: str = "white",
) -> Path:
    """Save a picture of several configurations, each under its name.

    Parameters
    ----------
    configurations : mapping of str to Configuration
        Single configurations that exist, by what is written above them.
    path, view, labels, background
        As for `save_picture`.
    width : int
        Width of the whole picture in pixels: 100 for each column at least, 260 with labels.

    Raises
    ------
    ArgumentError
        If there is none, `width` is less, or `save_picture` would raise it.
    """
    path = file_path(path, suffixes=FORMATS)
    if not configurations:
        raise ArgumentError("configurations", "at least one", "none", "No real branch?")
    count = len(configurations)
    columns = count if count <= 4 else math.ceil(count / 2)
    rows = math.ceil(count / columns)
    check_appearance(width, columns * (_NARROWEST_NAMED_COLUMN if labels else NARROWEST[False]), background)
    figure = new_figure(*(_GALLERY * (columns, rows)))
    dpi = width / (columns * _GALLERY[0])
    for k, (name, configuration) in enumerate(configurations.items()):
        column, row = k % columns, rows - 1 - k // columns
        place = ((column + 0.04) / columns, (row + 0.02) / rows, 0.92 / columns, 0.86 / rows)
        ax = draw(configuration, ax=figure.add_axes(place), view=view, labels=labels, dpi=dpi)
        ax.set_title(name, fontsize=11, pad=3)
    return save_figure(figure, path, dpi=dpi, background=background)
