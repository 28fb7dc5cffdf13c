"""Figures as files that come out the same whenever the same call writes them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from spm_pin.display.scene import plots_extra
from spm_pin.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "named_figure", "save_figure"]

FORMATS = (".png", ".svg", ".pdf")
"""File types that figures are written in."""


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

    # Without the date, and with names that are not drawn by lot.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    try:
        with rc_context({"svg.hashsalt": "spm-pin"}):
            figure.savefig(path, dpi=dpi, facecolor=background, metadata=metadata)
    except OSError as error:
        raise ArgumentError("path", "a file that can be written", path, str(error.strerror)) from error
    return path
