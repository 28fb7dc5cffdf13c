"""Results as Markdown; every number in it is one that was measured in the same run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.timing import Spread

Facts = dict[str, Spread]
"""Measured values that the targets are compared with, by key."""


@dataclass
class Section:
    """A heading and what is under it."""

    title: str
    blocks: list[str] = field(default_factory=list)

    def add(self, block: str) -> None:
        """Append a paragraph or a table."""
        self.blocks.append(block)

    @property
    def markdown(self) -> str:
        """The section as text."""
        return "\n\n".join([f"## {self.title}", *self.blocks])


def three_digits(value: float) -> str:
    """Return a number with three significant digits, without an exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    places = 2 - math.floor(math.log10(abs(value)))
    return f"{value:.{places}f}" if places > 0 else _spaced(round(value, places))


def _spaced(value: float) -> str:
    """Return a whole number, from ten thousand on in groups of three."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 10_000 else f"{value:.0f}"


def microseconds(spread: Spread) -> Spread:
    """Return a time in seconds in microseconds."""
    return Spread(*(1e6 * x for x in (spread.median, spread.low, spread.high)))


def seconds(value: float) -> str:
    """Return a time with its unit."""
    return spread_of_seconds(Spread(value, value, value))[0]


def spread_of_seconds(spread: Spread) -> list[str]:
    """Return two cells: the median of a time, and its quartiles in the same unit."""
    units = (("ns", 1e9, 100.0), ("µs", 1e6, 1e3), ("ms", 1e3, 1e3), ("s", 1.0, math.inf))
    unit, factor = next((unit, factor) for unit, factor, limit in units if spread.median * factor < limit)
    low, median, high = (three_digits(value * factor) for value in (spread.low, spread.median, spread.high))
    return [f"{median} {unit}", f"{low} – {high} {unit}"]


def times(spread: Spread) -> list[str]:
    """Return two cells: the median of a ratio, and its quartiles."""
    return [three_digits(spread.median), f"{three_digits(spread.low)} – {three_digits(spread.high)}"]


def size(number: float) -> str:
    """Return a number of bytes with its unit."""
    for unit, factor in (("B", 1.0), ("kB", 1e3), ("MB", 1e6)):
        if number < 1000.0 * factor:
            return f"{three_digits(number / factor)} {unit}"
    return f"{three_digits(number / 1e9)} GB"


def count(number: int) -> str:
    """Return a whole number, powers of ten as such."""
    exponent = round(math.log10(number)) if number > 0 else 0
    if number >= 10_000 and number == 10**exponent:
        return f"10{str(exponent).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    return _spaced(number)


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    """Return a table; the first `left` columns are text, the others numbers."""
    rule = ["---" if column < left else "---:" for column in range(len(header))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [header, rule, *rows])


def write(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    beside = path.with_name(f"{path.name}.part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)
