"""The report of a cross-check as one HTML file that needs nothing else."""

from __future__ import annotations

from html import escape
from math import log10

from spm_pin.crosscheck.report import Report
from spm_pin.crosscheck.verdicts import Comparison, Quantity, Standing

__all__ = ["page"]

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #57606a; --paper: #ffffff; --card: #f6f8fa;
  --line: #d0d7de; --good: #1a7f37; --bad: #cf222e; --bar: #0072b2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6edf3; --soft: #9198a1; --paper: #0d1117; --card: #161b22;
  --line: #30363d; --good: #3fb950; --bad: #ff7b72; --bar: #56b4e9; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem; max-width: 60rem; color: var(--ink); background: var(--paper);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .3rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .6rem; }
p { margin: .4rem 0; } .soft { color: var(--soft); }
.verdict { border-left: .35rem solid var(--good); background: var(--card); padding: .7rem 1rem; margin: 1rem 0;
  font-weight: 600; border-radius: .3rem; }
.verdict.bad { border-color: var(--bad); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: .8rem; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: .5rem; padding: .8rem 1rem; }
.card h3 { margin: 0 0 .3rem; font-size: 1rem; } .card p { margin: .1rem 0; font-size: .9rem; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: .9rem; }
th, td { text-align: left; padding: .35rem .6rem .35rem 0; border-bottom: 1px solid var(--line); white-space: nowrap; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
.scale { position: relative; width: 9rem; height: .6rem; background: var(--line); border-radius: .3rem; }
.scale i { position: absolute; inset: 0 auto 0 0; background: var(--bar); border-radius: .3rem; }
.bad .scale i { background: var(--bad); } .bad td { color: var(--bad); }
pre { background: var(--card); border: 1px solid var(--line); border-radius: .5rem; padding: .7rem; margin: .4rem 0;
  white-space: pre-wrap; overflow-wrap: anywhere; font-size: .85rem; }
"""
# The bar is logarithmic: empty at a share of the tolerance of 10⁻⁸, full where it is used up.
_DECADES = 8.0


def page(report: Report, geometry_file: str | None = None) -> str:
    """Return the report as HTML, readable on a phone, by day and by night; `geometry_file` as for its commands."""
    geometry = report.geometry
    dimensions = (
        f"E = {geometry.base_radius:.4g} m, C = {geometry.platform_radius:.4g} m, d = {geometry.middle_side:.4g} m"
    )
    body = [
        "<h1>Cross-check of the witnesses</h1>",
        f'<p class="soft">3RPS-3SPR manipulator, {dimensions}; {len(report.xyx)} poses, {report.reached} of them '
        f"reached, {report.states} configurations, seed {report.seed}.</p>",
        f'<p class="verdict{"" if report.agrees else " bad"}">{escape(report.verdict)}</p>',
        "<h2>Witnesses</h2>",
        f'<div class="cards">{"".join(_card(standing) for standing in report.standings)}</div>',
    ]
    for quantity in Quantity:
        rows = [one for one in report.comparisons if one.quantity is quantity]
        if rows:
            body += [f"<h2>{quantity.value[0].upper()}{quantity.value[1:]}</h2>", _table(rows)]
    worst = report.worst
    if worst is not None:
        body += [
            "<h2>The worst pose</h2>",
            f"<p>{escape(worst.first)} and {escape(worst.second)}, {worst.quantity.value}, branch {worst.branch}: "
            f"{worst.ratio:.1e} of the tolerance.</p>",
            f"<pre>{escape(report.command(worst.pose, geometry_file))}</pre>",
        ]
    body.append(
        '<p class="soft">A tolerance is what the witnesses&rsquo; rounding can do to an answer at that configuration; '
        "it follows from the loop equations&rsquo; smallest singular value. Bars are logarithmic, from 10⁻⁸ of the "
        "tolerance to all of it.</p>"
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Cross-check of the witnesses</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _card(standing: Standing) -> str:
    lines = [f"<h3>{escape(standing.name)}</h3>"]
    if standing.solved:
        missed = f"missed at {standing.missed}" if standing.missed else "none missed"
        allowance = f" (states up to {100 * standing.allowed:g} %)" if standing.allowed else ""
        lines += [
            f"<p>{standing.branches} branches of {standing.solved} poses</p>",
            f"<p>{missed}{allowance}, {standing.invented or 'none'} invented</p>",
            f"<p>closure residual up to {standing.residual:.1e} of what it states</p>",
        ]
    else:
        lines.append("<p>solves no inverse displacement</p>")
    if standing.blame:
        lines.append(f"<p><strong>outvoted {standing.blame} times</strong></p>")
    return f'<div class="card">{"".join(lines)}</div>'


def _table(rows: list[Comparison]) -> str:
    head = (
        '<tr><th>pair</th><th class="number">states</th><th class="number">worst</th>'
        '<th class="number">tolerance</th><th class="number">share of it</th>'
        '<th>on a log scale</th><th class="number">differ</th></tr>'
    )
    lines = []
    for one in rows:
        unit = f" {one.quantity.unit}" if one.quantity.unit else ""
        filled = 100.0 * min(1.0, max(0.0, 1.0 + _log10(one.ratio) / _DECADES))
        lines.append(
            f"<tr{' class=bad' if one.disagreements else ''}><td>{escape(one.first)} – {escape(one.second)}</td>"
            f'<td class="number">{one.compared}</td><td class="number">{one.worst:.1e}{unit}</td>'
            f'<td class="number">{one.tolerance:.1e}{unit}</td>'
            f'<td class="number">{one.ratio:.0e}</td>'
            f'<td><div class="scale"><i style="width:{filled:.0f}%"></i></div></td>'
            f'<td class="number">{one.disagreements or "none"}</td></tr>'
        )
    return f'<div class="scroll"><table>{head}{"".join(lines)}</table></div>'


def _log10(ratio: float) -> float:
    return log10(ratio) if ratio > 0.0 else -_DECADES
