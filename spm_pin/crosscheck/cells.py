"""Cells of the paper's tables: the printed number, the true one, and the verdict on the difference."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from decimal import Decimal


class Verdict(enum.StrEnum):
    """Verdict on a printed cell."""

    SAME = "same"
    MISPRINT = "misprint"
    NOT_PRINTED = "not printed"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Cell:
    """One cell of a table in the paper's units: cm, cm/s, kN."""

    table: int
    """Number of the table, from 1 to 5; `POSE` for the pose of the example."""
    row: str
    """Name of the row, as `b_1 X` or `r_b1`."""
    column: str
    """Number of the solution, from 1 to 8, as the paper counts them."""
    published: str | None
    """The number as printed; None where the cell is empty."""
    recomputed: complex
    """The true number [cm, cm/s, kN, or degrees for the angles of the pose]; complex in Tables 1 to 3."""
    verdict: Verdict
    """Whether they agree, and if not, whether the cause is known."""
    note: str = ""
    """The cause of a difference, in words; empty where they agree."""

    @property
    def difference(self) -> float | None:
        """Modulus of recomputed minus printed; None where nothing is printed."""
        return None if self.published is None else abs(self.recomputed - number(self.published))


def matches(published_value: str, recomputed: complex) -> bool:
    """Return whether a number rounds to the digits printed; a plain "0" stands for zero itself."""
    parts = zip(_parts(published_value), (recomputed.real, recomputed.imag), strict=True)
    return all(_agrees(digits, value) for digits, value in parts)


def _agrees(digits: str, value: float) -> bool:
    if digits == "0":
        return abs(value) < 1e-9
    exponent = Decimal(digits).as_tuple().exponent
    assert isinstance(exponent, int)
    half_a_unit = 0.5 * 10.0**exponent
    return abs(value - float(digits)) <= half_a_unit * (1.0 + 1e-9)


def _parts(text: str) -> tuple[str, str]:
    """Split "a+bi" into its parts; a real number has the imaginary part "0"."""
    if not text.endswith("i"):
        return text, "0"
    split = max(text.rfind("+"), text.rfind("-"))
    return text[:split], text[split:-1]


def number(text: str | None) -> complex:
    """Return a printed number; NaN where nothing is printed."""
    return complex("nan" if text is None else text.replace("i", "j"))
