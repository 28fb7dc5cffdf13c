"""CSV tables of motions and measurements: a heading that names the columns, then rows of numbers in SI units.

`time` [s]; `r_b1` to `r_c3`, readings of the legs [m]; `x`, `y`, `z`, the position of o in {B} [m]; `qx`, `qy`, `qz`,
`qw`, the rotation from {m} to {B} as a unit quaternion, scalar last; joints as `name.position` and so on. Each reader
takes the columns that it needs by their names, in any order; `MotionTable.unused` are the others.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.errors import ArgumentError
from spm_pin.support.arguments import COLUMNS, FloatArray, first_offender
from spm_pin.support.files import file_path, write_files
from spm_pin.support.pose import UNIT, first_wrong_quaternion, pose

TIME, POSITION, QUATERNION = "time", COLUMNS[3], COLUMNS[4]
NAMES = TIME, *POSITION, *QUATERNION, *COLUMNS[6]
"""Names of columns that readers take."""


class MotionTable:
    """A table read from a file; columns are converted to numbers when they are read."""

    def __init__(self, path: str | Path) -> None:
        self.path = file_path(path, suffixes=(".csv",))
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                reader = csv.reader(file)
                lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
        except (OSError, UnicodeDecodeError, csv.Error) as failed:
            reason = getattr(failed, "strerror", None) or str(failed)
            raise ArgumentError("", "a readable CSV file in UTF-8", reason, file=str(self.path)) from failed
        comments = [row for _, row in lines if row and row[0].startswith("#")]
        lines = [(number, row) for number, row in lines if any(row) and not row[0].startswith("#")]
        if len(lines) < 2:
            expected = "a heading that names the columns, then rows of numbers"
            raise ArgumentError("", expected, f"{len(lines)} lines", file=str(self.path))
        (number, self.names), *self._rows = lines
        heading = str(self.path), number
        self._taken: set[str] = set()
        if not np.isnan([_number(name) for name in self.names]).any():
            cause = "The first line looks like numbers: is the heading missing?"
            if any(set(NAMES) & {cell.strip("# ") for cell in row} for row in comments):
                cause = "The heading is a comment: remove its #, as numpy.savetxt does with comments=''"
            received = ", ".join(self.names[:3]) + ", …"
            raise ArgumentError("", "a heading that names the columns", received, cause, *heading)
        if len(self.names) == 1 and (separator := next((x for x in ";\t" if x in self.names[0]), "")):
            name = {";": "Semicolons", "\t": "Tabs"}[separator]
            cause = f"{name} instead of commas? Write numbers with points and separate them by commas"
            raise ArgumentError("", "a heading of names separated by commas", self.names[0][:60], cause, *heading)
        twice = [name for name, count in Counter(self.names).items() if count > 1]
        if twice:
            raise ArgumentError(
                "", "a heading without repeated columns", f"repeated {', '.join(twice[:3])}", "", *heading
            )
        for number, cells in self._rows:
            if len(cells) != len(self.names):
                expected = f"{len(self.names)} values, one per column of the heading"
                cause = "Are decimal commas used?" if len(cells) == 2 * len(self.names) else ""
                raise ArgumentError("", expected, len(cells), cause, str(self.path), number)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def lines(self) -> list[int]:
        """Line number in the file at which each row ends."""
        return [line for line, _ in self._rows]

    @property
    def unused(self) -> tuple[str, ...]:
        """Columns that have not been read so far."""
        return tuple(name for name in self.names if name not in self._taken)

    def has(self, names: Sequence[str]) -> bool:
        """Return whether the table has at least one of these columns."""
        return not set(names).isdisjoint(self.names)

    def columns(self, names: Sequence[str], *, missing: bool = False) -> FloatArray:
        """Return columns as an array (n, number of names); with `missing` an empty cell is NaN."""
        absent = [name for name in names if name not in self.names]
        if absent:
            expected = f"a heading with the columns {', '.join(names)}"
            raise ArgumentError("", expected, f"a heading without {', '.join(absent)}", file=str(self.path), line=1)
        self._taken.update(names)
        places = [self.names.index(name) for name in names]
        numbers = np.array([[_number(cells[place]) for place in places] for _, cells in self._rows])
        wrong = ~np.isfinite(numbers)
        if missing:
            wrong &= np.array([[cells[place] != "" for place in places] for _, cells in self._rows])
        if wrong.any():
            row, column = first_offender(wrong)
            line, cells = self._rows[row]
            cell = cells[places[column]]
            cause = "Is it a decimal comma?" if "," in cell else ""
            received = repr(cell) if cell else "nothing"
            raise ArgumentError(f"column {names[column]}", "a finite number", received, cause, str(self.path), line)
        return numbers

    def poses(self) -> RigidTransform | FloatArray | None:
        """Return poses (n,), or positions (n, 3) if there is no quaternion; None if there are no positions."""
        if not self.has(POSITION + QUATERNION):
            return None
        position = self.columns(POSITION)
        if not self.has(QUATERNION):
            return position
        quaternion = self.columns(QUATERNION)
        wrong = first_wrong_quaternion(quaternion)
        if wrong is not None:
            (row,), received, cause = wrong
            raise ArgumentError("columns qx to qw", UNIT, received, cause, str(self.path), self.lines[row])
        return pose(position, quat=quaternion)

    def times(self) -> FloatArray | None:
        """Return increasing times (n,) [s], or None."""
        if not self.has([TIME]):
            return None
        times = self.columns([TIME])[:, 0]
        backward = np.diff(times) <= 0.0
        if backward.any():
            row = 1 + int(backward.argmax())
            received, line = f"{times[row]:g} after {times[row - 1]:g}", self.lines[row]
            raise ArgumentError(f"column {TIME}", "increasing times in seconds", received, "", str(self.path), line)
        return np.asarray(times)


def _number(cell: str) -> float:
    """Return a number, or NaN where a cell holds none."""
    try:
        return math.nan if "_" in cell else float(cell)  # Python reads 1_2 as 12
    except ValueError:
        return math.nan


def table_text(columns: Mapping[str, FloatArray]) -> str:
    """Return columns (n,) by their names as the text of a CSV file, with the digits that float64 needs."""
    rows = np.column_stack(list(columns.values())) + 0.0  # no negative zeros
    return "".join(",".join(row) + "\n" for row in (list(columns), *(map(repr, row) for row in rows.tolist())))


def write_table(columns: Mapping[str, FloatArray], path: str | Path) -> None:
    """Write columns (n,) by their names as a CSV file."""
    path = file_path(path, suffixes=(".csv",))
    write_files({path: table_text(columns)})
