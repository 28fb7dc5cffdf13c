"""Figure of a comparison of methods: how much of its tolerance each pair uses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spm_pin.crosscheck import Quantity, Report
from spm_pin.display.figure_files import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["agreement_figure"]

_COLOURS = {
    Quantity.POSITIONS: "#0072b2",
    Quantity.JACOBIAN: "#009e73",
    Quantity.FORCES: "#e69f00",
    Quantity.ASSEMBLY: "#cc79a7",
}
_SMALLEST = 1e-8


def agreement_figure(report: Report) -> Figure:
    """Draw the largest difference of every pair of methods as a share of its tolerance, on a logarithmic axis."""
    pairs = report.differences
    figure = new_figure(8.0, 1.6 + 0.24 * len(pairs), layout="constrained")
    ax = figure.add_subplot()
    rows = range(len(pairs))
    for quantity, colour in _COLOURS.items():
        chosen = [k for k in rows if pairs[k].quantity is quantity]
        ratios = [max(pairs[k].ratio, _SMALLEST) for k in chosen]
        ax.barh(chosen, ratios, left=_SMALLEST, height=0.7, color=colour, label=str(quantity))
    ax.axvline(1.0, color="#d62728", linewidth=2.0)
    ax.set_xscale("log")
    ax.set_xlim(_SMALLEST, max(10.0, 2.0 * max((pair.ratio for pair in pairs), default=0.0)))
    ax.set_yticks(list(rows), [f"{pair.first} – {pair.second}" for pair in pairs])
    ax.invert_yaxis()
    ax.set_xlabel("largest difference over its tolerance (red line: the tolerance)")
    figure.legend(loc="outside lower center", ncols=len(_COLOURS), frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_title(f"{report.verdict} {len(report.xyx)} poses, {report.states} configurations", loc="left")
    return figure
