"""The tables that states and sets of states show in notebooks; no library is needed for them."""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

MOST_ROWS = 16
"""Solutions that a table shows."""


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return HTML: a title and a table."""
    top = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    lines = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    content = f"<table><thead><tr>{top}</tr></thead><tbody>{lines}</tbody></table>" if lines else ""
    return f"<div><p><code>{html.escape(title)}</code></p>{content}</div>"


def first_rows(shape: tuple[int, ...], cells: Callable[[tuple[int, ...]], tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return table rows of the first members of a batch, index and `cells` of each, and the number of further ones."""
    rows = [(", ".join(map(str, index)), *cells(index)) for index in itertools.islice(np.ndindex(shape), MOST_ROWS)]
    more = math.prod(shape) - len(rows)
    return [*rows, (f"and {more:,} more",)] if more else rows
