"""A set of solutions as an HTML table, for notebooks."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from spm_pin.mechanism.geometry import LEGS
from spm_pin.mechanism.solution_status import Status

__all__ = ["html_table"]

_MOST_ROWS = 16
"""Solutions that are shown."""


def html_table(solutions: Any) -> str:
    """Return a small table of a `SolutionSet`: the solutions of a single problem, or the outcomes of a batch."""
    if solutions.shape:
        header = ["status", "problems", "solutions"]
        at = [(status, solutions.status == status) for status in Status]
        rows = [[str(s), f"{np.count_nonzero(m)}", f"{np.count_nonzero(solutions.exists[m])}"] for s, m in at]
    else:
        header = ["", *(f"{leg} [m]" for leg in LEGS), "physical"]
        shown = np.flatnonzero(solutions.exists)[:_MOST_ROWS]
        marks = np.where(solutions.is_physical, "✓", "")
        lengths = solutions.leg_lengths
        rows = [[solutions.labels[i], *(f"{r:.4f}" for r in lengths[i]), str(marks[i])] for i in shown]
        if solutions.count > len(shown):
            rows.append([f"… {solutions.count - len(shown)} more", *[""] * 7])
    lines = [f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows]
    top = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    title = html.escape(repr(solutions))
    return f"<table><caption>{title}</caption><thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
