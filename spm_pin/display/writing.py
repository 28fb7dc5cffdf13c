"""Output of results: figures and their files, JSON, and numbers as text."""

from __future__ import annotations

import functools
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.errors import require_extra
from spm_pin.support.arguments import check_instance
from spm_pin.support.files import file_path, write_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""File types of figures."""
_NOTEBOOK_DPI = 110.0


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return a matplotlib figure of a size in inches, which a notebook shows at the end of a cell."""
    require_extra("plots", "matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), **options)
    show_in_notebooks(figure, figure)
    return figure


def show_in_notebooks(result: Figure | Axes, figure: Figure) -> None:
    """Let IPython show a figure as PNG if `result` ends a cell, without pyplot."""
    vars(result)["_repr_png_"] = functools.partial(_png, figure)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_NOTEBOOK_DPI, facecolor="white")
    return stream.getvalue()


def legend_below(figure: Figure, handles: Sequence[Any] = (), *, columns: int = 4, **options: Any) -> None:
    """Write one legend below all axes of a figure of constrained layout; by default of all labels in the axes."""
    drawn = {handle.get_label(): handle for ax in figure.axes for handle in ax.get_legend_handles_labels()[0]}
    handles = handles or list(drawn.values())
    figure.legend(handles=handles, ncols=columns, loc="outside lower center", frameon=False, **options)


def write_name(ax: Axes, place: tuple[float, float], text: str, size: float, colour: Any, halo: float) -> None:
    """Write a name of `size` points, centred, above a white halo of a relative width; it stays text in vector files."""
    from matplotlib.patheffects import Stroke

    centred: dict[str, Any] = {"fontsize": size, "ha": "center", "va": "center"}
    below = ax.text(*place, text, color="white", **centred)
    below.set_path_effects([Stroke(linewidth=halo * size, foreground="white", alpha=0.85)])
    ax.text(*place, text, color=colour, **centred)


def save_figure(figure: Figure, path: str | Path, *, dpi: float = 150.0) -> Path:
    """Save a figure as .png, .svg or .pdf, the same bytes for the same figure; an existing file is replaced.

    Vector formats contain lines as lines and labels as TrueType text; shaded areas are one image with `dpi`.
    """
    path = file_path(path, suffixes=FORMATS)
    require_extra("plots", "matplotlib")
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    check_instance(figure, Figure, "figure", "That of axes is ax.figure")

    # Without the date, and with names that do not change from run to run; text as TrueType, not as outlines.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    content, kind = io.BytesIO(), path.suffix.lower()[1:]
    with rc_context({"svg.hashsalt": "spm-pin", "pdf.fonttype": 42, "svg.fonttype": "none"}):
        figure.savefig(content, format=kind, dpi=dpi, facecolor="white", metadata=metadata)
    write_files({path: content.getvalue()})
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
    if isinstance(value, complex):
        value = value.real, value.imag
    if isinstance(value, list | tuple):
        return [_plain(member) for member in value]
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value
