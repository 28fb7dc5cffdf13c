"""Figures written to files, the same bytes for the same call."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from spm_pin.display.scene import plots_extra
from spm_pin.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "WIDEST", "check_appearance", "named_figure", "save_figure"]

FORMATS = (".png", ".svg", ".pdf")
"""File types that figures are written in."""

WIDEST = 6000
"""Largest width of a picture of the mechanism in pixels: one of 6000 takes 2 GB and a minute."""


def named_figure(path: str | Path) -> Path:
    """Return the path of a figure.

    Raises
    ------
    ArgumentError
        If its name does not end in one of `FORMATS`.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ArgumentError("path", f"a file name ending in {', '.join(FORMATS)}", repr(path.name))
    return path


def check_appearance(width: int, narrowest: int, background: str) -> None:
    """Check the width of a picture in pixels and the colour behind it.

    Raises
    ------
    ArgumentError
        If the width is no whole number from `narrowest` to `WIDEST`, or the colour is none of matplotlib's.
    MissingExtraError
        If matplotlib is not installed.
    """
    if not isinstance(width, int) or not narrowest <= width <= WIDEST:
        expected = f"at least {narrowest}" if isinstance(width, int) and width < narrowest else f"at most {WIDEST}"
        raise ArgumentError("width", f"{expected} pixels, a whole number", width)
    with plots_extra():
        from matplotlib.colors import is_color_like
    if not is_color_like(background):
        expected = "a colour of matplotlib, such as white, #f0f0f0 or none"
        raise ArgumentError("background", expected, repr(background))


def save_figure(figure: Figure, path: str | Path, *, dpi: float = 150.0, background: str = "white") -> Path:
    """Save a figure, by the end of the file's name one of `FORMATS`; a file that exists is replaced.

    Raises
    ------
    ArgumentError
        If the name ends otherwise, or the file cannot be written.
    MissingExtraError
        If matplotlib is not installed.
    """
    path = named_figure(path)
    with plots_extra():
        from matplotlib import rc_context

    # Without the date, and with names that do not change from run to run.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    try:
        with rc_context({"svg.hashsalt": "spm-pin"}):
            figure.savefig(path, dpi=dpi, facecolor=background, metadata=metadata)
    except OSError as error:
        raise ArgumentError("path", "a file that can be written", path, str(error.strerror)) from error
    return path
