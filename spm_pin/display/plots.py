"""Pictures of a configuration in a 2-D matplotlib Axes, or in a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from spm_pin.display.figure_files import check_appearance, named_figure, save_figure
from spm_pin.display.labels import LabelPlacer, label
from spm_pin.display.rendering import VIEW, bounds, camera_axes, render
from spm_pin.display.scene import plots_extra, scene
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.configuration import Configuration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["VIEW", "draw", "save_picture"]

_EDGE = 0.45  # width of edges in points
_WIDTH = 4.0  # of a figure of our own, in inches
_MARGIN = 0.035  # for labels


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
        Where to draw; a new figure, unknown to pyplot, if not given: ``ax.figure``.
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
    MissingExtraError
        If matplotlib or trimesh is not installed.
    """
    solids = scene(configuration, frames=labels)
    with plots_extra():
        from matplotlib.figure import Figure

    camera = camera_axes(view)
    low, high = bounds(solids, camera, _MARGIN if labels else 0.01)
    if ax is None:
        width, height = (high - low) / (high - low)[0] * _WIDTH
        ax = Figure(figsize=(width, height)).add_axes((0.0, 0.0, 1.0, 1.0))
    elif ax.name == "3d":
        cause = "The view is projected here: leave out projection='3d'"
        raise ArgumentError("ax", "two-dimensional axes", "3-D axes", cause)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.axis("off")
    ax.apply_aspect()
    inch = float((high - low)[1]) / ax.get_window_extent().transformed(ax.figure.dpi_scale_trans.inverted()).height
    image, extent = render(solids, camera, dpi / inch, _EDGE / 72.0 * dpi)
    ax.imshow(image, extent=extent, interpolation_stage="rgba")
    if labels:
        font = float(np.clip(1.55 * (high - low).max() / inch, 5.0, 11.0))
        darkness = image[..., 3] * (1.0 - image[..., :3].mean(axis=-1))
        placer = LabelPlacer(ax, darkness, extent, font / 72.0 * inch, font)
        label(configuration, placer, camera, solids.size)
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
        labels are outlines, the solids an image.
    view, labels
        As for `draw`.
    width : int
        Width of the picture in pixels; the height follows from the view.
    background : str
        Any colour of matplotlib, or ``"none"``.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    ArgumentError
        If the suffix is another, the file cannot be written, `width` is less than 100 or more than
        `WIDEST`, the colour is unknown, or `draw` would raise it.
    MissingExtraError
        If matplotlib or trimesh is not installed.
    """
    path = named_figure(path)
    check_appearance(width, 100, background)
    dpi = width / _WIDTH
    figure = cast("Figure", draw(configuration, view=view, labels=labels, dpi=dpi).figure)
    return save_figure(figure, path, dpi=dpi, background=background)
