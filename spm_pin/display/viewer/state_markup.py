"""A state as HTML: status, instruments and forces, never by colour alone, in the page's own light or dark colours."""

from __future__ import annotations

from html import escape

import numpy as np

from spm_pin.display.json_text import fixed
from spm_pin.display.viewer.readings import NEAR
from spm_pin.display.viewer.slider_ranges import pose_coordinates
from spm_pin.display.viewer.state import State
from spm_pin.mechanism.leg_limits import LEGS

# After Okabe and Ito's palette, distinct with any colour vision. Limits and warnings have a red of their own, darker
# than all colours of the robot.
_CALM, _UPPER, WARN, PUSH, PULL, LOAD = "#009E73", "#E69F00", "#C8102E", "#0072B2", "#D55E00", "#7A4FB5"

_BOX = "padding:0.35em 1em 0.35em 0.6em;font-size:0.8rem;line-height:1.4;font-variant-numeric:tabular-nums"
# One grid for all rows: a column is as wide as its widest text, and the bars take what is left.
_GRID = "display:grid;grid-template-columns:{columns};gap:0.15em 0.6em;align-items:center;white-space:nowrap"
_TRACK = "position:relative;height:0.62em;border-radius:0.3em;background:rgba(128,128,128,0.28);overflow:hidden"
_RIGHT = "text-align:right"


def _length(value: float) -> str:
    """Return a length in mm, or in m from ten metres on."""
    return f"{fixed(1e3 * value, 0)} mm" if abs(value) < 9.9995 else f"{fixed(value, 1)} m"


def _signed_length(value: float) -> str:
    return ("+" if value > 0.0 else "−") + _length(abs(value))


def status(state: State) -> str:
    """Return the branch, the position and the notices."""
    values = pose_coordinates(state.shown.pose)
    o, angles = (", ".join(fixed(x, digits) for x in part) for part, digits in ((values[:3], 3), (values[3:], 1)))
    name = escape(state.label) or "no isolated branch"
    tags = ["physical" if state.readings.physical else "not physical"]
    if state.shown.geometry.limits is not None:
        tags.append("within limits" if not state.readings.beyond.any() else "beyond limits")
    lines = [
        f'<div style="font-size:0.95rem"><b data-spm="branch">{name}</b> &nbsp;{escape(", ".join(tags))}</div>',
        f'<div data-spm="pose" style="opacity:0.75">o = ({o}) m, X-Y-X = ({angles})\u2060°</div>',
    ]
    for notice in state.notices:
        warning = notice.level == "warning"
        sign, colour = ("⚠", WARN) if warning else ("ℹ", "#808080")
        lines.append(
            f'<div data-spm="{notice.level}" role="{"alert" if warning else "note"}" '
            f'style="border-left:3px solid {colour};padding:0.1em 0 0.1em 0.5em;margin-top:0.3em">'
            f"{sign} {escape(notice.text)}</div>"
        )
    return f'<div style="{_BOX}">{"".join(lines)}</div>'


def instruments(state: State) -> str:
    """Return the legs against their limits, and the distances from singularities."""
    return f'<div style="{_BOX}">{_legs(state)}{_singularities(state)}</div>'


def note(*lines: str) -> str:
    """Return lines of plain text."""
    text = "<br>".join(escape(line) for line in lines)
    return f'<div data-spm="note" style="{_BOX}">{text}</div>'


def _grid(columns: str, cells: list[str]) -> str:
    return f'<div style="{_GRID.format(columns=columns)}">{"".join(cells)}</div>'


def _cell(text: str, style: str = "", name: str = "") -> str:
    tag = f' data-spm="{name}"' if name else ""
    return f'<span{tag} style="{style}">{text}</span>'


def _bar(share: float, colour: str, ticks: tuple[float, ...] = (), side: str = "left", start: float = 0.0) -> str:
    """Return a track with a bar of a share of it, from its start on a side, and ticks at shares."""
    marks = "".join(
        f'<div style="position:absolute;top:0;bottom:0;left:{100.0 * at:.1f}%;width:2px;background:currentColor"></div>'
        for at in ticks
    )
    filled = f"position:absolute;top:0;bottom:0;{side}:{100.0 * start:.1f}%;width:{100.0 * share:.1f}%"
    return f'<div style="{_TRACK}"><div style="{filled};background:{colour};opacity:0.85"></div>{marks}</div>'


def _legs(state: State) -> str:
    readings, lengths, limits = state.readings, state.shown.leg_lengths, state.shown.geometry.limits
    cells = []
    for k, leg in enumerate(LEGS):
        length, beyond = float(lengths[k]), float(readings.beyond[k])
        # The track is the range allowed with a tenth on either side, so that a leg beyond it is seen to be.
        low, high = (limits.minimum[k], limits.maximum[k]) if limits is not None else (0.0, np.inf)
        ticks = tuple(at for at, limit in ((0.1, low), (0.9, high)) if 0.0 < limit < np.inf)
        if not np.isfinite(high):
            high = low + 1.25 * float(lengths.max())
        share = float(np.clip(0.1 + 0.8 * (length - low) / max(high - low, 1e-12), 0.0, 1.0))
        colour = WARN if beyond else (PUSH if k < 3 else _UPPER)
        mark = f"⚠ {_signed_length(beyond)}" if beyond else ""
        value = _cell(fixed(length, 3), _RIGHT, leg)
        cells += [_cell(leg), _bar(share, colour, ticks), value, _cell(mark, f"color:{WARN};font-weight:600")]
    unit = "in m" + (", between limits" if limits is not None else "")
    columns = "max-content minmax(3em,1fr) max-content max-content"
    return f"<div><b>Leg lengths</b> {unit}</div>{_grid(columns, cells)}"


def _singularities(state: State) -> str:
    readings, side = state.readings, state.shown.geometry.middle_side
    near, found = readings.near, readings.singularities
    cells = [_cell(text, f"opacity:0.7;{_RIGHT}") for text in ("", "", "away", "σ", "cond")]
    for k, name in enumerate(("forward, lower", "forward, upper", "inverse")):
        travel, condition = float(readings.travel[k]), float(found.condition[k])
        finite = np.isfinite(travel)
        share = min(travel / (10.0 * NEAR * side), 1.0) if finite else 0.0
        cells += [
            _cell(f"{'⚠ ' if near[k] else ''}{name}"),
            _bar(max(share, 0.02), WARN if near[k] else _CALM),
            _cell(_length(travel) if finite else "–", _RIGHT),
            _cell(fixed(found.sigma[k], 3), _RIGHT),
            _cell(f"{condition:.3g}" if np.isfinite(condition) and condition < 1e5 else "&gt;10⁵", _RIGHT),
        ]
    columns = "max-content minmax(2em,1fr) max-content max-content max-content"
    heading = '<div style="margin-top:0.4em"><b>Singularities</b>, in leg travel</div>'
    return heading + _grid(columns, cells)


def forces_table(state: State) -> str:
    """Return the leg forces that hold the load, as bars from the middle."""
    forces = state.readings.forces
    if forces is None:
        return note("⚠ The legs cannot hold every load here.")
    largest = float(np.abs(forces).max())
    cells = []
    for leg, force in zip(LEGS, forces, strict=True):
        share = 0.5 * abs(force) / largest if largest > 0.0 else 0.0
        pushes = force >= 0.0
        bar = _bar(share, PUSH if pushes else PULL, side="left" if pushes else "right", start=0.5)
        sign = "" if abs(force) < 5e-4 else ("▲" if pushes else "▼")
        shown = fixed(force, 1) if abs(force) < 1e6 else f"{force:.3g}"
        cells += [_cell(leg), bar, _cell(shown, _RIGHT, f"force {leg}"), _cell(sign)]
    columns = "max-content minmax(3em,1fr) max-content 1em"
    soft = f"<div>Softest direction of o: {state.readings.softest:.2g} × the stiffness of a leg</div>"
    heading = "<div><b>Leg forces</b> in N: ▲ pushes, ▼ pulls</div>"
    return f'<div style="{_BOX}">{heading}{_grid(columns, cells)}{soft}</div>'
