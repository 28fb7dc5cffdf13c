"""Texts about a set of solutions: a line, an HTML table for notebooks, and why none can be chosen.

All take a `SolutionSet`.
"""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.leg_limits import LEGS
from spm_pin.mechanism.solution_status import Status
from spm_pin.mechanism.units import unit_hint

_MOST_ROWS = 16
"""Solutions that a table shows."""


def short_text(solutions: Any) -> str:
    """Return a line: the solutions that are real of a single problem, or the outcomes of a batch."""
    if solutions.shape:
        tally = ", ".join(f"{np.count_nonzero(solutions.status == s)} {s}" for s in Status)
        return f"<SolutionSet: {solutions.shape} problems ({tally}), {len(solutions.labels)} solutions each>"
    real = [label for label, real in zip(solutions.labels, solutions.exists, strict=True) if real]
    shown = (", ".join(real[:8]) + ", …" * (len(real) > 8)) or "none"
    hint = _hint(solutions, ()) if solutions.status is Status.UNREACHABLE else ""
    return f"<SolutionSet: {solutions.status}, {solutions.count} of {len(solutions.labels)} real: {shown}{hint}>"


def html_table(solutions: Any) -> str:
    """Return a small table: the solutions of a single problem, or the outcomes of a batch."""
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


def reason_for_none(solutions: Any, index: tuple[int, ...] = ()) -> str:
    """Return the reason why no solution of a problem can be chosen."""
    status, degeneracy = Status(int(np.asarray(solutions.status)[index])), solutions.degeneracy
    if status is Status.DEGENERATE:
        if solutions.labels == BRANCHES and degeneracy is not None and degeneracy.legs[index].all():
            return (
                "a level platform over the axis of the base is singular for the inverse, its solutions are a "
                "continuous family. Give leg lengths to forward_physical instead; or tilt the pose, which makes "
                "the solutions isolated, and choose with .nearest(near)"
            )
        return "the pose or the leg lengths are singular, the solutions are a continuous family; see .degeneracy"
    if status is Status.OK:
        return "none of the solutions is physical, or .within(limits) and .where(mask) excluded them"
    if status is Status.UNREACHABLE:
        return f"out of reach: no solution is real{_hint(solutions, index)}"
    return "the method failed here"


def _hint(solutions: Any, index: tuple[int, ...]) -> str:
    """Return the likely unit of an unreachable problem's lengths, as a sentence after a stop; or an empty string."""
    hint = solutions.configurations.missing_reason or unit_hint(solutions.geometry, solutions.translation[index][0])
    return hint and f". {hint}"
