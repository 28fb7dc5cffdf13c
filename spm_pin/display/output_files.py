"""Figures made and written to files, the same bytes for the same call; results as JSON, and numbers as text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism.arguments import file_path, writing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""File types that figures are written in."""

WIDEST = 6000
"""Largest width of a picture of the mechanism in pixels: one of 6000 takes 2 GB and a minute."""


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return a matplotlib figure of a size in inches, or raise `MissingExtraError`."""
    require_extra("plots", "matplotlib")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), **options)


def check_appearance(width: int, narrowest: int, background: str) -> None:
    """Check the width of a picture in pixels, from `narrowest` to `WIDEST`, and the colour behind it."""
    if not isinstance(width, int) or not narrowest <= width <= WIDEST:
        expected = f"at least {narrowest}" if isinstance(width, int) and width < narrowest else f"at most {WIDEST}"
        raise ArgumentError("width", f"{expected} pixels, a whole number", width)
    require_extra("plots", "matplotlib")
    from matplotlib.colors import is_color_like

    if not is_color_like(background):
        expected = "a colour of matplotlib, such as white, #f0f0f0 or none"
        raise ArgumentError("background", expected, repr(background))


def save_figure(figure: Figure, path: str | Path, *, dpi: float = 150.0, background: str = "white") -> Path:
    """Save a figure, by the end of the file's name one of `FORMATS`; a file that exists is replaced."""
    path = file_path(path, suffixes=FORMATS)
    from matplotlib import rc_context

    # Without the date, and with names that do not change from run to run.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    with writing(path), rc_context({"svg.hashsalt": "spm-pin"}):
        figure.savefig(path, dpi=dpi, facecolor=background, metadata=metadata)
    return path


def fixed(value: float, digits: int) -> str:
    """Format with a number of decimals; a number that rounds to zero has no sign."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def to_json(content: Any) -> str:
    """Return JSON text of dictionaries, sequences, arrays and scalars: not finite becomes null, -0.0 becomes 0.0."""
    return json.dumps(_plain(content), indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(member) for key, member in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value
