"""HTML tables and small SVG pictures for results in notebooks, without further libraries."""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from spm_pin.support.arguments import FloatArray

MOST_ROWS = 16
"""Largest number of solutions that a table shows."""
VIEW = (math.radians(15.0), math.radians(25.0))
"""Azimuth and elevation [rad] from which pictures are seen."""
_LOWER, _UPPER = "#0072b2", "#d98c00"
_LEG_COLOURS = ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#e69f00", "#cc79a7")


def view_axes(azimuth: float, elevation: float) -> FloatArray:
    """Return the unit vectors to the right, up and towards the viewer as rows (3, 3), in {B}; angles in radians."""
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    level = math.cos(elevation)
    near = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    return np.stack([right, np.cross(near, right), near])


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]], pictures: str = "") -> str:
    """Return HTML: a title, SVG `pictures`, and a table whose first column is aligned to the left."""
    top = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    lines = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    content = f"<table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table>" if lines else ""
    flow = f'<div style="display:flex;flex-wrap:wrap;gap:0.5em">{pictures}</div>' if pictures else ""
    return f"<div><p><code>{html.escape(title)}</code></p>{flow}{content}</div>"


def first_rows(shape: tuple[int, ...], cells: Callable[[tuple[int, ...]], tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return table rows of the first members of a batch, index and `cells` of each, and the number of further ones."""
    rows = [(", ".join(map(str, index)), *cells(index)) for index in itertools.islice(np.ndindex(shape), MOST_ROWS)]
    more = math.prod(shape) - len(rows)
    return [*rows, (f"and {more:,} more",)] if more else rows


def stick_figure(bases: FloatArray, balls: FloatArray, name: str = "", height: int = 150) -> str:
    """Return an SVG of six legs (6, 3) in {B}: lines between platforms that are triangles, and a name below."""
    axes = view_axes(*VIEW)
    points = np.concatenate([bases, balls]) @ axes.T
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    scale = (height - 30.0) / (high - low)[1]
    width = max(float((high - low)[0]) * scale + 16.0, 6.2 * len(name))
    corner = np.array([0.5 * (width - float((high + low)[0]) * scale), float(high[1]) * scale + 8.0])
    pivots, ends = np.split(corner + points[:, :2] * np.array([scale, -scale]), 2)
    # Drawn from below upwards: this hides the right parts in most states, and the lines are thin.
    shapes = [_triangle(pivots[:3], "#8f979f"), *map(_leg, pivots[:3], ends[:3], [_LOWER] * 3)]
    shapes += [_triangle(ends[:3], "#b9c0c6"), *map(_leg, pivots[3:], ends[3:], [_UPPER] * 3)]
    shapes += [_triangle(pivots[3:], "#8f979f")]
    return _svg(width, height, [*shapes, _text(width / 2.0, height - 2.0, 11, "middle", name)])


def curves(x: FloatArray, columns: FloatArray, label: str, marks: Iterable[float] = ()) -> str:
    """Return an SVG of curves (n, k) over x (n,), with labelled axis ends and vertical lines at `marks`."""
    width, height, left, bottom = 300.0, 120.0, 44.0, 18.0
    low, high = float(np.nanmin(columns)), float(np.nanmax(columns))
    across = left + (x - x[0]) / max(float(x[-1] - x[0]), 1e-300) * (width - left - 6.0)
    up = height - bottom - (columns - low) / max(high - low, 1e-300) * (height - bottom - 20.0)
    step = max(1, len(x) // 300)
    mark = f'y1="18" y2="{height - bottom}" stroke="#d62728" stroke-dasharray="3 2"'
    places = np.interp(np.array(list(marks)), x, across)
    shapes = [f'<line x1="{place:.1f}" x2="{place:.1f}" {mark}/>' for place in places]
    for column, colour in zip(up.T, np.resize(np.array(_LEG_COLOURS), up.shape[1]), strict=True):
        path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across[::step], column[::step], strict=True))
        shapes.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.4"/>')
    texts = [(left, 11.0, "start", label), (left - 3.0, 24.0, "end", f"{high:.3g}")]
    texts += [(left - 3.0, height - bottom, "end", f"{low:.3g}"), (left, height - 4.0, "start", f"{x[0]:.3g}")]
    texts += [(width - 4.0, height - 4.0, "end", f"{x[-1]:.3g}")]
    shapes += [_text(a, b, 10, anchor, text) for a, b, anchor, text in texts]
    return _svg(width, height, shapes)


def _svg(width: float, height: float, shapes: Iterable[str]) -> str:
    size = f'width="{width:.0f}" height="{height:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif">{"".join(shapes)}</svg>'


def _text(x: float, y: float, size: int, anchor: str, text: str) -> str:
    options = f'font-size="{size}" text-anchor="{anchor}" fill="currentColor"'
    return f'<text x="{x:.0f}" y="{y:.0f}" {options}>{html.escape(text)}</text>'


def _triangle(corners: FloatArray, colour: str) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    return f'<polygon points="{points}" fill="{colour}" fill-opacity="0.55" stroke="{colour}" stroke-linejoin="round"/>'


def _leg(start: FloatArray, end: FloatArray, colour: str) -> str:
    (a, b), (c, d) = start, end
    ends = f'x1="{a:.1f}" y1="{b:.1f}" x2="{c:.1f}" y2="{d:.1f}"'
    return f'<line {ends} stroke="{colour}" stroke-width="3" stroke-linecap="round"/>'
