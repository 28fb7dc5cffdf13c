"""Output of the subcommands: text, tables and numbers on the console, and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.cells import cell_len
from rich.console import Console

__all__ = ["fixed", "note", "print_lines", "print_table", "significant", "stderr", "stdout", "to_json"]

# Without markup: file names and messages may contain brackets, which Rich would take for styles.
stdout = Console(markup=False, highlight=False)
stderr = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)

_ROUNDING = 1e-12
"""A number smaller than this share of its scale is printed as zero."""


def print_lines(lines: Iterable[str], style: str | None = None) -> None:
    """Print sentences on stdout, wrapped between words on a screen and not at all in a pipe."""
    for line in lines:
        stdout.print(line, style=style, soft_wrap=not stdout.is_terminal)


def note(text: str, style: str | None = None) -> None:
    """Print a line on stderr, beside the results."""
    stderr.print(text, style=style)


def print_table(
    title: str,
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: Collection[str] = (),
    rules: Collection[int] = (),
    styles: Mapping[int, str] | None = None,
) -> None:
    """Print a table on stdout whose cells are never cut.

    In a pipe a line is as long as it needs to be. On a screen, columns that do not fit follow in further blocks below,
    each beginning with the first column. That column is aligned to the left, and so are those with headings in `left`;
    an empty line is put above the rows numbered in `rules`; `styles` are those of rows, by their number.
    """
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(cell_len(cell) for cell in column) for column in zip(headings, *cells, strict=True)]
    screen = stdout.width if stdout.is_terminal else math.inf
    blocks = [[0]]
    for k in range(1, len(headings)):
        if len(blocks[-1]) > 1 and sum(widths[c] + 2 for c in (*blocks[-1], k)) > screen:
            blocks.append([0])
        blocks[-1].append(k)

    def line(row: Sequence[str], block: list[int], style: str | None = None) -> None:
        padded = []
        for k in block:
            space = " " * (widths[k] - cell_len(row[k]))
            padded.append(row[k] + space if k == 0 or headings[k] in left else space + row[k])
        stdout.print(" " + "  ".join(padded).rstrip(), style=style, soft_wrap=True)

    stdout.print(title, style="bold", soft_wrap=True)
    for block in blocks:
        stdout.print()
        line(headings, block, "bold")
        stdout.print(" " + "─" * (sum(widths[k] + 2 for k in block) - 2), soft_wrap=True)
        for number, row in enumerate(cells):
            if number in rules:
                stdout.print()
            line(row, block, (styles or {}).get(number))
    stdout.print()


def fixed(value: float, digits: int) -> str:
    """Format with a number of decimals; a number that rounds to zero has no sign."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def significant(value: float, scale: float = 0.0, digits: int = 5) -> str:
    """Format with a number of significant digits; what is rounding beside `scale` is 0."""
    return "0" if abs(value) <= _ROUNDING * scale else f"{value:.{digits}g}"


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
