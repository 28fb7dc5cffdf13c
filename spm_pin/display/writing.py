"""Results written out: style and files of figures, JSON, and numbers as text."""

from __future__ import annotations

import functools
import io
import itertools
import json
import math
import re
import textwrap
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spm_pin.errors import ArgumentError, require_extra
from spm_pin.mechanism.arguments import file_path, writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

FORMATS = (".png", ".svg", ".pdf")
"""File types that figures are written in."""
_NOTEBOOK_DPI = 110.0
_DARKEST, _GREY = 0.1, 0.12  # white on a dark page, and by how much the channels of a grey differ at most
DARK = "#1a1a1a"
"""The dark background."""
_PER_INCH = {"mm": 25.4, "in": 1.0}
_ALLOWED = {"width": (1.0, 40.0), "height": (1.0, 40.0), "font_size": (4.0, 40.0), "dpi": (50.0, 1200.0)}
_STRETCHES = (1.15, 1.3, 1.5, 1.75, 2.0, 2.5)
"""By how much a figure is made higher until its texts fit, if its height is not given."""
_DRAWN_FONT = 10.0  # size of the axes' names as figures are drawn, in points


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """Return a matplotlib figure of a size in inches, which a notebook shows at the end of a cell."""
    require_extra("plots", "matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), **options)
    show_in_notebooks(figure, figure)
    return figure


def show_in_notebooks(result: Figure | Axes, figure: Figure) -> None:
    """Have IPython show a figure as PNG where `result` ends a cell; pyplot is not needed for that."""
    vars(result)["_repr_png_"] = functools.partial(_png, figure)


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_NOTEBOOK_DPI, facecolor="white")
    return stream.getvalue()


@dataclass(frozen=True)
class Style:
    """Size, font and background of a figure that is saved; what is not given is as the figure was drawn.

    Vector formats hold lines as lines and labels as text, in TrueType; what is shaded is one image of `dpi` in them.
    """

    width: float | None = None
    """Width [inch]."""
    height: float | None = None
    """Height [inch]; if only the width is given in proportion to it, or higher where texts need that."""
    font_size: float | None = None
    """Size of the axes' names in points; the other texts keep their proportion to it."""
    dpi: float | None = None
    """Pixels per inch, of PNG and of images within PDF and SVG."""
    dark: bool = False
    """Light lines and texts on a dark background."""

    @classmethod
    def from_text(cls, text: str) -> Style:
        """Read sizes with their units and ``dark``, joined by commas: ``"90x60mm,8pt,600dpi,dark"``, ``"3.5in"``."""
        values: dict[str, Any] = {}
        for word in filter(None, (word.strip() for word in text.split(","))):
            match = re.fullmatch(r"(?P<number>[\d.]+)(x(?P<height>[\d.]+))?(?P<unit>mm|in|pt|dpi)|dark", word)
            if match is None or (match["height"] and match["unit"] not in _PER_INCH):
                expected = "words such as 90mm, 3.5x2.5in, 8pt, 600dpi or dark, joined by commas"
                raise ArgumentError("style", expected, repr(word))
            key = {"pt": "font_size", "dpi": "dpi", None: "dark"}.get(match["unit"], "width")
            if key in values:
                raise ArgumentError("style", "each of size, font, dpi and dark once", f"another {word}")
            if key == "width":
                per_inch = _PER_INCH[match["unit"]]
                values["width"] = float(match["number"]) / per_inch
                values["height"] = float(match["height"]) / per_inch if match["height"] else None
            else:
                values[key] = float(match["number"]) if match["number"] else True
        unit = "mm" if "mm" in text else "in"
        units = {"width": unit, "height": unit, "font_size": "pt", "dpi": "dpi"}
        for name, limits in _ALLOWED.items():
            value = values.get(name)
            if value is not None and not limits[0] <= value <= limits[1]:
                low, high, typed = (number * _PER_INCH.get(units[name], 1.0) for number in (*limits, value))
                expected = f"a {name.replace('_', ' ')} from {low:g} to {high:g} {units[name]}"
                raise ArgumentError("style", expected, f"{typed:g} {units[name]}")
        return cls(**values)

    def apply(self, figure: Figure) -> None:
        """Change a figure's size, texts and colours."""
        if self.width is not None:
            width, height = figure.get_size_inches()
            figure.set_size_inches(self.width, self.height or height * self.width / width)
        if self.font_size is not None:
            _enlarge_texts(figure, self.font_size / _DRAWN_FONT)
        if (self.width or self.font_size) and figure.get_layout_engine() is not None:
            self._fit(figure)
        if self.dark:
            _darken(figure)

    def _fit(self, figure: Figure) -> None:
        """Break texts and legends for the figure's size, or raise `ArgumentError` with a size that is enough."""
        size, texts = figure.get_size_inches(), {text: text.get_text() for text in _titles(figure)}
        for stretch in [1.0] if self.height else [1.0, *_STRETCHES]:
            if _arrange(figure, texts, size[0], stretch * size[1]):
                _leave_out_covered_names(figure)
                return
        factor = 1.1
        while not _arrange(figure, texts, *(factor * size)) and factor < 8.0:
            factor *= 1.1
        width, height = np.ceil(factor * size * _PER_INCH["mm"])
        enough = f"{width:g}x{height:g}mm" if self.height else f"{width:g}mm"
        cause = "Its texts do not fit; a smaller font needs less" if self.font_size else "Its texts do not fit"
        received = f"{size[0] * _PER_INCH['mm']:.4g} mm"
        raise ArgumentError("style", f"a size for this figure, such as {enough}", received, cause)


def scaled(figure: Figure, factor: float) -> Figure:
    """Return a figure after its size and all its texts have been enlarged."""
    if factor != 1.0:
        figure.set_size_inches(*(factor * figure.get_size_inches()))
        _enlarge_texts(figure, factor)
    return figure


def _enlarge_texts(figure: Figure, factor: float) -> None:
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_fontsize(factor * float(text.get_fontsize()))


def legend_below(figure: Figure, handles: Sequence[Any] = (), **options: Any) -> None:
    """Write the legend below all axes, in place of the one that is there, with as few lines as the width allows.

    Without `handles` it has one entry for each label in the axes.
    """
    drawn = {handle.get_label(): handle for ax in figure.axes for handle in ax.get_legend_handles_labels()[0]}
    handles = handles or list(drawn.values())
    count, options = len(handles), {**options, "loc": "outside lower center", "frameon": False}
    # As many columns as fit, with lines of the same length.
    for columns in sorted({math.ceil(count / rows) for rows in range(1, count + 1)}, reverse=True):
        for legend in figure.legends:
            legend.remove()
        if figure.legend(handles=handles, ncols=columns, **options).get_window_extent().width <= figure.bbox.width:
            break


def _titles(figure: Figure) -> dict[Text, Axes | None]:
    """Return the texts that can be broken: of the figure, and titles and names of axes with their axes."""
    from matplotlib.text import Text

    texts: dict[Text, Axes | None] = dict.fromkeys(figure.texts)
    for ax in figure.axes:
        titles = [child for child in ax.get_children() if isinstance(child, Text) and child not in ax.texts]
        texts |= dict.fromkeys((*titles, ax.xaxis.label, ax.yaxis.label), ax)
    return {text: ax for text, ax in texts.items() if text.get_text() and (ax is None or ax.axison)}


def _arrange(figure: Figure, originals: Mapping[Text, str], width: float, height: float) -> bool:
    """Break the figure's texts and its legend to a size [inch]; return whether all have room."""
    figure.set_size_inches(width, height)
    for text, words in originals.items():
        text.set_text(words)
    for legend in figure.legends:
        names, handles = legend.get_texts(), [handle for handle in legend.legend_handles if handle is not None]
        for name, handle in zip(names, handles, strict=True):
            handle.set_label(name.get_text())
        legend_below(figure, handles, fontsize=names[0].get_fontsize())
    titles = _titles(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="constrained_layout not applied")
        try:
            figure.draw_without_rendering()
            for text, ax in titles.items():
                room, box = _room(text, ax), text.get_window_extent()
                length = max(box.width, box.height)
                if length > room:
                    letters = max(1, int(len(text.get_text()) * room / length))
                    text.set_text(textwrap.fill(text.get_text(), letters, break_long_words=False))
            figure.draw_without_rendering()
        except UserWarning:
            return False
    within_axes = [inner for ax in figure.axes if (inner := ax.get_legend()) is not None]
    boxes = [part.get_window_extent() for part in (*titles, *figure.legends, *within_axes)]
    page = figure.bbox.padded(1.0)
    within = all(page.contains(*corner) for box in boxes for corner in (box.min, box.max))
    covered = any(box.overlaps(other) for k, box in enumerate(boxes) for other in boxes[:k])
    return within and not covered and not any(_numbers_overlap(ax) for ax in figure.axes if ax.axison)


def _numbers_overlap(ax: Axes) -> bool:
    """Return whether neighbouring numbers of an axis cover one another."""
    for axis in (ax.xaxis, ax.yaxis):
        labels = [label for label in axis.get_majorticklabels() if label.get_visible() and label.get_text()]
        if any(a.get_window_extent().overlaps(b.get_window_extent()) for a, b in itertools.pairwise(labels)):
            return True
    return False


def _leave_out_covered_names(figure: Figure) -> None:
    """Hide names within axes that would cover a name before them."""
    for ax in figure.axes:
        boxes: dict[tuple[float, float], Any] = {}
        for text in ax.texts:
            # A name and its halo have one place.
            place, box = text.get_position(), text.get_window_extent()
            if place not in boxes and any(box.overlaps(other) for other in boxes.values()):
                text.set_visible(False)
            else:
                boxes.setdefault(place, box)


def _room(text: Text, ax: Axes | None) -> float:
    """Return how long a text may be [pixel]: within the figure, as axes are high, or as their column is wide."""
    assert text.figure is not None
    width = float(text.figure.bbox.width)
    if ax is None:
        return width
    place, box = ax.get_subplotspec(), text.get_window_extent()
    if text is ax.yaxis.label:
        return float(ax.get_window_extent().height)
    if place is None:
        return float(ax.get_window_extent().width)
    centre = 0.5 * (box.x0 + box.x1)
    on_the_page = width - box.x0 if text.get_horizontalalignment() == "left" else 2.0 * min(centre, width - centre)
    return float(min(on_the_page, 0.9 * width / place.get_gridspec().ncols))


def _darken(figure: Figure) -> None:
    """Turn the greys of lines, texts and frames over, dark ones into light ones; colours stay."""
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.colors import to_rgb
    from matplotlib.patheffects import Stroke
    from matplotlib.text import Text

    def turned(artist: Artist, colour: Any) -> Any:
        red, green, blue = values = to_rgb(colour)
        if max(values) - min(values) < _GREY:
            return tuple(_DARKEST + 0.85 * (1.0 - value) for value in values)
        dark_text = isinstance(artist, Text) and 0.3 * red + 0.6 * green + 0.1 * blue < 0.5
        return tuple(0.55 * value + 0.45 for value in values) if dark_text else colour

    # The colour of axes is that of their patch.
    artists: set[Artist] = {*figure.findobj()} - {figure, *figure.findobj(Axes)}
    for axis in figure.findobj(Axis):
        assert isinstance(axis, Axis)
        light = turned(axis, "black")
        axis.set_tick_params(which="both", color=light, labelcolor=light)  # of ticks that are made later, too
        artists -= {*axis.findobj()} - {axis.label}
    for artist in artists:
        for name in ("color", "edgecolor", "facecolor"):
            getter, setter = getattr(artist, f"get_{name}", None), getattr(artist, f"set_{name}", None)
            value = getter() if getter is not None and setter is not None else None
            # An array of colours, of a collection, is data; with no opacity nothing is seen.
            if setter is not None and isinstance(value, str | tuple) and value != "none" and value[3:] != (0.0,):
                setter(turned(artist, value))
        if isinstance(artist, Text) and (box := artist.get_bbox_patch()) is not None:
            box.set_facecolor(DARK)
        if artist.get_path_effects():  # the halo of a name
            artist.set_path_effects([Stroke(linewidth=3.0, foreground=DARK, alpha=0.85)])


def write_name(ax: Axes, place: tuple[float, float], text: str, size: float, colour: Any, halo: float) -> None:
    """Write a name of `size` points at a place, centred, above a white halo of a relative width.

    The halo is an outline; the name itself stays text in vector files.
    """
    from matplotlib.patheffects import Stroke

    centred: dict[str, Any] = {"fontsize": size, "ha": "center", "va": "center"}
    below = ax.text(*place, text, color="white", **centred)
    below.set_path_effects([Stroke(linewidth=halo * size, foreground="white", alpha=0.85)])
    ax.text(*place, text, color=colour, **centred)


def save_figure(
    figure: Figure, path: str | Path, *, dpi: float = 150.0, background: str = "white", style: Style | None = None
) -> Path:
    """Save a figure as .png, .svg or .pdf, the same bytes for the same figure; a file that exists is replaced.

    A `style` changes the figure first; its `dpi` and its dark background count in place of the arguments.
    """
    path, style = file_path(path, suffixes=FORMATS), style or Style()
    from matplotlib import rc_context

    style.apply(figure)
    # Without the date, and with names that do not change from run to run; texts as texts in TrueType, not as outlines.
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    with writing(path), rc_context({"svg.hashsalt": "spm-pin", "pdf.fonttype": 42, "svg.fonttype": "none"}):
        colour = DARK if style.dark else background
        figure.savefig(path, dpi=style.dpi or dpi, facecolor=colour, metadata=metadata)
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
