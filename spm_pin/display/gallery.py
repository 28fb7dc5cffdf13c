"""Several configurations side by side in one picture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from spm_pin.display.figure_files import check_appearance, named_figure, save_figure
from spm_pin.display.plots import VIEW, draw
from spm_pin.display.scene import plots_extra
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.configuration import Configuration

__all__ = ["save_gallery"]

_WIDTH, _HEIGHT = 2.6, 3.3  # of one picture, in inches


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
    path, view, background
        As for `save_picture`.
    labels : bool
        Name the joints, the legs and the axes of {B} and {m} in each.
    width : int
        Width of the whole picture in pixels.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    ArgumentError
        If there is none, the suffix is another, the file cannot be written, `width` is less than 100 for each column
        or more than `WIDEST`, the colour is unknown, or `draw` would raise it.
    MissingExtraError
        If matplotlib or trimesh is not installed.
    """
    path = named_figure(path)
    if not configurations:
        raise ArgumentError("configurations", "at least one", "none", "No real branch?")
    count = len(configurations)
    columns = count if count <= 4 else math.ceil(count / 2)
    rows = math.ceil(count / columns)
    check_appearance(width, 100 * columns, background)
    with plots_extra():
        from matplotlib.figure import Figure

    figure = Figure(figsize=(columns * _WIDTH, rows * _HEIGHT))
    dpi = width / (columns * _WIDTH)
    for k, (name, configuration) in enumerate(configurations.items()):
        column, row = k % columns, rows - 1 - k // columns
        place = ((column + 0.04) / columns, (row + 0.02) / rows, 0.92 / columns, 0.86 / rows)
        ax = draw(configuration, ax=figure.add_axes(place), view=view, labels=labels, dpi=dpi)
        ax.set_title(name, fontsize=11, pad=3)
    return save_figure(figure, path, dpi=dpi, background=background)
