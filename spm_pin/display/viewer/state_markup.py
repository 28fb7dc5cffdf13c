"""A state as HTML: what to know at a glance, never by colour alone, in the page's own light or dark colours."""

from __future__ import annotations

from html import escape
from string import Template

import numpy as np

from spm_pin.display.viewer.readings import NEAR
from spm_pin.display.viewer.state import State
from spm_pin.display.viewer.state_export import xyx_degrees
from spm_pin.mechanism.geometry import LEGS

__all__ = ["CALM", "PULL", "PUSH", "WARN", "forces_table", "instruments", "note", "status"]

# Okabe and Ito's palette, told apart with any colour vision.
CALM, WARN, PUSH, PULL = "#009E73", "#D55E00", "#0072B2", "#D55E00"

_BOX = "padding:0.35em 0.6em;font-size:0.8rem;line-height:1.35;white-space:nowrap;font-variant-numeric:tabular-nums"
_ROW = "display:grid;grid-template-columns:$columns;gap:0.5em;align-items:center;margin:0.16em 0"
_TRACK = "position:relative;height:0.62em;border-radius:0.3em;background:rgba(128,128,128,0.28);overflow:hidden"
_NAMES = ("forward, lower", "forward, upper", "inverse")


def status(state: State) -> str:
    """Return the branch, the position and what to say about it."""
    o, angles = state.shown.translation, xyx_degrees(state.shown)
    name = escape(state.label) or "no isolated branch"
    tags = ["physical" if state.readings.physical else "not physical"]
    if state.shown.geometry.limits is not None:
        tags.append("within limits" if not state.readings.beyond.any() else "beyond limits")
    lines = [
        f'<div style="font-size:0.95rem"><b data-spm="branch">{name}</b> &nbsp;{escape(", ".join(tags))}</div>',
        f'<div data-spm="pose" style="opacity:0.75;white-space:normal">o = ({o[0]:.3f}, {o[1]:.3f}, {o[2]:.3f}) m, '
        f"X-Y-X = ({angles[0]:.1f}, {angles[1]:.1f}, {angles[2]:.1f})°</div>",
    ]
    for notice in state.notices:
        warning = notice.level == "warning"
        sign, colour = ("⚠", WARN) if warning else ("ℹ", "#808080")
        lines.append(
            f'<div data-spm="{notice.level}" role="{"alert" if warning else "note"}" '
            f'style="border-left:3px solid {colour};padding:0.1em 0 0.1em 0.5em;margin-top:0.3em;white-space:normal">'
            f"{sign} {escape(notice.text)}</div>"
        )
    return f'<div style="{_BOX}">{"".join(lines)}</div>'


def instruments(state: State) -> str:
    """Return the legs against their limits, and the distances from singularities."""
    return f'<div style="{_BOX}">{_legs(state)}{_singularities(state)}</div>'


def _row(columns: str, cells: list[str]) -> str:
    return f'<div style="{Template(_ROW).substitute(columns=columns)}">{"".join(cells)}</div>'


def _legs(state: State) -> str:
    readings, limits = state.readings, state.shown.geometry.limits
    rows = ["<div><b>Leg lengths</b> in m" + (", between limits" if limits is not None else "") + "</div>"]
    for k, leg in enumerate(LEGS):
        length, beyond = float(readings.leg_lengths[k]), float(readings.beyond[k])
        # The track is the range allowed with a tenth on either side, so that a leg beyond it is seen to be.
        low, high = (limits.minimum[k], limits.maximum[k]) if limits is not None else (0.0, np.inf)
        ticks = [at for at, limit in ((10, low), (90, high)) if 0.0 < limit < np.inf]
        if not np.isfinite(high):
            high = low + 1.25 * float(readings.leg_lengths.max())
        share = float(np.clip(0.1 + 0.8 * (length - low) / (high - low), 0.0, 0.985))
        colour = WARN if beyond else (PUSH if k < 3 else "#E69F00")
        bar = (
            f'<div style="{_TRACK}"><div style="position:absolute;inset:0 auto 0 0;width:{100 * share:.1f}%;'
            f'background:{colour};opacity:0.85"></div>'
            + "".join(
                f'<div style="position:absolute;top:0;bottom:0;left:{at}%;width:2px;background:currentColor"></div>'
                for at in ticks
            )
            + "</div>"
        )
        mark = f"⚠ {1e3 * beyond:+.0f} mm" if beyond else ""
        rows.append(
            _row(
                "2.6em 1fr 2.8em 5em",
                [
                    f"<span>{leg}</span>",
                    bar,
                    f'<span data-spm="{leg}" style="text-align:right">{length:.3f}</span>',
                    f"<span>{mark}</span>",
                ],
            )
        )
    return "".join(rows)


def _singularities(state: State) -> str:
    readings, side = state.readings, state.shown.geometry.middle_side
    heading = "<b>Singularities</b>: leg travel to the next, σ, condition"
    rows = [f'<div style="margin-top:0.5em;white-space:normal">{heading}</div>']
    near = readings.near(side)
    for k, name in enumerate(_NAMES):
        travel, condition = float(readings.travel[k]), float(readings.condition[k])
        away = f"{1e3 * travel:.0f} mm" if np.isfinite(travel) else "–"
        share = 0.0 if not np.isfinite(travel) else min(travel / (10.0 * NEAR * side), 1.0)
        cond = f"{condition:.3g}" if np.isfinite(condition) and condition < 1e6 else "&gt;10⁶"
        bar = (
            f'<div style="{_TRACK}"><div style="position:absolute;inset:0 auto 0 0;width:{max(100 * share, 2.0):.1f}%;'
            f'background:{WARN if near[k] else CALM}"></div></div>'
        )
        cells = [
            f"<span>{'⚠ ' if near[k] else ''}{name}</span>",
            bar,
            f'<span style="text-align:right">{away}</span>',
            f'<span style="text-align:right">{readings.sigma[k]:.3f}</span>',
            f'<span style="text-align:right">{cond}</span>',
        ]
        rows.append(_row("8.6em 1fr 4.8em 2.9em 3em", cells))
    return "".join(rows)


def note(*lines: str) -> str:
    """Return lines of plain text."""
    text = "<br>".join(escape(line) for line in lines)
    return f'<div data-spm="note" style="padding:0.35em 0.6em;font-size:0.8rem">{text}</div>'


def forces_table(state: State) -> str:
    """Return the leg forces that hold the load, as bars from the middle."""
    forces = state.readings.forces
    if forces is None:
        return f'<div style="{_BOX}">⚠ The legs cannot hold every load here.</div>'
    largest = float(np.abs(forces).max())
    rows = ["<div><b>Leg forces</b> in N: ▲ pushes, ▼ pulls</div>"]
    for leg, force in zip(LEGS, forces, strict=True):
        share = 50.0 * abs(force) / largest if largest > 0.0 else 0.0
        side = "left:50%" if force >= 0.0 else "right:50%"
        bar = (
            f'<div style="{_TRACK}"><div style="position:absolute;top:0;bottom:0;{side};width:{share:.1f}%;'
            f'background:{PUSH if force >= 0.0 else PULL}"></div></div>'
        )
        sign = "" if abs(force) < 5e-4 else ("▲" if force > 0.0 else "▼")
        value = f'<span data-spm="force {leg}" style="text-align:right">{force:.1f} {sign}</span>'
        rows.append(_row("2.6em 1fr 6em", [f"<span>{leg}</span>", bar, value]))
    return f'<div style="{_BOX}">{"".join(rows)}</div>'
